use super::*;
use crate::conic::{ContourNoise, Ellipse};
use crate::detect::{Disc, EdgePoints, Shape};
use crate::frames::Pixel;
use crate::stats::random::Random;
use crate::target::{Grid, Mark, MarkKind, Pair, Plate, Polarity};
use nalgebra::{Matrix2, Matrix3, SMatrix, Vector2, Vector3};

const WIDTH: f64 = 1600.0;
const HEIGHT: f64 = 1200.0;

/// A pinhole with radial distortion that sees the target plane.
struct View {
    rotation: Matrix3<f64>,
    offset: Vector3<f64>,
    f_px: f64,
    k1: f64,
}

impl View {
    /// `oblique_rad` between axis and plate normal, towards a random side; the plate turned by `roll_rad`.
    fn new(r: &mut Random, oblique_rad: f64, roll_rad: f64, k1: f64, center: Vector2<f64>, size: f64) -> Self {
        let side = r.in_range(0.0, std::f64::consts::TAU);
        let axis = Vector3::new(side.cos(), side.sin(), 0.0);
        let tilt = crate::rigid::rotation_exp(&(axis * oblique_rad));
        let roll = crate::rigid::rotation_exp(&Vector3::new(0.0, 0.0, roll_rad));
        // Target y up and z to the viewer, camera y down and z forward.
        let front = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        let rotation = tilt * roll * front;
        let f_px = 2500.0;
        let distance = f_px * size / r.in_range(700.0, 1100.0);
        let offset = Vector3::new(0.0, 0.0, distance) - rotation * Vector3::new(center.x, center.y, 0.0);
        Self { rotation, offset, f_px, k1 }
    }
    fn pixel(&self, p: &Vector3<f64>) -> Vector2<f64> {
        let q = self.rotation * p + self.offset;
        let x = q.xy() / q.z;
        // k1 is stated at the corner of the image, as a fraction.
        let corner = (WIDTH * WIDTH + HEIGHT * HEIGHT) / (4.0 * self.f_px * self.f_px);
        let d = x * (1.0 + self.k1 * x.norm_squared() / corner);
        d * self.f_px + Vector2::new(0.5 * WIDTH, 0.5 * HEIGHT)
    }
    /// Ellipse of a small circle of the plane z = const, noise on all parameters.
    fn disc(&self, r: &mut Random, p: &Vector3<f64>, radius: f64, noise_px: f64) -> Disc {
        let h = 1e-3 * radius;
        let column = |d: Vector3<f64>| (self.pixel(&(p + d * h)) - self.pixel(&(p - d * h))) / (2.0 * h) * radius;
        let j = Matrix2::from_columns(&[column(Vector3::x()), column(Vector3::y())]);
        let e = (j * j.transpose()).symmetric_eigen();
        let k = e.eigenvalues.imax();
        let axis = e.eigenvectors.column(k);
        let c = self.pixel(p);
        let mut near = |x: f64| x + noise_px * r.gauss();
        disc(
            near(c.x),
            near(c.y),
            near(e.eigenvalues[k].sqrt()),
            near(e.eigenvalues[1 - k].sqrt()),
            axis[1].atan2(axis[0]),
        )
    }
}

pub(in crate::detect) fn disc(u: f64, v: f64, a: f64, b: f64, phi: f64) -> Disc {
    let (a, b) = (a.max(b).max(0.6), a.min(b).max(0.5));
    Disc {
        ellipse: Ellipse { center_px: Pixel::new(u, v), semi_major_px: a, semi_minor_px: b, angle_rad: phi },
        covariance: SMatrix::identity(),
        edge: EdgePoints::default(),
        contour: ContourNoise::default(),
        polarity: Polarity::Dark,
        blur_px: 1.0,
        contrast: 100.0,
        mark: None,
    }
}

fn inside(d: &Disc) -> bool {
    let (c, m) = (d.ellipse.center_px, d.ellipse.semi_major_px);
    c.u_px > m && c.v_px > m && c.u_px < WIDTH - m && c.v_px < HEIGHT - m
}

fn id(column: i32, row: i32, level: u8) -> DotId {
    DotId { column, row, level }
}

