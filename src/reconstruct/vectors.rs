//! Three components at every point of a grid.

use super::calibration::PerturbedMaps;
use super::grid::{Between, PlanarField};
use super::noise::Noise;
use super::read::FieldUnit;
use super::shared::{Shared, common};
use crate::dewarp::{SheetGrid, SheetMap};
use crate::error::{Error, Insufficient, Invalid, Result};
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};
use rayon::prelude::*;

/// Where on its path a planar vector belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reference {
    /// The middle (central differences, symmetric window shifts).
    #[default]
    Center,
    /// The beginning (windows fixed in the first frame).
    Start,
}

/// Bits of [`VectorField::flags`]; 0 is a good vector.
pub mod flag {
    /// Neighbours were missing: interpolated linearly instead of by a cubic.
    pub const LOWERED: u8 = 1;
    /// The residual is beyond five standard deviations.
    pub const RESIDUAL: u8 = 2;
    /// The first camera has no vector here.
    pub const FIRST_MISSING: u8 = 4;
    /// The second camera has no vector here.
    pub const SECOND_MISSING: u8 = 8;
    /// Both cameras have a vector here, but no displacement in space that both would see so: one of them cannot be right.
    pub const UNSOLVED: u8 = 16;
}

/// Residuals beyond this many sigmas are flagged.
const RESIDUAL_SIGMAS: f64 = 5.0;
/// Largest ratio of the sigmas along the direction that is known worst and best that still is a stereo arrangement.
const WORST_GAIN: f64 = 1e3;

/// Part of a field's vectors that its camera may not see (the corners of a dewarped image).
const UNSEEN: f64 = 0.3;

/// Options of [`reconstruct`].
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Unit of both fields.
    pub unit: FieldUnit,
    /// Grid of the dewarped images, for [`FieldUnit::DewarpedPixels`].
    pub dewarped: Option<SheetGrid>,
    /// Where on its path a vector belongs.
    pub reference: Reference,
    /// Standard deviation of one component of a planar vector in the unit of the fields (dewarped: geometric mean over the
    /// directions), everywhere; estimated from the residuals, with its growth with the flow's gradient, where not given.
    pub sigma: Option<f64>,
    /// Distance of the vectors of the result, mm; that of the finer field where not given.
    pub spacing_mm: Option<f64>,
    /// Maps of the calibration moved by its covariance (see [`super::perturbed_maps`]); none leaves its part out.
    pub perturbed: Option<PerturbedMaps>,
}

/// Three components on a regular grid of the sheet, structure of arrays; y from the top down, x fastest. `NaN` where a camera
/// has no vector.
#[derive(Debug, Clone, PartialEq)]
pub struct VectorField {
    /// Places: `mm_per_px` is their distance, y goes down with the rows.
    pub grid: SheetGrid,
    /// Place, mm.
    pub x_mm: Vec<f64>,
    /// Place, mm.
    pub y_mm: Vec<f64>,
    /// Displacement along x, mm.
    pub u_mm: Vec<f64>,
    /// Displacement along y, mm.
    pub v_mm: Vec<f64>,
    /// Displacement along z, positive towards the first camera, mm.
    pub w_mm: Vec<f64>,
    /// Standard deviations of u, v, w by the noise of the planar vectors, mm.
    pub sigma_mm: [Vec<f64>; 3],
    /// Covariances of u and v, u and w, v and w by the noise of the planar vectors, mm^2.
    pub covariance_mm2: [Vec<f64>; 3],
    /// Standard deviations of u, v, w by the calibration, mm; common to neighbours. `NaN` where not determined; empty where not asked for.
    pub calibration_sigma_mm: [Vec<f64>; 3],
    /// Covariances of u and v, u and w, v and w by the calibration, mm^2; as the standard deviations.
    pub calibration_covariance_mm2: [Vec<f64>; 3],
    /// How many times larger these are than the calibration's noise alone would tell ([`PerturbedMaps::enlarged`]).
    pub calibration_enlarged: [f64; 3],
    /// What four equations leave, raw px.
    pub residual_px: Vec<f64>,
    /// Bits of [`flag`].
    pub flags: Vec<u8>,
    /// Standard deviation of a planar vector's component that was used, in the unit of the fields, where neighbours are alike; of dewarped
    /// fields the geometric mean over the directions.
    pub sigma: f64,
    /// Growth of that standard deviation with the change from vector to vector: `sqrt(sigma^2 + (sigma_by_gradient change)^2)`.
    pub sigma_by_gradient: f64,
    /// Whether it was estimated from the residuals.
    pub sigma_estimated: bool,
    /// Where the files state the standard deviations of the vectors: correlation of both cameras' errors across the direction of depth.
    pub common_errors: Option<f64>,
    /// Points that the fields of both cameras cover, whether vectors are there or not.
    pub covered: usize,
    /// What four equations leave over what the standard deviations of the vectors let expect, errors of both cameras being independent.
    pub residual_ratio: f64,
}

