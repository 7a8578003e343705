//! The Scheimpflug camera: a lens with radial distortion and a sensor tilted against its axis.
//!
//! The ideal image lies on a plane normal to the lens axis at unit distance; Brown's polynomial distorts it there;
//! the ray through the distorted point is cut with the tilted sensor, whose origin is where the lens axis meets it.
//!
//! ```text
//! (x, y)   = (X/Z, Y/Z)                                         ideal point, untilted plane at unit distance
//! s        = x^2 + y^2,   g(s) = 1 + k1 s + k2 s^2 + k3 s^3
//! (xd, yd) = (x, y) g(s)                                        distorted point, still untilted
//! h        = 1 - (xd tan b + yd tan a / cos b) / m              1 / lambda1 of eq 11
//! tx       = (xd / cos b + yd tan a tan b) / h                  eq 10
//! ty       = (yd / cos a) / h
//! (u, v)   = (cx + f tx, cy + aspect f ty)
//! ```
//! and back
//! ```text
//! lambda   = 1 / (1 + (tx sin b + ty sin a cos b) / m)          eq 6
//! xd = lambda (tx cos b - ty sin a sin b),  yd = lambda ty cos a   eq 7, corrected
//! ```
//! then the radius is undistorted by a safeguarded Newton iteration.
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | f | `f_px` | px | Sensor | image distance along the lens axis over the pixel pitch |
//! | aspect | `aspect` | 1 | Sensor | pixel pitch in u over pixel pitch in v |
//! | (cx, cy) | `cx_px`, `cy_px` | px | Sensor | axis point: where the lens axis meets the sensor; centre of distortion |
//! | a, b | `alpha_rad`, `beta_rad` | rad | Cam | sensor axes `(cos b, 0, sin b)` and `(-sin a sin b, cos a, sin a cos b)` |
//! | k1, k2, k3 | `k` | 1 | Cam | radial distortion on the untilted plane at unit distance |
//! | m | `pupil_ratio` | 1 | Cam | distance exit pupil - sensor along the axis, over f; 1 for a thin lens |
//!
//! Source: the paper's eqs 1-13 after Legarda et al. Eq 7 is printed with `+ sin a cos b` in its x component; that is
//! wrong by 42 px at the top edge of the paper's own image and is corrected here (`tests/camera_reference.rs`).
//! Eqs 12-13 leave open which way the polynomial goes: both are offered by [`Radial`], never mixed.
//!
//! Not valid, and refused by [`Refusal`]: behind the camera; where the ray no longer meets the sensor (`h <= 0`);
//! beyond the radius where `r g(r^2)` stops growing (with distortion at most 1e3); where numbers overflow.

mod arrays;
mod bulk;
mod convert;
mod design;
mod lanes;
mod radial;
mod window;

pub(crate) use arrays::{LineImage, rows};
pub(crate) use bulk::BulkCamera;
pub use convert::{EffectivePinhole, HalconTilt, OpenCvTilted};
pub use design::Drawing;
pub(crate) use lanes::{LaneCamera, LaneImage};
pub use window::{ApparentJet, LAYER_NAMES, LAYERS, WINDOW_STEP_NAMES, WINDOW_STEPS, WaterRay, Window, WindowJet};

use crate::error::{Invalid, Result};
use crate::frames::{Cam, Direction, Pixel, Point};
use nalgebra::{Matrix2, Matrix2x3, SMatrix, Vector2, Vector3};
use radial::RadialLimit;

/// Number of intrinsic parameters.
pub const INTRINSICS: usize = 10;

/// Names of the intrinsic parameters with their units, in the order of every derivative.
pub const INTRINSIC_NAMES: [&str; INTRINSICS] =
    ["f_px", "aspect", "cx_px", "cy_px", "alpha_rad", "beta_rad", "k1", "k2", "k3", "pupil_ratio"];

/// Derivative of a pixel (or of an ideal point) by the intrinsics, in the order of [`INTRINSIC_NAMES`].
pub type DIntrinsics = SMatrix<f64, 2, INTRINSICS>;

/// Which way the radial polynomial goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Radial {
    /// Brown: `distorted = ideal g(ideal radius)`. The default, and OpenCV's.
    #[default]
    IdealToDistorted,
    /// Photogrammetric: `ideal = distorted g(distorted radius)`.
    DistortedToIdeal,
}

