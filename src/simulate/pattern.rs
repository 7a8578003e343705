//! What a target shows: outlines in planes z = const of the target frame.
//!
//! Frame: pairs have disc 0 at the origin and disc 1 at (+spacing, 0); grids and plates have the dot labelled (0, 0)
//! at the origin. x along columns, y along rows, z towards the viewer of the printed side.

use super::random::{Stream, Use};
use super::scene::{MarkWord, TargetKeys};
use crate::target::DotId;
use crate::target::TargetKind as Kind;
use nalgebra::{Vector2, Vector3};

/// An outline, in mm about its centre.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Outline {
    Disc {
        radius_mm: f64,
    },
    Ring {
        radius_mm: f64,
        hole_mm: f64,
    },
    /// Convex; unit outward normals with the distance of each side from the centre.
    Polygon {
        sides: Vec<(Vector2<f64>, f64)>,
        corners_mm: Vec<Vector2<f64>>,
    },
}

/// One thing printed on a target, or one bubble.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Feature {
    pub(super) id: DotId,
    pub(super) mark: Option<MarkWord>,
    pub(super) center_mm: Vector3<f64>,
    pub(super) outline: Outline,
}

/// All features of a target and the middle by which a scene places it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Pattern {
    pub(super) features: Vec<Feature>,
    pub(super) middle_mm: Vector3<f64>,
}

impl Outline {
    /// Depth inside the outline (positive inside, mm) and its gradient, at a point about the centre.
    ///
    /// Exact for discs and rings; outside the corners of a polygon an underestimate of the distance.
    #[inline]
    pub(super) fn depth(&self, p: &Vector2<f64>) -> (f64, Vector2<f64>) {
        match self {
            Outline::Disc { radius_mm } => {
                let (r, away) = polar(p);
                (radius_mm - r, -away)
            }
            Outline::Ring { radius_mm, hole_mm } => {
                let (r, away) = polar(p);
                if radius_mm - r < r - hole_mm { (radius_mm - r, -away) } else { (r - hole_mm, away) }
            }
            Outline::Polygon { sides, .. } => {
                let mut nearest = (f64::INFINITY, Vector2::zeros());
                for (normal, distance) in sides {
                    let depth = distance - normal.dot(p);
                    if depth < nearest.0 {
                        nearest = (depth, -normal);
                    }
                }
                nearest
            }
        }
    }

    /// `count` points on the outer outline about the centre, mm (a polygon gives its corners).
    pub(super) fn rim(&self, count: usize) -> Vec<Vector2<f64>> {
        match self {
            Outline::Disc { radius_mm } | Outline::Ring { radius_mm, .. } => {
                let angle = |i: usize| std::f64::consts::TAU * i as f64 / count as f64;
                (0..count).map(|i| Vector2::new(angle(i).cos(), angle(i).sin()) * *radius_mm).collect()
            }
            Outline::Polygon { corners_mm, .. } => corners_mm.clone(),
        }
    }

    /// Radius of the outer circle, mm; none for a polygon.
    pub(super) fn radius_mm(&self) -> Option<f64> {
        match self {
            Outline::Disc { radius_mm } | Outline::Ring { radius_mm, .. } => Some(*radius_mm),
            Outline::Polygon { .. } => None,
        }
    }

    /// A convex polygon from its corners, counter-clockwise.
    fn polygon(corners_mm: Vec<Vector2<f64>>) -> Self {
        let n = corners_mm.len();
        let side = |i: usize| {
            let along = corners_mm[(i + 1) % n] - corners_mm[i];
            let normal = Vector2::new(along.y, -along.x).normalize();
            (normal, normal.dot(&corners_mm[i]))
        };
        Outline::Polygon { sides: (0..n).map(side).collect(), corners_mm }
    }
}

fn polar(p: &Vector2<f64>) -> (f64, Vector2<f64>) {
    let r = p.norm();
    (r, if r > 0.0 { p / r } else { Vector2::x() })
}

/// Two discs, disc 0 at the origin.
pub(super) fn pair(radii_mm: [f64; 2], spacing_mm: f64) -> Pattern {
    let disc = |i: usize| Feature {
        id: DotId { column: i as i32, row: 0, level: 0 },
        mark: None,
        center_mm: Vector3::new(spacing_mm * i as f64, 0.0, 0.0),
        outline: Outline::Disc { radius_mm: radii_mm[i] },
    };
    // The middle of the whole figure, not of the two centres, so that it sits in the image as asked for.
    let middle = 0.5 * (spacing_mm + radii_mm[1] - radii_mm[0]);
    Pattern { features: vec![disc(0), disc(1)], middle_mm: Vector3::new(middle, 0.0, 0.0) }
}

