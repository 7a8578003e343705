//! What a call through the C door costs: a million points mapped by `spivcal_calibration_*` against the loop that a Rust program would
//! write around the same function, both in this thread, into memory that is there already.
//!
//! `cargo bench --bench door`. Rounds take turns, both ways of calling in an order that changes; CPU time of the thread where the
//! system tells it. The goal is a speed of 95 % of the loop's.
#![allow(unsafe_code, clippy::unwrap_used, clippy::print_stdout, missing_docs)]

use nalgebra::{Vector2, Vector3};
use spivcal::dewarp::SheetMap;
use spivcal::ffi::*;
use spivcal::frames::{Rig, Sheet};
use spivcal::record::{PlacedCamera, Record};
use std::ffi::CString;
use std::hint::black_box;
use std::time::Instant;

const POINTS: usize = 1_000_000;
const ROUNDS: usize = 31;
/// The made-up scene that the random calls begin with.
const SCENE: &str = include_str!("../fuzz/corpus/calibration/scene.json");

/// Nanoseconds that this thread has run, or those that have passed.
fn now_ns(start: Instant) -> f64 {
    let own = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let ran = own.and_then(|text| text.split_whitespace().next()?.parse().ok());
    ran.unwrap_or_else(|| start.elapsed().as_nanos() as f64)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
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

/// Medians in ns per point of the loop and of the door, and of the ratio of neighbouring rounds.
fn compare(name: &str, from: &[Vec<f64>; 3], inner: Way, door: Way) {
    let start = Instant::now();
    let (mut a, mut b) = (Arrays::of(from.clone()), Arrays::of(from.clone()));
    let timed = |way: Way, arrays: &mut Arrays| {
        let before = now_ns(start);
        way(black_box(arrays));
        (now_ns(start) - before) / POINTS as f64
    };
    let (mut inner_ns, mut door_ns, mut speed) = (vec![], vec![], vec![]);
    for round in 0..=ROUNDS {
        let (i, d) = if round % 2 == 0 {
            let i = timed(inner, &mut a);
            (i, timed(door, &mut b))
        } else {
            let d = timed(door, &mut b);
            (timed(inner, &mut a), d)
        };
        // The first round finds cold memory.
        if round > 0 {
            inner_ns.push(i);
            door_ns.push(d);
            speed.push(i / d);
        }
    }
    let same = |x: &f64, y: &f64| x.to_bits() == y.to_bits();
    assert!(a.to.iter().zip(&b.to).all(|(x, y)| x.iter().zip(y).all(|(x, y)| same(x, y))), "{name}: other numbers");
    assert!(a.to[0].iter().filter(|x| x.is_finite()).count() > POINTS / 2, "{name}: hardly a point has a result");
    let (i, d, s) = (median(&mut inner_ns), median(&mut door_ns), median(&mut speed));
    println!(
        "{name:<18} loop {i:6.1} ns, door {d:6.1} ns per point, speed of the door {:5.1} % (median of rounds)",
        100.0 * s
    );
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
        &|a| each(a, |x, y, z| camera.pixel_from_rig(&Vector3::new(x, y, z)).map(|q| [q.x, q.y])),
        &|Arrays { from: [x, y, z], to: [u, v, _] }| unsafe {
            let (x, y, z) = (x.as_ptr(), y.as_ptr(), z.as_ptr());
            assert_eq!(spivcal_calibration_project(handle, 0, n, x, y, z, u.as_mut_ptr(), v.as_mut_ptr(), none), 0);
        },
    );
    compare(
        "unproject",
        &pixels,
        &|a| each(a, |u, v, _| camera.ray_in_rig(&Vector2::new(u, v)).map(|d| [d.x, d.y, d.z])),
        &|Arrays { from: [u, v, _], to: [x, y, z] }| unsafe {
            let (x, y, z) = (x.as_mut_ptr(), y.as_mut_ptr(), z.as_mut_ptr());
            assert_eq!(spivcal_calibration_unproject(handle, 0, n, u.as_ptr(), v.as_ptr(), x, y, z, none), 0);
        },
    );
    compare(
        "sheet from pixel",
        &pixels,
        &|a| each(a, |u, v, _| map.sheet_from_pixel(&Vector2::new(u, v), 0.0).map(|p| [p.x, p.y])),
        &|Arrays { from: [u, v, _], to: [x, y, _] }| unsafe {
            let (x, y) = (x.as_mut_ptr(), y.as_mut_ptr());
            assert_eq!(spivcal_calibration_sheet_from_pixel(handle, 0, n, u.as_ptr(), v.as_ptr(), x, y, none), 0);
        },
    );
    compare(
        "pixel from sheet",
        &sheet,
        &|a| each(a, |x, y, _| map.pixel_from_sheet(&Vector3::new(x, y, 0.0)).map(|q| [q.x, q.y])),
        &|Arrays { from: [x, y, _], to: [u, v, _] }| unsafe {
            let (u, v) = (u.as_mut_ptr(), v.as_mut_ptr());
            assert_eq!(spivcal_calibration_pixel_from_sheet(handle, 0, n, x.as_ptr(), y.as_ptr(), u, v, none), 0);
        },
    );
    assert_eq!(spivcal_context_destroy(context), SPIVCAL_OK);
}