/// Parameters of a Scheimpflug camera (table above).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Intrinsics {
    /// Image distance over pixel pitch, px.
    pub f_px: f64,
    /// Pixel pitch in u over pixel pitch in v.
    pub aspect: f64,
    /// Axis point, px.
    pub cx_px: f64,
    /// Axis point, px.
    pub cy_px: f64,
    /// Tilt about the u axis, rad.
    pub alpha_rad: f64,
    /// Tilt about the v axis, rad.
    pub beta_rad: f64,
    /// Radial distortion k1, k2, k3.
    pub k: [f64; 3],
    /// Exit-pupil distance over f.
    pub pupil_ratio: f64,
    /// Direction of the polynomial.
    pub radial: Radial,
}

impl Intrinsics {
    /// An undistorted, untilted camera with square pixels.
    pub fn pinhole(f_px: f64, cx_px: f64, cy_px: f64) -> Self {
        Self {
            f_px,
            aspect: 1.0,
            cx_px,
            cy_px,
            alpha_rad: 0.0,
            beta_rad: 0.0,
            k: [0.0; 3],
            pupil_ratio: 1.0,
            radial: Radial::default(),
        }
    }
    /// The parameters in the order of [`INTRINSIC_NAMES`].
    pub fn to_array(&self) -> [f64; INTRINSICS] {
        let [k1, k2, k3] = self.k;
        [self.f_px, self.aspect, self.cx_px, self.cy_px, self.alpha_rad, self.beta_rad, k1, k2, k3, self.pupil_ratio]
    }
    /// Parameters from an array in the order of [`INTRINSIC_NAMES`].
    pub fn from_array(p: &[f64; INTRINSICS], radial: Radial) -> Self {
        Self {
            f_px: p[0],
            aspect: p[1],
            cx_px: p[2],
            cy_px: p[3],
            alpha_rad: p[4],
            beta_rad: p[5],
            k: [p[6], p[7], p[8]],
            pupil_ratio: p[9],
            radial,
        }
    }
}

/// Why a point has no image, or a pixel no ray.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The point is not in front of the camera.
    #[error("the point lies {depth_mm} mm along the lens axis, behind the camera")]
    BehindCamera {
        /// Coordinate along the lens axis, mm.
        depth_mm: f64,
    },
    /// The ray runs parallel to the tilted sensor or away from it.
    #[error("the ray does not meet the tilted sensor")]
    OffSensor,
    /// Beyond the radius to which the distortion polynomial is monotonic.
    #[error("radius {radius} is beyond {limit}, where the distortion polynomial stops growing")]
    BeyondDistortion {
        /// Radius on the untilted plane at unit distance.
        radius: f64,
        /// The largest valid one.
        limit: f64,
    },
    /// The point does not lie beyond the window.
    #[error("the point lies {missing_mm} mm before the far face of the window")]
    BeforeWindow {
        /// How much it lacks along the window's normal, mm.
        missing_mm: f64,
    },
    /// A coordinate is NaN or infinite.
    #[error("a coordinate is not finite")]
    NotFinite,
}

/// A pixel with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProjectionJet {
    /// The image, px.
    pub pixel: Vector2<f64>,
    /// Derivative by the point in the camera frame, px per mm.
    pub dq_dp: Matrix2x3<f64>,
    /// Derivative by the intrinsics, px per unit.
    pub dq_dintrinsics: DIntrinsics,
}

/// An ideal point (x, y) with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnprojectionJet {
    /// Ideal point (X/Z, Y/Z).
    pub xy: Vector2<f64>,
    /// Derivative by the pixel, per px.
    pub dxy_dq: Matrix2<f64>,
    /// Derivative by the intrinsics, per unit.
    pub dxy_dintrinsics: DIntrinsics,
}

/// A Scheimpflug camera whose parameters have been checked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    intrinsics: Intrinsics,
    limit: RadialLimit,
    tilt: TiltTerms,
    window: Option<Window>,
}

/// Trigonometry of the tilts, computed once per camera.
#[derive(Debug, Clone, Copy, PartialEq)]
struct TiltTerms {
    sa: f64,
    ca: f64,
    ta: f64,
    sb: f64,
    cb: f64,
    tb: f64,
}

/// Largest tilt that is still a camera, rad (80 degrees).
const TILT_LIMIT_RAD: f64 = 80.0 * std::f64::consts::PI / 180.0;

