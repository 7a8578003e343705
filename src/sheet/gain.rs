//! What errors of a calibration do to displacements measured in the sheet.
//!
//! A particle in the sheet at X (sheet frame, z = 0) moves by D, three components. Camera c sees it at q_c and sees it
//! move by `A_c D`. A reconstruction knows the pixels and its own, slightly wrong calibration:
//! ```text
//! A_c(q)  = d(pixel of camera c) / d(point in the sheet frame), at the point of the sheet that camera c sees at q
//! A       = [A_1(q_1); A_2(q_2)]                      4 x 3
//! M       = A^+ A_true,   A^+ = (A^T A)^-1 A^T         measured displacement = M true displacement
//! gain    = M_ww / sqrt(M_uu M_vv - M_uv M_vu)         out-of-plane gain relative to the in-plane scale
//! leak of component j into component i = M_ij
//! disparity = (pixel, in camera 2, of the sheet point that camera 1 sees at q_1) - q_2
//! ```
//! With the true calibration M is the identity, the gain 1 and the disparity 0. A wrong scale of the rig multiplies M as a
//! whole and leaves the gain alone; a sheet frame turned against the true one adds an antisymmetric part to M and leaves the gain
//! alone to first order. The sheet frame of each calibration is the one it reports (see [`super`]).
//!
//! Sigmas: the [`RESPONSES`] numbers are expanded at the estimate by every intrinsic, the motion between the cameras and the plane
//! of the sheet (central differences of exact derivatives), and the full covariance is carried through. A number that moves along an
//! undetermined direction has no sigma; one that does not, has: in a fixed sheet the disparity is known where the gain is not.
//!
//! | symbol | identifier | shape | unit | frame | meaning |
//! |---|---|---|---|---|---|
//! | X | `point_mm` | 2 | mm | Sheet | point of the sheet |
//! | q_c | `pixels` | 2 | px | Sensor | its image in camera c |
//! | A_c | `by_displacement` | 2 x 3 | px/mm | Sensor, Sheet | change of the image by a displacement |
//! | M | [`Response::measured_from_true`] | 3 x 3 | 1 | Sheet | measured from true displacement |
//!
//! Source: method sections 6 and 7; Prasad, "Stereoscopic particle image velocimetry" (2000) for the ratio of out-of-plane to in-plane errors.
//! Not valid where both cameras see the sheet along the same line (A has no inverse: `None`).

use super::{Placement, plane_geometry};
use crate::bundle::{NamedCovariance, Parameter, ParameterSteps, symmetric_eigen};
use crate::camera::Camera;
use crate::frames::{Cam, Rig, Sheet};
use crate::rigid::Motion;
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, SVector, Vector2, Vector3};

/// Numbers of a [`Response`]: disparity (2, px), place seen by the first and by the second camera (2 + 2, mm), M by rows (9).
pub const RESPONSES: usize = 15;

/// Two cameras and the sheet between them, as one calibration has them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StereoSheet {
    cameras: [Camera; 2],
    cam_from_rig: [Motion<Cam, Rig>; 2],
    rig_from_sheet: Motion<Rig, Sheet>,
    /// Where the frame of the sheet stands against the one that goes with the plane.
    own_from_sheet: Motion<Sheet, Sheet>,
    cam_from_sheet: [Motion<Cam, Sheet>; 2],
    sheet_from_cam: [Motion<Sheet, Cam>; 2],
}

/// A point of the true sheet, as the true calibration has it.
#[derive(Debug, Clone, Copy)]
struct TruePoint {
    pixels: [Vector2<f64>; 2],
    by_displacement: SMatrix<f64, 4, 3>,
    places: [Vector2<f64>; 2],
}

/// What a calibration makes of a displacement at one point of the true sheet.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// Where the second camera should see what the first one sees, minus where it sees it, px.
    pub disparity_px: Vector2<f64>,
    /// Where each camera puts the point in the sheet frame of the calibration, minus where it is in the true one, mm.
    pub misplaced_mm: [Vector2<f64>; 2],
    /// M: measured from true displacement, sheet frame.
    pub measured_from_true: Matrix3<f64>,
}