/// One solved vector.
#[derive(Debug, Clone, Copy)]
struct Solved {
    d_mm: Vector3<f64>,
    /// Covariance for unit variance of a planar component, mm^2 per unit^2.
    covariance: Matrix3<f64>,
    /// What is left, weighted, for unit variance: one degree of freedom.
    chi2: f64,
    residual_px: f64,
    lowered: bool,
    /// Squared change of the planar vectors from one to the next, mean of both cameras, unit^2.
    unevenness: f64,
    shared: Shared,
}

/// A planar vector at a raw pixel.
struct Here {
    /// Displacement, raw px, with its relative variance.
    between: Between,
    /// From raw px to unit variance: by the file's standard deviations along the axes of the field, else from raw px, in which the noise is
    /// alike along x and y, to the unit of the field (geometric mean).
    white: Matrix2<f64>,
}

/// A field with what turns a raw pixel into a raw displacement.
struct Measured<'a> {
    field: &'a PlanarField,
    /// The map that dewarped the images.
    nominal: &'a SheetMap,
    options: &'a Options,
}

impl Measured<'_> {
    /// Position in the field of a raw pixel.
    fn place(&self, q: &Vector2<f64>) -> Option<[f64; 2]> {
        let in_sheet = || self.nominal.hit(q, 0.0).map(|h| h.xy_mm);
        match (self.options.unit, &self.options.dewarped) {
            (FieldUnit::RawPixels, _) => Some([q.x, q.y]),
            (FieldUnit::Millimetres, _) => in_sheet().map(|p| [p.x, p.y]),
            (FieldUnit::DewarpedPixels, grid) => in_sheet().zip(grid.as_ref()).map(|(p, g)| g.pixel(p.x, p.y)),
        }
    }

    /// Whether a pixel lies between the vectors of the field, there or not.
    fn covers(&self, q: &Vector2<f64>) -> bool {
        let e = self.field.extent();
        self.nominal.on_sensor(q) && self.place(q).is_some_and(|p| (0..2).all(|a| (e[a]..=e[a + 2]).contains(&p[a])))
    }

    /// From raw px at a place (derivative of the sheet by the pixel there, where the field is in the sheet) to unit variance.
    fn white(&self, between: &Between, by_pixel: Option<(Matrix2<f64>, Vector2<f64>)>) -> Matrix2<f64> {
        let own = between.sigma.filter(|_| self.options.sigma.is_none());
        match (own, by_pixel) {
            (Some(s), None) => Matrix2::from_diagonal(&s.map(|s| 1.0 / s)),
            (Some(s), Some((m, scale))) => Matrix2::from_diagonal(&s.component_mul(&scale).map(|s| 1.0 / s)) * m,
            (None, None) => Matrix2::identity() / between.variance.sqrt(),
            (None, Some((m, scale))) => {
                Matrix2::identity() * (m.determinant().abs().sqrt() / (scale.x * between.variance.sqrt()))
            }
        }
    }

    /// The planar vector at a raw pixel.
    fn at(&self, q: &Vector2<f64>) -> Option<Here> {
        if !self.nominal.on_sensor(q) {
            return None;
        }
        let [x, y] = self.place(q)?;
        let between = self.field.at(x, y)?;
        let scale = match self.options.unit {
            FieldUnit::RawPixels => {
                let white = self.white(&between, None);
                return Some(Here { between, white });
            }
            FieldUnit::Millimetres => Vector2::new(1.0, 1.0),
            FieldUnit::DewarpedPixels => self.options.dewarped.map(|g| Vector2::new(g.mm_per_px, -g.mm_per_px))?,
        };
        let hit = self.nominal.hit(q, 0.0)?;
        let p = hit.xy_mm;
        let d = between.vector.component_mul(&scale);
        let (a, b) = match self.options.reference {
            Reference::Center => (p - 0.5 * d, p + 0.5 * d),
            Reference::Start => (p, p + d),
        };
        let image = |p: Vector2<f64>| self.nominal.project(&p.push(0.0));
        let vector = image(b)? - image(a)?;
        let white = self.white(&between, Some((hit.dxy_dq, scale)));
        Some(Here { between: Between { vector, ..between }, white })
    }
}

