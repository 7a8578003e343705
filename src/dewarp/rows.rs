//! Rows of a dewarped image: the map and the levels, [`TOGETHER`] pixels at a time.
//!
//! Where a window lies in the image as a whole its levels come from [`super::weights`], read from the image in its own depth and memory;
//! that is equal to [`Source::at`] to the rounding of `f32`. At the border [`Source::at`] itself is asked. Nothing but a block's positions
//! is ever held.

use super::grid::SheetGrid;
use super::kernel::{Kernel, MOST_TAPS, Source};
use super::map::SheetMap;
use super::panels::Panels;
use super::weights::{Cubic, Found, Linear, Nearest, Table, Weights};
use crate::camera::{BulkCamera, LineImage};
use crate::lanes::{self, Lanes, Level, Raster, Twice};
use nalgebra::{Vector2, Vector3};

/// Pixels that go through all steps together.
pub(super) const TOGETHER: usize = 64;
/// 0, 1, 2, ...
const COUNT: [f64; TOGETHER] = {
    let mut out = [0.0; TOGETHER];
    let mut i = 0;
    while i < TOGETHER {
        out[i] = i as f64;
        i += 1;
    }
    out
};

/// Where the windows of some positions begin, and what their weights need.
pub(super) struct Places {
    u_px: [f64; TOGETHER],
    v_px: [f64; TOGETHER],
    /// First sample of the window.
    start: [u64; TOGETHER],
    /// Column and row of that sample, for clusters.
    pub(super) first: [[f32; TOGETHER]; 2],
    /// Place in the pixel, from its sample or from half a sample behind it ([`Weights::FROM`]).
    pub(super) x: [[f32; TOGETHER]; 2],
}

impl Places {
    const NONE: Self = Self {
        u_px: [0.0; TOGETHER],
        v_px: [0.0; TOGETHER],
        start: [0; TOGETHER],
        first: [[0.0; TOGETHER]; 2],
        x: [[0.0; TOGETHER]; 2],
    };

    #[inline(always)]
    pub(super) fn start(&self, i: usize) -> usize {
        self.start[i] as usize
    }

    /// Windows of the positions; whether all of them lie in the image, which with INSIDE is known. Those that do not begin at the first sample.
    #[inline(always)]
    fn find<L: Lanes, const INSIDE: bool>(&mut self, bounds: &Bounds, from: f64, clusters: bool) -> bool {
        let (zero, low, from) = (L::splat(0.0), L::splat(-0.5), L::splat(from));
        let (stride, shift, reach) = (L::splat(bounds.stride), L::splat(bounds.shift), L::splat(bounds.reach));
        // From the sample of the pixel (0, 0) to the one in which its window begins.
        let back = L::splat(bounds.reach * (bounds.stride + 1.0));
        let mut all = low.below(zero);
        let mut i = 0;
        while i < TOGETHER {
            let at = [L::load(&self.u_px[i..]), L::load(&self.v_px[i..])];
            let (mut pixel, mut x) = (at, at);
            for k in 0..2 {
                pixel[k] = if bounds.shift == 0.0 { at[k].floor() } else { (at[k] + shift).floor() };
                x[k] = at[k] - (pixel[k] + from);
            }
            if !INSIDE {
                let mut whole = low.below(zero);
                for k in 0..2 {
                    let first = pixel[k] - reach;
                    whole = L::and(whole, L::and(low.below(first), first.below(L::splat(bounds.end[k]))));
                }
                all = L::and(all, whole);
                for k in 0..2 {
                    (pixel[k], x[k]) = (L::select(whole, pixel[k], reach), L::select(whole, x[k], zero));
                }
            }
            (pixel[1].fused(stride, pixel[0]) - back).whole(&mut self.start[i..]);
            for k in 0..2 {
                if clusters {
                    (pixel[k] - reach).narrow(&mut self.first[k][i..]);
                }
                x[k].narrow(&mut self.x[k][i..]);
            }
            i += L::N;
        }
        L::all(all)
    }
}