impl Response {
    /// Square root of the determinant of the in-plane part of M; 1 for the true calibration.
    pub fn in_plane_scale(&self) -> f64 {
        let m = &self.measured_from_true;
        (m.m11 * m.m22 - m.m12 * m.m21).sqrt()
    }
    /// Out-of-plane gain relative to the in-plane scale; 1 for the true calibration.
    pub fn relative_gain(&self) -> f64 {
        self.measured_from_true.m33 / self.in_plane_scale()
    }
    /// All numbers in the order of [`RESPONSES`].
    fn numbers(&self) -> SVector<f64, RESPONSES> {
        let mut out = SVector::<f64, RESPONSES>::zeros();
        out.fixed_rows_mut::<2>(0).copy_from(&self.disparity_px);
        out.fixed_rows_mut::<2>(2).copy_from(&self.misplaced_mm[0]);
        out.fixed_rows_mut::<2>(4).copy_from(&self.misplaced_mm[1]);
        (0..9).for_each(|k| out[FIRST_OF_M + k] = self.measured_from_true[(k / 3, k % 3)]);
        out
    }
}

const FIRST_OF_M: usize = 6;

impl StereoSheet {
    /// Cameras, motion of the second against the rig, and any frame whose plane z = 0 is the sheet.
    pub fn new(cameras: [Camera; 2], second_from_rig: Motion<Cam, Rig>, rig_from_plane: &Motion<Rig, Sheet>) -> Self {
        let axis: Vector3<f64> = rig_from_plane.rotation.column(2).into_owned();
        let geometry = plane_geometry(axis, axis.dot(&rig_from_plane.translation_mm), None, &Placement::default());
        Self::placed(cameras, [Motion::identity(), second_from_rig], geometry.estimate.rig_from_sheet)
    }

    /// With the frame of the sheet as it is.
    fn placed(cameras: [Camera; 2], cam_from_rig: [Motion<Cam, Rig>; 2], rig_from_sheet: Motion<Rig, Sheet>) -> Self {
        let cam_from_sheet = cam_from_rig.map(|m| m * rig_from_sheet);
        let sheet_from_cam = cam_from_sheet.map(|m| m.inverse());
        let own_from_sheet = Motion::identity();
        Self { cameras, cam_from_rig, rig_from_sheet, own_from_sheet, cam_from_sheet, sheet_from_cam }
    }

    /// The same with points and displacements told in another frame of the same plane, which goes with it.
    #[must_use]
    pub fn told_in(&self, rig_from_sheet: &Motion<Rig, Sheet>) -> Self {
        let own_from_sheet = self.own_from_sheet * (self.rig_from_sheet.inverse() * *rig_from_sheet);
        Self { own_from_sheet, ..Self::placed(self.cameras, self.cam_from_rig, *rig_from_sheet) }
    }

    /// The first two cameras and the common plane of an adjustment; `None` where it has no second camera or no plane.
    pub fn of(covariance: &NamedCovariance) -> Option<Self> {
        let natural = &covariance.natural;
        let cameras = [*natural.cameras.first()?, *natural.cameras.get(1)?];
        Some(Self::new(cameras, natural.cam_from_rig[1], natural.rig_from_plane.as_ref()?))
    }

    /// Sheet frame of this calibration.
    pub fn rig_from_sheet(&self) -> &Motion<Rig, Sheet> {
        &self.rig_from_sheet
    }

    /// Images of a point of the sheet (x, y in the sheet frame, mm) in both cameras, px; `None` where a camera has none.
    pub fn pixels(&self, point_mm: [f64; 2]) -> Option<[Vector2<f64>; 2]> {
        let p = Vector3::new(point_mm[0], point_mm[1], 0.0);
        Some([self.image(0, &p)?.0, self.image(1, &p)?.0])
    }

