//! What a call through the C door costs: a million points mapped by `spivcal_calibration_*` against the library's own loop over arrays, which
//! does several points at a time, and against a loop around the function for one point; all in this thread, into memory that is there already.
//! And one point per call.
//!
//! `cargo bench --bench door`. Rounds take turns, the ways of calling in an order that changes; CPU time of the thread where the
//! system tells it. The goal is a speed of 95 % of that of the library's loop.
#![allow(unsafe_code, clippy::unwrap_used, clippy::print_stdout, missing_docs)]

mod clock;

use clock::{Clock, median, seconds};
use nalgebra::{Vector2, Vector3};
use spivcal::dewarp::{Pixels, SheetMap, SheetPoints};
use spivcal::ffi::*;
use spivcal::frames::{Rig, Sheet};
use spivcal::record::{PlacedCamera, Record};
use std::ffi::CString;
use std::hint::black_box;
use std::mem::take;
use std::time::Instant;

const POINTS: usize = 1_000_000;
const ROUNDS: usize = 31;
/// The made-up scene that the random calls begin with.
const SCENE: &str = include_str!("../fuzz/corpus/calibration/scene.json");

/// Nanoseconds that this thread has run.
fn now_ns(start: Instant) -> f64 {
    1e9 * seconds(Clock::Thread, start)
}

/// Inputs and outputs of either way.
struct Arrays {
    from: [Vec<f64>; 3],
    to: [Vec<f64>; 3],
}

impl Arrays {
    fn of(from: [Vec<f64>; 3]) -> Self {
        Self { from, to: std::array::from_fn(|_| vec![0.0; POINTS]) }
    }
}

/// The loop: NaN where a point has no result.
fn each<const M: usize, E>(a: &mut Arrays, map: impl Fn(f64, f64, f64) -> Result<[f64; M], E>) {
    let [x, y, z] = &a.from;
    for i in 0..POINTS {
        let values = map(x[i], y[i], z[i]).unwrap_or([f64::NAN; M]);
        for k in 0..M {
            a.to[k][i] = values[k];
        }
    }
}

/// One way to map all points.
type Way<'a> = &'a dyn Fn(&mut Arrays);

/// Medians in ns per point of the loop over points, the library's loop and the door, and the speed of the door: median of the ratio of
/// neighbouring rounds.
fn compare(name: &str, from: &[Vec<f64>; 3], ways: [Way; 3]) {
    let start = Instant::now();
    let mut arrays = [(); 3].map(|_| Arrays::of(from.clone()));
    let mut ns = [(); 3].map(|_| vec![]);
    for round in 0..=ROUNDS {
        for turn in 0..3 {
            let k = (turn + round) % 3;
            let before = now_ns(start);
            ways[k](black_box(&mut arrays[k]));
            // The first round finds cold memory.
            if round > 0 {
                ns[k].push((now_ns(start) - before) / POINTS as f64);
            }
        }
    }
    let [plain, inner, door] = &arrays;
    let pairs = || inner.to.iter().flatten().zip(door.to.iter().flatten());
    assert!(pairs().all(|(x, y)| x.to_bits() == y.to_bits()), "{name}: other numbers");
    let gap = plain.to.iter().flatten().zip(door.to.iter().flatten()).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max);
    assert!(gap < 1e-10, "{name}: the door is {gap} from the function for one point");
    assert!(door.to[0].iter().all(|x| x.is_finite()), "{name}: a point has no result");
    let mut speed: Vec<f64> = ns[1].iter().zip(&ns[2]).map(|(i, d)| i / d).collect();
    let speed = 100.0 * median(&mut speed);
    let [p, i, d] = ns.each_mut().map(|ns| median(ns));
    println!(
        "{name:<18} one by one {p:6.2} ns, library {i:6.2} ns, door {d:6.2} ns per point; speed of the door {speed:5.1} % of the library's"
    );
}

/// Nanoseconds of a call with one point: median over rounds of a thousand calls.
fn single(name: &str, call: impl Fn(usize)) {
    let start = Instant::now();
    let mut ns: Vec<f64> = (0..ROUNDS * 10)
        .map(|_| {
            let before = now_ns(start);
            (0..1000).for_each(&call);
            (now_ns(start) - before) / 1000.0
        })
        .collect();
    println!("{name:<18} {:6.1} ns per call with one point", median(&mut ns));
}