impl Camera {
    /// A camera with these parameters.
    ///
    /// # Errors
    /// [`Invalid::Value`] where a parameter is not finite, f, aspect or pupil ratio are not positive, or a tilt
    /// exceeds 80 degrees.
    ///
    /// ```
    /// use spivcal::camera::{Camera, Intrinsics};
    /// use spivcal::frames::Point;
    /// let mut i = Intrinsics::pinhole(8889.0, 511.5, 383.5);
    /// i.beta_rad = 6.34_f64.to_radians();
    /// let camera = Camera::new(i)?;
    /// let q = camera.project(&Point::new(10.0, 5.0, 500.0)).expect("in front of the camera");
    /// let ray = camera.unproject(q).expect("on the sensor");
    /// assert!((ray.xyz.x - 0.02).abs() < 1e-15 && (ray.xyz.y - 0.01).abs() < 1e-15);
    /// # Ok::<(), spivcal::Error>(())
    /// ```
    pub fn new(intrinsics: Intrinsics) -> Result<Self> {
        let positive = |name: &str, value: f64| {
            if value.is_finite() && value > 0.0 {
                Ok(())
            } else {
                Err(Invalid::value(name, value, "a positive number"))
            }
        };
        let i = &intrinsics;
        positive("f_px", i.f_px)?;
        positive("aspect", i.aspect)?;
        positive("pupil_ratio", i.pupil_ratio)?;
        for (name, tilt) in [("alpha_rad", i.alpha_rad), ("beta_rad", i.beta_rad)] {
            if !(tilt.abs() < TILT_LIMIT_RAD) {
                return Err(Invalid::value(name, tilt, "a tilt below 80 degrees").into());
            }
        }
        for (name, value) in INTRINSIC_NAMES.iter().zip(i.to_array()) {
            if !value.is_finite() {
                return Err(Invalid::value(*name, value, "a finite number").into());
            }
        }
        let (sa, ca) = i.alpha_rad.sin_cos();
        let (sb, cb) = i.beta_rad.sin_cos();
        let tilt = TiltTerms { sa, ca, ta: sa / ca, sb, cb, tb: sb / cb };
        Ok(Self { intrinsics, limit: RadialLimit::of(&i.k), tilt, window: None })
    }

    /// The parameters.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// The same camera behind this window (in its own frame), or behind none. Points are then those behind the window; rays of
    /// pixels ([`Camera::unproject`] and its kin) stay those in the air before it, [`Camera::line_of_sight`] goes through.
    pub fn with_window(self, window: Option<Window>) -> Self {
        Self { window, ..self }
    }

    /// The window before it.
    pub fn window(&self) -> Option<&Window> {
        self.window.as_ref()
    }

    /// Image of a point, px.
    ///
    /// # Errors
    /// [`Refusal`] where the point has no image.
    pub fn project(&self, p_in_cam: &Point<Cam>) -> std::result::Result<Pixel, Refusal> {
        self.project_xyz(&p_in_cam.xyz_mm).map(|q| Pixel::new(q.x, q.y))
    }

    /// Image of a point given by its coordinates in the camera frame (mm), px; for inner loops.
    ///
    /// # Errors
    /// [`Refusal`] where the point has no image.
    pub fn project_xyz(&self, p: &Vector3<f64>) -> std::result::Result<Vector2<f64>, Refusal> {
        let xd = match &self.window {
            None => self.distort(&ideal_point(p)?)?,
            Some(window) => self.distort(&ideal_point(&window.apparent(p)?)?)?,
        };
        let (t, _) = self.on_sensor(&xd)?;
        Ok(self.pixel(&t))
    }

    /// Image of a point with derivatives by the point and by the intrinsics.
    ///
    /// # Errors
    /// [`Refusal`] where the point has no image.
    pub fn project_jet(&self, p: &Vector3<f64>) -> std::result::Result<ProjectionJet, Refusal> {
        if let Some(window) = &self.window {
            let WindowJet { pixel, dq_dp, dq_dintrinsics, .. } = self.project_through(window, p)?;
            return Ok(ProjectionJet { pixel, dq_dp, dq_dintrinsics });
        }
        self.jet_in_air(p)
    }

    /// [`Camera::project_jet`] without the window.
    fn jet_in_air(&self, p: &Vector3<f64>) -> std::result::Result<ProjectionJet, Refusal> {
        let xy = ideal_point(p)?;
        let (pixel, dq_dxy, dq_dintrinsics) = self.image_jet(&xy)?;
        let iz = 1.0 / p.z;
        let dxy_dp = Matrix2x3::new(iz, 0.0, -xy.x * iz, 0.0, iz, -xy.y * iz);
        Ok(ProjectionJet { pixel, dq_dp: dq_dxy * dxy_dp, dq_dintrinsics })
    }

    /// Image of a point with its derivative by the point alone; for inner loops.
    ///
    /// # Errors
    /// [`Refusal`] where the point has no image.
    pub fn image_of_point(&self, p: &Vector3<f64>) -> std::result::Result<(Vector2<f64>, Matrix2x3<f64>), Refusal> {
        if let Some(window) = &self.window {
            let a = window.apparent_jet(p)?;
            let (pixel, dq_da) = self.image_in_air(&a.apparent)?;
            return Ok((pixel, dq_da * a.by_point));
        }
        self.image_in_air(p)
    }

