//! Bytes as a sequence of calls on objects that are there, were there, or never were.

use super::{UNTOUCHED, call, filled, judged, made};
use spivcal::ffi::*;
use std::ffi::CString;

const KINDS: usize = 6;
const CONTEXT: usize = 0;
const IMAGE: usize = 1;
const DETECTION: usize = 2;
const RIG: usize = 3;
const JOB: usize = 4;
const CALIBRATION: usize = 5;

/// Calls of one sequence; more only make an input slow.
const MOST_CALLS: usize = 48;
/// Numbers that name nothing.
const ODD: [u64; 7] = [0, 1, 42, u64::MAX, 1 << 63, 1 << 52, 7 << 48];
const CAPACITIES: [usize; 8] = [0, 1, 2, 5, 16, 25, 200, 4000];
/// Where the numbers of the keys begin.
const PAGES: [i32; 23] =
    [0, 0, 10, 20, 30, 50, 100, 110, 120, 130, 140, 200, 210, 300, 320, 330, 400, 440, 460, 500, 520, 540, 600];
const WORDS: [&str; 22] = [
    "",
    "left",
    "right",
    "two-discs",
    "bubbles",
    "dot-grid",
    "two-level-plate",
    "auto",
    "bright",
    "dark",
    "contour",
    "bitangent",
    "none",
    "huber",
    "cauchy",
    "k1",
    "k1 k2",
    "all",
    "ring",
    "square",
    "no such file.png",
    "none k3",
];
/// The calibration that sequences begin with, also a seed of the target `calibration`.
const SCENE: &str = include_str!("../../fuzz/corpus/calibration/scene.json");

struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *first
    }
    fn below(&mut self, n: usize) -> usize {
        usize::from(self.byte()) % n
    }
    fn word(&mut self) -> u64 {
        u64::from_le_bytes(std::array::from_fn(|_| self.byte()))
    }
    fn number(&mut self) -> f64 {
        match self.below(20) {
            0 => f64::NAN,
            1 => f64::INFINITY,
            2 => -1e308,
            3 => 5e-324,
            4 => f64::from_bits(self.word()),
            5 => 0.0,
            6..=12 => f64::from(self.byte()) * 10.0,
            _ => f64::from(self.byte() as i8) / 8.0,
        }
    }
    fn key(&mut self) -> i32 {
        match self.below(30) {
            0 => self.word() as i32,
            _ => PAGES[self.below(PAGES.len())] + self.below(16) as i32,
        }
    }
    fn index(&mut self) -> u64 {
        match self.below(16) {
            0 => self.word(),
            _ => self.below(4) as u64,
        }
    }
    fn text(&mut self) -> CString {
        match self.below(8) {
            0 => CString::new((0..self.below(9)).map(|_| self.byte().max(1)).collect::<Vec<_>>()).unwrap_or_default(),
            _ => CString::new(WORDS[self.below(WORDS.len())]).unwrap_or_default(),
        }
    }
    fn capacity(&mut self) -> usize {
        CAPACITIES[self.below(CAPACITIES.len())]
    }
}

/// A picture of 96 x 64 px with two discs somewhere.
fn picture(b: &mut Bytes) -> Vec<u8> {
    let discs: [[f64; 4]; 2] = std::array::from_fn(|d| {
        let [u, v, r, e] = std::array::from_fn(|_| f64::from(b.byte()) / 255.0);
        [14.0 + 40.0 * d as f64 + 28.0 * u, 16.0 + 32.0 * v, 6.0 + 9.0 * r, 0.6 + 0.4 * e]
    });
    let grey = |u: usize, v: usize| {
        let inside = |[cu, cv, r, e]: &[f64; 4]| {
            let distance = r - (u as f64 - cu).hypot((v as f64 - cv) / e);
            (0.5 + 0.5 * distance).clamp(0.0, 1.0)
        };
        40.0 + 150.0 * discs.iter().map(inside).sum::<f64>().min(1.0) + ((u * 7 + v * 13) % 5) as f64
    };
    (0..96 * 64).map(|i| grey(i % 96, i / 96) as u8).collect()
}

/// Handles that were given, also those of objects that have ended.
#[derive(Default)]
struct Host {
    made: [Vec<u64>; KINDS],
}