/// A scene: what was "detected" and the true label of each disc, `None` for strays.
struct Scene {
    detection: Detection,
    truth: Vec<Option<DotId>>,
}

impl Scene {
    /// Strays of the size of dots anywhere, `share` of the discs.
    fn add_strays(&mut self, r: &mut Random, share: f64) {
        let count = (share * self.truth.len() as f64) as usize;
        let typical = self.detection.discs[0].ellipse.semi_major_px;
        for _ in 0..count {
            let a = typical * r.in_range(0.3, 1.5);
            let stray = disc(
                r.in_range(0.0, WIDTH),
                r.in_range(0.0, HEIGHT),
                a,
                a * r.in_range(0.4, 1.0),
                r.in_range(-1.5, 1.5),
            );
            // Two detections cannot overlap.
            let apart = |d: &Disc| {
                let (p, q) = (d.ellipse.center_px, stray.ellipse.center_px);
                (p.u_px - q.u_px).hypot(p.v_px - q.v_px) > d.ellipse.semi_major_px + a
            };
            if self.detection.discs.iter().all(apart) {
                self.detection.discs.push(stray);
                self.truth.push(None);
            }
        }
    }
    /// Order must not matter.
    fn shuffle(&mut self, r: &mut Random) {
        for i in (1..self.truth.len()).rev() {
            let k = (r.next() % (i as u64 + 1)) as usize;
            self.truth.swap(i, k);
            self.detection.discs.swap(i, k);
        }
    }
    /// Whether every label is right.
    fn all_right(&self, discs: &[LabelledDisc]) -> bool {
        discs.iter().all(|d| self.truth[d.disc] == Some(d.id))
    }
    fn dots(&self) -> usize {
        self.truth.iter().flatten().count()
    }
}

/// A grid of `columns` x `rows` at pitch 10, dots of radius 2.5; `special` gives the radius factor and mark of a dot.
fn grid_scene(
    r: &mut Random,
    size: (i32, i32),
    view: &View,
    missing: f64,
    special: impl Fn(i32, i32) -> Option<(f64, Option<MarkKind>)>,
    first: (i32, i32),
) -> Scene {
    let mut scene = Scene { detection: Detection::default(), truth: Vec::new() };
    for column in first.0..first.0 + size.0 {
        for row in first.1..first.1 + size.1 {
            let mark = special(column, row);
            if mark.is_none() && r.in_range(0.0, 1.0) < missing {
                continue;
            }
            let p = Vector3::new(10.0 * f64::from(column), 10.0 * f64::from(row), 0.0);
            let mut d = view.disc(r, &p, 2.5 * mark.map_or(1.0, |m| m.0), 0.08);
            d.mark = mark.and_then(|m| m.1);
            if inside(&d) {
                scene.detection.discs.push(d);
                scene.truth.push(Some(id(column, row, 0)));
            }
        }
    }
    scene
}

fn grid_target(columns: Option<usize>, rows: Option<usize>, marks: Vec<Mark>) -> Target {
    Target::DotGrid(Grid { spacing_mm: Some(10.0), columns, rows, radius_mm: None, marks })
}

fn three_rings() -> Vec<Mark> {
    [id(0, 0, 0), id(5, 0, 0), id(0, 3, 0)].map(|at| Mark { kind: MarkKind::Ring, at }).to_vec()
}

fn ring_at(c: i32, r: i32) -> Option<(f64, Option<MarkKind>)> {
    [(0, 0), (5, 0), (0, 3)].contains(&(c, r)).then_some((1.0, Some(MarkKind::Ring)))
}

