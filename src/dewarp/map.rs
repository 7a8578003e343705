//! The exact map of one camera, in bulk, structure of arrays.

use super::bulk::{hits, in_blocks};
use crate::bundle::ParameterSteps;
use crate::camera::{Camera, Refusal};
use crate::error::{Invalid, Result, same_length};
use crate::frames::{Cam, Rig, Sheet};
use crate::lanes::{Column, ColumnMut};
use crate::record::Record;
use crate::rigid::Motion;
use nalgebra::{Matrix2, Matrix2x3, Matrix3x2, Vector2, Vector3};

/// Pixel positions, px; `NaN` where a point has no image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Pixels {
    /// To the right, px.
    pub u_px: Vec<f64>,
    /// Down, px.
    pub v_px: Vec<f64>,
}

/// Pixel positions with their derivatives by the point, px and px per mm; all `NaN` where a point has no image.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PixelJets {
    /// To the right, px.
    pub u_px: Vec<f64>,
    /// Down, px.
    pub v_px: Vec<f64>,
    /// Derivative of u by x, px per mm.
    pub du_dx: Vec<f64>,
    /// Derivative of u by y, px per mm.
    pub du_dy: Vec<f64>,
    /// Derivative of u by z, px per mm.
    pub du_dz: Vec<f64>,
    /// Derivative of v by x, px per mm.
    pub dv_dx: Vec<f64>,
    /// Derivative of v by y, px per mm.
    pub dv_dy: Vec<f64>,
    /// Derivative of v by z, px per mm.
    pub dv_dz: Vec<f64>,
}

/// Points in a plane z = const of the sheet frame, mm; `NaN` where the ray of a pixel does not meet it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SheetPoints {
    /// x in the sheet, mm.
    pub x_mm: Vec<f64>,
    /// y in the sheet, mm.
    pub y_mm: Vec<f64>,
}

/// Points in a plane z = const with their derivatives by the pixel (mm per px) and along the ray (by z, 1); all `NaN`
/// where the ray of a pixel does not meet the plane.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SheetJets {
    /// x in the sheet, mm.
    pub x_mm: Vec<f64>,
    /// y in the sheet, mm.
    pub y_mm: Vec<f64>,
    /// Derivative of x by u, mm per px.
    pub dx_du: Vec<f64>,
    /// Derivative of x by v, mm per px.
    pub dx_dv: Vec<f64>,
    /// Derivative of y by u, mm per px.
    pub dy_du: Vec<f64>,
    /// Derivative of y by v, mm per px.
    pub dy_dv: Vec<f64>,
    /// Slope of the ray: derivative of x by z.
    pub dx_dz: Vec<f64>,
    /// Slope of the ray: derivative of y by z.
    pub dy_dz: Vec<f64>,
}

/// View angles of pixels; `NaN` where a pixel does not see the sheet.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ViewAngles {
    /// `atan(dx/dz)`: positive where the ray comes from +x when seen from +z, rad.
    pub x_rad: Vec<f64>,
    /// `atan(dy/dz)`, rad.
    pub y_rad: Vec<f64>,
    /// Angle between the ray and the sheet's normal, 0 to pi/2, rad.
    pub to_normal_rad: Vec<f64>,
}

/// Where one pixel sees a plane z = const, with derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PlaneHit {
    pub(crate) xy_mm: Vector2<f64>,
    /// By the pixel, mm per px.
    pub(crate) dxy_dq: Matrix2<f64>,
    /// Along the ray, by z.
    pub(crate) slope: Vector2<f64>,
}

/// Why a pixel and the sheet do not meet.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoMeeting {
    /// The camera refuses.
    #[error(transparent)]
    Camera(#[from] Refusal),
    /// The ray runs parallel to the sheet or away from it.
    #[error("the ray of the pixel does not meet the sheet in front of the camera")]
    OffSheet,
}

/// The exact map between the pixels of one camera and the sheet.
#[derive(Debug, Clone, PartialEq)]
pub struct SheetMap {
    camera: Camera,
    cam_from_sheet: Motion<Cam, Sheet>,
    size_px: [usize; 2],
    /// Projection centre in the sheet frame, mm.
    center_mm: Vector3<f64>,
}