    /// Point of the sheet that camera `c` sees at a pixel, mm; `None` where its ray does not meet the sheet.
    pub fn point_at(&self, c: usize, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let sheet_from_cam = &self.sheet_from_cam[c];
        let (center, along) = if self.cameras[c].window().is_some() {
            let sight = self.cameras[c].line_of_sight(pixel).ok()?;
            (sheet_from_cam.apply(&sight.from_mm), sheet_from_cam.rotation * sight.direction)
        } else {
            let ray = self.cameras[c].ideal_of_pixel(pixel).ok()?.push(1.0);
            (sheet_from_cam.translation_mm, sheet_from_cam.rotation * ray)
        };
        let s = -center.z / along.z;
        (s > 0.0 && s.is_finite()).then(|| (center + along * s).xy())
    }

    /// Image of a point of the sheet frame and its derivative by a displacement there.
    fn image(&self, c: usize, p: &Vector3<f64>) -> Option<(Vector2<f64>, SMatrix<f64, 2, 3>)> {
        let cam_from_sheet = &self.cam_from_sheet[c];
        let (pixel, dq_dp) = self.cameras[c].image_of_point(&cam_from_sheet.apply(p)).ok()?;
        Some((pixel, dq_dp * cam_from_sheet.rotation))
    }

    /// A of pixels that both cameras see, with the places in the sheet.
    fn by_displacement(&self, pixels: &[Vector2<f64>; 2]) -> Option<(SMatrix<f64, 4, 3>, [Vector2<f64>; 2])> {
        let mut a = SMatrix::<f64, 4, 3>::zeros();
        let mut places = [Vector2::zeros(); 2];
        for c in 0..2 {
            places[c] = self.point_at(c, &pixels[c])?;
            let (_, own) = self.image(c, &places[c].push(0.0))?;
            a.fixed_view_mut::<2, 3>(2 * c, 0).copy_from(&own);
        }
        Some((a, places))
    }

    /// How much larger equal noise of both images makes the error of a displacement along the direction that is known worst than along
    /// the one known best, at a point of the sheet (mm): `sqrt(l_1 / l_3)` of the eigenvalues of `A^T A`; `None` where a camera does not see it.
    pub fn noise_ratio(&self, point_mm: [f64; 2]) -> Option<f64> {
        let truth = self.true_point(point_mm)?;
        let a = truth.by_displacement;
        let values = a.tr_mul(&a).symmetric_eigenvalues();
        Some((values.max() / values.min().max(f64::MIN_POSITIVE)).sqrt())
    }

    /// What this calibration makes of displacements at a point of the sheet of `truth` (x, y in its sheet frame, mm); `None` where a
    /// camera does not see the point, or both see it along one line.
    pub fn response(&self, truth: &StereoSheet, point_mm: [f64; 2]) -> Option<Response> {
        self.response_to(&truth.true_point(point_mm)?)
    }

    fn true_point(&self, point_mm: [f64; 2]) -> Option<TruePoint> {
        let pixels = self.pixels(point_mm)?;
        let (by_displacement, places) = self.by_displacement(&pixels)?;
        Some(TruePoint { pixels, by_displacement, places })
    }

    fn response_to(&self, truth: &TruePoint) -> Option<Response> {
        let (a, places) = self.by_displacement(&truth.pixels)?;
        let normal = a.tr_mul(&a);
        let measured_from_true = normal.try_inverse()? * a.tr_mul(&truth.by_displacement);
        let (across, _) = self.image(1, &places[0].push(0.0))?;
        Some(Response {
            disparity_px: across - truth.pixels[1],
            misplaced_mm: [places[0] - truth.places[0], places[1] - truth.places[1]],
            measured_from_true,
        })
    }

    /// Another calibration of the same rig, told in a frame that goes with its plane as the frame here does.
    pub(crate) fn found_anew(
        &self,
        cameras: [Camera; 2],
        second_from_rig: Motion<Cam, Rig>,
        rig_from_plane: &Motion<Rig, Sheet>,
    ) -> Self {
        let own = Self::new(cameras, second_from_rig, rig_from_plane);
        own.told_in(&(own.rig_from_sheet * self.own_from_sheet))
    }

