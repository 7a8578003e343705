//! One condition of the table of detection accuracy: images drawn, discs found, errors against the Cramer-Rao bound.
#![allow(dead_code, missing_docs, unreachable_pub, clippy::unwrap_used, clippy::expect_used)]

use crate::render::{Clean, Random, Spot, draw};
use nalgebra::{DMatrix, SVector};
use spivcal::detect::{DetectOptions, Disc, Smoke, find_discs};
use spivcal::image::{GrayView, Samples};
use std::f64::consts::{PI, TAU};

/// Light on the disc and around it, as a factor.
#[derive(Clone, Copy, PartialEq)]
pub enum Light {
    Even,
    /// Rises by 30 % across the disc.
    Slanted,
    /// Smoke in the disc alone: eight waves, 30 % together; the shortest half a disc long.
    Smoke,
    /// The same three times as long.
    Haze,
    /// Falls off as the square of the distance: by 5 % from the middle of the disc to its far ends along the image's rows, by half of that along
    /// its columns, and rises by 5 % along the rows.
    Bent,
    /// A saturated spot of a quarter of the radius on the contour; where it adds more than half the noise nothing is seen.
    Glare,
    /// As smoke, but even in the plane of the disc in place of the image: as that of a round bubble that is seen obliquely.
    Bubble,
    /// Even, with noise whose variance grows with the light: nine times as loud where it is lighter, be that the disc or the ground.
    Shot,
    /// As shot, through a lens out of focus, which spreads light over a disc of three times the radius of the Gaussian's standard deviation.
    Defocus,
}

impl Light {
    /// Whether the disc is full of waves.
    pub fn is_smoke(self) -> bool {
        matches!(self, Self::Smoke | Self::Haze | Self::Bubble)
    }
}

/// Errors of the centre (u, v) and the semi-axes of a disc, px, and the mean square of all five numbers, the angle with them, in its sigmas.
pub fn off(spot: &Spot, disc: &Disc) -> ([f64; 4], f64) {
    let e = &disc.ellipse;
    let turned = (e.angle_rad - spot.phi + 0.5 * PI).rem_euclid(PI) - 0.5 * PI;
    let [u, v] = [e.center_px.u_px - spot.u, e.center_px.v_px - spot.v];
    let all = SVector::<f64, 5>::from([u, v, e.semi_major_px - spot.a, e.semi_minor_px - spot.b, turned]);
    let z2 = all.dot(&(disc.covariance.try_inverse().unwrap() * all)) / 5.0;
    ([all[0], all[1], all[2], all[3]], z2)
}

/// Angle of the major axis, rad.
const PHI: f64 = 0.4;

#[derive(Clone, Copy)]
pub struct Condition {
    pub semi_minor_px: f64,
    /// Major over minor semi-axis.
    pub ratio: f64,
    pub blur_px: f64,
    pub light: Light,
    pub bits: u32,
    /// Of the step; in shot noise that of the darker side.
    pub noise: f64,
    pub bright: bool,
}

/// What came out, in the order centre u, centre v, semi-major, semi-minor.
pub struct Row {
    pub bias_px: [f64; 4],
    /// Scatter over the bound.
    pub ratio: [f64; 4],
    pub bound_px: [f64; 4],
    /// Mean of (error / sigma)^2 of the covariance given.
    pub z2: f64,
    pub found: usize,
}

impl Row {
    /// Root mean square of the four ratios.
    pub fn overall(&self) -> f64 {
        (self.ratio.iter().map(|r| r * r).sum::<f64>() / 4.0).sqrt()
    }
}

impl Condition {
    /// Width and height of its images, px.
    pub fn size(&self) -> usize {
        let spread_px = if self.light == Light::Defocus { self.spread_px() } else { 0.0 };
        (2.0 * (self.semi_minor_px * self.ratio + 5.0 * self.blur_px + spread_px) + 24.0) as usize
    }

    /// What detection is told: that discs are printed, where it is the light that is loud, or the lens that spreads it, and smoke could look alike.
    fn told(&self) -> DetectOptions {
        let smoke = if matches!(self.light, Light::Shot | Light::Defocus) { Smoke::None } else { Smoke::Maybe };
        DetectOptions { smoke, ..DetectOptions::default() }
    }

    /// Of the smoke, px.
    fn wavelengths(&self) -> [f64; 8] {
        let times = if self.light == Light::Haze { 3.0 } else { 1.0 };
        std::array::from_fn(|i| times * self.semi_minor_px * (1.0 + 3.0 * i as f64 / 7.0))
    }