/// What positions are compared with.
struct Bounds {
    stride: f64,
    /// Added before a position is rounded down.
    shift: f64,
    /// Samples of a window before the one at or below the position.
    reach: f64,
    /// Half a sample beyond where the last window begins.
    end: [f64; 2],
    size_px: [f64; 2],
}

impl Bounds {
    fn new<S, const T: usize>(source: &Source<'_, S>) -> Self {
        let size_px = source.size_px.map(|n| n as f64);
        Self {
            stride: source.stride as f64,
            shift: if T == 1 { 0.5 } else { 0.0 },
            reach: if T == 1 { 0.0 } else { (T / 2 - 1) as f64 },
            end: size_px.map(|n| n - T as f64 + 0.5),
            size_px,
        }
    }

    fn on_sensor(&self, u: f64, v: f64) -> bool {
        let [width, height] = self.size_px;
        u >= -0.5 && u <= width - 0.5 && v >= -0.5 && v <= height - 0.5
    }

    fn whole(&self, u: f64, v: f64) -> bool {
        let first = [u, v].map(|x| (x + self.shift).floor() - self.reach);
        first[0] > -0.5 && first[0] < self.end[0] && first[1] > -0.5 && first[1] < self.end[1]
    }
}

/// Where levels go: 8 and 16 bit are rounded and kept within their limits.
pub(super) enum Levels<'a> {
    U8(&'a mut [u8]),
    U16(&'a mut [u16]),
    F32(&'a mut [f32]),
}

impl Levels<'_> {
    #[inline(always)]
    fn put(&mut self, first: usize, levels: &[f32]) {
        let range = first..first + levels.len();
        match self {
            Self::U8(out) => {
                for (o, x) in out[range].iter_mut().zip(levels) {
                    *o = x.round() as u8;
                }
            }
            Self::U16(out) => {
                for (o, x) in out[range].iter_mut().zip(levels) {
                    *o = x.round() as u16;
                }
            }
            Self::F32(out) => out[range].copy_from_slice(levels),
        }
    }
}

/// Rows of a grid in the plane z = `z_mm` from number `first_row` on; zero and not valid where the camera does not see a pixel.
pub(super) struct Band<'a, S> {
    pub(super) source: Source<'a, S>,
    /// Of kernels that have one.
    pub(super) table: Option<&'a Table>,
    pub(super) panels: &'a Panels,
    pub(super) map: &'a SheetMap,
    pub(super) grid: &'a SheetGrid,
    pub(super) z_mm: f64,
    pub(super) first_row: usize,
    pub(super) levels: Levels<'a>,
    pub(super) valid: &'a mut [bool],
}

/// A band with its weights. Each is compiled by itself: what one of them needs leaves the registers of the others alone.
struct By<'a, S, W, const T: usize> {
    band: Band<'a, S>,
    weights: &'a W,
}

impl<S: Level, W: Weights<T>, const T: usize> lanes::Kernel for By<'_, S, W, T> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        self.band.rows::<L, W, T>(self.weights);
    }
}

/// Does something with a band and the weights of its kernel.
macro_rules! by_kernel {
    ($band:expr, |$by:ident| $work:expr) => {{
        let band = $band;
        match (band.source.kernel, band.table) {
            (Kernel::Nearest, _) => by_kernel!(band, &Nearest, 1, $by, $work),
            (Kernel::Linear, _) => by_kernel!(band, &Linear, 2, $by, $work),
            (Kernel::Lanczos | Kernel::BSpline, Some(table)) => by_kernel!(band, table, 8, $by, $work),
            _ => by_kernel!(band, &Cubic, 4, $by, $work),
        }
    }};
    ($band:ident, $weights:expr, $taps:literal, $by:ident, $work:expr) => {{
        let $by = By::<_, _, $taps> { band: $band, weights: $weights };
        $work
    }};
}

