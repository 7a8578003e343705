//! Maps of many points, several at a time for cameras without a window.
//!
//! Arrays are cut into blocks that do not depend on the threads; inside a pool its threads share them. Every point is computed alone, so
//! the bits depend neither on the pool nor on the width of the processor ([`crate::lanes`]).

use super::map::SheetMap;
use crate::camera::{BulkCamera, rows};
use crate::lanes::{Column, ColumnMut, Each, Kernel, Lanes, Twice, run, splats, sweep};
use nalgebra::Vector3;
use rayon::prelude::*;

/// Points of a block: input and output stay in a core's own cache. Below two of them threads cost more than they save.
const BLOCK: usize = 4096;

/// Arrays of one length, and where the results go.
pub(super) type Part<'a> = ([&'a [f64]; 3], [&'a mut [f64]; 2]);

/// Where a pixel (u, v) sees the plane z = const: (u, v, z) to (x, y).
struct Hit<L> {
    camera: BulkCamera<L>,
    sheet_from_cam: [[L; 3]; 3],
    /// Projection centre in the sheet frame, mm.
    center: [L; 3],
}

impl<L: Lanes> Each<L, 3, 2> for Hit<L> {
    #[inline(always)]
    fn of(&self, q: [L; 3]) -> [L; 2] {
        let o = &self.center;
        let ray = self.camera.ray(&self.sheet_from_cam, [q[0], q[1]]);
        let depth = (q[2] - o[2]) / ray[2];
        let (zero, none) = (L::splat(0.0), L::splat(f64::NAN));
        let met = L::and(zero.below(depth), depth.below(L::splat(f64::INFINITY)));
        [L::select(met, ray[0].fused(depth, o[0]), none), L::select(met, ray[1].fused(depth, o[1]), none)]
    }
}

struct Hits<'a> {
    map: &'a SheetMap,
    center_mm: Vector3<f64>,
    from: [Column<'a>; 3],
    to: [ColumnMut<'a>; 2],
}

impl Hits<'_> {
    #[inline(always)]
    fn hit<L: Lanes>(&self) -> Option<Hit<L>> {
        let camera = BulkCamera::of(self.map.camera())?;
        let sheet_from_cam = rows(&self.map.cam_from_sheet().rotation.transpose());
        Some(Hit { camera, sheet_from_cam, center: splats([self.center_mm.x, self.center_mm.y, self.center_mm.z]) })
    }
}

impl Kernel for Hits<'_> {
    type Output = bool;
    #[inline(always)]
    fn run<L: Lanes>(self) -> bool {
        match (self.hit::<Twice<L>>(), self.hit::<L>()) {
            (Some(pair), Some(one)) => sweep(&pair, &one, self.from, self.to),
            _ => false,
        }
    }
}

/// Cut into blocks, for all threads of the pool in which this is called; outside of any pool in the calling thread.
pub(super) fn in_blocks(from: [&[f64]; 3], to: [&mut [f64]; 2], work: &(dyn Fn(Part<'_>) + Sync)) {
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

/// Where pixels see planes: (u, v, z) to (x, y), all of one length; `NaN` where they do not. The camera has no window. Whether every pixel
/// sees its plane.
pub(super) fn hits(map: &SheetMap, center_mm: &Vector3<f64>, from: [Column; 3], to: [ColumnMut; 2]) -> bool {
    run(Hits { map, center_mm: *center_mm, from, to })
}
