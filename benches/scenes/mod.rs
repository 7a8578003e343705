//! Images whose discs are found while the time, or the instructions, are counted.

/// Ellipses `(u, v, a, b)`, blurred by 1 px, in the light given inside and outside, with noise of 2 grey levels times what the light makes of it.
fn picture(
    width: usize,
    height: usize,
    spots: impl Fn(f64, f64) -> (f64, f64, f64, f64),
    light: impl Fn(f64, f64) -> [f64; 2],
    louder: impl Fn(f64) -> f64,
) -> Vec<u8> {
    let mut state = 1u64;
    let mut noise = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as f64 / (1u64 << 31) as f64 - 0.5) * 7.0
    };
    let mut grey = Vec::with_capacity(width * height);
    for v in 0..height {
        for u in 0..width {
            let (x, y) = (u as f64, v as f64);
            let (cu, cv, a, b) = spots(x, y);
            let q = ((x - cu) / a).hypot((y - cv) / b).max(1e-6);
            let d = (q - 1.0) * q / ((x - cu) / (a * a)).hypot((y - cv) / (b * b)).max(1e-6);
            // The normal distribution to 1.4e-4.
            let inside = 1.0 / (1.0 + (0.07056 * d.powi(3) + 1.5976 * d).exp());
            let [disc, ground] = light(x, y);
            let clean = ground + (disc - ground) * inside;
            grey.push((clean + noise() * louder(clean)).round().clamp(0.0, 255.0) as u8);
        }
    }
    grey
}

/// Dark discs in uneven light.
fn dark(width: usize) -> impl Fn(f64, f64) -> [f64; 2] {
    move |x, _| {
        let ground = 170.0 + 40.0 * x / width as f64;
        [0.25 * ground, ground]
    }
}

/// Two discs in 1024 x 768.
pub(crate) fn two_discs() -> (Vec<u8>, usize, usize) {
    let spots = |x, _| if x < 512.0 { (300.3, 380.2, 120.0, 90.0) } else { (720.7, 390.6, 100.0, 75.0) };
    (picture(1024, 768, spots, dark(1024), |_| 1.0), 1024, 768)
}

/// A bubble of 7 x 5 px, full of smoke, in 96 x 72.
pub(crate) fn smoke() -> (Vec<u8>, usize, usize) {
    let light = |x: f64, y: f64| {
        let wave = |k: u32| {
            let (turn, length) = (2.4 * f64::from(k), 5.0 + 3.0 * f64::from(k));
            ((turn.cos() * x + turn.sin() * y) * std::f64::consts::TAU / length + turn).sin()
        };
        [120.0 * (1.0 + 0.1 * (0..8).map(wave).sum::<f64>()), 20.0]
    };
    (picture(96, 72, |_, _| (47.3, 36.8, 7.0, 5.0), light, |_| 1.0), 96, 72)
}

/// Two small bright discs in shot noise, which may pass for smoke, in 128 x 72.
pub(crate) fn shot_noise() -> (Vec<u8>, usize, usize) {
    let spots = |x, _| if x < 64.0 { (38.3, 36.8, 7.0, 5.0) } else { (90.6, 34.1, 6.0, 4.5) };
    (picture(128, 72, spots, |_, _| [160.0, 12.0], |light| (light / 120.0).sqrt()), 128, 72)
}

/// A grid of dots of 13 x 11 px, 74 px apart.
pub(crate) fn dots(width: usize, height: usize) -> (Vec<u8>, usize, usize) {
    let pitch = 74.0;
    let spots = |x: f64, y: f64| ((x / pitch).floor() * pitch + 37.0, (y / pitch).floor() * pitch + 37.0, 13.0, 11.0);
    (picture(width, height, spots, dark(width), |_| 1.0), width, height)
}