/// Share of dots found and of images refused over many random views; panics on a wrong label.
fn recall(
    seed: u64,
    runs: usize,
    max_oblique_deg: f64,
    make: impl Fn(&mut Random, f64) -> (Scene, Target),
) -> (f64, f64) {
    let mut r = Random(seed);
    let (mut found, mut dots, mut refused, mut open) = (0, 0, 0, 0);
    for run in 0..runs {
        let oblique = max_oblique_deg.to_radians() * (run as f64 + 0.5) / runs as f64;
        let (mut scene, target) = make(&mut r, oblique);
        scene.add_strays(&mut r, 0.1);
        scene.shuffle(&mut r);
        match label_discs("image", &scene.detection, &target) {
            Ok(l) => {
                // A mark out of view may leave a turn open; then the labelling says so and holds the truth.
                let among = l.alternatives.iter().any(|a| scene.all_right(&l.relabelled(a)));
                let wrong: Vec<_> = l.discs.iter().filter(|d| scene.truth[d.disc] != Some(d.id)).collect();
                open += usize::from(!l.alternatives.is_empty());
                assert!(
                    wrong.is_empty() || among,
                    "run {run} at {:.0} deg: {wrong:?}, {:?}",
                    oblique.to_degrees(),
                    l.warnings
                );
                found += l.discs.len();
                dots += scene.dots();
            }
            Err(e) => {
                println!("run {run} at {:.0} deg, {} dots: {e}", oblique.to_degrees(), scene.dots());
                refused += 1;
            }
        }
    }
    let shares = (found as f64 / dots as f64, refused as f64 / runs as f64);
    println!(
        "{:.1} % of the dots found, {:.1} % of the images refused, {open} left open",
        100.0 * shares.0,
        100.0 * shares.1
    );
    assert!(open * 50 <= runs, "{open} of {runs} left open");
    shares
}

#[test]
fn rings_fix_the_labels_at_any_turn_up_to_70_degrees() {
    let (found, refused) = recall(11, 400, 70.0, |r, oblique| {
        let (roll, k1) = (r.in_range(0.0, 6.2), r.in_range(-0.05, 0.05));
        let view = View::new(r, oblique, roll, k1, Vector2::new(25.0, 15.0), 120.0);
        (grid_scene(r, (14, 11), &view, 0.2, ring_at, (-4, -4)), grid_target(None, None, three_rings()))
    });
    assert!(found > 0.95 && refused < 0.02, "{found} {refused}");
}

/// A square and a triangle in the place of two dots, as on commercial plates; letters beside the grid look like either.
#[test]
fn squares_and_triangles_fix_the_labels_of_a_grid() {
    let marks = [(MarkKind::Square, (0, 0)), (MarkKind::Triangle, (3, 0))];
    let (found, refused) = recall(21, 200, 60.0, |r, oblique| {
        let roll = r.in_range(0.0, 6.2);
        let view = View::new(r, oblique, roll, 0.02, Vector2::new(25.0, 25.0), 150.0);
        let mut scene = grid_scene(r, (11, 9), &view, 0.1, |_, _| None, (-3, -3));
        for (mark, (column, row)) in marks {
            let p = Vector3::new(10.0 * f64::from(column), 10.0 * f64::from(row), 0.0);
            let d = view.disc(r, &p, 2.5, 0.08);
            let there = scene.truth.iter().position(|t| *t == Some(id(column, row, 0)));
            if let Some(k) = there {
                scene.detection.discs.remove(k);
                scene.truth.remove(k);
            }
            let radius_px = d.ellipse.mean_radius_px();
            scene.detection.shapes.push(Shape { center_px: d.ellipse.center_px, radius_px, mark });
            // Print far from any dot.
            let q = Vector3::new(10.0 * f64::from(column) + 4.0, -70.0, 0.0);
            let letter = view.disc(r, &q, 2.5, 0.08).ellipse.center_px;
            scene.detection.shapes.push(Shape { center_px: letter, radius_px, mark });
        }
        let marks = marks.map(|(kind, (column, row))| Mark { kind, at: id(column, row, 0) });
        (scene, grid_target(None, None, marks.to_vec()))
    });
    assert!(found > 0.95 && refused < 0.02, "{found} {refused}");
}

#[test]
fn a_large_corner_dot_fixes_the_labels() {
    let corner = |c: i32, r: i32| ((c, r) == (0, 0)).then_some((1.6, Some(MarkKind::Large).filter(|_| false)));
    let (found, refused) = recall(12, 300, 65.0, |r, oblique| {
        let roll = r.in_range(0.0, 6.2);
        let view = View::new(r, oblique, roll, 0.02, Vector2::new(45.0, 45.0), 150.0);
        let mark = Mark { kind: MarkKind::Large, at: id(0, 0, 0) };
        (grid_scene(r, (10, 10), &view, 0.1, corner, (0, 0)), grid_target(Some(10), Some(10), vec![mark]))
    });
    assert!(found > 0.95 && refused < 0.03, "{found} {refused}");
}

