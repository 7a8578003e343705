//! Conditions under which the accuracy of detection is measured, and the bound on what any method can reach there.

use super::{Clean, Random, Spot, draw};
use nalgebra::SMatrix;
use spivcal::image::{GrayView, Samples};

/// Discs of one kind in images of one kind.
pub struct Case {
    pub name: &'static str,
    pub spot: Spot,
    pub psf: f64,
    pub low: f64,
    pub high: f64,
    pub noise: f64,
    pub bits: u32,
}

/// Width and height of the images, px.
pub const SIZE: usize = 80;

fn render(spot: &Spot, psf: f64, low: f64, high: f64) -> Clean {
    draw(SIZE, SIZE, psf, |u, v, h| low + (high - low) * spot.cover(u, v, h))
}

/// Grey levels as a camera of the case's bit depth gives them.
pub enum Exposure {
    U8(Vec<u8>),
    U16(Vec<u16>),
    F32(Vec<f32>),
}

impl Exposure {
    pub fn view(&self) -> GrayView<'_> {
        let samples = match self {
            Self::U8(p) => Samples::U8(p),
            Self::U16(p) => Samples::U16(p),
            Self::F32(p) => Samples::F32(p),
        };
        GrayView::new(samples, SIZE, SIZE, SIZE).unwrap()
    }
    /// The same numbers as floats (exact).
    pub fn levels(&self) -> Vec<f32> {
        match self {
            Self::U8(p) => p.iter().map(|x| f32::from(*x)).collect(),
            Self::U16(p) => p.iter().map(|x| f32::from(*x)).collect(),
            Self::F32(p) => p.clone(),
        }
    }
}

impl Case {
    /// One noisy image, and where its disc is: at another place within the pixel in each trial, so that errors that repeat
    /// with the pixel grid show up.
    pub fn expose(&self, trial: usize, random: &mut Random) -> (Spot, Exposure) {
        let mut spot = self.spot;
        spot.u += (trial as f64 * 0.618).fract() - 0.5;
        spot.v += (trial as f64 * 0.414).fract() - 0.5;
        let clean: Clean = render(&spot, self.psf, self.low, self.high);
        let image = match self.bits {
            8 => Exposure::U8(clean.noisy_u8(self.noise, random)),
            16 => Exposure::U16(clean.noisy_u16(self.noise, random)),
            _ => Exposure::F32(clean.noisy_f32(self.noise, random)),
        };
        (spot, image)
    }
}

/// Cramer-Rao covariance of (u, v, a, b) with angle, blur and both levels unknown, by differences of rendered images.
pub fn bound(case: &Case) -> SMatrix<f64, 8, 8> {
    let p0 = [case.spot.u, case.spot.v, case.spot.a, case.spot.b, case.spot.phi, case.psf, case.low, case.high];
    let span = case.high - case.low;
    let step = [0.05, 0.05, 0.05, 0.05, 0.05 / case.spot.a, 0.03, 0.01 * span, 0.01 * span];
    let at = |p: [f64; 8]| render(&Spot { u: p[0], v: p[1], a: p[2], b: p[3], phi: p[4] }, p[5], p[6], p[7]).grey;
    let columns: Vec<Vec<f64>> = (0..8)
        .map(|k| {
            let (mut up, mut down) = (p0, p0);
            up[k] += step[k];
            down[k] -= step[k];
            at(up).iter().zip(at(down)).map(|(x, y)| (x - y) / (2.0 * step[k])).collect()
        })
        .collect();
    let quantised = if case.bits == 8 { 1.0 / 12.0 } else { 0.0 };
    let variance = case.noise * case.noise + quantised;
    let fisher = SMatrix::<f64, 8, 8>::from_fn(|i, j| {
        columns[i].iter().zip(&columns[j]).map(|(x, y)| x * y).sum::<f64>() / variance
    });
    fisher.try_inverse().unwrap()
}

/// The five conditions.
pub fn cases() -> Vec<Case> {
    let oblique = Spot { u: 39.7, v: 40.2, a: 24.0, b: 9.0, phi: 0.5 };
    vec![
        Case {
            name: "dark 8 bit, blur 1, noise 2 %",
            spot: Spot { a: 18.0, b: 14.0, u: 40.0, v: 40.0, phi: -0.7 },
            psf: 1.0,
            low: 200.0,
            high: 60.0,
            noise: 2.8,
            bits: 8,
        },
        Case {
            name: "bright 16 bit, blur 0.5, noise 1 %",
            spot: Spot { a: 15.0, b: 12.0, u: 40.0, v: 40.0, phi: 0.3 },
            psf: 0.5,
            low: 3000.0,
            high: 30000.0,
            noise: 270.0,
            bits: 16,
        },
        Case {
            name: "bright float, blur 3, noise 3 %",
            spot: Spot { a: 20.0, b: 16.0, u: 40.0, v: 40.0, phi: 1.2 },
            psf: 3.0,
            low: 0.1,
            high: 1.1,
            noise: 0.03,
            bits: 32,
        },
        Case {
            name: "oblique 8 bit, blur 0.8, noise 2 %",
            spot: oblique,
            psf: 0.8,
            low: 40.0,
            high: 190.0,
            noise: 3.0,
            bits: 8,
        },
        Case {
            name: "small 8 bit, blur 0.8, noise 1 %",
            spot: Spot { a: 5.0, b: 4.0, u: 40.0, v: 40.0, phi: 0.3 },
            psf: 0.8,
            low: 180.0,
            high: 40.0,
            noise: 1.4,
            bits: 8,
        },
    ]
}