/// A sequence of calls.
pub(super) fn calls(data: &[u8]) {
    let mut b = Bytes(data);
    let mut host = Host::default();
    let context = super::context(1);
    host.made[CONTEXT].push(context);
    let json = CString::new(SCENE).unwrap();
    // SAFETY: the text ends with a zero, the handle can be written.
    let scene = made(|h| unsafe { call!(spivcal_calibration_parse(context, json.as_ptr(), h)) });
    host.made[CALIBRATION].push(scene.expect("the scene is a calibration with a sheet"));
    for _ in 0..MOST_CALLS {
        if b.0.is_empty() {
            break;
        }
        match b.below(16) {
            0 => host.ends(&mut b),
            1 | 2 => host.images(&mut b),
            3 | 4 => host.detections(&mut b),
            5..=9 => host.rigs(&mut b),
            10 => host.stories(&mut b),
            11 | 12 => host.jobs(&mut b),
            13 | 14 => host.calibrations(&mut b),
            _ => host.maps(&mut b),
        }
    }
    for context in &host.made[CONTEXT] {
        judged(call!(spivcal_context_destroy(*context)));
    }
    // Whatever was made has ended with its context.
    for (kind, destroy) in DESTROY.iter().enumerate() {
        assert!(host.made[kind].iter().all(|h| destroy(*h) == SPIVCAL_ERROR_HANDLE));
    }
}

const DESTROY: [extern "C" fn(u64) -> i32; KINDS] = [
    spivcal_context_destroy,
    spivcal_image_destroy,
    spivcal_detection_destroy,
    spivcal_rig_destroy,
    spivcal_job_destroy,
    spivcal_calibration_destroy,
];

// SAFETY of all calls below: outputs can be written, texts end with a zero, arrays have the number of elements stated (or one so
// large that the call must refuse it before it looks).
impl Host {
    fn handle(&self, b: &mut Bytes, kind: usize) -> u64 {
        let of = |kind: usize, n: u8| {
            let all = &self.made[kind];
            all.get(usize::from(n) % all.len().max(1)).copied().unwrap_or(0)
        };
        match b.below(24) {
            0 => ODD[b.below(ODD.len())],
            1 => of(b.below(KINDS), b.byte()),
            _ => of(kind, b.byte()),
        }
    }

    fn keep(&mut self, kind: usize, handle: Option<u64>) {
        self.made[kind].extend(handle);
    }

    fn ends(&mut self, b: &mut Bytes) {
        let kind = b.below(KINDS + 2);
        if kind < KINDS {
            judged(DESTROY[b.below(KINDS)](self.handle(b, kind)));
            return;
        }
        let threads = b.byte() as i8;
        self.keep(CONTEXT, made(|h| unsafe { call!(spivcal_context_create(i32::from(threads), h)) }));
    }

    fn images(&mut self, b: &mut Bytes) {
        let context = self.handle(b, CONTEXT);
        let image = match b.below(6) {
            0 => {
                let (w, h, stride) = (b.byte() as u32 % 20, b.byte() as u32 % 20, b.byte() as u64 % 50);
                let data = vec![b.byte(); 50 * 20];
                made(|out| unsafe { call!(spivcal_image_create_u8(context, data.as_ptr(), w, h, stride, out)) })
            }
            1 => {
                let (w, h) = (b.byte() as u32 % 20, b.byte() as u32 % 20);
                let data: Vec<f32> = (0..400).map(|_| b.number() as f32).collect();
                made(|out| unsafe {
                    call!(spivcal_image_create_f32(context, data.as_ptr(), w, h, 4 * u64::from(w), out))
                })
            }
            2 => {
                // Sizes that no memory has.
                let (w, h, stride) = (u32::MAX - u32::from(b.byte()), u32::MAX, b.word() | 1 << 60);
                made(|out| unsafe { call!(spivcal_image_create_u16(context, [0u16; 4].as_ptr(), w, h, stride, out)) })
            }
            3 => {
                let name = b.text();
                made(|out| unsafe { call!(spivcal_image_load(context, name.as_ptr(), out)) })
            }
            _ => {
                let data = picture(b);
                made(|out| unsafe { call!(spivcal_image_create_u8(context, data.as_ptr(), 96, 64, 96, out)) })
            }
        };
        self.keep(IMAGE, image);
    }

    fn detections(&mut self, b: &mut Bytes) {
        let (detection, key, index, capacity) = (self.handle(b, DETECTION), b.key(), b.index(), b.capacity());
        match b.below(8) {
            0 | 1 => {
                let context = self.handle(b, CONTEXT);
                self.keep(DETECTION, made(|h| unsafe { call!(spivcal_detection_create(context, h)) }));
            }
            2 => {
                judged(call!(spivcal_detection_set_number(detection, key % 8, b.number())));
            }
            6 => drop(judged(call!(spivcal_detection_unset(detection, key % 8)))),
            3 | 4 => {
                judged(call!(spivcal_detection_run(detection, self.handle(b, IMAGE))));
            }
            5 => {
                made(|n| unsafe { call!(spivcal_detection_count(detection, key, n)) });
                filled(capacity, 1.25e300, |to, c, n| unsafe {
                    call!(spivcal_detection_array_copy(detection, key, index, to, c, n))
                });
            }
            _ => {
                let name = b.text();
                let name = if b.below(2) == 0 { std::ptr::null() } else { name.as_ptr() };
                filled(capacity, 0x5a, |to, c, n| unsafe {
                    call!(spivcal_detection_text_copy(detection, key, index, name, to, c, n))
                });
            }
        }
    }