impl SheetMap {
    /// The map of a camera in this place, with images of `size_px` (width, height).
    pub fn new(camera: Camera, cam_from_sheet: Motion<Cam, Sheet>, size_px: [usize; 2]) -> Self {
        Self { camera, cam_from_sheet, size_px, center_mm: cam_from_sheet.inverse().translation_mm }
    }

    /// The map of camera `camera` (its position in [`Record::cameras`]) to the record's sheet.
    ///
    /// # Errors
    /// [`Invalid`] where the calibration has no such camera or no sheet.
    pub fn from_record(record: &Record, camera: usize) -> Result<Self> {
        let Some(c) = record.cameras.get(camera) else {
            let n = record.cameras.len();
            return Err(Invalid::value("camera", camera as f64, format!("0 to {}", n.saturating_sub(1))).into());
        };
        let Some(sheet) = &record.sheet else {
            let how = match record.cameras.len() {
                1 => "one camera alone does not tell where the sheet is: calibrate it together with the second",
                _ => {
                    "mark the views recorded in the sheet with sheet = true and calibrate, or find it with spivcal sheet"
                }
            };
            let what = format!("the calibration has no laser sheet, so pixels have no place in it; {how}");
            return Err(Invalid::Contradiction(what).into());
        };
        let cam_from_rig = c.cam_from_rig.motion::<Cam, Rig>();
        Ok(Self::new(c.model()?, cam_from_rig * sheet.rig_from_sheet.motion(), c.image_size_px))
    }

    /// The maps of all cameras of a record after steps of their numbers, to a sheet in the rig; `None` where there is no such camera.
    pub(crate) fn after_steps(
        record: &Record,
        steps: &ParameterSteps,
        rig_from_sheet: &Motion<Rig, Sheet>,
    ) -> Option<Vec<Self>> {
        let one = |(c, camera): (usize, &crate::record::Camera)| {
            let cam_from_rig = camera.cam_from_rig.motion::<Cam, Rig>();
            let pose = if c == 1 { steps.motion(&cam_from_rig) } else { cam_from_rig };
            let model = steps.camera(c, &camera.model().ok()?)?;
            Some(Self::new(model, pose * *rig_from_sheet, camera.image_size_px))
        };
        record.cameras.iter().enumerate().map(one).collect()
    }

    /// The same camera seen from another frame of the sheet.
    pub fn in_frame(&self, sheet_from_placed: &Motion<Sheet, Sheet>) -> Self {
        Self::new(self.camera, self.cam_from_sheet * *sheet_from_placed, self.size_px)
    }

    /// The camera.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }
    /// Its place: camera coordinates from sheet coordinates.
    pub fn cam_from_sheet(&self) -> &Motion<Cam, Sheet> {
        &self.cam_from_sheet
    }
    /// Width and height of its images, px.
    pub fn size_px(&self) -> [usize; 2] {
        self.size_px
    }
    /// Whether a pixel lies on the sensor, the outer halves of the border pixels included.
    pub fn on_sensor(&self, q: &Vector2<f64>) -> bool {
        let within = |x: f64, n: usize| x >= -0.5 && x <= n as f64 - 0.5;
        within(q.x, self.size_px[0]) && within(q.y, self.size_px[1])
    }

    /// Image (px) of one point (x, y, z) of the sheet frame, mm; for inner loops.
    ///
    /// # Errors
    /// [`Refusal`] where the point has no image.
    pub fn pixel_from_sheet(&self, p_mm: &Vector3<f64>) -> std::result::Result<Vector2<f64>, Refusal> {
        self.camera.project_xyz(&self.cam_from_sheet.apply(p_mm))
    }

