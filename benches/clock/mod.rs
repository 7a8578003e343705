//! The processors' own time, which other work on the machine lengthens less than the time that passes.

use std::time::Instant;

/// Whose time is counted, by its number in the system's interface.
#[derive(Clone, Copy)]
#[allow(dead_code)]
pub(crate) enum Clock {
    /// All threads of this process.
    Process = 2,
    /// This thread.
    Thread = 3,
}

/// Seconds that they have run, or those that have passed since `start` where the system tells no more.
pub(crate) fn seconds(clock: Clock, start: Instant) -> f64 {
    #[cfg(target_os = "linux")]
    {
        #[repr(C)]
        struct Time {
            s: std::ffi::c_long,
            ns: std::ffi::c_long,
        }
        unsafe extern "C" {
            fn clock_gettime(clock: i32, time: *mut Time) -> i32;
        }
        let mut time = Time { s: 0, ns: 0 };
        // SAFETY: the time can be written. (What /proc tells of a thread is as old as the last tick.)
        if unsafe { clock_gettime(clock as i32, &mut time) } == 0 {
            return time.s as f64 + 1e-9 * time.ns as f64;
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = clock;
    start.elapsed().as_secs_f64()
}

pub(crate) fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