    fn rigs(&mut self, b: &mut Bytes) {
        let (rig, word, key) = (self.handle(b, RIG), b.text(), b.key());
        match b.below(17) {
            0 => {
                let context = self.handle(b, CONTEXT);
                self.keep(RIG, made(|h| unsafe { call!(spivcal_rig_create(context, h)) }));
            }
            1 | 2 => drop(made(|n| unsafe { call!(spivcal_rig_add_camera(rig, word.as_ptr(), n)) })),
            3 | 4 => drop(made(|n| unsafe { call!(spivcal_rig_add_view(rig, n)) })),
            5 => {
                let [i, j, k] = std::array::from_fn(|_| i32::from(b.byte() as i8));
                judged(unsafe { call!(spivcal_rig_add_mark(rig, word.as_ptr(), i, j, k)) });
            }
            6 | 7 => drop(judged(call!(spivcal_rig_set_number(rig, key, b.index(), b.number())))),
            8 => drop(judged(unsafe { call!(spivcal_rig_set_text(rig, key, b.index(), word.as_ptr())) })),
            9 => drop(judged(call!(spivcal_rig_set_known(rig, b.index(), key % 26, b.number(), b.number())))),
            10 => {
                let (view, disc) = (b.index(), b.index());
                judged(call!(spivcal_rig_set_scale(rig, key % 7, view, disc, b.number(), b.number())));
            }
            11 => drop(judged(call!(spivcal_rig_set_image(rig, b.index(), b.index(), self.handle(b, IMAGE))))),
            12 => drop(judged(unsafe { call!(spivcal_rig_set_image_file(rig, b.index(), b.index(), word.as_ptr())) })),
            13 => drop(judged(call!(spivcal_rig_unset(rig, key, b.index())))),
            14 => drop(judged(call!(spivcal_rig_unset_known(rig, b.index(), key % 26)))),
            15 => {
                judged(match b.below(4) {
                    0 => call!(spivcal_rig_unset_scale(rig)),
                    1 => call!(spivcal_rig_unset_image(rig, b.index(), b.index())),
                    2 => call!(spivcal_rig_remove_view(rig, b.index())),
                    _ => call!(spivcal_rig_remove_marks(rig)),
                });
            }
            _ => {
                judged(call!(spivcal_rig_check(rig)));
                let capacity = b.capacity();
                filled(capacity, 0x5a, |to, c, n| unsafe { call!(spivcal_rig_text_copy(rig, to, c, n)) });
            }
        }
    }

    /// A whole rig with pictures, so that jobs come as far as the adjustment.
    fn stories(&mut self, b: &mut Bytes) {
        let context = self.handle(b, CONTEXT);
        let Some(rig) = made(|h| unsafe { call!(spivcal_rig_create(context, h)) }) else { return };
        self.keep(RIG, Some(rig));
        let cameras = 1 + b.below(2) as u64;
        for name in [c"left", c"right"].iter().take(cameras as usize) {
            made(|n| unsafe { call!(spivcal_rig_add_camera(rig, name.as_ptr(), n)) });
        }
        let kind = if b.below(2) == 0 { c"two-discs" } else { c"bubbles" };
        judged(unsafe { call!(spivcal_rig_set_text(rig, SPIVCAL_RIG_TARGET_KIND, 0, kind.as_ptr())) });
        judged(call!(spivcal_rig_set_number(rig, SPIVCAL_RIG_TARGET_SPACING_MM, 0, 26.0)));
        for view in 0..1 + b.below(4) as u64 {
            made(|n| unsafe { call!(spivcal_rig_add_view(rig, n)) });
            for camera in 0..cameras {
                let mut data = picture(b);
                // No picture is another one: those would be refused before the adjustment.
                data[2 * view as usize + camera as usize] ^= 1;
                let image = made(|h| unsafe { call!(spivcal_image_create_u8(context, data.as_ptr(), 96, 64, 96, h)) });
                self.keep(IMAGE, image);
                judged(call!(spivcal_rig_set_image(rig, view, camera, image.unwrap_or(0))));
            }
        }
        self.keep(JOB, made(|h| unsafe { call!(spivcal_job_start(rig, h)) }));
    }