    pub fn spot(&self, du: f64, dv: f64) -> Spot {
        let middle = (self.size() / 2) as f64;
        Spot { u: middle + du, v: middle + dv, a: self.semi_minor_px * self.ratio, b: self.semi_minor_px, phi: PHI }
    }

    /// Wave vector of smoke in the image, along u and v, 1/px: of wave number `k` (1/px) at the angle `t` from u; of a bubble from the major axis, along
    /// which waves are longer by major over minor, as the disc is.
    fn wave(&self, k: f64, t: f64) -> [f64; 2] {
        let [x, y] = [k * t.cos(), k * t.sin()];
        if self.light != Light::Bubble {
            return [x, y];
        }
        let (s, c) = PHI.sin_cos();
        [x / self.ratio * c - y * s, x / self.ratio * s + y * c]
    }

    /// Grey levels of the ground and the disc.
    pub fn levels(&self) -> (f64, f64) {
        let full = if self.bits == 8 { 255.0 } else { 60_000.0 };
        if self.bright { (0.1 * full, 0.6 * full) } else { (0.65 * full, 0.15 * full) }
    }

    fn step(&self) -> f64 {
        (self.levels().1 - self.levels().0).abs()
    }

    /// Standard deviation of the noise where the clean image has this grey level.
    pub fn sigma(&self, grey: f64) -> f64 {
        let (ground, disc) = self.levels();
        let light = (grey - ground.min(disc)) / self.step();
        let louder = if matches!(self.light, Light::Shot | Light::Defocus) { 1.0 + 8.0 * light } else { 1.0 };
        self.noise * self.step() * louder.max(0.0).sqrt()
    }

    /// Waves of smoke about the middle of the image: wave numbers (1/px), phase, height.
    fn waves(&self, seed: u64) -> Vec<[f64; 4]> {
        let mut random = Random(seed);
        (0..8)
            .map(|i| {
                let wavelength = self.wavelengths()[i];
                let t = TAU * random.uniform();
                let [x, y] = self.wave(TAU / wavelength, t);
                [x, y, TAU * random.uniform(), 0.3 / 8.0_f64.sqrt()]
            })
            .collect()
    }

    fn draw(&self, spot: &Spot, psf: f64, levels: (f64, f64), waves: &[[f64; 4]]) -> Clean {
        if self.light == Light::Defocus {
            return self.draw_out_of_focus(spot, psf, levels, self.spread_px());
        }
        let (ground, disc) = levels;
        let middle = (self.size() / 2) as f64;
        let across = 2.0 * self.semi_minor_px;
        draw(self.size(), self.size(), psf, |u, v, h| {
            let (x, y) = (u - middle, v - middle);
            let cover = spot.cover(u, v, h);
            match self.light {
                Light::Even | Light::Glare | Light::Shot | Light::Defocus => ground + (disc - ground) * cover,
                Light::Bent => {
                    let (x, y) = (x / self.semi_minor_px, y / self.semi_minor_px);
                    (ground + (disc - ground) * cover) * (1.0 + 0.05 * x - 0.05 * x * x - 0.025 * y * y)
                }
                Light::Slanted => (ground + (disc - ground) * cover) * (1.0 + 0.3 * (0.8 * x + 0.6 * y) / across),
                Light::Smoke | Light::Haze | Light::Bubble if cover == 0.0 => ground,
                Light::Smoke | Light::Haze | Light::Bubble => {
                    let smoke: f64 = waves.iter().map(|w| w[3] * (w[0] * x + w[1] * y + w[2]).sin()).sum();
                    ground + (disc * (1.0 + smoke) - ground) * cover
                }
            }
        })
    }

    /// Radius of the disc that a point is spread over, px.
    fn spread_px(&self) -> f64 {
        3.0 * self.blur_px
    }