#[test]
fn without_marks_the_truth_is_among_the_stated_alternatives() {
    let mut r = Random(13);
    for run in 0..120 {
        let (columns, rows) = if run % 2 == 0 { (9, 7) } else { (8, 8) };
        let oblique = r.in_range(0.0, 1.1);
        let roll = r.in_range(0.0, 6.2);
        let center = Vector2::new(5.0 * f64::from(columns - 1), 5.0 * f64::from(rows - 1));
        let view = View::new(&mut r, oblique, roll, 0.0, center, 140.0);
        let mut scene = grid_scene(&mut r, (columns, rows), &view, 0.0, |_, _| None, (0, 0));
        scene.shuffle(&mut r);
        let target = grid_target(Some(columns as usize), Some(rows as usize), vec![]);
        let l = label_discs("image", &scene.detection, &target).unwrap();
        assert_eq!(l.discs.len(), (columns * rows) as usize);
        assert_eq!(l.alternatives.len(), if columns == rows { 3 } else { 1 });
        assert!(!l.origin_is_arbitrary && !l.warnings.is_empty());
        let alternatives: Vec<_> = l.alternatives.iter().map(|a| l.relabelled(a)).collect();
        assert!(scene.all_right(&l.discs) || alternatives.iter().any(|d| scene.all_right(d)), "run {run}");
        // Up in the image decides as long as the plate is not turned by more than an eighth.
        let turn = (roll + 0.3) % std::f64::consts::TAU;
        if turn < 0.6 && oblique < 0.6 {
            assert!(scene.all_right(&l.discs), "run {run}");
        }
    }
}

#[test]
fn part_of_an_unmarked_grid_has_an_arbitrary_origin() {
    let mut r = Random(14);
    let view = View::new(&mut r, 0.5, 0.1, 0.0, Vector2::new(45.0, 35.0), 40.0);
    let scene = grid_scene(&mut r, (10, 8), &view, 0.0, |_, _| None, (0, 0));
    let l = label_discs("image", &scene.detection, &grid_target(Some(10), Some(8), vec![])).unwrap();
    assert!(l.origin_is_arbitrary && l.discs.len() >= 12);
    let shift = |d: &LabelledDisc| {
        let t = scene.truth[d.disc].unwrap();
        (t.column - d.id.column, t.row - d.id.row)
    };
    assert!(l.discs.iter().all(|d| shift(d) == shift(&l.discs[0])));
}

#[test]
fn a_mirrored_plate_is_refused_and_says_so() {
    let mut r = Random(15);
    for _ in 0..50 {
        let (oblique, roll) = (r.in_range(0.0, 1.0), r.in_range(0.0, 6.2));
        let view = View::new(&mut r, oblique, roll, 0.0, Vector2::new(25.0, 15.0), 120.0);
        let mut scene = grid_scene(&mut r, (12, 10), &view, 0.1, ring_at, (-3, -3));
        for d in &mut scene.detection.discs {
            d.ellipse.center_px.u_px = WIDTH - d.ellipse.center_px.u_px;
            d.ellipse.angle_rad = -d.ellipse.angle_rad;
        }
        let e = label_discs("left.png", &scene.detection, &grid_target(None, None, three_rings())).unwrap_err();
        assert!(e.to_string().contains("mirror") && e.to_string().starts_with("left.png"), "{e}");
    }
}