    /// Where one pixel sees the plane z = `z_mm`: (x, y) of the sheet frame, mm; for inner loops.
    ///
    /// # Errors
    /// [`NoMeeting`] where it does not see it.
    pub fn sheet_from_pixel(&self, q: &Vector2<f64>, z_mm: f64) -> std::result::Result<Vector2<f64>, NoMeeting> {
        if self.camera.window().is_some() {
            return self.behind_window(q, z_mm).map(|(xy_mm, _)| xy_mm);
        }
        let ray = self.cam_from_sheet.rotation.tr_mul(&self.camera.ideal_of_pixel(q)?.push(1.0));
        let depth_mm = self.depth_mm(&ray, z_mm).ok_or(NoMeeting::OffSheet)?;
        Ok(self.center_mm.xy() + ray.xy() * depth_mm)
    }

    /// Where one pixel sees the plane z = `z_mm` through the window, and the slope of its ray there.
    fn behind_window(
        &self,
        q: &Vector2<f64>,
        z_mm: f64,
    ) -> std::result::Result<(Vector2<f64>, Vector2<f64>), NoMeeting> {
        let sight = self.camera.line_of_sight(q)?;
        let from_mm = self.cam_from_sheet.rotation.tr_mul(&sight.from_mm) + self.center_mm;
        let ray = self.cam_from_sheet.rotation.tr_mul(&sight.direction);
        let slope = ray.xy() / ray.z;
        let rise_mm = z_mm - from_mm.z;
        let met = rise_mm / ray.z;
        if !(met >= 0.0 && met.is_finite()) {
            return Err(NoMeeting::OffSheet);
        }
        Ok((from_mm.xy() + slope * rise_mm, slope))
    }

    /// Depth along the lens axis at which a ray meets the plane z = `z_mm`; the ray has unit z in the camera.
    fn depth_mm(&self, ray: &Vector3<f64>, z_mm: f64) -> Option<f64> {
        let depth_mm = (z_mm - self.center_mm.z) / ray.z;
        (depth_mm > 0.0 && depth_mm.is_finite()).then_some(depth_mm)
    }

    /// Image of one point; none where it has no image.
    pub(crate) fn project(&self, p_mm: &Vector3<f64>) -> Option<Vector2<f64>> {
        self.pixel_from_sheet(p_mm).ok()
    }

    /// Image of one point with its derivative by the point, px per mm.
    pub(crate) fn project_jet(&self, p_mm: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let (q, dq_dp) = self.camera.image_of_point(&self.cam_from_sheet.apply(p_mm)).ok()?;
        Some((q, dq_dp * self.cam_from_sheet.rotation))
    }

    /// Where one pixel sees the plane z = `z_mm`.
    pub(crate) fn hit(&self, q: &Vector2<f64>, z_mm: f64) -> Option<PlaneHit> {
        if self.camera.window().is_some() {
            let (xy_mm, slope) = self.behind_window(q, z_mm).ok()?;
            // The pixel of that point moves with it by the derivative of the projection; backwards by its inverse.
            let (_, dq_dp) = self.project_jet(&xy_mm.push(z_mm))?;
            let dxy_dq = dq_dp.fixed_columns::<2>(0).into_owned().try_inverse()?;
            return Some(PlaneHit { xy_mm, dxy_dq, slope });
        }
        let jet = self.camera.unproject_jet(q).ok()?;
        let r = &self.cam_from_sheet.rotation;
        let ray = r.tr_mul(&jet.xy.push(1.0));
        let depth_mm = self.depth_mm(&ray, z_mm)?;
        let slope = Vector2::new(ray.x, ray.y) / ray.z;
        let xy_mm = self.center_mm.xy() + slope * (z_mm - self.center_mm.z);
        // d(ray)/d(ideal point): the first two columns of R^T; what is along z is made up for by the depth.
        let dray: Matrix3x2<f64> = r.fixed_rows::<2>(0).transpose();
        let in_plane = Matrix2::from_fn(|i, j| dray[(i, j)] - slope[i] * dray[(2, j)]) * depth_mm;
        Some(PlaneHit { xy_mm, dxy_dq: in_plane * jet.dxy_dq, slope })
    }

