//! Maps of many points, several at a time, for cameras without a window.
//!
//! Arrays are cut into blocks that do not depend on the threads; inside a pool its threads share them. Every point is computed alone, so
//! the bits depend neither on the pool nor on the width of the processor ([`crate::lanes`]).

use super::map::SheetMap;
use crate::camera::BulkCamera;
use crate::lanes::{GROUP, Kernel, Lanes, run, splats};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Points of a block: input and output stay in a core's own cache. Below two of them threads cost more than they save.
const BLOCK: usize = 4096;

/// Arrays of one length, and where the results go.
type Part<'a> = ([&'a [f64]; 3], [&'a mut [f64]; 2]);

/// The loop over the lanes of arrays, the rest in a group of its own, filled up with its last point.
macro_rules! sweep {
    ($lanes:ident, $from:expr, $to:expr, |$x:ident| $each:expr) => {{
        let (from, to) = ($from, $to);
        let n = from[0].len();
        let whole = n - n % GROUP;
        let mut i = 0;
        while i < whole {
            let $x = [$lanes::load(&from[0][i..]), $lanes::load(&from[1][i..]), $lanes::load(&from[2][i..])];
            let [a, b] = $each;
            a.store(&mut to[0][i..]);
            b.store(&mut to[1][i..]);
            i += $lanes::N;
        }
        if whole < n {
            let mut last = [[0.0; GROUP]; 3];
            let mut found = [[0.0; GROUP]; 2];
            for (place, list) in last.iter_mut().zip(&from) {
                for (k, x) in place.iter_mut().enumerate() {
                    *x = list[(whole + k).min(n - 1)];
                }
            }
            let mut i = 0;
            while i < GROUP {
                let $x = [$lanes::load(&last[0][i..]), $lanes::load(&last[1][i..]), $lanes::load(&last[2][i..])];
                let [a, b] = $each;
                a.store(&mut found[0][i..]);
                b.store(&mut found[1][i..]);
                i += $lanes::N;
            }
            for (list, found) in to.into_iter().zip(&found) {
                list[whole..].copy_from_slice(&found[..n - whole]);
            }
        }
    }};
}

/// Images of points of the sheet frame.
struct Images<'a> {
    map: &'a SheetMap,
    part: Part<'a>,
}

impl Kernel for Images<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Some(camera) = BulkCamera::<L>::of(self.map.camera()) else { return };
        let place = self.map.cam_from_sheet();
        let m = &place.rotation;
        let r: [[L; 3]; 3] =
            [splats([m.m11, m.m12, m.m13]), splats([m.m21, m.m22, m.m23]), splats([m.m31, m.m32, m.m33])];
        let t: [L; 3] = splats([place.translation_mm.x, place.translation_mm.y, place.translation_mm.z]);
        sweep!(L, self.part.0, self.part.1, |p| {
            let x = r[0][0] * p[0] + r[0][1] * p[1] + r[0][2] * p[2] + t[0];
            let y = r[1][0] * p[0] + r[1][1] * p[1] + r[1][2] * p[2] + t[1];
            let z = r[2][0] * p[0] + r[2][1] * p[1] + r[2][2] * p[2] + t[2];
            camera.image([x, y, z])
        });
    }
}

/// Where pixels (u, v) see planes z = const: (u, v, z) to (x, y).
struct Hits<'a> {
    map: &'a SheetMap,
    center_mm: Vector3<f64>,
    part: Part<'a>,
}

impl Kernel for Hits<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Some(camera) = BulkCamera::<L>::of(self.map.camera()) else { return };
        let m = &self.map.cam_from_sheet().rotation;
        // Columns: what the transposed rotation makes of (x, y, 1).
        let r: [[L; 3]; 3] =
            [splats([m.m11, m.m21, m.m31]), splats([m.m12, m.m22, m.m32]), splats([m.m13, m.m23, m.m33])];
        let o: [L; 3] = splats([self.center_mm.x, self.center_mm.y, self.center_mm.z]);
        let (zero, none) = (L::splat(0.0), L::splat(f64::NAN));
        sweep!(L, self.part.0, self.part.1, |q| {
            let [x, y] = camera.ideal(q[0], q[1]);
            let ray = [
                r[0][0] * x + r[0][1] * y + r[0][2],
                r[1][0] * x + r[1][1] * y + r[1][2],
                r[2][0] * x + r[2][1] * y + r[2][2],
            ];
            let depth = (q[2] - o[2]) / ray[2];
            let met = L::and(zero.below(depth), depth.below(L::splat(f64::INFINITY)));
            [L::select(met, o[0] + ray[0] * depth, none), L::select(met, o[1] + ray[1] * depth, none)]
        });
    }
}

/// Cut into blocks, for all threads of the pool in which this is called; outside of any pool in the calling thread.
fn in_blocks(from: [&[f64]; 3], to: [&mut [f64]; 2], work: &(dyn Fn(Part<'_>) + Sync)) {
    let n = from[0].len();
    let [a, b] = to;
    if rayon::current_thread_index().is_none() || n < 2 * BLOCK {
        return work((from, [a, b]));
    }
    a.par_chunks_mut(BLOCK).zip(b.par_chunks_mut(BLOCK)).enumerate().for_each(|(k, (a, b))| {
        let range = k * BLOCK..(k * BLOCK + a.len());
        work((from.map(|list| &list[range.clone()]), [a, b]));
    });
}

/// Images (u, v) of points (x, y, z) of the sheet frame, all of one length; `NaN` where a point has none. The camera has no window.
pub(super) fn images(map: &SheetMap, from: [&[f64]; 3], to: [&mut [f64]; 2]) {
    in_blocks(from, to, &|part| run(Images { map, part }));
}

/// Where pixels see planes: (u, v, z) to (x, y), all of one length; `NaN` where they do not. The camera has no window.
pub(super) fn hits(map: &SheetMap, center_mm: &Vector3<f64>, from: [&[f64]; 3], to: [&mut [f64]; 2]) {
    in_blocks(from, to, &|part| run(Hits { map, center_mm: *center_mm, part }));
}