    /// What [`Self::response`] has instead of what the true calibration has, in the order of [`RESPONSES`].
    pub(crate) fn change(&self, truth: &StereoSheet, point_mm: [f64; 2]) -> Option<SVector<f64, RESPONSES>> {
        let at_truth = Response {
            disparity_px: Vector2::zeros(),
            misplaced_mm: [Vector2::zeros(); 2],
            measured_from_true: Matrix3::identity(),
        };
        Some(self.response(truth, point_mm)?.numbers() - at_truth.numbers())
    }

    /// The calibration after a change of one number.
    fn stepped(&self, parameter: Parameter, h: f64) -> Option<Self> {
        let steps = ParameterSteps::one(parameter, h);
        let [first, second] = self.cam_from_rig;
        if let Parameter::Sheet(_) = parameter {
            return Some(self.found_anew(self.cameras, second, &steps.sheet(&self.rig_from_sheet)));
        }
        let cameras = [steps.camera(0, &self.cameras[0])?, steps.camera(1, &self.cameras[1])?];
        let second = steps.motion(&second);
        Some(Self {
            own_from_sheet: self.own_from_sheet,
            ..Self::placed(cameras, [first, second], self.rig_from_sheet)
        })
    }

    /// A change small enough to be straight and large enough to be felt.
    fn step_of(&self, parameter: Parameter) -> f64 {
        let f_px = self.cameras.each_ref().map(|c| c.intrinsics().f_px);
        parameter.step(f_px, self.rig_from_sheet.translation_mm.norm())
    }
}

/// A stereo calibration with its covariance, ready to be asked about points of the sheet.
#[derive(Debug, Clone)]
pub struct SheetUncertainty {
    stereo: StereoSheet,
    parameters: Vec<Parameter>,
    /// Their places in the covariance it was made of.
    names_at: Vec<usize>,
    /// For each of them a step, and the calibration after it and after the opposite one.
    steps: Vec<(f64, Option<[StereoSheet; 2]>)>,
    covariance: DMatrix<f64>,
    null_directions: DMatrix<f64>,
}

impl SheetUncertainty {
    /// The first two cameras (with their names) and the common plane of an adjustment; `None` where it has no second camera
    /// or no plane.
    pub fn of(covariance: &NamedCovariance, camera_names: [&str; 2]) -> Option<Self> {
        Some(Self::about(StereoSheet::of(covariance)?, covariance, camera_names))
    }

    /// Of cameras and sheet as the adjustment has them, in any frame of the sheet.
    pub(crate) fn about(stereo: StereoSheet, covariance: &NamedCovariance, camera_names: [&str; 2]) -> Self {
        let named = covariance.names.iter().enumerate();
        let own: Vec<(usize, Parameter)> =
            named.filter_map(|(i, n)| Some((i, Parameter::of(n, camera_names)?))).collect();
        let null = &covariance.null_directions;
        let matrix = DMatrix::from_fn(own.len(), own.len(), |i, j| covariance.matrix[(own[i].0, own[j].0)]);
        let null = DMatrix::from_fn(own.len(), null.ncols(), |i, j| null[(own[i].0, j)]);
        let (names_at, parameters) = own.into_iter().unzip();
        Self { names_at, ..Self::made_of(stereo, parameters, matrix, null) }
    }

    /// With parameters of no names.
    fn made_of(
        stereo: StereoSheet,
        parameters: Vec<Parameter>,
        covariance: DMatrix<f64>,
        null_directions: DMatrix<f64>,
    ) -> Self {
        let stepped = |p: &Parameter| {
            let h = stereo.step_of(*p);
            (h, stereo.stepped(*p, h).zip(stereo.stepped(*p, -h)).map(<[StereoSheet; 2]>::from))
        };
        let steps = parameters.iter().map(stepped).collect();
        Self { stereo, parameters, names_at: vec![], steps, covariance, null_directions }
    }

    /// The calibration itself.
    pub fn stereo(&self) -> &StereoSheet {
        &self.stereo
    }

