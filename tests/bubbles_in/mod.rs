//! `examples/bubbles` in other light.

#![allow(clippy::unwrap_used, unreachable_pub)]

use spivcal::simulate::Scene;

/// With a seed, and of its light the share of smoke, the length of its waves in mm and the unevenness.
pub fn bubbles_in(seed: u64, light: [f64; 3]) -> Scene {
    Scene::parse(&bubbles_text(seed, light), "scene.toml").unwrap()
}

/// Its file.
pub fn bubbles_text(seed: u64, [smoke, length_mm, unevenness]: [f64; 3]) -> String {
    let line = |line: &str| match line.split(" = ").next() {
        Some("seed") => format!("seed = {seed}"),
        Some("smoke") => format!("smoke = {smoke:?}"),
        Some("smoke_length_mm") => format!("smoke_length_mm = {length_mm:?}"),
        Some("unevenness") => format!("unevenness = {unevenness:?}"),
        _ => line.to_string(),
    };
    let text: Vec<String> = include_str!("../../examples/bubbles/scene.toml").lines().map(line).collect();
    text.join("\n")
}