/// u, v, w at P from both cameras.
fn solve(maps: [&SheetMap; 2], measured: &[Measured; 2], p: &Vector2<f64>) -> Option<Solved> {
    let p = p.push(0.0);
    let mut seen = vec![];
    for (map, m) in maps.iter().zip(measured) {
        seen.push(m.at(&map.project(&p)?)?);
    }
    let (back, ahead) = match measured[0].options.reference {
        Reference::Center => (0.5, 0.5),
        Reference::Start => (0.0, 1.0),
    };
    let mut d = Vector3::zeros();
    let mut raw = [0.0; 2];
    for _ in 0..20 {
        let mut jacobian = SMatrix::<f64, 4, 3>::zeros();
        let mut rest = SVector::<f64, 4>::zeros();
        for c in 0..2 {
            let (q1, j1) = maps[c].project_jet(&(p + d * ahead))?;
            let (q0, j0) = maps[c].project_jet(&(p - d * back))?;
            let Here { between, white } = &seen[c];
            let left = between.vector - (q1 - q0);
            raw[c] = left.norm_squared();
            rest.fixed_rows_mut::<2>(2 * c).copy_from(&(white * left));
            jacobian.fixed_rows_mut::<2>(2 * c).copy_from(&(white * (j1 * ahead + j0 * back)));
        }
        let covariance = jacobian.tr_mul(&jacobian).try_inverse()?;
        let step = covariance * jacobian.tr_mul(&rest);
        d += step;
        if !d.iter().all(|x| x.is_finite()) {
            return None;
        }
        if step.norm() < 1e-10 * (1.0 + d.norm()) {
            let lowered = seen.iter().any(|s| s.between.lowered);
            return Some(Solved {
                d_mm: d,
                covariance,
                chi2: rest.norm_squared(),
                residual_px: (raw[0] + raw[1]).sqrt(),
                lowered,
                shared: Shared::of(&jacobian, &covariance),
                unevenness: 0.5 * seen.iter().map(|s| s.between.unevenness).sum::<f64>(),
            });
        }
    }
    None
}

