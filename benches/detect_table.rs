//! Accuracy of detection over a table of conditions: scatter over the Cramer-Rao bound, bias, truth of the sigmas. Seeded.
//!
//! `cargo bench --bench detect_table` prints the table; `SPIVCAL_TABLE=wide` adds the discs of 100 and 400 px (minutes). Words after
//! `--` choose rows by light and minor semi-axis, `scenes=30` their scenes: `cargo bench --bench detect_table -- glare 4 scenes=12`.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stdout)]

#[path = "../tests/detect_table/mod.rs"]
mod detect_table;
#[path = "../tests/render/mod.rs"]
mod render;

use detect_table::{Condition, Light};

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|x| !x.starts_with("--")).collect();
    let wished = |name: &str| words.iter().find_map(|w| w.strip_prefix(name).map(|x| x.parse().unwrap()));
    let (scenes_wished, shots_wished) = (wished("scenes="), wished("shots="));
    let lights = ["even", "slanted", "smoke", "haze", "bent", "glare", "bubble", "shot", "defocus"];
    let any_light = !words.iter().any(|w| lights.contains(&&w[..]));
    let sizes: Vec<f64> = words.iter().filter_map(|w| w.parse().ok()).collect();
    let wide = std::env::var("SPIVCAL_TABLE").is_ok_and(|x| x == "wide");
    let wide = wide || sizes.iter().any(|x| *x > 50.0);
    let radii: &[f64] = if wide { &[4.0, 8.0, 15.0, 40.0, 100.0, 400.0] } else { &[4.0, 8.0, 15.0, 40.0] };
    println!(
        "scatter about the truth over the Cramer-Rao bound (u v a b), bias in px, mean squared z of the sigmas given"
    );
    println!(
        "{:>6} {:>5} {:>5} {:>8} {:>5} {:>23}  {:>31}  {:>5} {:>5}",
        "b px", "a/b", "blur", "light", "bits", "ratio", "bias px", "z^2", "found"
    );
    let mut seed = 1;
    for &semi_minor_px in radii {
        for (ratio, blur_px, light, bits, bright) in conditions() {
            // On small discs such light is even or slanted, large discs are hardly behind a blur.
            let late = matches!(light, Light::Bent | Light::Haze);
            let behind = light == Light::Smoke && blur_px > 1.0;
            let added = late || behind || matches!(light, Light::Bubble | Light::Shot | Light::Defocus);
            let whole_blur_px = if light == Light::Defocus { 1.8 * blur_px } else { blur_px };
            if whole_blur_px > 0.45 * semi_minor_px || late && semi_minor_px < 40.0 || behind && semi_minor_px > 20.0 {
                continue;
            }
            // Rows keep their seeds.
            seed += u64::from(!added);
            let seed = match light {
                Light::Bent => 1000 + semi_minor_px as u64,
                Light::Haze => 2000 + semi_minor_px as u64,
                Light::Bubble => 3000 + semi_minor_px as u64,
                Light::Shot => 5000 + 1000 * u64::from(bright) + 100 * blur_px as u64 + semi_minor_px as u64,
                Light::Defocus => 7000 + 1000 * u64::from(bright) + semi_minor_px as u64,
                _ if behind => 1000 * blur_px as u64 + 4000 + semi_minor_px as u64,
                _ => seed,
            };
            let name = lights[light as usize];
            let chosen = any_light || words.iter().any(|w| w == name);
            if !chosen || !sizes.is_empty() && !sizes.contains(&semi_minor_px) {
                continue;
            }
            let c = Condition { semi_minor_px, ratio, blur_px, light, bits, noise: 0.015, bright };
            let (scenes, shots) = match (light.is_smoke(), semi_minor_px > 50.0) {
                // What smoke does to a scene it does to all its images.
                (true, false) => (100, 1),
                (false, false) => (20, 8),
                (_, true) => (4, 8),
            };
            let (scenes, shots) = (scenes_wished.unwrap_or(scenes), shots_wished.unwrap_or(shots));
            let row = c.run(scenes, shots, seed);
            let [r0, r1, r2, r3] = row.ratio;
            let [b0, b1, b2, b3] = row.bias_px;
            println!(
                "{semi_minor_px:6} {ratio:5} {blur_px:5} {name:>8} {bits:5} {r0:5.2} {r1:5.2} {r2:5.2} {r3:5.2}  {b0:+7.4} {b1:+7.4} {b2:+7.4} {b3:+7.4}  {:5.2} {:3}/{}",
                row.z2,
                row.found,
                scenes * shots
            );
        }
    }
}

/// a/b, blur, light, bits, bright.
fn conditions() -> [(f64, f64, Light, u32, bool); 20] {
    [
        (1.2, 0.8, Light::Even, 8, false),
        (1.2, 0.8, Light::Even, 16, true),
        (1.2, 0.5, Light::Even, 8, false),
        (1.2, 1.7, Light::Even, 8, false),
        (1.2, 3.0, Light::Even, 16, true),
        (2.5, 0.8, Light::Even, 8, false),
        (1.2, 0.8, Light::Slanted, 8, false),
        (1.2, 0.8, Light::Haze, 16, true),
        (1.2, 0.8, Light::Bent, 8, false),
        (1.2, 0.8, Light::Smoke, 16, true),
        (1.2, 1.7, Light::Smoke, 16, true),
        (1.2, 3.0, Light::Smoke, 16, true),
        (1.2, 0.8, Light::Bubble, 16, true),
        (1.2, 0.8, Light::Glare, 8, false),
        (1.2, 0.8, Light::Shot, 8, false),
        (1.2, 0.8, Light::Shot, 16, true),
        (1.2, 1.7, Light::Shot, 8, false),
        (1.2, 1.7, Light::Shot, 16, true),
        (1.2, 0.6, Light::Defocus, 8, false),
        (1.2, 1.0, Light::Defocus, 16, true),
    ]
}
