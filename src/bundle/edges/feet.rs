//! Feet of edge points on their imaged circles, several at a time; see [`super`].

use super::allows;
use crate::bundle::contour::SeenCircle;
use crate::bundle::model::DiscObservation;
use crate::camera::{LaneCamera, LaneImage};
use crate::lanes::{self, GROUP, Kernel, Lanes, splats};
use nalgebra::Vector2;

/// A circle of the target in the camera frame, each number in every lane.
pub(super) struct LaneCircle<L> {
    center: [L; 3],
    /// Axes of the target's plane times the radius.
    ex: [L; 3],
    ey: [L; 3],
    inverse_radius: L,
    center_px: [L; 2],
    plane_from_image: [[L; 2]; 2],
}

impl<L: Lanes> LaneCircle<L> {
    #[inline(always)]
    pub(super) fn of(circle: &SeenCircle) -> Option<Self> {
        let start = circle.start()?;
        let motion = &circle.cam_from_target;
        let axes = motion.rotation * circle.radius;
        let (center, plane) = (motion.apply(&circle.center), start.plane_from_image());
        Some(Self {
            center: splats([center.x, center.y, center.z]),
            ex: splats([axes[(0, 0)], axes[(1, 0)], axes[(2, 0)]]),
            ey: splats([axes[(0, 1)], axes[(1, 1)], axes[(2, 1)]]),
            inverse_radius: L::splat(1.0 / circle.radius),
            center_px: splats([start.center_px().x, start.center_px().y]),
            plane_from_image: [splats([plane[(0, 0)], plane[(0, 1)]]), splats([plane[(1, 0)], plane[(1, 1)]])],
        })
    }
}

/// Feet of some edge points.
pub(super) struct LaneFoot<L: Lanes> {
    /// Its image.
    pub(super) image: LaneImage<L>,
    /// Point of the circle in the camera frame, and the radial direction there.
    pub(super) p: [L; 3],
    pub(super) radial: [L; 3],
    /// Outward unit normal in the image.
    pub(super) normal: [L; 2],
    pub(super) distance: L,
    /// Cosine and sine of its angle on the circle.
    pub(super) direction: [L; 2],
}

#[inline(always)]
pub(super) fn dot<L: Lanes, const N: usize>(a: [L; N], b: [L; N]) -> L {
    let mut sum = a[0] * b[0];
    for k in 1..N {
        sum = sum + a[k] * b[k];
    }
    sum
}

/// Feet of edge points on their imaged circle, from the direction of the points from its centre; `None` where one has none.
#[inline(always)]
pub(super) fn feet<L: Lanes>(camera: &LaneCamera<L>, circle: &LaneCircle<L>, q: [L; 2]) -> Option<LaneFoot<L>> {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let aside = [q[0] - circle.center_px[0], q[1] - circle.center_px[1]];
    let (gx, gy) = (dot(circle.plane_from_image[0], aside), dot(circle.plane_from_image[1], aside));
    let size = (gx * gx + gy * gy).sqrt();
    let off = zero.below(size);
    feet_from(camera, circle, q, [L::select(off, gx / size, one), L::select(off, gy / size, zero)])
}

/// The same from cosines and sines of angles close by.
#[inline(always)]
pub(super) fn feet_from<L: Lanes>(
    camera: &LaneCamera<L>,
    circle: &LaneCircle<L>,
    q: [L; 2],
    [mut cos, mut sin]: [L; 2],
) -> Option<LaneFoot<L>> {
    let (zero, one) = (L::splat(0.0), L::splat(1.0));
    let [cu, cv] = circle.center_px;
    for round in 0..12 {
        let (mut spoke, mut p, mut turned) = ([zero; 3], [zero; 3], [zero; 3]);
        for k in 0..3 {
            spoke[k] = circle.ex[k] * cos + circle.ey[k] * sin;
            p[k] = circle.center[k] + spoke[k];
            turned[k] = circle.ey[k] * cos - circle.ex[k] * sin;
        }
        let image = camera.image(p);
        if !L::all(image.valid) {
            return None;
        }
        let tangent = camera.along(&image, turned);
        let gap = [q[0] - image.u, q[1] - image.v];
        let (speed, along) = (dot(tangent, tangent), dot(gap, tangent));
        // 1e-7 px along the curve leave 1e-15 px across it.
        let arrived = (along * along).below(L::splat(1e-14) * speed);
        if L::all(arrived) || round == 11 {
            let length = one / speed.sqrt();
            let outward = [tangent[1] * length, -(tangent[0] * length)];
            let inwards = dot(outward, [image.u - cu, image.v - cv]).below(zero);
            let normal = [L::select(inwards, -outward[0], outward[0]), L::select(inwards, -outward[1], outward[1])];
            let inverse = circle.inverse_radius;
            let radial = [spoke[0] * inverse, spoke[1] * inverse, spoke[2] * inverse];
            return Some(LaneFoot { p, radial, normal, distance: dot(normal, gap), direction: [cos, sin], image });
        }
        // The ellipse's own q'' = centre - q.
        let curvature = dot(gap, [cu - image.u, cv - image.v]);
        let limit = L::splat(0.35);
        let half = (L::splat(0.5) * along / (speed - curvature).at_least(L::splat(0.3) * speed))
            .at_most(limit)
            .at_least(-limit);
        let square = half * half;
        let inverse = one / (one + square);
        let (c, s) = ((one - square) * inverse, (half + half) * inverse);
        // Those that have arrived stay where they are, whoever their neighbours are.
        let next = (cos * c - sin * s, sin * c + cos * s);
        (cos, sin) = (L::select(arrived, cos, next.0), L::select(arrived, sin, next.1));
    }
    None
}