    /// Even light behind a blur of a disc of `spread_px` and a Gaussian: the mean over rings of that disc of equal area.
    pub fn draw_out_of_focus(&self, spot: &Spot, psf: f64, (ground, disc): (f64, f64), spread_px: f64) -> Clean {
        const RINGS: usize = 6;
        const PLACES: usize = 12;
        let mut sum = Clean { width: self.size(), height: self.size(), grey: vec![0.0; self.size() * self.size()] };
        for k in 0..RINGS * PLACES {
            let radius = spread_px * (((k / PLACES) as f64 + 0.5) / RINGS as f64).sqrt();
            let (sin, cos) = (TAU * ((k % PLACES) as f64 + 0.382 * (k / PLACES) as f64) / PLACES as f64).sin_cos();
            let moved = Spot { u: spot.u + radius * cos, v: spot.v + radius * sin, ..*spot };
            let one = draw(sum.width, sum.height, psf, |u, v, h| ground + (disc - ground) * moved.cover(u, v, h));
            sum.grey.iter_mut().zip(one.grey).for_each(|(sum, x)| *sum += x / (RINGS * PLACES) as f64);
        }
        sum
    }

    /// Cramer-Rao covariance of (u, v, a, b) with angle, blur, levels and light unknown, by differences of drawn images. Of the
    /// light is known what kind it is: slanted, with slopes of its own on either side; or smoke, a random field of which the spectrum is
    /// known (the eight wavelengths, equal strength, any direction and phase), not the waves of the scene. Of the noise it is known how loud each pixel's is.
    fn bound(&self, waves: &[[f64; 4]], light: &[(Vec<f64>, f64)], hidden: &dyn Fn(f64, f64) -> bool) -> [f64; 4] {
        let spot = self.spot(0.0, 0.0);
        let span = self.step();
        let at = |d: [f64; 8]| {
            let s =
                Spot { u: spot.u + d[0], v: spot.v + d[1], a: spot.a + d[2], b: spot.b + d[3], phi: spot.phi + d[4] };
            let levels = (self.levels().0 + d[6], self.levels().1 + d[7]);
            self.draw(&s, self.blur_px + d[5], levels, waves).grey
        };
        let steps = [0.05, 0.05, 0.05, 0.05, 0.05 / spot.a, 0.03, 0.01 * span, 0.01 * span];
        let mut columns: Vec<(Vec<f64>, f64)> = (0..8)
            .map(|k| {
                let (mut up, mut down) = ([0.0; 8], [0.0; 8]);
                up[k] = steps[k];
                down[k] = -steps[k];
                let column = at(up).iter().zip(at(down)).map(|(x, y)| (x - y) / (2.0 * steps[k])).collect();
                (column, 0.0)
            })
            .collect();
        columns.extend_from_slice(light);
        let quantised = if self.bits == 8 { 1.0 / 12.0 } else { 0.0 };
        let clean = at([0.0; 8]);
        let weight: Vec<f64> = clean.iter().map(|grey| 1.0 / (self.sigma(*grey).powi(2) + quantised)).collect();
        let size = self.size();
        let seen: Vec<usize> = (0..size * size).filter(|i| !hidden((i % size) as f64, (i / size) as f64)).collect();
        let n = columns.len();
        let fisher = DMatrix::from_fn(n, n, |i, j| {
            let dot: f64 = seen.iter().map(|p| weight[*p] * columns[i].0[*p] * columns[j].0[*p]).sum();
            dot + if i == j { columns[i].1 } else { 0.0 }
        });
        // Unknowns differ by orders of magnitude: scale before inverting.
        let scale: Vec<f64> = (0..n).map(|i| fisher[(i, i)].sqrt()).collect();
        let scaled = DMatrix::from_fn(n, n, |i, j| fisher[(i, j)] / (scale[i] * scale[j]));
        let inverse = scaled.try_inverse().unwrap();
        std::array::from_fn(|k| inverse[(k, k)].sqrt() / scale[k])
    }