/// The pattern of a dot grid or a two-level plate, nominal places.
pub(super) fn grid(t: &TargetKeys) -> Pattern {
    let (pitch, radius) = (t.spacing_mm.unwrap_or(1.0), t.radius_mm.unwrap_or(0.1));
    let (columns, rows) = (t.columns.unwrap_or(0) as i32, t.rows.unwrap_or(0) as i32);
    let plate = t.kind == Kind::TwoLevelPlate;
    let unit = if plate { 0.5 * pitch } else { pitch };
    let depth = t.step_mm.unwrap_or(0.0);
    let place =
        |id: &DotId| Vector3::new(f64::from(id.column) * unit, f64::from(id.row) * unit, -depth * f64::from(id.level));
    let mut features = Vec::new();
    for row in 0..rows {
        for column in 0..columns {
            let (c, r) = (column - t.origin[0], row - t.origin[1]);
            let front = if plate { (2 * c, 2 * r) } else { (c, r) };
            features.push((DotId { column: front.0, row: front.1, level: 0 }, None));
            if plate && row + 1 < rows && column + 1 < columns {
                features.push((DotId { column: 2 * c + 1, row: 2 * r + 1, level: 1 }, None));
            }
        }
    }
    for m in &t.marks {
        let id = DotId { column: m.column, row: m.row, level: m.level };
        match features.iter_mut().find(|(dot, _)| *dot == id) {
            Some(found) => found.1 = Some(m.kind),
            None => features.push((id, Some(m.kind))),
        }
    }
    let feature = |(id, mark): (DotId, Option<MarkWord>)| Feature {
        id,
        mark,
        center_mm: place(&id),
        outline: outline(mark, radius, t.ring_hole, t.large_factor),
    };
    let last = |n: i32, origin: i32| {
        unit * f64::from(if plate { 2 } else { 1 }) * (0.5 * f64::from(n - 1) - f64::from(origin))
    };
    let middle_mm = Vector3::new(last(columns, t.origin[0]), last(rows, t.origin[1]), 0.0);
    Pattern { features: features.into_iter().map(feature).collect(), middle_mm }
}

fn outline(mark: Option<MarkWord>, radius_mm: f64, hole: f64, large: f64) -> Outline {
    let corner = |x: f64, y: f64| Vector2::new(x, y) * radius_mm;
    match mark {
        None => Outline::Disc { radius_mm },
        Some(MarkWord::Ring) => Outline::Ring { radius_mm, hole_mm: hole * radius_mm },
        Some(MarkWord::Large) => Outline::Disc { radius_mm: large * radius_mm },
        Some(MarkWord::Square) => {
            Outline::polygon(vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)])
        }
        // Its centroid is the place of the mark.
        Some(MarkWord::Triangle) => {
            let h = 3.0_f64.sqrt();
            Outline::polygon(vec![corner(-1.0, -h / 3.0), corner(1.0, -h / 3.0), corner(0.0, 2.0 * h / 3.0)])
        }
    }
}

/// Move every feature in its plane by a normal error of `sigma_um`, the same in all views.
pub(super) fn misprint(pattern: &mut Pattern, sigma_um: f64, seed: u64) {
    let mut stream = Stream::new(seed, Use::Print, &[]);
    for f in &mut pattern.features {
        f.center_mm.x += 1e-3 * sigma_um * stream.normal();
        f.center_mm.y += 1e-3 * sigma_um * stream.normal();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_is_positive_inside_and_its_gradient_leads_inwards() {
        for (mark, inside) in
            [(None, 0.3), (Some(MarkWord::Ring), 0.7), (Some(MarkWord::Square), 0.3), (Some(MarkWord::Triangle), 0.1)]
        {
            let o = outline(mark, 1.0, 0.3, 1.6);
            for angle in [0.1, 1.3, 2.9, 4.4] {
                let along = Vector2::new(f64::cos(angle), f64::sin(angle));
                let (depth, gradient) = o.depth(&(along * inside));
                assert!(depth > 0.0);
                assert!((gradient.norm() - 1.0).abs() < 1e-12);
                assert!((o.depth(&(along * inside + gradient * 1e-4)).0 - depth - 1e-4).abs() < 1e-8);
                assert!(o.depth(&(along * 2.0)).0 < 0.0);
            }
        }
        assert!(
            outline(Some(MarkWord::Ring), 1.0, 0.4, 1.6).depth(&Vector2::new(0.1, 0.0)).0 < 0.0,
            "the hole is empty"
        );
    }

    #[test]
    fn plate_dots_alternate_between_two_levels_and_marks_sit_between_dots() {
        let text = "kind = 'two-level-plate'\npolarity = 'bright'\nspacing_mm = 15.0\nradius_mm = 1.6\ncolumns = 4\nrows = 3\norigin = [1, 1]\nstep_mm = 3.0\nmarks = [{kind = 'square', column = 1, row = 0}]";
        let keys: TargetKeys = toml::from_str(text).unwrap();
        let p = grid(&keys);
        assert_eq!(p.features.len(), 12 + 6 + 1);
        for f in &p.features {
            let parity = (f.id.column.rem_euclid(2), f.id.row.rem_euclid(2));
            match (f.mark, f.id.level) {
                (None, 0) => assert_eq!((parity, f.center_mm.z), ((0, 0), 0.0)),
                (None, _) => assert_eq!((parity, f.center_mm.z), ((1, 1), -3.0)),
                _ => assert_eq!(f.center_mm, Vector3::new(7.5, 0.0, 0.0)),
            }
        }
        assert_eq!(p.middle_mm, Vector3::new(7.5, 0.0, 0.0));
    }
}