    /// Images of points (x, y, z) of the sheet frame, mm.
    ///
    /// # Errors
    /// [`Invalid::Value`] where the lists differ in length.
    pub fn pixel_of_sheet(&self, x_mm: &[f64], y_mm: &[f64], z_mm: &[f64]) -> Result<Pixels> {
        same_length("points", x_mm.len(), &[y_mm, z_mm])?;
        let mut out = Pixels::default();
        self.pixel_of_sheet_into(x_mm, y_mm, z_mm, &mut out)?;
        Ok(out)
    }

    /// [`SheetMap::pixel_of_sheet`] into lists that are there already; they are made as long as the points. Inside a pool of threads all of
    /// them take part, with equal bits.
    ///
    /// # Errors
    /// [`Invalid::Value`] where the lists differ in length.
    pub fn pixel_of_sheet_into(&self, x_mm: &[f64], y_mm: &[f64], z_mm: &[f64], out: &mut Pixels) -> Result<()> {
        same_length("points", x_mm.len(), &[y_mm, z_mm])?;
        out.u_px.resize(x_mm.len(), 0.0);
        out.v_px.resize(x_mm.len(), 0.0);
        self.images_into([x_mm, y_mm, z_mm], [&mut out.u_px, &mut out.v_px]);
        Ok(())
    }

    /// Images of points, lists of one length.
    pub(super) fn images_into(&self, from: [&[f64]; 3], to: [&mut [f64]; 2]) {
        in_blocks(from, to, &|(from, to)| {
            self.camera.images_into(&self.cam_from_sheet, from.map(Column::from), to.map(ColumnMut::from));
        });
    }

    /// As [`SheetMap::pixel_of_sheet`], with derivatives by x, y and z.
    ///
    /// # Errors
    /// [`Invalid::Value`] where the lists differ in length.
    pub fn pixel_of_sheet_jets(&self, x_mm: &[f64], y_mm: &[f64], z_mm: &[f64]) -> Result<PixelJets> {
        same_length("points", x_mm.len(), &[y_mm, z_mm])?;
        let mut out = PixelJets::default();
        for i in 0..x_mm.len() {
            let jet = self.project_jet(&Vector3::new(x_mm[i], y_mm[i], z_mm[i]));
            out.push(jet.unwrap_or((Vector2::repeat(f64::NAN), Matrix2x3::repeat(f64::NAN))));
        }
        Ok(out)
    }

    /// Where pixels see the plane z = `z_mm` of the sheet frame.
    ///
    /// ```
    /// use nalgebra::{Matrix3, Vector3};
    /// use spivcal::camera::{Camera, Intrinsics};
    /// use spivcal::dewarp::SheetMap;
    /// use spivcal::rigid::Motion;
    /// // A camera 500 mm above the sheet; it sees y up, so its frame is turned about x.
    /// let turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    /// let camera = Camera::new(Intrinsics::pinhole(5000.0, 511.5, 383.5))?;
    /// let map = SheetMap::new(camera, Motion::new(turn, Vector3::new(0.0, 0.0, 500.0)), [1024, 768]);
    /// let points = map.sheet_of_pixel(&[611.5], &[383.5], &[0.0])?;
    /// assert!((points.x_mm[0] - 10.0).abs() < 1e-12 && points.y_mm[0].abs() < 1e-12);
    /// let back = map.pixel_of_sheet(&points.x_mm, &points.y_mm, &[0.0])?;
    /// assert!((back.u_px[0] - 611.5).abs() < 1e-9);
    /// # Ok::<(), spivcal::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Invalid::Value`] where the lists differ in length.
    pub fn sheet_of_pixel(&self, u_px: &[f64], v_px: &[f64], z_mm: &[f64]) -> Result<SheetPoints> {
        let mut out = SheetPoints::default();
        self.sheet_of_pixel_into(u_px, v_px, z_mm, &mut out)?;
        Ok(out)
    }

    /// [`SheetMap::sheet_of_pixel`] into lists that are there already; as [`SheetMap::pixel_of_sheet_into`].
    ///
    /// # Errors
    /// [`Invalid::Value`] where the lists differ in length.
    pub fn sheet_of_pixel_into(&self, u_px: &[f64], v_px: &[f64], z_mm: &[f64], out: &mut SheetPoints) -> Result<()> {
        same_length("pixels", u_px.len(), &[v_px, z_mm])?;
        out.x_mm.resize(u_px.len(), 0.0);
        out.y_mm.resize(u_px.len(), 0.0);
        in_blocks([u_px, v_px, z_mm], [&mut out.x_mm, &mut out.y_mm], &|(from, to)| {
            self.hits_into(from.map(Column::from), to.map(ColumnMut::from));
        });
        Ok(())
    }