/// `[x_min, y_min, x_max, y_max]` in the sheet of what a field covers, and its spacing there, mm.
fn coverage(m: &Measured, camera: &str) -> Result<([f64; 4], f64)> {
    let (e, field) = (m.field.extent(), m.field);
    let [w, h] = m.nominal.size_px().map(|n| n as f64);
    let fault = |message: String| -> Error { Invalid::File { path: field.file.clone(), message }.into() };
    let to_sheet = |x: f64, y: f64| match (m.options.unit, &m.options.dewarped) {
        (FieldUnit::RawPixels, _) => m.nominal.hit(&Vector2::new(x, y), 0.0).map(|h| h.xy_mm),
        (FieldUnit::Millimetres, _) => Some(Vector2::new(x, y)),
        (FieldUnit::DewarpedPixels, g) => g.as_ref().map(|g| Vector2::from(g.point_mm(x, y))),
    };
    if m.options.unit == FieldUnit::RawPixels && (e[0] < -0.5 || e[1] < -0.5 || e[2] > w - 0.5 || e[3] > h - 0.5) {
        return Err(fault(format!(
            "positions run from ({}, {}) to ({}, {}), but the images of camera \"{camera}\" are {w} x {h} px; is this the field of another \
             camera, of a dewarped image (--unit dewarped), or in mm (--unit mm)?",
            e[0], e[1], e[2], e[3]
        )));
    }
    let mut out = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for i in 0..=32 {
        let t = f64::from(i) / 32.0;
        let (x, y) = (e[0] + t * (e[2] - e[0]), e[1] + t * (e[3] - e[1]));
        for p in [to_sheet(x, e[1]), to_sheet(x, e[3]), to_sheet(e[0], y), to_sheet(e[2], y)].into_iter().flatten() {
            out = [out[0].min(p.x), out[1].min(p.y), out[2].max(p.x), out[3].max(p.y)];
        }
    }
    let middle = [0.5 * (e[0] + e[2]), 0.5 * (e[1] + e[3])];
    let step =
        |dx: f64, dy: f64| Some((to_sheet(middle[0] + dx, middle[1] + dy)? - to_sheet(middle[0], middle[1])?).norm());
    let spacing = step(field.spacing[0], 0.0).zip(step(0.0, field.spacing[1])).map(|(a, b)| a.min(b));
    let all = field.filled().0;
    let seen = |p: &[f64; 2]| {
        to_sheet(p[0], p[1]).and_then(|p| m.nominal.project(&p.push(0.0))).is_some_and(|q| m.nominal.on_sensor(&q))
    };
    let unseen = all - field.positions().filter(seen).count();
    match spacing {
        Some(spacing) if spacing > 0.0 && unseen as f64 <= UNSEEN * all as f64 => Ok((out, spacing)),
        _ if unseen == 0 => Err(fault(format!(
            "positions run from ({}, {}) to ({}, {}), which camera \"{camera}\" sees in one point of the sheet; check their unit and, where they are px of \
             dewarped images, mm_per_px of dewarp.json",
            e[0], e[1], e[2], e[3]
        ))),
        _ => Err(fault(format!(
            "positions run from ({}, {}) to ({}, {}); camera \"{camera}\" does not see {unseen} of the {all} vectors. Check unit and origin: mm count from \
             the origin of the sheet frame (dewarp.json: origin_mm of the first pixel), px of dewarped images from their first pixel (--dewarped dewarp.json)",
            e[0], e[1], e[2], e[3]
        ))),
    }
}

/// The factor of stated variances: what residuals say where chance would hardly give so much, else 1.
fn refuted(level: f64, count: usize) -> f64 {
    let chance = 1.0 + 3.0 * (2.0 / count as f64).sqrt();
    if level > chance { level } else { 1.0 }
}

/// Vectors that may lie where one was measured, along either axis.
const FINEST: f64 = 10.0;