    /// Derivatives of the image by the unknowns of the light, each with the weight of its prior.
    fn light_columns(&self) -> Vec<(Vec<f64>, f64)> {
        let spot = &self.spot(0.0, 0.0);
        let (ground, disc) = self.levels();
        let middle = (self.size() / 2) as f64;
        let image = |f: &dyn Fn(f64, f64) -> f64, inside: f64, outside: f64| {
            draw(self.size(), self.size(), self.blur_px, |u, v, h| {
                let level = outside + (inside - outside) * spot.cover(u, v, h);
                if level == 0.0 { 0.0 } else { f(u - middle, v - middle) * level }
            })
            .grey
        };
        match self.light {
            Light::Even | Light::Glare | Light::Shot => vec![],
            // How far the lens is out of focus is not known either.
            Light::Defocus => {
                let at = |spread| self.draw_out_of_focus(spot, self.blur_px, self.levels(), spread).grey;
                let step = 0.05 * self.spread_px();
                let ends = [at(self.spread_px() + step), at(self.spread_px() - step)];
                vec![(ends[0].iter().zip(&ends[1]).map(|(a, b)| (a - b) / (2.0 * step)).collect(), 0.0)]
            }
            Light::Slanted => [(disc, 0.0), (0.0, ground)]
                .iter()
                .flat_map(|(i, o)| [(image(&|x, _| x, *i, *o), 0.0), (image(&|_, y| y, *i, *o), 0.0)])
                .collect(),
            Light::Bent => [(disc, 0.0), (0.0, ground)]
                .iter()
                .flat_map(|(i, o)| {
                    let r = self.semi_minor_px;
                    let of = |f: &dyn Fn(f64, f64) -> f64| (image(&|x, y| f(x / r, y / r), *i, *o), 0.0);
                    [of(&|x, _| x), of(&|_, y| y), of(&|x, _| x * x), of(&|x, y| x * y), of(&|_, y| y * y)]
                })
                .collect(),
            Light::Smoke | Light::Haze | Light::Bubble => self
                .wavelengths()
                .into_iter()
                .flat_map(|wavelength| {
                    let k = TAU / wavelength;
                    // As many directions as make the sum over them isotropic across the disc.
                    let directions = (1.2 * k * spot.a + 4.0).ceil();
                    let weight = 2.0 * directions / (0.3 * 0.3 / 8.0);
                    let turned = (0..directions as usize).map(move |i| i as f64 * PI / directions);
                    turned.flat_map(move |t| {
                        let [x, y] = self.wave(k, t);
                        [(x, y, 0.0, weight), (x, y, 0.5 * PI, weight)]
                    })
                })
                .map(|(x, y, phase, weight)| (image(&|u, v| (x * u + y * v + phase).sin(), disc, 0.0), weight))
                .collect(),
        }
    }

    /// One noisy image, as grey levels, and the discs in it.
    fn expose(&self, clean: &Clean, options: &DetectOptions, random: &mut Random) -> (Vec<f32>, Vec<Disc>) {
        let (w, h, sigma) = (clean.width, clean.height, |grey| self.sigma(grey));
        let (levels, found) = if self.bits == 8 {
            let p = clean.noisy_u8(sigma, random);
            let found = find_discs(&GrayView::new(Samples::U8(&p), w, h, w).unwrap(), options);
            (p.iter().map(|x| f32::from(*x)).collect(), found)
        } else {
            let p = clean.noisy_u16(sigma, random);
            let found = find_discs(&GrayView::new(Samples::U16(&p), w, h, w).unwrap(), options);
            (p.iter().map(|x| f32::from(*x)).collect(), found)
        };
        (levels, found.unwrap().discs)
    }