#[test]
fn hidden_marks_are_told() {
    let mut r = Random(16);
    let view = View::new(&mut r, 0.4, 0.1, 0.0, Vector2::new(25.0, 15.0), 120.0);
    let rings = |seen: &'static [(i32, i32)]| {
        move |c: i32, r: i32| seen.contains(&(c, r)).then_some((1.0, Some(MarkKind::Ring)))
    };
    let target = grid_target(None, None, three_rings());
    // None: refused. One: origin open, refused. Two: "up" decides between the two ways they fit, with a warning.
    for seen in [&[][..], &[(0, 0)][..]] {
        let scene = grid_scene(&mut r, (12, 10), &view, 0.0, rings(seen), (-3, -3));
        let e = label_discs("image", &scene.detection, &target).unwrap_err();
        assert!(e.to_string().contains("mark"), "{e}");
    }
    let scene = grid_scene(&mut r, (12, 10), &view, 0.0, rings(&[(0, 0), (5, 0)]), (-3, -3));
    let l = label_discs("image", &scene.detection, &target).unwrap();
    assert!(scene.all_right(&l.discs) && l.alternatives.len() == 1 && l.warnings.len() == 2);
    // The slanted pair fits one way only.
    let scene = grid_scene(&mut r, (12, 10), &view, 0.0, rings(&[(5, 0), (0, 3)]), (-3, -3));
    let l = label_discs("image", &scene.detection, &target).unwrap();
    assert!(scene.all_right(&l.discs) || l.alternatives.iter().any(|a| scene.all_right(&l.relabelled(a))));
}

/// Four discs on a square of which no two neighbours are of one size: each leaves the lattice, and nothing is left to label.
#[test]
fn a_square_of_unlike_discs_is_refused_with_their_number() {
    let place = [(400.0, 400.0, 14.0), (500.0, 400.0, 14.0), (400.0, 500.0, 20.3), (500.0, 500.0, 20.3)];
    let discs = place.map(|(u, v, a)| disc(u, v, a, a, 0.0)).to_vec();
    let detection = Detection { discs, ..Detection::default() };
    let refused = label_discs("image", &detection, &grid_target(None, None, vec![])).unwrap_err().to_string();
    assert!(refused.contains("of 4 discs on a square grid") && refused.contains("differ in size"), "{refused}");
}

#[test]
fn blobs_in_no_order_are_no_grid() {
    let mut r = Random(17);
    let mut accepted = 0;
    for _ in 0..60 {
        let mut scene = Scene { detection: Detection::default(), truth: Vec::new() };
        for _ in 0..70 {
            let a = r.in_range(5.0, 9.0);
            let d = disc(
                r.in_range(0.0, WIDTH),
                r.in_range(0.0, HEIGHT),
                a,
                a * r.in_range(0.7, 1.0),
                r.in_range(-1.5, 1.5),
            );
            scene.detection.discs.push(d);
        }
        accepted += usize::from(label_discs("image", &scene.detection, &grid_target(None, None, vec![])).is_ok());
    }
    assert_eq!(accepted, 0);
    let nothing = label_discs("image", &Detection::default(), &grid_target(None, None, vec![])).unwrap_err();
    assert!(matches!(nothing, crate::Error::Insufficient(Insufficient::TooFewDiscs { found: 0, .. })), "{nothing}");
}

fn plate_marks() -> Vec<Mark> {
    vec![Mark { kind: MarkKind::Square, at: id(-4, -1, 0) }, Mark { kind: MarkKind::Triangle, at: id(-3, -2, 1) }]
}

fn plate_target(marks: Vec<Mark>) -> Target {
    Target::TwoLevelPlate(Plate { spacing_mm: 15.0, step_mm: 3.0, radius_mm: Some(1.6), marks })
}

/// Two levels 3 mm apart, pitch 15 mm; marks in their places.
fn plate_scene(r: &mut Random, view: &View, missing: f64, marks: &[Mark]) -> Scene {
    let mut scene = Scene { detection: Detection::default(), truth: Vec::new() };
    let place =
        |at: &DotId| Vector3::new(7.5 * f64::from(at.column), 7.5 * f64::from(at.row), -3.0 * f64::from(at.level));
    for column in -9..=9_i32 {
        for row in -7..=7_i32 {
            let level = u8::from(column.rem_euclid(2) == 1);
            if column.rem_euclid(2) != row.rem_euclid(2) || r.in_range(0.0, 1.0) < missing {
                continue;
            }
            let at = id(column, row, level);
            let d = view.disc(r, &place(&at), 1.6, 0.08);
            if inside(&d) {
                scene.detection.discs.push(d);
                scene.truth.push(Some(at));
            }
        }
    }
    for m in marks {
        let d = view.disc(r, &place(&m.at), 1.6, 0.1);
        let radius_px = d.ellipse.mean_radius_px();
        if inside(&d) {
            scene.detection.shapes.push(Shape { center_px: d.ellipse.center_px, radius_px, mark: m.kind });
        }
    }
    scene
}