    /// [`Camera::image_of_point`] without the window.
    fn image_in_air(&self, p: &Vector3<f64>) -> std::result::Result<(Vector2<f64>, Matrix2x3<f64>), Refusal> {
        let xy = ideal_point(p)?;
        let (xd, dxd_dxy, _) = self.distort_jet(&xy)?;
        let (t, h) = self.on_sensor(&xd)?;
        let i = &self.intrinsics;
        let dq_dxy = Matrix2::from_diagonal(&Vector2::new(i.f_px, i.f_px * i.aspect))
            * self.sensor_by_distorted(&t, h)
            * dxd_dxy;
        let iz = 1.0 / p.z;
        Ok((self.pixel(&t), dq_dxy * Matrix2x3::new(iz, 0.0, -xy.x * iz, 0.0, iz, -xy.y * iz)))
    }

    /// Where the scene is that a pixel sees: behind the window where there is one, else from the projection centre.
    ///
    /// # Errors
    /// [`Refusal`] where no ray reaches that place of the sensor plane, or none passes the window.
    pub fn line_of_sight(&self, q: &Vector2<f64>) -> std::result::Result<WaterRay, Refusal> {
        let direction = self.ideal_of_pixel(q)?.push(1.0);
        match &self.window {
            Some(window) => window.water_ray(&direction),
            None => Ok(WaterRay { from_mm: Vector3::zeros(), direction: direction.normalize() }),
        }
    }

    /// Ray of a pixel: direction (x, y, 1) in the camera frame, in the air before any window.
    ///
    /// # Errors
    /// [`Refusal`] where no ray reaches that place of the sensor plane.
    pub fn unproject(&self, q: Pixel) -> std::result::Result<Direction<Cam>, Refusal> {
        let xy = self.ideal_of_pixel(&Vector2::new(q.u_px, q.v_px))?;
        Ok(Direction::from_vector(Vector3::new(xy.x, xy.y, 1.0)))
    }

    /// Ideal point (x, y) = (X/Z, Y/Z) of a pixel; for inner loops.
    ///
    /// # Errors
    /// [`Refusal`] where no ray reaches that place of the sensor plane.
    pub fn ideal_of_pixel(&self, q: &Vector2<f64>) -> std::result::Result<Vector2<f64>, Refusal> {
        let (i, t) = (&self.intrinsics, &self.tilt);
        let tx = (q.x - i.cx_px) / i.f_px;
        let ty = (q.y - i.cy_px) / (i.aspect * i.f_px);
        let h = 1.0 + (tx * t.sb + ty * t.sa * t.cb) / i.pupil_ratio;
        if !(h > 0.0 && h.is_finite()) {
            return Err(if h.is_finite() || h == f64::NEG_INFINITY { Refusal::OffSensor } else { Refusal::NotFinite });
        }
        self.undistort(&Vector2::new((tx * t.cb - ty * t.sa * t.sb) / h, ty * t.ca / h))
    }

    /// Ideal point of a pixel with derivatives by the pixel and by the intrinsics.
    ///
    /// The derivatives follow from those of the projection: `q = image(xy, i)` gives
    /// `dxy/dq = (dq/dxy)^-1` and `dxy/di = -(dq/dxy)^-1 dq/di`.
    ///
    /// # Errors
    /// [`Refusal`] where no ray reaches that place of the sensor plane.
    pub fn unproject_jet(&self, q: &Vector2<f64>) -> std::result::Result<UnprojectionJet, Refusal> {
        let xy = self.ideal_of_pixel(q)?;
        let (_, dq_dxy, dq_di) = self.image_jet(&xy)?;
        let dxy_dq = dq_dxy.try_inverse().ok_or(Refusal::OffSensor)?;
        Ok(UnprojectionJet { xy, dxy_dq, dxy_dintrinsics: -(dxy_dq * dq_di) })
    }