    /// Where pixels (u, v) see planes z = const, columns of one length; `NaN` where they do not. Whether every pixel sees its plane; `false` is
    /// also said where that was not looked at.
    pub(crate) fn hits_into(&self, from: [Column; 3], to: [ColumnMut; 2]) -> bool {
        if self.camera.window().is_none() {
            return hits(self, &self.center_mm, from, to);
        }
        let ([u_px, v_px, z_mm], [mut x_mm, mut y_mm]) = (from, to);
        for i in 0..u_px.len() {
            let p = self.sheet_from_pixel(&Vector2::new(u_px.get(i), v_px.get(i)), z_mm.get(i));
            let p = p.unwrap_or(Vector2::repeat(f64::NAN));
            x_mm.set(i, p.x);
            y_mm.set(i, p.y);
        }
        false
    }

    /// As [`SheetMap::sheet_of_pixel`], with derivatives by u and v, and along the ray by z.
    ///
    /// # Errors
    /// [`Invalid::Value`] where the lists differ in length.
    pub fn sheet_of_pixel_jets(&self, u_px: &[f64], v_px: &[f64], z_mm: &[f64]) -> Result<SheetJets> {
        same_length("pixels", u_px.len(), &[v_px, z_mm])?;
        let nowhere = PlaneHit {
            xy_mm: Vector2::repeat(f64::NAN),
            dxy_dq: Matrix2::repeat(f64::NAN),
            slope: Vector2::repeat(f64::NAN),
        };
        let mut out = SheetJets::default();
        for i in 0..u_px.len() {
            out.push(&self.hit(&Vector2::new(u_px[i], v_px[i]), z_mm[i]).unwrap_or(nowhere));
        }
        Ok(out)
    }

    /// View angles of pixels at the plane z = 0; their signs are those of the table above.
    ///
    /// # Errors
    /// [`Invalid::Value`] where the lists differ in length.
    pub fn view_angles(&self, u_px: &[f64], v_px: &[f64]) -> Result<ViewAngles> {
        let jets = self.sheet_of_pixel_jets(u_px, v_px, &vec![0.0; u_px.len()])?;
        let atan = |slopes: &[f64]| slopes.iter().map(|s| s.atan()).collect();
        let to_normal_rad = jets.dx_dz.iter().zip(&jets.dy_dz).map(|(x, y)| x.hypot(*y).atan()).collect();
        Ok(ViewAngles { x_rad: atan(&jets.dx_dz), y_rad: atan(&jets.dy_dz), to_normal_rad })
    }
}

impl PixelJets {
    pub(super) fn push(&mut self, (q, d): (Vector2<f64>, Matrix2x3<f64>)) {
        let lists =
            [&mut self.du_dx, &mut self.du_dy, &mut self.du_dz, &mut self.dv_dx, &mut self.dv_dy, &mut self.dv_dz];
        for (k, list) in lists.into_iter().enumerate() {
            list.push(d[(k / 3, k % 3)]);
        }
        self.u_px.push(q.x);
        self.v_px.push(q.y);
    }
}