    /// Uncertainty at a point of the sheet (x, y in the sheet frame, mm); `None` where [`StereoSheet::response`] is.
    pub fn at(&self, point_mm: [f64; 2]) -> Option<PointUncertainty> {
        let truth = self.stereo.true_point(point_mm)?;
        let mut derivative = DMatrix::zeros(RESPONSES, self.parameters.len());
        for (k, (h, stepped)) in self.steps.iter().enumerate() {
            let [more, less] = stepped.as_ref()?.each_ref().map(|s| Some(s.response_to(&truth)?.numbers()));
            derivative.set_column(k, &((more? - less?) / (2.0 * h)));
        }
        let c = &derivative * &self.covariance * derivative.transpose();
        let mut felt = derivative.map(f64::abs);
        for (k, (h, _)) in self.steps.iter().enumerate() {
            felt.column_mut(k).add_scalar_mut(ROUNDING / STILL / h);
        }
        let terms = felt * self.null_directions.map(f64::abs);
        Some(PointUncertainty {
            covariance: SMatrix::from_fn(|i, j| c[(i, j)]),
            moved: &derivative * &self.null_directions,
            terms,
            derivative,
        })
    }

    /// Places, in the names of the covariance it was made of, of the parameters that anything here depends on.
    pub(crate) fn names_at(&self) -> &[usize] {
        &self.names_at
    }
}

impl SheetUncertainty {
    /// Expected disparity (root mean square over points of the sheet, x and y in the sheet frame, mm) after the plane has been
    /// found anew from particle images, px in the second camera: what no plane takes away.
    ///
    /// With D the derivatives of all disparities, P the projector onto what the six movements of the plane do to them (rank 3), the
    /// rest is `(1 - P) D` times the error of the calibration. `None` where a point is not seen or nothing determines the rest.
    pub fn disparity_after_refit_px(&self, points_mm: &[[f64; 2]]) -> Option<f64> {
        let truth: Option<Vec<TruePoint>> = points_mm.iter().map(|p| self.stereo.true_point(*p)).collect();
        let truth = truth?;
        let by = |parameter: Parameter| -> Option<DVector<f64>> {
            let h = self.stereo.step_of(parameter);
            let at = |h: f64| {
                let stepped = self.stereo.stepped(parameter, h)?;
                let all: Option<Vec<Vector2<f64>>> =
                    truth.iter().map(|p| Some(stepped.response_to(p)?.disparity_px)).collect();
                Some(DVector::from_iterator(2 * points_mm.len(), all?.iter().flat_map(|d| [d.x, d.y])))
            };
            Some((at(h)? - at(-h)?) / (2.0 * h))
        };
        let mut plane = DMatrix::zeros(2 * points_mm.len(), 6);
        for k in 0..6 {
            let parameter = Parameter::Sheet(k);
            plane.set_column(k, &(by(parameter)? * self.stereo.step_of(parameter)));
        }
        let moved = symmetric_eigen(&(plane.tr_mul(&plane)))?;
        let most = moved.values.amax();
        let mut rest = DMatrix::zeros(2 * points_mm.len(), self.parameters.len());
        let mut felt = rest.clone();
        for (k, parameter) in self.parameters.iter().enumerate() {
            let mut column = by(*parameter)?;
            felt.set_column(k, &column.map(f64::abs).add_scalar(ROUNDING / STILL / self.stereo.step_of(*parameter)));
            for (value, vector) in moved.values.iter().zip(moved.vectors.column_iter()) {
                if *value > PLANE_RANK * most {
                    let direction = &plane * vector;
                    column -= &direction * (direction.dot(&column) / value);
                }
            }
            rest.set_column(k, &column);
        }
        let (moved, terms) = (&rest * &self.null_directions, felt * self.null_directions.map(f64::abs));
        let still = moved.iter().zip(terms.iter()).all(|(m, t)| m.abs() <= STILL * t);
        let squares = (&rest * &self.covariance * rest.transpose()).trace();
        still.then(|| (squares.max(0.0) / points_mm.len() as f64).sqrt())
    }
}

