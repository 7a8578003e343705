//! A sequence of calls on objects that are there, were there, or never were.
#![no_main]

#[path = "../../tests/door_calls/mod.rs"]
mod door_calls;

libfuzzer_sys::fuzz_target!(|data: &[u8]| door_calls::run("calls", data));