/// Places of the result: the field that both planar fields cover.
fn places(measured: &[Measured; 2], names: [&str; 2]) -> Result<SheetGrid> {
    let options = measured[0].options;
    let ((a, sa), (b, sb)) = (coverage(&measured[0], names[0])?, coverage(&measured[1], names[1])?);
    let common = [a[0].max(b[0]), a[1].max(b[1]), a[2].min(b[2]), a[3].min(b[3])];
    if !(common[2] > common[0] && common[3] > common[1]) {
        return Err(Insufficient::Degenerate(format!(
            "the two fields have nothing in common in the sheet: \"{}\" covers x {:.2} to {:.2}, y {:.2} to {:.2} mm, \"{}\" x {:.2} to {:.2}, \
             y {:.2} to {:.2} mm; check that left and right are not exchanged and that the unit is right",
            names[0], a[0], a[2], a[1], a[3], names[1], b[0], b[2], b[1], b[3]
        ))
        .into());
    }
    let spacing = options.spacing_mm.unwrap_or(sa.min(sb));
    // One grid in the sheet for both: its own points are used, and nothing is interpolated.
    let same = measured[0].field.origin == measured[1].field.origin
        && measured[0].field.spacing == measured[1].field.spacing
        && options.unit != FieldUnit::RawPixels
        && options.spacing_mm.is_none()
        && (measured[0].field.spacing[0] / measured[0].field.spacing[1] - 1.0).abs() < 1e-6;
    let shortest = (common[2] - common[0]).min(common[3] - common[1]);
    if spacing > shortest {
        let what =
            format!("a length of at most {shortest:.4} mm, the shorter side of the field that both cameras measured");
        return Err(Invalid::value("distance of the vectors (spacing_mm)", spacing, what).into());
    }
    let least = sa.min(sb) / FINEST;
    if spacing < least {
        let what = format!(
            "a length of at least {least:.4} mm, a tenth of the distance of the measured vectors: closer ones say nothing new"
        );
        return Err(Invalid::value("distance of the vectors (spacing_mm)", spacing, what).into());
    }
    let inner = if same { common } else { inset(common, spacing) };
    SheetGrid::over(inner, spacing)
}

/// A whole number of spacings, centred.
fn inset(extent: [f64; 4], spacing: f64) -> [f64; 4] {
    let mut out = extent;
    for a in 0..2 {
        let length = extent[a + 2] - extent[a];
        let rest = 0.5 * (length - (length / spacing).floor() * spacing);
        out[a] += rest;
        out[a + 2] -= rest;
    }
    out
}

