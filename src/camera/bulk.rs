//! Images of points and ideal points of pixels, several at a time and without derivatives, for a camera without a window.
//!
//! The formulas of the room's head and of [`super::radial`], arranged for few and early divisions, products and sums fused: equal to the
//! plain path to rounding. `NaN` where that refuses.

use super::{Camera, Radial};
use crate::lanes::{Lanes, splats};

/// Relative error below which Newton's method has arrived.
const NEAR: f64 = 1e-16;

/// A camera, each of its numbers in every lane.
#[derive(Clone, Copy)]
pub(crate) struct BulkCamera<L> {
    outward: bool,
    straight: bool,
    center: [L; 2],
    /// 1 / f
    per_f: [L; 2],
    k: [L; 3],
    /// Of the radius before the polynomial over that after it: r / t = 1 + a_1 t^2 + a_2 t^4 + a_3 t^6 + ...
    reversed: [L; 3],
    /// Bound of the curvature: |f'' r / 2| <= b_1 s + b_2 s^2 + b_3 s^3, f = r g(r^2).
    bend: [L; 3],
    radius: L,
    radius_squared: L,
    /// Image of the largest radius.
    image: L,
    /// h = 1 + h_by . xd
    h_by: [L; 2],
    /// f tx h = u_by . xd
    u_by: [L; 2],
    /// aspect f ty h = v_by yd
    v_by: L,
    /// Back: h = 1 + back_h . t, xd h = back_x . t, yd h = back_y ty
    back_h: [L; 2],
    back_x: [L; 2],
    back_y: L,
}

impl<L: Lanes> BulkCamera<L> {
    /// `None` for a camera behind a window.
    #[inline(always)]
    pub(crate) fn of(camera: &Camera) -> Option<Self> {
        if camera.window.is_some() {
            return None;
        }
        let (i, t) = (&camera.intrinsics, &camera.tilt);
        let m = i.pupil_ratio;
        let [radius, image] = [camera.limit.radius(), camera.limit.image()].map(|x| x.min(f64::MAX));
        let f = [i.f_px, i.aspect * i.f_px];
        let [k1, k2, k3] = i.k;
        Some(Self {
            outward: i.radial == Radial::IdealToDistorted,
            straight: i.k == [0.0; 3],
            center: splats([i.cx_px, i.cy_px]),
            per_f: f.map(|f| L::splat(1.0 / f)),
            k: splats(i.k),
            reversed: splats([-k1, 3.0 * k1 * k1 - k2, k1 * (8.0 * k2 - 12.0 * k1 * k1) - k3]),
            bend: splats([3.0 * k1.abs(), 10.0 * k2.abs(), 21.0 * k3.abs()]),
            radius: L::splat(radius),
            radius_squared: L::splat((radius * radius).min(f64::MAX)),
            image: L::splat(image),
            h_by: splats([-t.tb / m, -t.ta / (t.cb * m)]),
            u_by: splats([f[0] / t.cb, f[0] * t.ta * t.tb]),
            v_by: L::splat(f[1] / t.ca),
            back_h: splats([t.sb / m, t.sa * t.cb / m]),
            back_x: splats([t.cb, -t.sa * t.sb]),
            back_y: L::splat(t.ca),
        })
    }

    /// Images of points of the camera frame, px. With g the polynomial, D = Z h: `u = cx + (g / D) u_by . (X, Y)`, `D = Z + g h_by . (X, Y)`; what
    /// has to wait for the two divisions is kept short.
    #[inline(always)]
    pub(crate) fn image(&self, [x, y, z]: [L; 3]) -> [L; 2] {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let (across, along) = (x.fused(self.u_by[0], y * self.u_by[1]), x.fused(self.h_by[0], y * self.h_by[1]));
        let (squared, iz) = (x.fused(x, y * y), one / z);
        let s = squared * (iz * iz);
        let (gain, lens) = if self.outward { self.polynomial(s) } else { self.inverse(s) };
        let depth = gain.fused(along, z);
        let by = gain / depth;
        let (u, v) = (across.fused(by, self.center[0]), (y * self.v_by).fused(by, self.center[1]));
        // Comparisons with NaN are false, 1 / Z of an infinite Z is zero; the last one refuses what overflows.
        let before = L::and(zero.below(iz), lens);
        let both = u + v;
        let bounded = L::and(zero.below(depth), (both * zero).below(one));
        let valid = L::and(before, bounded);
        let none = L::splat(f64::NAN);
        [L::select(valid, u, none), L::select(valid, v, none)]
    }