#[test]
fn square_and_triangle_fix_both_levels() {
    let (found, refused) = recall(18, 300, 55.0, |r, oblique| {
        let roll = r.in_range(0.0, 6.2);
        let view = View::new(r, oblique, roll, 0.02, Vector2::new(-5.0, 0.0), 110.0);
        (plate_scene(r, &view, 0.1, &plate_marks()), plate_target(plate_marks()))
    });
    assert!(found > 0.95 && refused < 0.03, "{found} {refused}");
}

#[test]
fn one_mark_and_up_are_enough_for_an_upright_plate() {
    let mut r = Random(19);
    for run in 0..60 {
        let (oblique, roll) = (r.in_range(0.0, 0.7), r.in_range(-0.3, 0.3));
        let view = View::new(&mut r, oblique, roll, 0.0, Vector2::new(-5.0, 0.0), 110.0);
        let marks = plate_marks();
        let scene = plate_scene(&mut r, &view, 0.05, &marks[run % 2..=run % 2]);
        let l = label_discs("image", &scene.detection, &plate_target(marks)).unwrap();
        assert!(scene.all_right(&l.discs), "run {run}: {:?}", l.warnings);
        assert!(!l.alternatives.is_empty() && l.warnings.iter().any(|w| w.contains("up")));
    }
}

#[test]
fn a_plain_grid_is_no_two_level_plate() {
    let mut r = Random(20);
    let view = View::new(&mut r, 0.4, 0.1, 0.0, Vector2::new(25.0, 15.0), 120.0);
    let scene = grid_scene(&mut r, (12, 10), &view, 0.0, |_, _| None, (-3, -3));
    let e = label_discs("image", &scene.detection, &plate_target(plate_marks())).unwrap_err();
    assert!(e.to_string().contains("plate"), "{e}");
}

#[test]
fn two_discs_are_the_pair_that_stands_out() {
    let target = |radii_mm, spacing_mm| Target::TwoDiscs(Pair { spacing_mm, radii_mm });
    let discs = vec![
        disc(300.0, 500.0, 8.0, 5.0, 0.3),
        disc(900.0, 500.0, 150.0, 105.0, 0.02),
        disc(500.0, 500.0, 190.0, 135.0, 0.0),
    ];
    let mut d = Detection { discs, ..Detection::default() };
    let l = label_discs("image", &d, &target(None, None)).unwrap();
    assert_eq!(l.discs, vec![LabelledDisc { disc: 2, id: id(0, 0, 0) }, LabelledDisc { disc: 1, id: id(1, 0, 0) }]);
    assert_eq!((l.left_over.clone(), l.alternatives.len()), (vec![0], 1));
    let exchanged = l.relabelled(&l.alternatives[0]);
    assert_eq!((exchanged[0].disc, exchanged[1].disc), (1, 2));
    // A wisp of smoke in one of them makes no third disc.
    d.discs.push(disc(520.0, 470.0, 120.0, 85.0, 0.0));
    let with_wisp = label_discs("image", &d, &target(None, None)).unwrap();
    assert_eq!((with_wisp.discs, with_wisp.left_over), (l.discs.clone(), vec![0, 3]));
    d.discs.pop();
    // Stated radii turn the numbers round.
    let l = label_discs("image", &d, &target(Some([10.0, 12.5]), Some(26.0))).unwrap();
    assert_eq!(l.discs[0].disc, 1);
    // A stated ratio that nothing fits.
    assert!(label_discs("image", &d, &target(Some([5.0, 12.5]), None)).is_err());
    // A rival as large as the pair.
    d.discs.push(disc(700.0, 950.0, 160.0, 115.0, 0.0));
    let e = label_discs("image", &d, &target(None, None)).unwrap_err();
    assert!(e.to_string().contains("more than one pair"), "{e}");
    d.discs.truncate(1);
    let e = label_discs("image", &d, &target(None, None)).unwrap_err();
    assert!(matches!(e, crate::Error::Insufficient(Insufficient::TooFewDiscs { found: 1, needed: 2, .. })), "{e}");
}