/// Covariance of a [`Response`] about the true calibration, at one point of the sheet.
#[derive(Debug, Clone, PartialEq)]
pub struct PointUncertainty {
    /// Covariance in the order of [`RESPONSES`], over the determined directions.
    pub covariance: SMatrix<f64, RESPONSES, RESPONSES>,
    /// How far each number moves along each undetermined direction.
    moved: DMatrix<f64>,
    /// The sum of the magnitudes of what moves it.
    terms: DMatrix<f64>,
    derivative: DMatrix<f64>,
}

/// A number that moves by less than this part of what moves it stands still along an undetermined direction: weak directions leave
/// about 1e-5.
const STILL: f64 = 1e-4;
/// Part of the largest eigenvalue below which a movement of the plane is one within itself: turns of it are felt as 1 to 1e-4.
const PLANE_RANK: f64 = 1e-8;
/// Rounding of the numbers whose differences are taken: pixels of size 1e3 after some hundred operations.
const ROUNDING: f64 = 1e-11;

impl PointUncertainty {
    /// Standard deviation of a linear function of the numbers; `None` where nothing determines it.
    pub fn sigma(&self, row: &SVector<f64, RESPONSES>) -> Option<f64> {
        let still = (0..self.moved.ncols()).all(|k| {
            let moved: f64 = (0..RESPONSES).map(|i| row[i] * self.moved[(i, k)]).sum();
            let terms: f64 = (0..RESPONSES).map(|i| row[i].abs() * self.terms[(i, k)]).sum();
            moved.abs() <= STILL * terms
        });
        still.then(|| row.dot(&(self.covariance * row)).max(0.0).sqrt())
    }

    /// Derivatives of all numbers (rows, in the order of [`RESPONSES`]) by the parameters at [`SheetUncertainty::names_at`].
    pub(crate) fn derivative(&self) -> &DMatrix<f64> {
        &self.derivative
    }

    fn root_of_two(&self, first: usize) -> Option<f64> {
        let one = |k: usize| self.sigma(&unit(first + k));
        Some(one(0)?.hypot(one(1)?))
    }

    /// Expected length of the disparity (root of the sum of both variances), px in the second camera.
    pub fn disparity_px(&self) -> Option<f64> {
        self.root_of_two(0)
    }
    /// Expected misplacement by the mapping of camera `c` (0 or 1) in the sheet frame (root of the sum of both variances), mm.
    pub fn misplaced_mm(&self, c: usize) -> Option<f64> {
        self.root_of_two(2 + 2 * c.min(1))
    }
    /// Standard deviation of the in-plane scale.
    pub fn in_plane_scale(&self) -> Option<f64> {
        self.sigma(&in_plane_scale_row())
    }
    /// Standard deviation of the out-of-plane gain relative to the in-plane scale.
    pub fn relative_gain(&self) -> Option<f64> {
        self.sigma(&gain_row())
    }
    /// Standard deviation of `M - 1`, entry (measured, true): gains on the diagonal, leaks beside it.
    pub fn measured_from_true(&self, measured: usize, truth: usize) -> Option<f64> {
        self.sigma(&m_row(measured.min(2), truth.min(2)))
    }
    /// Standard deviation of each component of a measured displacement, in the unit of `displacement` (sheet frame): the part
    /// that the calibration adds.
    pub fn displacement(&self, displacement: &Vector3<f64>) -> [Option<f64>; 3] {
        [0, 1, 2].map(|i| self.sigma(&(0..3).map(|j| m_row(i, j) * displacement[j]).sum()))
    }
}

/// In-plane scale by the numbers of a [`Response`], to first order about the true calibration.
pub(crate) fn in_plane_scale_row() -> SVector<f64, RESPONSES> {
    0.5 * (m_row(0, 0) + m_row(1, 1))
}

/// Out-of-plane gain over the in-plane scale likewise.
pub(crate) fn gain_row() -> SVector<f64, RESPONSES> {
    m_row(2, 2) - in_plane_scale_row()
}

