//! The camera's analytic Jacobians against dual numbers on a camera written anew as geometry in space, and against
//! differences of the camera itself; and the checker against Jacobians it must refuse.
//!
//! The other camera, in units of f: exit pupil at 0, sensor plane through `o = (0, 0, m)` spanned by u and v.
//! ```text
//! forward    d = (xd, yd, m),  s = (n . o) / (n . d),  w = s d - o,  (tx, ty) = (u . w, v . w)
//! back       w = o + tx u + ty v,  (xd, yd) = m (w_x, w_y) / w_z
//! ```
//! The inverse of the polynomial is Newton's iteration on the factor q of the radius, carried out on dual numbers.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod dual;

use nalgebra::{Vector2, Vector3};
use spivcal::camera::{Camera, INTRINSICS, Intrinsics, Radial};

/// Three coordinates (or two pixels and an idle one), then the intrinsics.
const N: usize = 3 + INTRINSICS;

/// Largest departure of an analytic derivative, relative to the length of its column.
const RELATIVE: f64 = 1e-10;

/// A number with its gradient by all of them.
type Dual = dual::Dual<N>;

type Space = [Dual; 3];

fn dot(a: &Space, b: &Space) -> Dual {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: &Space, b: &Space) -> Space {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The sensor and the lens as geometry in space.
struct Geometry {
    f: Dual,
    aspect: Dual,
    axis_point: [Dual; 2],
    origin: Space,
    u: Space,
    v: Space,
    k: [Dual; 3],
    radial: Radial,
}

impl Geometry {
    fn of(i: &Intrinsics) -> Self {
        let p = i.to_array();
        let q: [Dual; INTRINSICS] = std::array::from_fn(|k| Dual::variable(p[k], 3 + k));
        let (sa, ca, sb, cb) = (q[4].sin(), q[4].cos(), q[5].sin(), q[5].cos());
        let zero = Dual::constant(0.0);
        Self {
            f: q[0],
            aspect: q[1],
            axis_point: [q[2], q[3]],
            origin: [zero, zero, q[9]],
            u: [cb, zero, sb],
            v: [-(sa * sb), ca, sa * cb],
            k: [q[6], q[7], q[8]],
            radial: i.radial,
        }
    }
    fn gain(&self, s: Dual) -> Dual {
        Dual::constant(1.0) + s * (self.k[0] + s * (self.k[1] + s * self.k[2]))
    }
    fn polynomial(&self, xy: [Dual; 2]) -> [Dual; 2] {
        let g = self.gain(xy[0] * xy[0] + xy[1] * xy[1]);
        [xy[0] * g, xy[1] * g]
    }
    /// `q (x, y)` with `q g(q^2 s) = 1`.
    fn inverse_polynomial(&self, xy: [Dual; 2]) -> [Dual; 2] {
        let s = xy[0] * xy[0] + xy[1] * xy[1];
        let one = Dual::constant(1.0);
        let mut q = one;
        for _ in 0..40 {
            let w = q * q * s;
            let slope = one
                + w * (Dual::constant(3.0) * self.k[0]
                    + w * (Dual::constant(5.0) * self.k[1] + w * Dual::constant(7.0) * self.k[2]));
            q = q - (q * self.gain(w) - one) / slope;
        }
        [q * xy[0], q * xy[1]]
    }
    fn project(&self, p: &Space) -> [Dual; 2] {
        let xy = [p[0] / p[2], p[1] / p[2]];
        let xd = match self.radial {
            Radial::IdealToDistorted => self.polynomial(xy),
            Radial::DistortedToIdeal => self.inverse_polynomial(xy),
        };
        let n = cross(&self.u, &self.v);
        let d = [xd[0], xd[1], self.origin[2]];
        let s = dot(&n, &self.origin) / dot(&n, &d);
        let w: Space = std::array::from_fn(|k| s * d[k] - self.origin[k]);
        [self.axis_point[0] + self.f * dot(&self.u, &w), self.axis_point[1] + self.f * self.aspect * dot(&self.v, &w)]
    }
    fn unproject(&self, q: &[Dual; 2]) -> [Dual; 2] {
        let tx = (q[0] - self.axis_point[0]) / self.f;
        let ty = (q[1] - self.axis_point[1]) / (self.f * self.aspect);
        let w: Space = std::array::from_fn(|k| self.origin[k] + tx * self.u[k] + ty * self.v[k]);
        let xd = [self.origin[2] * w[0] / w[2], self.origin[2] * w[1] / w[2]];
        match self.radial {
            Radial::IdealToDistorted => self.inverse_polynomial(xd),
            Radial::DistortedToIdeal => self.polynomial(xd),
        }
    }
}

/// Refuses columns that differ by more than `relative` of their reference's length (a zero column must be zero).
fn check(got: &[[f64; 2]], reference: &[[f64; 2]], relative: f64) -> Result<(), String> {
    for (k, (g, r)) in got.iter().zip(reference).enumerate() {
        let off = (g[0] - r[0]).hypot(g[1] - r[1]);
        if !(off <= relative * r[0].hypot(r[1])) {
            return Err(format!("column {k}: {g:?} against {r:?}, relative {:.2e}", off / r[0].hypot(r[1])));
        }
    }
    Ok(())
}

fn columns<const C: usize>(m: &nalgebra::SMatrix<f64, 2, C>) -> Vec<[f64; 2]> {
    m.column_iter().map(|c| [c[0], c[1]]).collect()
}

fn dual_columns(q: &[Dual; 2], range: std::ops::Range<usize>) -> Vec<[f64; 2]> {
    range.map(|k| [q[0].d[k], q[1].d[k]]).collect()
}

/// Uniform numbers of a seed (64-bit congruential generator, upper bits).
struct Random(u64);

impl Random {
    fn within(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((self.0 >> 11) as f64 / (1u64 << 53) as f64)
    }
}

/// Tilts to 35 degrees in any direction, strong distortion, pixels that are not square, pupils off the lens.
fn random_camera(r: &mut Random, radial: Radial) -> Camera {
    let tilt = r.within(0.0, 35_f64.to_radians());
    let direction = r.within(0.0, std::f64::consts::TAU);
    let p = [
        r.within(600.0, 12_000.0),
        r.within(0.8, 1.25),
        r.within(-300.0, 2000.0),
        r.within(-300.0, 2000.0),
        tilt * direction.sin(),
        tilt * direction.cos(),
        r.within(-0.5, 0.5),
        r.within(-0.4, 0.4),
        r.within(-0.3, 0.3),
        r.within(0.6, 1.6),
    ];
    Camera::new(Intrinsics::from_array(&p, radial)).unwrap()
}

/// Cameras of both polynomials with a point each sees.
fn cases() -> Vec<(Camera, Vector3<f64>)> {
    let mut r = Random(20_240_607);
    let mut out = vec![];
    for k in 0..600 {
        let radial = if k % 2 == 0 { Radial::IdealToDistorted } else { Radial::DistortedToIdeal };
        let camera = random_camera(&mut r, radial);
        let z = r.within(50.0, 3000.0);
        out.push((camera, Vector3::new(r.within(-0.35, 0.35) * z, r.within(-0.3, 0.3) * z, z)));
    }
    out
}

#[test]
fn projection_agrees_with_dual_numbers_on_geometry() {
    for (camera, p) in cases() {
        let jet = camera.project_jet(&p).unwrap();
        let point: Space = std::array::from_fn(|k| Dual::variable(p[k], k));
        let q = Geometry::of(camera.intrinsics()).project(&point);
        for k in 0..2 {
            assert!((jet.pixel[k] - q[k].x).abs() < 1e-9, "{camera:?}: {} {}", jet.pixel[k], q[k].x);
        }
        check(&columns(&jet.dq_dp), &dual_columns(&q, 0..3), RELATIVE)
            .unwrap_or_else(|e| panic!("{camera:?}, by p: {e}"));
        check(&columns(&jet.dq_dintrinsics), &dual_columns(&q, 3..N), RELATIVE)
            .unwrap_or_else(|e| panic!("{camera:?}, by intrinsics: {e}"));
        let (pixel, dq_dp) = camera.image_of_point(&p).unwrap();
        assert!((pixel - jet.pixel).norm() < 1e-9);
        check(&columns(&dq_dp), &dual_columns(&q, 0..3), RELATIVE).unwrap();
    }
}

#[test]
fn unprojection_agrees_with_dual_numbers_on_geometry() {
    for (camera, p) in cases() {
        let q = camera.project_xyz(&p).unwrap();
        let jet = camera.unproject_jet(&q).unwrap();
        let pixel = [Dual::variable(q.x, 0), Dual::variable(q.y, 1)];
        let xy = Geometry::of(camera.intrinsics()).unproject(&pixel);
        for k in 0..2 {
            assert!((jet.xy[k] - xy[k].x).abs() < 1e-12, "{camera:?}");
        }
        check(&columns(&jet.dxy_dq), &dual_columns(&xy, 0..2), RELATIVE).unwrap_or_else(|e| panic!("{camera:?}: {e}"));
        check(&columns(&jet.dxy_dintrinsics), &dual_columns(&xy, 3..N), RELATIVE)
            .unwrap_or_else(|e| panic!("{camera:?}: {e}"));
    }
}

/// Central differences with one Richardson step.
fn difference(f: &dyn Fn(f64) -> Vector2<f64>, h: f64) -> [f64; 2] {
    let d = |h: f64| (f(h) - f(-h)) / (2.0 * h);
    let v = (d(0.5 * h) * 4.0 - d(h)) / 3.0;
    [v.x, v.y]
}

/// Steps for the intrinsics: all in a part of their own size or of one.
fn step(i: &Intrinsics, k: usize) -> f64 {
    if k < 4 { 1e-3 * i.to_array()[k].abs().max(1.0) } else { 1e-3 }
}

fn changed(camera: &Camera, k: usize, h: f64) -> Camera {
    let mut p = camera.intrinsics().to_array();
    p[k] += h;
    Camera::new(Intrinsics::from_array(&p, camera.intrinsics().radial)).unwrap()
}

#[test]
fn both_agree_with_central_differences() {
    for (camera, p) in cases() {
        let (i, jet) = (camera.intrinsics(), camera.project_jet(&p).unwrap());
        let by_p: Vec<[f64; 2]> = (0..3)
            .map(|k| difference(&|h| camera.project_xyz(&(p + Vector3::ith(k, h))).unwrap(), 1e-3 * p.z))
            .collect();
        check(&columns(&jet.dq_dp), &by_p, 1e-6).unwrap_or_else(|e| panic!("{camera:?}: {e}"));
        let by_i: Vec<[f64; 2]> = (0..INTRINSICS)
            .map(|k| difference(&|h| changed(&camera, k, h).project_xyz(&p).unwrap(), step(i, k)))
            .collect();
        // Columns of k2, k3 are as small as r^7 f: differences of pixels near 1000 see them to 1e-13 1000 / 1e-3 px.
        let floor = |m: Vec<[f64; 2]>, r: &[[f64; 2]], floor: f64| -> Vec<[f64; 2]> {
            m.iter().zip(r).map(|(a, b)| if (a[0] - b[0]).hypot(a[1] - b[1]) < floor { *b } else { *a }).collect()
        };
        check(&floor(columns(&jet.dq_dintrinsics), &by_i, 1e-8), &by_i, 1e-6)
            .unwrap_or_else(|e| panic!("{camera:?}: {e}"));

        let q = jet.pixel;
        let back = camera.unproject_jet(&q).unwrap();
        let by_q: Vec<[f64; 2]> = (0..2)
            .map(|k| difference(&|h| camera.ideal_of_pixel(&(q + Vector2::ith(k, h))).unwrap(), 1e-3 * i.f_px))
            .collect();
        check(&columns(&back.dxy_dq), &by_q, 1e-6).unwrap_or_else(|e| panic!("{camera:?}: {e}"));
        let by_i: Vec<[f64; 2]> = (0..INTRINSICS)
            .map(|k| difference(&|h| changed(&camera, k, h).ideal_of_pixel(&q).unwrap(), step(i, k)))
            .collect();
        check(&floor(columns(&back.dxy_dintrinsics), &by_i, 1e-12), &by_i, 1e-6)
            .unwrap_or_else(|e| panic!("{camera:?}: {e}"));
    }
}

#[test]
fn a_wrong_jacobian_is_refused() {
    let (camera, p) = cases().swap_remove(3);
    let point: Space = std::array::from_fn(|k| Dual::variable(p[k], k));
    let reference = dual_columns(&Geometry::of(camera.intrinsics()).project(&point), 3..N);
    let right = columns(&camera.project_jet(&p).unwrap().dq_dintrinsics);
    assert_eq!(check(&right, &reference, RELATIVE), Ok(()));
    for k in 0..INTRINSICS {
        let refused = |what: &str, change: &dyn Fn(&mut [f64; 2])| {
            let mut wrong = right.clone();
            change(&mut wrong[k]);
            let said = check(&wrong, &reference, RELATIVE).expect_err(what);
            assert!(said.starts_with(&format!("column {k}:")), "{what}: {said}");
        };
        refused("a sign", &|c| *c = c.map(|x| -x));
        refused("a part in 1e9", &|c| *c = c.map(|x| x * (1.0 + 1e-9)));
        refused("rows exchanged", &|c| c.swap(0, 1));
        refused("not a number", &|c| c[0] = f64::NAN);
        refused("left away", &|c| *c = [0.0; 2]);
    }
    // A camera that is wrong in one place only: the tilt derivative of a camera without the pupil ratio.
    let mut thin = *camera.intrinsics();
    thin.pupil_ratio = 1.0;
    let other = columns(&Camera::new(thin).unwrap().project_jet(&p).unwrap().dq_dintrinsics);
    assert!(check(&other, &reference, RELATIVE).is_err());
}