/// The numbers from `at` on; past the end the last one, or `beyond`.
#[inline(always)]
pub(in crate::bundle) fn padded<L: Lanes>(x: &[f64], at: usize, beyond: Option<f64>) -> L {
    if at + L::N <= x.len() {
        return L::load(&x[at..]);
    }
    let mut place = [0.0; GROUP];
    for (k, p) in place.iter_mut().enumerate() {
        let last = beyond.unwrap_or_else(|| x[x.len() - 1]);
        *p = x.get(at + k).copied().unwrap_or(last);
    }
    L::load(&place)
}

/// How many points the groups of `n` points hold.
pub(in crate::bundle) fn filled(n: usize) -> usize {
    n.div_ceil(GROUP) * GROUP
}

/// Feet of the edge points of a contour, number by number.
#[derive(Debug, Default)]
pub(in crate::bundle) struct Feet {
    /// Signed distance of the edge point, px; positive outside.
    pub(in crate::bundle) distance_px: Vec<f64>,
    /// Outward unit normal in the image.
    pub(in crate::bundle) normal: [Vec<f64>; 2],
    /// How far the image moves along it as the radius grows, px per mm.
    pub(in crate::bundle) px_per_mm: Vec<f64>,
    /// Cosine and sine of the foot's angle on the circle.
    pub(in crate::bundle) direction: [Vec<f64>; 2],
}

impl Feet {
    /// `None` where the circle has no image.
    pub(in crate::bundle) fn of(circle: &SeenCircle, seen: &DiscObservation) -> Option<Self> {
        if allows(circle.camera) { lanes::run(AllFeet { circle, seen }) } else { Self::plain(circle, seen) }
    }

    /// One by one.
    pub(super) fn plain(circle: &SeenCircle, seen: &DiscObservation) -> Option<Self> {
        let (start, edge, mut out) = (circle.start()?, &seen.edge, Self::default());
        let plane = &circle.cam_from_target.rotation;
        for i in 0..edge.u_px.len() {
            let foot = circle.foot(&start, &Vector2::new(edge.u_px[i], edge.v_px[i]))?;
            let (_, dq_dp) = circle.camera.image_of_point(&foot.p_in_cam).ok()?;
            out.distance_px.push(foot.distance_px);
            out.px_per_mm.push(foot.normal.dot(&(dq_dp * foot.radial)));
            for k in 0..2 {
                out.normal[k].push(foot.normal[k]);
                out.direction[k].push(plane.column(k).dot(&foot.radial));
            }
        }
        Some(out)
    }

    pub(super) fn all(&mut self) -> [&mut Vec<f64>; 6] {
        let ([u, v], [cos, sin]) = (&mut self.normal, &mut self.direction);
        [&mut self.distance_px, u, v, &mut self.px_per_mm, cos, sin]
    }
}

struct AllFeet<'a> {
    circle: &'a SeenCircle<'a>,
    seen: &'a DiscObservation,
}

impl Kernel for AllFeet<'_> {
    type Output = Option<Feet>;
    #[inline(always)]
    fn run<L: Lanes>(self) -> Option<Feet> {
        let edge = &self.seen.edge;
        let camera = LaneCamera::<L>::of(self.circle.camera)?;
        let circle = LaneCircle::<L>::of(self.circle)?;
        let n = edge.u_px.len();
        let groups = if n > 0 { filled(n) } else { 0 };
        let mut out = Feet::default();
        out.all().into_iter().for_each(|o| o.resize(groups, 0.0));
        for i in (0..groups).step_by(L::N) {
            let foot = feet(&camera, &circle, [padded(&edge.u_px, i, None), padded(&edge.v_px, i, None)])?;
            let (g, _) = camera.derivative(&foot.image, foot.normal);
            foot.distance.store(&mut out.distance_px[i..]);
            dot(g, foot.radial).store(&mut out.px_per_mm[i..]);
            foot.normal[0].store(&mut out.normal[0][i..]);
            foot.normal[1].store(&mut out.normal[1][i..]);
            foot.direction[0].store(&mut out.direction[0][i..]);
            foot.direction[1].store(&mut out.direction[1][i..]);
        }
        out.all().into_iter().for_each(|o| o.truncate(n));
        Some(out)
    }
}