    fn jobs(&mut self, b: &mut Bytes) {
        let (job, rig) = (self.handle(b, JOB), self.handle(b, RIG));
        match b.below(8) {
            0 => self.keep(JOB, made(|h| unsafe { call!(spivcal_job_start(rig, h)) })),
            1 => {
                let cameras = self.handle(b, CALIBRATION);
                self.keep(JOB, made(|h| unsafe { call!(spivcal_job_start_sheet(rig, cameras, h)) }));
            }
            2 => {
                let (mut state, mut done, mut decrement) = (99, UNTOUCHED, 0.0);
                let none = std::ptr::null_mut();
                let status =
                    judged(unsafe { call!(spivcal_job_poll(job, &mut state, &mut done, none, none, &mut decrement)) });
                assert_eq!(status < 0, state == 99);
            }
            3 | 4 => {
                let (mut state, time) = (99, i32::from(b.byte()));
                let status = judged(unsafe { call!(spivcal_job_wait(job, time, &mut state)) });
                assert_eq!(status < 0, state == 99);
            }
            5 => drop(judged(call!(spivcal_job_cancel(job)))),
            _ => self.keep(CALIBRATION, made(|h| unsafe { call!(spivcal_job_result(job, h)) })),
        }
    }

    fn calibrations(&mut self, b: &mut Bytes) {
        let (calibration, key, index, capacity) = (self.handle(b, CALIBRATION), b.key(), b.index(), b.capacity());
        match b.below(6) {
            0 => {
                let (mut value, mut sigma) = (1.25e300, 1.25e300);
                let status = judged(unsafe {
                    call!(spivcal_calibration_number(calibration, key, index, &mut value, &mut sigma))
                });
                assert_eq!(status < 0, value == 1.25e300);
            }
            1 => {
                filled(capacity, 1.25e300, |to, c, n| unsafe {
                    call!(spivcal_calibration_array_copy(calibration, key, index, to, c, n))
                });
            }
            2 => {
                filled(capacity, 0x5a, |to, c, n| unsafe {
                    call!(spivcal_calibration_text_copy(calibration, key, index, to, c, n))
                });
            }
            3 => {
                let (any, bad) = (self.handle(b, CALIBRATION), b"/dev/null/x.json\0");
                made(|n| unsafe { call!(spivcal_calibration_count(any, key, n)) });
                judged(unsafe { call!(spivcal_calibration_save(any, bad.as_ptr().cast())) });
            }
            4 => {
                let rig = self.handle(b, RIG);
                self.keep(CALIBRATION, made(|h| unsafe { call!(spivcal_calibration_run_sheet(rig, calibration, h)) }));
            }
            _ => {
                filled(capacity, 0x5a, |to, c, n| unsafe { call!(spivcal_error_text(calibration, to, c, n)) });
                filled(capacity, 0x5a, |to, c, n| unsafe { call!(spivcal_status_text(key, to, c, n)) });
                filled(capacity, 0x5a, |to, c, n| unsafe { call!(spivcal_version_copy(to, c, n)) });
            }
        }
    }

    fn maps(&mut self, b: &mut Bytes) {
        const N: usize = 4;
        let (calibration, camera) = (self.handle(b, CALIBRATION), b.index() % 3);
        let count = if b.below(10) == 0 { u64::MAX >> b.below(20) } else { b.below(N + 1) as u64 };
        let from: [Vec<f64>; 3] = std::array::from_fn(|_| (0..N).map(|_| b.number()).collect());
        let [x, y, z] = [0, 1, 2].map(|k| from[k].as_ptr());
        let mut to = [[1.25e300; N + 1]; 6];
        let mut status = [77; N + 1];
        let points = if b.below(3) == 0 { std::ptr::null_mut() } else { status.as_mut_ptr() };
        let [p, q, r, d, e, f] = to.each_mut().map(|t| t.as_mut_ptr());
        let answer = judged(unsafe {
            match b.below(5) {
                0 => call!(spivcal_calibration_project(calibration, camera, count, x, y, z, p, q, points)),
                1 => call!(spivcal_calibration_unproject(calibration, camera, count, x, y, p, q, r, points)),
                2 => call!(spivcal_calibration_sheet_from_pixel(calibration, camera, count, x, y, p, q, points)),
                3 => call!(spivcal_calibration_sight_from_pixel(
                    calibration,
                    camera,
                    count,
                    x,
                    y,
                    p,
                    q,
                    r,
                    d,
                    e,
                    f,
                    points
                )),
                _ => call!(spivcal_calibration_pixel_from_sheet(calibration, camera, count, x, y, p, q, points)),
            }
        });
        let written = if answer < 0 { 0 } else { count as usize };
        assert!(to.iter().all(|t| t[written..].iter().all(|x| *x == 1.25e300)));
        assert!(status[written..].iter().all(|s| *s == 77));
        if !points.is_null() && answer >= 0 {
            let all_good = status[..written].iter().all(|s| *s == SPIVCAL_POINT_OK);
            assert_eq!(all_good, answer == SPIVCAL_OK);
            assert!((0..written).all(|i| (status[i] == SPIVCAL_POINT_OK) == to[0][i].is_finite()));
        }
    }
}