impl<S: Level> Band<'_, S> {
    /// Writes levels and validity, as wide as the processor is.
    pub(super) fn fill(self) {
        by_kernel!(self, |band| lanes::run(band));
    }

    #[inline(always)]
    fn rows<L: Lanes, W: Weights<T>, const T: usize>(mut self, weights: &W) {
        let bounds = Bounds::new::<S, T>(&self.source);
        let raster = Raster::<S, T>::new(self.source.samples, self.source.stride);
        let raster = raster.filter(|_| bounds.end.iter().all(|e| *e > 0.0));
        let camera = BulkCamera::<Twice<L>>::of(self.map.camera());
        let (width, clusters) = (self.grid.width_px, L::PICKS && T == MOST_TAPS);
        let (mut places, mut found, mut nodes) = (Places::NONE, Found::NONE, self.panels.nodes());
        for j in 0..self.valid.len() / width {
            let [_, y_mm] = self.grid.point_mm(0.0, (self.first_row + j) as f64);
            let line = camera.map(|c| LineImage::new(c, self.map.cam_from_sheet(), y_mm, self.z_mm));
            match &line {
                Some(line) => self.panels.see(line, self.grid, &mut nodes),
                None => self.panels.see_one_by_one(|column| self.position(column, y_mm), &mut nodes),
            }
            self.panels.fit::<L>(&mut nodes);
            let mut first = 0;
            while first < width {
                let n = TOGETHER.min(width - first);
                let between = self.panels.place::<L>(&nodes, first / TOGETHER, [&mut places.u_px, &mut places.v_px]);
                match (&between, &line) {
                    (Some(_), _) => (),
                    (_, Some(line)) => self.positions(line, first, &mut places),
                    _ => self.positions_one_by_one(first, y_mm, &mut places),
                }
                let to = j * width + first;
                let inside = between.is_some_and(|[u, v]| bounds.whole(u[0], v[0]) && bounds.whole(u[1], v[1]));
                let whole = match (&raster, inside) {
                    (None, _) => false,
                    (_, true) => places.find::<L, true>(&bounds, W::FROM, clusters),
                    (_, false) => places.find::<L, false>(&bounds, W::FROM, clusters),
                };
                if let Some(raster) = &raster {
                    weights.levels::<S, L>(raster, &places, n, &mut found);
                    // A length that is known is written at once.
                    match n {
                        TOGETHER => self.levels.put(to, &found.levels),
                        _ => self.levels.put(to, &found.levels[..n]),
                    }
                }
                if whole {
                    self.valid[to..to + n].fill(true);
                } else {
                    self.at_border(&bounds, raster.is_some(), &places, to, n);
                }
                first += TOGETHER;
            }
        }
    }

    #[inline(always)]
    fn positions<L: Lanes>(&self, line: &LineImage<L>, first: usize, places: &mut Places) {
        let (origin, step) = (L::splat(self.grid.origin_mm[0]), L::splat(self.grid.mm_per_px));
        let first = L::splat(first as f64);
        let mut i = 0;
        while i < TOGETHER {
            let [u, v] = line.at(origin + step * (L::load(&COUNT[i..]) + first));
            u.store(&mut places.u_px[i..]);
            v.store(&mut places.v_px[i..]);
            i += L::N;
        }
    }

    /// Of a camera behind a window.
    fn position(&self, column: f64, y_mm: f64) -> Option<Vector2<f64>> {
        let [x_mm, _] = self.grid.point_mm(column, 0.0);
        self.map.project(&Vector3::new(x_mm, y_mm, self.z_mm))
    }

    fn positions_one_by_one(&self, first: usize, y_mm: f64, places: &mut Places) {
        for i in 0..TOGETHER {
            let q = self.position((first + i) as f64, y_mm);
            (places.u_px[i], places.v_px[i]) = q.map_or((f64::NAN, f64::NAN), |q| (q.x, q.y));
        }
    }

    /// Validity, and the levels of windows that do not lie in the image as a whole.
    #[inline(never)]
    fn at_border(&mut self, bounds: &Bounds, some_whole: bool, places: &Places, to: usize, n: usize) {
        for i in 0..n {
            let (u, v) = (places.u_px[i], places.v_px[i]);
            let on_sensor = bounds.on_sensor(u, v);
            self.valid[to + i] = on_sensor;
            if !on_sensor {
                self.levels.put(to + i, &[0.0]);
            } else if !(some_whole && bounds.whole(u, v)) {
                self.levels.put(to + i, &[self.source.at(u, v)]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::{Camera, Intrinsics, Window};
    use crate::dewarp::Sampler;
    use crate::image::{GrayView, Samples};
    use crate::lanes::run_all;
    use crate::rigid::{Motion, rotation_exp};

    const ALL: [Kernel; 5] = [Kernel::Nearest, Kernel::Linear, Kernel::Cubic, Kernel::Lanczos, Kernel::BSpline];

    /// An oblique camera with distortion, 2 px per mm, in the air or behind glass; its rows are turned by so much from those of the sheet.
    fn map(size_px: [usize; 2], window: Option<Window>, turned_rad: f64) -> SheetMap {
        let [cx, cy] = size_px.map(|n| 0.5 * (n as f64 - 1.0));
        let mut i = Intrinsics::pinhole(1000.0, cx, cy);
        (i.alpha_rad, i.beta_rad, i.k[0]) = (0.01, 0.11, -0.3);
        let turn = rotation_exp(&Vector3::new(0.0, -0.6, 0.0)) * rotation_exp(&Vector3::new(3.1, 0.05, 0.1));
        let turn = rotation_exp(&Vector3::new(0.0, 0.0, turned_rad)) * turn;
        let camera = Camera::new(i).unwrap().with_window(window);
        SheetMap::new(camera, Motion::new(turn, Vector3::new(0.3, -0.2, 500.0)), size_px)
    }

    #[derive(Clone)]
    struct Bits<'a, S> {
        source: Source<'a, S>,
        map: SheetMap,
        grid: SheetGrid,
    }
    impl<S: Level> lanes::Kernel for Bits<'_, S> {
        type Output = (Vec<u32>, Vec<bool>);
        #[inline(always)]
        fn run<L: Lanes>(self) -> Self::Output {
            let table = Table::of(Kernel::Lanczos);
            let table = if self.source.kernel == Kernel::BSpline { Table::of(Kernel::BSpline) } else { table };
            let n = self.grid.width_px * self.grid.height_px;
            let (mut levels, mut valid) = (vec![f32::NAN; n], vec![false; n]);
            let band = Band {
                source: self.source,
                table: Some(&table),
                panels: &Panels::of(self.grid.width_px),
                map: &self.map,
                grid: &self.grid,
                z_mm: 0.7,
                first_row: 0,
                levels: Levels::F32(&mut levels),
                valid: &mut valid,
            };
            by_kernel!(band, |band| lanes::Kernel::run::<L>(band));
            (levels.iter().map(|x| x.to_bits()).collect(), valid)
        }
    }

    /// Against [`Source::at`] at the exact position, of levels up to `scale`; returns the largest difference.
    fn agree<S: Level>(source: Source<'_, S>, map: &SheetMap, grid: &SheetGrid, scale: f64) -> f64 {
        let all = run_all(&Bits { source, map: map.clone(), grid: *grid });
        all.iter().for_each(|one| assert!(*one == all[0], "{:?}", source.kernel));
        let ([width, height], mut worst, mut inside) = (source.size_px.map(|n| n as f64), 0.0_f64, 0);
        for (i, (bits, valid)) in all[0].0.iter().zip(&all[0].1).enumerate() {
            let [x, y] = grid.point_mm((i % grid.width_px) as f64, (i / grid.width_px) as f64);
            let q = map.project(&Vector3::new(x, y, 0.7)).unwrap();
            let on = (-0.5..=width - 0.5).contains(&q.x) && (-0.5..=height - 0.5).contains(&q.y);
            let wanted = if on { f64::from(source.at(q.x, q.y)) } else { 0.0 };
            let level = f64::from(f32::from_bits(*bits));
            assert_eq!(level.is_nan(), wanted.is_nan(), "{:?} {q}", source.kernel);
            worst = worst.max((level - wanted).abs() / scale);
            assert_eq!(*valid, on, "{:?} {q}", source.kernel);
            inside += usize::from(on);
        }
        assert!(inside > all[0].1.len() / 3 && inside < all[0].1.len(), "{inside} of {}", all[0].1.len());
        worst
    }

    /// All kernels, depths and widths of the processor, in the air and behind a window, windows beyond the border and images smaller than one; windows
    /// of sixteen neighbours that begin in one row, in two, in up to five and further apart, and in columns further apart.
    #[test]
    fn levels_are_those_of_the_plain_path() {
        let glass = Window::new(Vector3::new(-0.1, -0.2, 1.0), 300.0, 8.0, [1.0, 1.52, 1.33]).unwrap();
        let grid = |mm_per_px| SheetGrid::over([-27.0, -21.0, 26.0, 22.0], mm_per_px).unwrap();
        for (size_px, grid, window, turned_rad) in [
            ([90, 77], grid(0.31), None, 0.0),
            ([90, 77], grid(0.31), Some(glass), 0.0),
            ([90, 77], grid(0.29), None, 0.3),
            ([90, 77], grid(0.27), None, -0.5),
            ([90, 77], grid(0.27), None, 1.5),
            ([90, 77], grid(0.29), None, 3.0),
            ([90, 77], grid(0.9), None, 0.1),
            ([3, 2], SheetGrid::over([-0.8, -0.5, 0.8, 0.5], 0.31).unwrap(), None, 0.0),
        ] {
            let (map, [w, h]) = (map(size_px, window, turned_rad), size_px);
            let stride = w + 5;
            let wave = |i: usize| 0.5 + 0.5 * (0.8 * i as f64 * i as f64).sin();
            let floats: Vec<f32> = (0..stride * h).map(|i| wave(i) as f32).collect();
            let words: Vec<u16> = floats.iter().map(|x| (65535.0 * x) as u16).collect();
            let bytes: Vec<u8> = floats.iter().map(|x| (255.0 * x) as u8).collect();
            for kernel in ALL {
                let view = GrayView::new(Samples::F32(&floats), w, h, stride).unwrap();
                let sampler = Sampler::new(&view, kernel);
                let mut worst = [agree(sampler.source(), &map, &grid, 1.0), 0.0, 0.0, 0.0];
                if kernel != Kernel::BSpline {
                    worst[1] = agree(Source { kernel, samples: &floats, stride, size_px }, &map, &grid, 1.0);
                    worst[2] = agree(Source { kernel, samples: &words, stride, size_px }, &map, &grid, 65535.0);
                    worst[3] = agree(Source { kernel, samples: &bytes, stride, size_px }, &map, &grid, 255.0);
                }
                println!("{size_px:?} {kernel:?}: {worst:.9?} of full scale");
                assert!(worst.iter().all(|w| *w < 1e-6), "{kernel:?}: {worst:?}");
            }
        }
    }

    /// What is no number hides the windows it lies in, whether their neighbours have it or not.
    #[test]
    fn samples_that_are_no_numbers_hide_their_windows_alone() {
        let (size_px, stride) = ([90, 77], 91);
        let mut samples: Vec<f32> = (0..stride * 77).map(|i| (0.8 * i as f32).sin()).collect();
        [5000, 3210, 1234].iter().for_each(|i| samples[*i] = f32::NAN);
        let grid = SheetGrid::over([-27.0, -21.0, 26.0, 22.0], 0.3).unwrap();
        for turned_rad in [0.0, 0.2, -0.3] {
            for kernel in [Kernel::Nearest, Kernel::Linear, Kernel::Cubic, Kernel::Lanczos] {
                let source = Source { kernel, samples: &samples, stride, size_px };
                assert!(agree(source, &map(size_px, None, turned_rad), &grid, 1.0) < 1e-6);
            }
        }
    }
}