/// One number of a [`Response`].
pub(crate) fn unit(k: usize) -> SVector<f64, RESPONSES> {
    let mut row = SVector::zeros();
    row[k] = 1.0;
    row
}

fn m_row(i: usize, j: usize) -> SVector<f64, RESPONSES> {
    unit(FIRST_OF_M + 3 * i + j)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::rigid::rotation_exp;

    /// Two cameras under +-45 degrees, 500 mm from the sheet.
    fn symmetric(f_px: f64, half_angle_rad: f64) -> StereoSheet {
        let camera = Camera::new(Intrinsics::pinhole(f_px, 500.0, 400.0)).unwrap();
        let flip = rotation_exp(&Vector3::new(std::f64::consts::PI, 0.0, 0.0));
        let at = |angle: f64| -> Motion<Cam, Sheet> {
            Motion::new(rotation_exp(&Vector3::new(0.0, angle, 0.0)) * flip, Vector3::new(0.0, 0.0, 500.0))
        };
        let first = at(-half_angle_rad);
        let rig_from_sheet: Motion<Rig, Sheet> = Motion::new(first.rotation, first.translation_mm);
        StereoSheet::new([camera; 2], at(half_angle_rad) * rig_from_sheet.inverse(), &rig_from_sheet)
    }

    #[test]
    fn the_true_calibration_measures_the_truth() {
        let s = symmetric(8000.0, 0.7);
        let r = s.response(&s, [7.0, -4.0]).unwrap();
        assert!(r.disparity_px.norm() < 1e-9);
        assert!((r.measured_from_true - Matrix3::identity()).norm() < 1e-12);
        assert!((r.relative_gain() - 1.0).abs() < 1e-12);
    }

    /// Cameras at a to either side: u has twice cos(a)^2, v twice 1, w twice sin(a)^2. Whoever looks along one line, from one side or both,
    /// sees nothing along it.
    #[test]
    fn noise_is_that_of_the_angle_between_the_lines_of_sight() {
        for a in [0.7_f64, 0.3, 0.01] {
            let ratio = symmetric(8000.0, a).noise_ratio([0.0, 0.0]).unwrap();
            assert!((ratio * a.sin() - 1.0).abs() < 1e-9, "{a} {ratio}");
        }
        let mut facing = symmetric(8000.0, 0.7);
        let turn = crate::rigid::rotation_exp(&Vector3::new(0.0, std::f64::consts::PI, 0.0));
        let first = facing.cam_from_sheet[0];
        let second = Motion::new(turn * first.rotation, Vector3::new(0.0, 0.0, 1000.0) + turn * first.translation_mm);
        facing = StereoSheet::placed(
            facing.cameras,
            [facing.cam_from_rig[0], second * facing.rig_from_sheet.inverse()],
            facing.rig_from_sheet,
        );
        assert!(facing.noise_ratio([0.0, 0.0]).unwrap() > 1e5);
    }

    /// At the centre a camera at the angle a shows u cos a + w sin a: a calibration that believes in the angle b measures
    /// w sin a / sin b and u cos a / cos b.
    #[test]
    fn the_gain_is_that_of_the_textbook() {
        let (a, b) = (0.7_f64, 0.72_f64);
        let r = symmetric(8000.0, b).response(&symmetric(8000.0, a), [0.0, 0.0]).unwrap();
        let m = r.measured_from_true;
        assert!((m.m33 - a.sin() / b.sin()).abs() < 1e-12, "{m}");
        assert!((m.m11 - a.cos() / b.cos()).abs() < 1e-12, "{m}");
        let relative = (a.sin() / b.sin()) / (a.cos() / b.cos()).sqrt();
        assert!((r.relative_gain() - relative).abs() < 1e-12);
    }

    /// A scale common to all lengths, and a focal length that only magnifies, leave the relative gain alone.
    #[test]
    fn scale_is_no_gain() {
        let truth = symmetric(8000.0, 0.7);
        let (mut motions, mut sheet) = (truth.cam_from_rig, truth.rig_from_sheet);
        motions[1].translation_mm *= 1.01;
        sheet.translation_mm *= 1.01;
        let larger = StereoSheet::placed(truth.cameras, motions, sheet);
        let r = larger.response(&truth, [5.0, 3.0]).unwrap();
        assert!((r.in_plane_scale() - 1.01).abs() < 1e-12);
        assert!((r.relative_gain() - 1.0).abs() < 1e-12);
        assert!(r.disparity_px.norm() < 1e-9);
        let r = symmetric(8080.0, 0.7).response(&truth, [0.0, 0.0]).unwrap();
        assert!((r.in_plane_scale() - 1.0 / 1.01).abs() < 1e-12);
        assert!((r.relative_gain() - 1.0).abs() < 1e-12);
    }

    /// Derivatives by parameters are those of the exact response, and undetermined directions are felt where they act only.
    #[test]
    fn sigmas_are_those_of_the_exact_response() {
        let stereo = symmetric(8000.0, 0.7);
        let parameters =
            vec![Parameter::Intrinsic(0, 0), Parameter::Motion(1), Parameter::Sheet(1), Parameter::Sheet(5)];
        let sigmas = [8.0, 2e-4, 3e-4, 0.02];
        let covariance = DMatrix::from_fn(4, 4, |i, j| if i == j { sigmas[i] * sigmas[i] } else { 0.0 });
        let u = SheetUncertainty::made_of(stereo, parameters, covariance, DMatrix::zeros(4, 0));
        let got = u.at([3.0, 2.0]).unwrap();
        let moved = |p: Parameter, h: f64| stereo.stepped(p, h).unwrap().response(&stereo, [3.0, 2.0]).unwrap();
        let (mut gain, mut disparity) = (0.0, 0.0);
        for (p, s) in u.parameters.iter().zip(sigmas) {
            gain += ((moved(*p, 0.1 * s).relative_gain() - 1.0) / 0.1).powi(2);
            disparity += (moved(*p, 0.1 * s).disparity_px / 0.1).norm_squared();
        }
        assert!((got.relative_gain().unwrap() / gain.sqrt() - 1.0).abs() < 1e-3);
        assert!((got.disparity_px().unwrap() / disparity.sqrt() - 1.0).abs() < 1e-3);
        // A plane that is found anew takes away what the sheet's own parameters did, not what the lens and the turn of the camera do.
        let points = [[-20.0, -10.0], [-20.0, 10.0], [20.0, -10.0], [20.0, 10.0], [3.0, 2.0]];
        let all = points.map(|p| u.at(p).unwrap().disparity_px().unwrap().powi(2)).iter().sum::<f64>() / 5.0;
        let after = u.disparity_after_refit_px(&points).unwrap();
        let sheet_only = SheetUncertainty {
            covariance: DMatrix::from_fn(4, 4, |i, j| if i == j && i > 1 { sigmas[i] * sigmas[i] } else { 0.0 }),
            ..u.clone()
        };
        assert!(after < all.sqrt() && after > 0.0, "{after} {all}");
        assert!(sheet_only.disparity_after_refit_px(&points).unwrap() < 1e-4 * all.sqrt());
        // Nothing fixes the angle between the cameras: the gain is lost; a turn of the sheet in itself moves neither.
        let lost = SheetUncertainty { null_directions: DMatrix::from_column_slice(4, 1, &[0.0, 1.0, 0.0, 0.0]), ..u };
        assert_eq!(lost.at([3.0, 2.0]).unwrap().relative_gain(), None);
        let parameters = vec![Parameter::Sheet(0), Parameter::Sheet(1), Parameter::Sheet(2)];
        let n: Vector3<f64> = stereo.rig_from_sheet.rotation.column(2).into_owned();
        let null_directions = DMatrix::from_column_slice(3, 1, n.as_slice());
        let turned = SheetUncertainty::made_of(stereo, parameters, DMatrix::zeros(3, 3), null_directions);
        let at = turned.at([3.0, 2.0]).unwrap();
        assert_eq!((at.disparity_px(), at.relative_gain()), (Some(0.0), Some(0.0)));
    }
}