/// Three components from the planar fields of the two cameras; `names` are the cameras' in messages.
///
/// Points are solved by the threads of the pool in which this is called; the bits do not depend on their number.
///
/// # Errors
/// [`Invalid`] where positions are not on the images or the options contradict each other; [`Insufficient`] where the fields have
/// nothing in common or the cameras look along one line.
pub fn reconstruct(
    maps: [&SheetMap; 2],
    fields: [&PlanarField; 2],
    names: [&str; 2],
    options: &Options,
) -> Result<VectorField> {
    if options.unit == FieldUnit::DewarpedPixels && options.dewarped.is_none() {
        let what = "displacements in dewarped pixels need the grid of the dewarped images (--dewarped dewarp.json)";
        return Err(Invalid::Contradiction(what.into()).into());
    }
    if let Some(s) = options.sigma.filter(|s| !(*s > 0.0 && s.is_finite())) {
        return Err(Invalid::value("sigma of the planar vectors", s, "a positive number").into());
    }
    if let Some(s) = options.spacing_mm.filter(|s| !(*s > 0.0 && s.is_finite())) {
        return Err(Invalid::value("distance of the vectors (spacing_mm)", s, "a positive number of mm").into());
    }
    let stated = fields.map(|f| f.has_sigmas());
    if stated[0] != stated[1] && options.sigma.is_none() {
        let with = usize::from(stated[1]);
        let what = format!(
            "{} has standard deviations (sigma_dx, sigma_dy), but {} has none; export both alike, or say --sigma",
            fields[with].file,
            fields[1 - with].file
        );
        return Err(Invalid::Contradiction(what).into());
    }
    let stated = stated[0] && options.sigma.is_none();
    let measured = [0, 1].map(|c| Measured { field: fields[c], nominal: maps[c], options });
    let grid = places(&measured, names)?;
    let n = grid.width_px * grid.height_px;
    let place = |i: usize| Vector2::from(grid.point_mm((i % grid.width_px) as f64, (i / grid.width_px) as f64));
    let solved: Vec<Option<Solved>> = (0..n).into_par_iter().map(|i| solve(maps, &measured, &place(i))).collect();
    let (chi2, unevenness): (Vec<f64>, Vec<f64>) = solved.iter().flatten().map(|s| (s.chi2, s.unevenness)).unzip();
    let level = Noise::fit(&chi2, &vec![0.0; chi2.len()]).map_or(f64::NAN, |n| n.still);
    let noise = match (options.sigma, Noise::fit(&chi2, &unevenness)) {
        (_, None) => return Err(nothing(&measured, names).into()),
        (Some(sigma), _) => Noise::even(sigma),
        (None, Some(_)) if stated => Noise::even(refuted(level, chi2.len()).sqrt()),
        (None, Some(noise)) => noise,
    };
    let calibration = options.perturbed.as_ref().map(|p| calibration_covariance(p, &measured, n, &place));
    let found: Vec<&Solved> = solved.iter().flatten().collect();
    let correlation = if stated { common(level, found.iter().map(|s| &s.shared)) } else { 0.0 };
    let mut out = VectorField::empty(grid, &noise, options.sigma.is_none() && !stated);
    out.calibration_enlarged = options.perturbed.as_ref().map_or([1.0; 3], |p| p.enlarged);
    if stated {
        out.common_errors = Some(correlation);
        out.residual_ratio = level.sqrt();
        out.sigma = stated_sigma(&measured) * noise.still.sqrt();
    } else {
        let expected: Vec<f64> = found.iter().map(|s| s.chi2 / noise.variance(s.unevenness)).collect();
        out.residual_ratio = Noise::fit(&expected, &vec![0.0; expected.len()]).map_or(f64::NAN, |n| n.still.sqrt());
    }
    for (i, s) in solved.iter().enumerate() {
        let pixel = |c: usize| maps[c].project(&place(i).push(0.0));
        let missing = |c: usize| pixel(c).and_then(|q| measured[c].at(&q)).is_none();
        let covered = |c: usize| pixel(c).is_some_and(|q| measured[c].covers(&q));
        out.covered += usize::from(s.is_some() || covered(0) && covered(1));
        let calibration = calibration.as_ref().map(|c| c[i]);
        out.push(&place(i), s.as_ref(), &noise, correlation, || [missing(0), missing(1)], calibration);
    }
    let worst = solved
        .iter()
        .flatten()
        .map(|s| s.covariance.symmetric_eigenvalues())
        .map(|v| (v.max() / v.min().max(f64::MIN_POSITIVE)).sqrt())
        .fold(0.0, f64::max);
    if worst > WORST_GAIN {
        let what = format!(
            "both cameras look at the sheet along nearly one line: errors along it are up to {worst:.0} times those across; three components cannot be measured"
        );
        return Err(Insufficient::Degenerate(what).into());
    }
    Ok(out)
}

fn nothing(measured: &[Measured; 2], names: [&str; 2]) -> Insufficient {
    let part = |c: usize| {
        let (filled, all) = measured[c].field.filled();
        format!("\"{}\" has {filled} of {all} vectors", names[c])
    };
    Insufficient::Degenerate(format!(
        "no point of the sheet has a vector of both cameras ({}, {}); check the masks and flags of the fields, and the fill values of what is missing",
        part(0),
        part(1)
    ))
}