impl SheetJets {
    fn push(&mut self, hit: &PlaneHit) {
        self.x_mm.push(hit.xy_mm.x);
        self.y_mm.push(hit.xy_mm.y);
        self.dx_du.push(hit.dxy_dq.m11);
        self.dx_dv.push(hit.dxy_dq.m12);
        self.dy_du.push(hit.dxy_dq.m21);
        self.dy_dv.push(hit.dxy_dq.m22);
        self.dx_dz.push(hit.slope.x);
        self.dy_dz.push(hit.slope.y);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::rigid::rotation_exp;

    fn map() -> SheetMap {
        let mut i = Intrinsics::pinhole(8000.0, 511.5, 383.5);
        (i.alpha_rad, i.beta_rad, i.k[0]) = (0.01, 0.11, -0.2);
        let place = Motion::new(rotation_exp(&Vector3::new(2.9, 0.1, -0.3)), Vector3::new(3.0, -8.0, 500.0));
        SheetMap::new(Camera::new(i).unwrap(), place, [1024, 768])
    }

    #[test]
    fn single_points_go_there_and_back_and_agree_with_the_jets() {
        let m = map();
        for (x, y, z) in [(0.0, 0.0, 0.0), (12.0, -7.0, 1.5), (-20.0, 15.0, -2.0)] {
            let q = m.pixel_from_sheet(&Vector3::new(x, y, z)).unwrap();
            let p = m.sheet_from_pixel(&q, z).unwrap();
            assert!((p - Vector2::new(x, y)).norm() < 1e-10, "{p:?}");
            assert!((m.hit(&q, z).unwrap().xy_mm - p).norm() < 1e-11);
        }
    }

    /// In bulk, of any length and on any number of threads, as one by one.
    #[test]
    fn many_points_go_where_single_ones_do() {
        let m = map();
        let list =
            |n: usize, scale: f64, step: f64| -> Vec<f64> { (0..n).map(|i| scale * (step * i as f64).sin()).collect() };
        for n in [0, 1, 7, 8, 21, 20_000] {
            let [x, y, z] = [list(n, 60.0, 0.37), list(n, 40.0, 0.61), list(n, 3.0, 0.9)];
            let pixels = m.pixel_of_sheet(&x, &y, &z).unwrap();
            let back = m.sheet_of_pixel(&pixels.u_px, &pixels.v_px, &z).unwrap();
            let jets = m.sheet_of_pixel_jets(&pixels.u_px, &pixels.v_px, &z).unwrap();
            for i in 0..n {
                let q = m.pixel_from_sheet(&Vector3::new(x[i], y[i], z[i])).unwrap();
                assert!((q.x - pixels.u_px[i]).hypot(q.y - pixels.v_px[i]) < 1e-11, "{i} of {n}");
                assert!((back.x_mm[i] - x[i]).hypot(back.y_mm[i] - y[i]) < 1e-10, "{i} of {n}");
                assert!((back.x_mm[i] - jets.x_mm[i]).hypot(back.y_mm[i] - jets.y_mm[i]) < 1e-11, "{i} of {n}");
            }
            for threads in [1, 3] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                assert_eq!(pool.install(|| m.pixel_of_sheet(&x, &y, &z)).unwrap(), pixels);
                let found = pool.install(|| m.sheet_of_pixel(&pixels.u_px, &pixels.v_px, &z)).unwrap();
                assert_eq!(found, back);
            }
        }
        let nowhere = m.pixel_of_sheet(&[f64::NAN, 0.0], &[0.0, 0.0], &[0.0, 1e6]).unwrap();
        assert!(nowhere.u_px.iter().chain(&nowhere.v_px).all(|x| x.is_nan()), "{nowhere:?}");
        let nowhere = m.sheet_of_pixel(&[f64::NAN, 500.0], &[0.0, 400.0], &[0.0, 1e6]).unwrap();
        assert!(nowhere.x_mm.iter().chain(&nowhere.y_mm).all(|x| x.is_nan()), "{nowhere:?}");
    }

    #[test]
    fn a_sheet_behind_the_camera_is_not_met() {
        let m = map();
        let place = m.cam_from_sheet();
        let behind = SheetMap::new(*m.camera(), Motion::new(place.rotation, -place.translation_mm), [1024, 768]);
        let q = Vector2::new(511.5, 383.5);
        assert_eq!(behind.sheet_from_pixel(&q, 0.0), Err(NoMeeting::OffSheet));
        assert!(matches!(behind.pixel_from_sheet(&Vector3::zeros()), Err(Refusal::BehindCamera { .. })));
        assert!(matches!(m.sheet_from_pixel(&Vector2::new(f64::NAN, 0.0), 0.0), Err(NoMeeting::Camera(_))));
    }
}