    /// Pixel of an ideal point with derivatives by (x, y) and by the intrinsics.
    pub(crate) fn image_jet(
        &self,
        xy: &Vector2<f64>,
    ) -> std::result::Result<(Vector2<f64>, Matrix2<f64>, DIntrinsics), Refusal> {
        let i = &self.intrinsics;
        let (xd, dxd_dxy, dxd_dk) = self.distort_jet(xy)?;
        let (t, h) = self.on_sensor(&xd)?;
        let scale = Vector2::new(i.f_px, i.f_px * i.aspect);
        let dt = self.sensor_derivatives(&xd, &t, h);
        let dq_dt = Matrix2::from_diagonal(&scale);
        let dq_dxd = dq_dt * dt.dxd;
        let mut dq_di = DIntrinsics::zeros();
        dq_di.set_column(0, &Vector2::new(t.x, i.aspect * t.y));
        dq_di.set_column(1, &Vector2::new(0.0, i.f_px * t.y));
        dq_di[(0, 2)] = 1.0;
        dq_di[(1, 3)] = 1.0;
        dq_di.set_column(4, &t_scaled(&scale, &dt.dalpha));
        dq_di.set_column(5, &t_scaled(&scale, &dt.dbeta));
        dq_di.fixed_view_mut::<2, 3>(0, 6).copy_from(&(dq_dxd * dxd_dk));
        dq_di.set_column(9, &t_scaled(&scale, &dt.dpupil));
        Ok((self.pixel(&t), dq_dxd * dxd_dxy, dq_di))
    }

    fn pixel(&self, t: &Vector2<f64>) -> Vector2<f64> {
        let i = &self.intrinsics;
        Vector2::new(i.cx_px + i.f_px * t.x, i.cy_px + i.aspect * i.f_px * t.y)
    }

    /// Where the ray through a distorted point meets the sensor, over f; and h.
    fn on_sensor(&self, xd: &Vector2<f64>) -> std::result::Result<(Vector2<f64>, f64), Refusal> {
        let t = &self.tilt;
        let h = 1.0 - (xd.x * t.tb + xd.y * t.ta / t.cb) / self.intrinsics.pupil_ratio;
        if !(h > 0.0) {
            return Err(if h.is_nan() { Refusal::NotFinite } else { Refusal::OffSensor });
        }
        let on = Vector2::new((xd.x / t.cb + xd.y * t.ta * t.tb) / h, xd.y / t.ca / h);
        // Where numbers overflow there is no image either.
        let q = self.pixel(&on);
        if !(h.is_finite() && q.x.is_finite() && q.y.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        Ok((on, h))
    }

    /// Derivative of [`Self::on_sensor`] by the distorted point.
    fn sensor_by_distorted(&self, t: &Vector2<f64>, h: f64) -> Matrix2<f64> {
        let (k, m) = (&self.tilt, self.intrinsics.pupil_ratio);
        let dh = Vector2::new(-k.tb / m, -k.ta / (k.cb * m));
        (Matrix2::new(1.0 / k.cb, k.ta * k.tb, 0.0, 1.0 / k.ca) - t * dh.transpose()) / h
    }

    /// Derivatives of [`Self::on_sensor`]: with `t = n / h`, `dt = (dn - t dh) / h`.
    fn sensor_derivatives(&self, xd: &Vector2<f64>, t: &Vector2<f64>, h: f64) -> SensorDerivatives {
        let k = &self.tilt;
        let m = self.intrinsics.pupil_ratio;
        let (ca2, cb2) = (k.ca * k.ca, k.cb * k.cb);
        let dn_dalpha = Vector2::new(xd.y * k.tb / ca2, xd.y * k.sa / ca2);
        let dh_dalpha = -xd.y / (ca2 * k.cb * m);
        let dn_dbeta = Vector2::new((xd.x * k.sb + xd.y * k.ta) / cb2, 0.0);
        let dh_dbeta = -(xd.x + xd.y * k.ta * k.sb) / (cb2 * m);
        let dh_dpupil = (xd.x * k.tb + xd.y * k.ta / k.cb) / (m * m);
        SensorDerivatives {
            dxd: self.sensor_by_distorted(t, h),
            dalpha: (dn_dalpha - t * dh_dalpha) / h,
            dbeta: (dn_dbeta - t * dh_dbeta) / h,
            dpupil: -t * (dh_dpupil / h),
        }
    }
}

struct SensorDerivatives {
    dxd: Matrix2<f64>,
    dalpha: Vector2<f64>,
    dbeta: Vector2<f64>,
    dpupil: Vector2<f64>,
}

fn t_scaled(scale: &Vector2<f64>, t: &Vector2<f64>) -> Vector2<f64> {
    scale.component_mul(t)
}

fn ideal_point(p: &Vector3<f64>) -> std::result::Result<Vector2<f64>, Refusal> {
    if !(p.x.is_finite() && p.y.is_finite() && p.z.is_finite()) {
        return Err(Refusal::NotFinite);
    }
    if p.z <= 0.0 {
        return Err(Refusal::BehindCamera { depth_mm: p.z });
    }
    Ok(Vector2::new(p.x / p.z, p.y / p.z))
}