/// Median of the standard deviations that the files state (geometric mean of both directions), unit of the fields.
fn stated_sigma(measured: &[Measured; 2]) -> f64 {
    let mut all: Vec<f64> = measured.iter().flat_map(|m| m.field.stated()).map(|s| (s.x * s.y).sqrt()).collect();
    all.sort_by(f64::total_cmp);
    all.get(all.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Components that a covariance is of, in the order in which covariances are told.
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// Covariance of u, v, w by the calibration at every point; `NaN` where a moved calibration gives nothing.
fn calibration_covariance(
    perturbed: &PerturbedMaps,
    measured: &[Measured; 2],
    n: usize,
    place: &(dyn Fn(usize) -> Vector2<f64> + Sync),
) -> Vec<Matrix3<f64>> {
    let one = |i: usize| {
        let mut sum = Matrix3::zeros();
        for sides in &perturbed.sides {
            let at = |maps: &[SheetMap]| match maps {
                [a, b] => solve([a, b], measured, &place(i)).map(|s| s.d_mm),
                _ => None,
            };
            match (at(&sides[0]), at(&sides[1])) {
                (Some(p), Some(m)) => {
                    let step = (p - m) / 2.0;
                    sum += step * step.transpose();
                }
                _ => return Matrix3::repeat(f64::NAN),
            }
        }
        let enlarged = Matrix3::from_diagonal(&Vector3::from(perturbed.enlarged));
        enlarged * sum * enlarged
    };
    (0..n).into_par_iter().map(one).collect()
}

/// Standard deviations and covariances of one vector, to their lists.
fn add(c: &Matrix3<f64>, sigmas: &mut [Vec<f64>; 3], covariances: &mut [Vec<f64>; 3]) {
    // Rounding below zero is none; what is not known stays so.
    let sigma = |variance: f64| if variance < 0.0 { 0.0 } else { variance.sqrt() };
    sigmas.iter_mut().enumerate().for_each(|(a, list)| list.push(sigma(c[(a, a)])));
    covariances.iter_mut().zip(PAIRS).for_each(|(list, at)| list.push(c[at]));
}

impl VectorField {
    fn empty(grid: SheetGrid, noise: &Noise, sigma_estimated: bool) -> Self {
        let v = Vec::new;
        Self {
            grid,
            x_mm: v(),
            y_mm: v(),
            u_mm: v(),
            v_mm: v(),
            w_mm: v(),
            sigma_mm: [v(), v(), v()],
            covariance_mm2: [v(), v(), v()],
            calibration_sigma_mm: [v(), v(), v()],
            calibration_covariance_mm2: [v(), v(), v()],
            calibration_enlarged: [1.0; 3],
            residual_px: v(),
            flags: Vec::new(),
            sigma: noise.still.sqrt(),
            sigma_by_gradient: noise.by_gradient.sqrt(),
            sigma_estimated,
            common_errors: None,
            covered: 0,
            residual_ratio: f64::NAN,
        }
    }

    fn push(
        &mut self,
        p: &Vector2<f64>,
        s: Option<&Solved>,
        noise: &Noise,
        correlation: f64,
        missing: impl Fn() -> [bool; 2],
        calibration: Option<Matrix3<f64>>,
    ) {
        let nan = f64::NAN;
        let d = s.map_or(Vector3::repeat(nan), |s| s.d_mm);
        for (list, value) in [&mut self.x_mm, &mut self.y_mm, &mut self.u_mm, &mut self.v_mm, &mut self.w_mm]
            .into_iter()
            .zip([p.x, p.y, d.x, d.y, d.z])
        {
            list.push(value);
        }
        let covariance = s.map_or(Matrix3::repeat(nan), |s| {
            (s.covariance + s.shared.covariance * correlation) * noise.variance(s.unevenness)
        });
        add(&covariance, &mut self.sigma_mm, &mut self.covariance_mm2);
        if let Some(c) = calibration {
            let c = if s.is_some() { c } else { Matrix3::repeat(nan) };
            add(&c, &mut self.calibration_sigma_mm, &mut self.calibration_covariance_mm2);
        }
        self.residual_px.push(s.map_or(nan, |s| s.residual_px));
        self.flags.push(match s {
            Some(s) => {
                let far = s.chi2 > RESIDUAL_SIGMAS * RESIDUAL_SIGMAS * noise.variance(s.unevenness);
                (flag::LOWERED * u8::from(s.lowered)) | (flag::RESIDUAL * u8::from(far))
            }
            None => {
                let [a, b] = missing();
                let unsolved = flag::UNSOLVED * u8::from(!a && !b);
                unsolved | (flag::FIRST_MISSING * u8::from(a)) | (flag::SECOND_MISSING * u8::from(b))
            }
        });
    }

    /// Points with a vector, and points in all.
    pub fn filled(&self) -> (usize, usize) {
        (self.u_mm.iter().filter(|u| u.is_finite()).count(), self.u_mm.len())
    }
}