fn main() {
    // `cargo test --benches` asks every benchmark to do nothing much.
    if std::env::args().any(|a| a == "--test") {
        return;
    }
    let record = Record::from_json(SCENE, "scene.json").unwrap();
    let camera: PlacedCamera = record.placed_cameras().unwrap()[0];
    let map = SheetMap::from_record(&record, 0).unwrap();
    let [w, h] = record.cameras[0].image_size_px.map(|n| n as f64);
    // Places that do not repeat, in an order that memory likes.
    let at = |i: usize, step: f64| (i as f64 * step).fract();
    let list = |f: &dyn Fn(usize) -> f64| (0..POINTS).map(f).collect::<Vec<f64>>();
    let (u, v) = (list(&|i| w * at(i, 0.618_033_988_749)), list(&|i| h * at(i, 0.754_877_666_246)));
    let seen: Vec<Vector2<f64>> =
        (0..POINTS).map(|i| map.sheet_from_pixel(&[u[i], v[i]].into(), 0.0).unwrap()).collect();
    let rig_from_sheet = record.sheet.as_ref().unwrap().rig_from_sheet.motion::<Rig, Sheet>();
    let in_rig: Vec<Vector3<f64>> = seen.iter().map(|p| rig_from_sheet.apply(&p.push(0.0))).collect();
    let (json, mut context, mut handle) = (CString::new(SCENE).unwrap(), 0, 0);
    // SAFETY: the text ends with a zero, the handles can be written.
    unsafe {
        assert_eq!(spivcal_context_create(1, &mut context), SPIVCAL_OK);
        assert!(spivcal_calibration_parse(context, json.as_ptr(), &mut handle) >= 0);
    }
    let (none, n) = (std::ptr::null_mut(), POINTS as u64);
    let pixels = [u, v, vec![0.0; POINTS]];
    let sheet = [list(&|i| seen[i].x), list(&|i| seen[i].y), vec![0.0; POINTS]];
    let rig = [list(&|i| in_rig[i].x), list(&|i| in_rig[i].y), list(&|i| in_rig[i].z)];
    // SAFETY (all calls below): every array has `POINTS` elements.
    compare(
        "project",
        &rig,
        [
            &|a| each(a, |x, y, z| camera.pixel_from_rig(&Vector3::new(x, y, z)).map(|q| [q.x, q.y])),
            &|Arrays { from: [x, y, z], to: [u, v, _] }| camera.pixels_from_rig_into([x, y, z], [u, v]).unwrap(),
            &|Arrays { from: [x, y, z], to: [u, v, _] }| unsafe {
                let (x, y, z) = (x.as_ptr(), y.as_ptr(), z.as_ptr());
                assert_eq!(spivcal_calibration_project(handle, 0, n, x, y, z, u.as_mut_ptr(), v.as_mut_ptr(), none), 0);
            },
        ],
    );
    compare(
        "unproject",
        &pixels,
        [
            &|a| each(a, |u, v, _| camera.ray_in_rig(&Vector2::new(u, v)).map(|d| [d.x, d.y, d.z])),
            &|Arrays { from: [u, v, _], to: [x, y, z] }| camera.rays_in_rig_into([u, v], [x, y, z]).unwrap(),
            &|Arrays { from: [u, v, _], to: [x, y, z] }| unsafe {
                let (x, y, z) = (x.as_mut_ptr(), y.as_mut_ptr(), z.as_mut_ptr());
                assert_eq!(spivcal_calibration_unproject(handle, 0, n, u.as_ptr(), v.as_ptr(), x, y, z, none), 0);
            },
        ],
    );
    compare(
        "sheet from pixel",
        &pixels,
        [
            &|a| each(a, |u, v, _| map.sheet_from_pixel(&Vector2::new(u, v), 0.0).map(|p| [p.x, p.y])),
            &|Arrays { from: [u, v, z], to: [x, y, _] }| {
                let mut out = SheetPoints { x_mm: take(x), y_mm: take(y) };
                map.sheet_of_pixel_into(u, v, z, &mut out).unwrap();
                (*x, *y) = (out.x_mm, out.y_mm);
            },
            &|Arrays { from: [u, v, _], to: [x, y, _] }| unsafe {
                let (x, y) = (x.as_mut_ptr(), y.as_mut_ptr());
                assert_eq!(spivcal_calibration_sheet_from_pixel(handle, 0, n, u.as_ptr(), v.as_ptr(), x, y, none), 0);
            },
        ],
    );
    compare(
        "pixel from sheet",
        &sheet,
        [
            &|a| each(a, |x, y, _| map.pixel_from_sheet(&Vector3::new(x, y, 0.0)).map(|q| [q.x, q.y])),
            &|Arrays { from: [x, y, z], to: [u, v, _] }| {
                let mut out = Pixels { u_px: take(u), v_px: take(v) };
                map.pixel_of_sheet_into(x, y, z, &mut out).unwrap();
                (*u, *v) = (out.u_px, out.v_px);
            },
            &|Arrays { from: [x, y, _], to: [u, v, _] }| unsafe {
                let (u, v) = (u.as_mut_ptr(), v.as_mut_ptr());
                assert_eq!(spivcal_calibration_pixel_from_sheet(handle, 0, n, x.as_ptr(), y.as_ptr(), u, v, none), 0);
            },
        ],
    );
    let (u, v) = (&pixels[0], &pixels[1]);
    single("sheet from pixel", |i| unsafe {
        let (mut x, mut y) = (0.0, 0.0);
        assert_eq!(spivcal_calibration_sheet_from_pixel(handle, 0, 1, &u[i], &v[i], &mut x, &mut y, none), 0);
        black_box((x, y));
    });
    assert_eq!(spivcal_context_destroy(context), SPIVCAL_OK);
}
