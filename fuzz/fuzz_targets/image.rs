//! An image file.
#![no_main]

#[path = "../../tests/door_calls/mod.rs"]
mod door_calls;

libfuzzer_sys::fuzz_target!(|data: &[u8]| door_calls::run("image", data));