    /// Ideal points (x, y) of pixels.
    #[inline(always)]
    pub(crate) fn ideal(&self, u: L, v: L) -> [L; 2] {
        let (zero, one) = (L::splat(0.0), L::splat(1.0));
        let (tx, ty) = ((u - self.center[0]) * self.per_f[0], (v - self.center[1]) * self.per_f[1]);
        let h = tx.fused(self.back_h[0], ty.fused(self.back_h[1], one));
        let ih = one / h;
        let (xd, yd) = (tx.fused(self.back_x[0], ty * self.back_x[1]) * ih, ty * self.back_y * ih);
        let s = xd.fused(xd, yd * yd);
        let (gain, lens) = if self.outward { self.inverse(s) } else { self.polynomial(s) };
        let valid = L::and(L::and(zero.below(h), h.below(L::splat(f64::INFINITY))), lens);
        let none = L::splat(f64::NAN);
        [L::select(valid, xd * gain, none), L::select(valid, yd * gain, none)]
    }

    /// Directions (x, y, z) of the rays of pixels (u, v) in another frame, to which this rotation leads; not of unit length.
    #[inline(always)]
    pub(crate) fn ray(&self, r: &[[L; 3]; 3], [u, v]: [L; 2]) -> [L; 3] {
        let [x, y] = self.ideal(u, v);
        let mut ray = [x; 3];
        for k in 0..3 {
            ray[k] = r[k][0].fused(x, r[k][1].fused(y, r[k][2]));
        }
        ray
    }

    #[inline(always)]
    fn gain(&self, s: L) -> L {
        let [k1, k2, k3] = self.k;
        s.fused(s.fused(s.fused(k3, k2), k1), L::splat(1.0))
    }

    #[inline(always)]
    fn growth(&self, s: L) -> L {
        let [k1, k2, k3] = self.k;
        let by = [L::splat(3.0) * k1, L::splat(5.0) * k2, L::splat(7.0) * k3];
        s.fused(s.fused(s.fused(by[2], by[1]), by[0]), L::splat(1.0))
    }

    /// Radius after the polynomial over that before it, of the square of that before.
    #[inline(always)]
    fn polynomial(&self, s: L) -> (L, L::Mask) {
        (self.gain(s), s.below(self.radius_squared))
    }