    /// The disc that was found for the one drawn.
    fn at<'a>(&self, spot: &Spot, discs: &'a [Disc]) -> Option<&'a Disc> {
        let off_px = |d: &Disc| (d.ellipse.center_px.u_px - spot.u).hypot(d.ellipse.center_px.v_px - spot.v);
        discs.iter().find(|d| off_px(d) < self.semi_minor_px)
    }

    /// Draws `scenes` scenes, each at another place within the pixel and in other smoke, and shows `shots` noisy images of each:
    /// the disc as it is, the grey levels, the disc found. Returns the Cramer-Rao bound, as standard deviations.
    pub fn show(
        &self,
        scenes: usize,
        shots: usize,
        seed: u64,
        each: impl FnMut(&Spot, &[f32], Option<&Disc>),
    ) -> [f64; 4] {
        // The smoke modulates the step, a spot hides another stretch of the contour: the bound is another in each scene.
        let bounds = if self.light.is_smoke() || self.light == Light::Glare { scenes } else { 1 };
        self.expose_all([scenes, shots, bounds], seed, each)
    }

    /// The same without the bound, which takes most of the time.
    pub fn show_only(&self, scenes: usize, seed: u64, mut each: impl FnMut(&Spot, Option<&Disc>)) {
        self.expose_all([scenes, 1, 0], seed, |spot, _, disc| each(spot, disc));
    }

    /// The place of the disc and the smoke of a scene.
    fn scene(&self, scene: usize, seed: u64) -> (Spot, Vec<[f64; 4]>) {
        let spot = self.spot((scene as f64 * 0.618).fract() - 0.5, (scene as f64 * 0.414).fract() - 0.5);
        (spot, self.waves(seed * 1000 + scene as u64))
    }

    /// Draws so many columns and rows of scenes, without spots of glare, side by side in one noisy image, the heights of their waves so many times those of a scene alone,
    /// and shows each disc as it is and as it is found.
    pub fn show_together(
        &self,
        [columns, rows]: [usize; 2],
        heights: f64,
        options: &DetectOptions,
        seed: u64,
        mut each: impl FnMut(&Spot, Option<&Disc>),
    ) {
        let size = self.size();
        let mut all =
            Clean { width: columns * size, height: rows * size, grey: vec![0.0; columns * rows * size * size] };
        let mut spots = vec![];
        for scene in 0..columns * rows {
            let (spot, mut waves) = self.scene(scene, seed);
            waves.iter_mut().for_each(|w| w[3] *= heights);
            let [left, top] = [scene % columns * size, scene / columns * size];
            let one = self.draw(&spot, self.blur_px, self.levels(), &waves);
            for (v, row) in one.grey.chunks(size).enumerate() {
                all.grey[(top + v) * all.width + left..][..size].copy_from_slice(row);
            }
            spots.push(Spot { u: spot.u + left as f64, v: spot.v + top as f64, ..spot });
        }
        let (_, discs) = self.expose(&all, options, &mut Random(seed));
        for spot in &spots {
            each(spot, self.at(spot, &discs));
        }
    }

    /// As [`Condition::show`], with the bound of the first `bounds` scenes.
    fn expose_all(
        &self,
        [scenes, shots, bounds]: [usize; 3],
        seed: u64,
        mut each: impl FnMut(&Spot, &[f32], Option<&Disc>),
    ) -> [f64; 4] {
        let mut random = Random(seed);
        let mut bound = [0.0; 4];
        let light = if bounds > 0 { self.light_columns() } else { vec![] };
        for scene in 0..scenes {
            let (spot, waves) = self.scene(scene, seed);
            let mut clean = self.draw(&spot, self.blur_px, self.levels(), &waves);
            let (radius, turn) = (0.25 * self.semi_minor_px, TAU * random.uniform());
            let (s, c) = spot.phi.sin_cos();
            let (x, y) = (spot.a * turn.cos(), spot.b * turn.sin());
            let (gu, gv) = (spot.u + c * x - s * y, spot.v + s * x + c * y);
            let top = if self.bits == 8 { 255.0 } else { 60_000.0 };
            if self.light == Light::Glare {
                for (i, g) in clean.grey.iter_mut().enumerate() {
                    let d = ((i % clean.width) as f64 - gu).hypot((i / clean.width) as f64 - gv);
                    *g = (*g + 3.0 * top * (-0.5 * (d / (0.4 * radius)).powi(2)).exp()).min(top);
                }
            }
            if scene < bounds {
                // Where the spot adds more than half the noise.
                let sigmas = (2.0 * (3.0 * top / (0.5 * self.noise * self.step())).ln()).sqrt();
                let hidden =
                    |u: f64, v: f64| self.light == Light::Glare && (u - gu).hypot(v - gv) < 0.4 * radius * sigmas;
                let b = self.bound(&waves, &light, &hidden);
                (0..4).for_each(|k| bound[k] += b[k] * b[k] / bounds as f64);
            }
            for _ in 0..shots {
                let (levels, discs) = self.expose(&clean, &self.told(), &mut random);
                each(&spot, &levels, self.at(&spot, &discs));
            }
        }
        bound.map(f64::sqrt)
    }

    /// Measures the discs that [`Condition::show`] shows.
    pub fn run(&self, scenes: usize, shots: usize, seed: u64) -> Row {
        let (mut errors, mut z2) = (Vec::new(), 0.0);
        let bound_px = self.show(scenes, shots, seed, |spot, _, disc| {
            let Some(disc) = disc else { return };
            let (error, squared) = off(spot, disc);
            z2 += squared;
            errors.push(error);
        });
        let n = errors.len().max(2) as f64;
        let bias_px = std::array::from_fn(|k| errors.iter().map(|e| e[k]).sum::<f64>() / n);
        // About the truth, not about the mean: what a scene does to all its images counts.
        let ratio = std::array::from_fn(|k| (errors.iter().map(|e| e[k] * e[k]).sum::<f64>() / n).sqrt() / bound_px[k]);
        Row { bias_px, ratio, bound_px, z2: z2 / n, found: errors.len() }
    }
}