    /// Radius before the polynomial over that after it, of the square of that after: the safeguarded Newton's method of the plain path, from the
    /// polynomial's reversed series. After a step its relative error is the square of that step times `f'' r / (2 f')`, so that for common
    /// lenses one step is enough. A lane that has arrived stands still, so that no lane feels the others.
    #[inline(always)]
    fn inverse(&self, s: L) -> (L, L::Mask) {
        let (zero, half, one) = (L::splat(0.0), L::splat(0.5), L::splat(1.0));
        if self.straight {
            return (one, s.below(L::splat(f64::INFINITY)));
        }
        let target = s.sqrt();
        let valid = target.below(self.image);
        let [a1, a2, a3] = self.reversed;
        let series = s.fused(s.fused(s.fused(a3, a2), a1), one);
        let mut r = (target * series.at_least(half).at_most(L::splat(2.0))).at_most(self.radius);
        let (mut low, mut high) = (zero, self.radius);
        // 1 where a lane has not arrived.
        let mut moving = L::select(L::and(valid, zero.below(target)), one, zero);
        for _ in 0..64 {
            let s = r * r;
            let excess = r.fused(self.gain(s), -target);
            let above = zero.below(excess);
            high = L::select(above, r, high);
            low = L::select(above, low, r);
            let growth = self.growth(s);
            let step = excess / growth;
            let newton = r - step;
            let [b1, b2, b3] = self.bend;
            let far = (L::splat(NEAR) * (s * growth)).below(step * step * (s * s.fused(s.fused(b3, b2), b1)));
            let inside = L::and(low.below(newton), newton.below(high));
            let next = L::select(far, L::select(inside, newton, half * (low + high)), newton);
            r = L::select(half.below(moving), next, r);
            moving = L::select(far, moving, zero);
            if L::all(moving.below(half)) {
                break;
            }
        }
        (L::select(zero.below(target), r / target, one), valid)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Intrinsics;
    use crate::lanes::{GROUP, Kernel, run_all};
    use nalgebra::{Vector2, Vector3};

    #[derive(Clone)]
    struct Both {
        camera: Camera,
        points: [[f64; 3]; GROUP],
        pixels: [[f64; 2]; GROUP],
    }
    impl Kernel for Both {
        type Output = Vec<[u64; 4]>;
        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<[u64; 4]> {
            let camera = BulkCamera::<L>::of(&self.camera).unwrap();
            let mut out = vec![[0; 4]; GROUP];
            for first in (0..GROUP).step_by(L::N) {
                let list = |f: &dyn Fn(usize) -> f64| L::load(&(0..L::N).map(|i| f(first + i)).collect::<Vec<_>>());
                let [u, v] = camera.image([0, 1, 2].map(|k| list(&|i| self.points[i][k])));
                let [x, y] = camera.ideal(list(&|i| self.pixels[i][0]), list(&|i| self.pixels[i][1]));
                for (k, lanes) in [u, v, x, y].into_iter().enumerate() {
                    let mut place = [0.0; GROUP];
                    lanes.store(&mut place);
                    (0..L::N).for_each(|n| out[first + n][k] = place[n].to_bits());
                }
            }
            out
        }
    }

    fn cameras() -> Vec<Camera> {
        let mut all = vec![];
        for radial in [Radial::IdealToDistorted, Radial::DistortedToIdeal] {
            for k in [[0.0; 3], [-0.25, 1.2, -3.0], [0.4, 0.0, 0.0]] {
                let mut i = Intrinsics::pinhole(2000.0, 500.0, 390.0);
                (i.aspect, i.alpha_rad, i.beta_rad, i.k, i.pupil_ratio) = (1.02, 0.2, -0.35, k, 1.1);
                i.radial = radial;
                all.push(Camera::new(i).unwrap());
            }
        }
        all
    }

    fn agree(got: [u64; 2], wanted: Option<Vector2<f64>>, scale: f64) {
        let got = got.map(f64::from_bits);
        match wanted {
            None => assert!(got.iter().all(|x| x.is_nan()), "{got:?}"),
            Some(w) => {
                let gap = (Vector2::from(got) - w).norm();
                assert!(gap < 2e-15 * (scale + w.norm()), "{got:?} {w:?}");
            }
        }
    }

    #[test]
    fn lanes_agree_with_the_plain_camera_and_each_other() {
        for camera in cameras() {
            for round in 0..20 {
                let t = |k: usize| (k + GROUP * round) as f64;
                let mut points: [[f64; 3]; GROUP] =
                    std::array::from_fn(|k| [140.0 * t(k).sin(), 110.0 * (2.0 * t(k)).cos(), 480.0 + t(k)]);
                let mut pixels: [[f64; 2]; GROUP] =
                    std::array::from_fn(|k| [500.0 + 600.0 * (3.0 * t(k)).sin(), 390.0 + 500.0 * (0.7 * t(k)).cos()]);
                match round {
                    0 => (points[0], pixels[0]) = ([0.0, 0.0, 500.0], [500.0, 390.0]),
                    1 => {
                        points[1] = [f64::NAN, 0.0, 500.0];
                        points[2][2] = -480.0;
                        points[3] = [500.0, 0.0, 1.0];
                        points[4] = [0.0, f64::INFINITY, 500.0];
                        points[5] = [0.0, 0.0, f64::INFINITY];
                        pixels[1] = [f64::NAN, 0.0];
                        pixels[2] = [1e6, 1e6];
                        pixels[3] = [-1e6, 0.0];
                        pixels[4] = [f64::INFINITY, 0.0];
                    }
                    _ => {}
                }
                let all = run_all(&Both { camera, points, pixels });
                for widths in &all {
                    assert_eq!(*widths, all[0]);
                }
                for (k, [u, v, x, y]) in all[0].iter().enumerate() {
                    agree([*u, *v], camera.project_xyz(&Vector3::from(points[k])).ok(), 2000.0);
                    agree([*x, *y], camera.ideal_of_pixel(&Vector2::from(pixels[k])).ok(), 1.0);
                }
            }
        }
    }
}
