//! A flat window between the camera and the scene: air, glass, water, as layers between parallel planes.
//!
//! A ray keeps `s = n_i sin(theta_i)` through all layers (Snell). With n the unit normal from the camera into the scene, a point
//! p lies `H = n . p` along it and `r = |p - n H|` aside. With `u = tan(theta_air)` and `v = u^2`:
//! ```text
//! g_i(v) = tan(theta_i) / u = n_air / sqrt(q_i),   q_i = n_i^2 (1 + v) - n_air^2 v
//! h(v)   = d + t g_glass(v) + D g_water(v),        D = H - d - t
//! u h(u^2) = r                                     where the ray arrives
//! a      = p - n (H - h)                           apparent point: on the straight line of the ray in air
//! ```
//! The camera sees p where it would see the apparent point a without a window, so everything else stays as it is. `u h(u^2)`
//! grows, and where glass and water are denser than air it is concave: Newton's steps from the paraxial ray `u = r / h(0)`
//! rise to the root. Elsewhere, and against rounding, they are kept between bounds: `0 <= u <= r / d`.
//!
//! Derivatives follow from `v h^2 = Q`, `Q = |p|^2 - H^2`, with theta everything that h holds beside v:
//! ```text
//! dh = (h_v dQ / h^2 + h_theta dtheta) / (1 + 2 v h_v / h)
//! da = dp - n (n . dp - dh)                        for a movement dp: dH = n . dp, dQ = 2 (p - n H) . dp
//! da = -dn (H - h) - n (p . dn - dh)               for a turn w of the window: dn = w x n, dH = p . dn, dQ = -2 H p . dn
//! ```
//! They hold on the normal through the camera too, since neither h nor Q knows the direction of r.
//!
//! | symbol | identifier | unit | frame | meaning |
//! |---|---|---|---|---|
//! | n | `normal` | 1 | Cam | normal of the window, away from the camera |
//! | d, t | `distance_mm`, `thickness_mm` | mm | - | camera to glass along n; thickness of the glass |
//! | n_air, n_glass, n_water | `indices` | 1 | - | refractive indices |
//! | a | `apparent` | mm | Cam | apparent point |
//!
//! Source: Snell's law; refraction at flat layers after Treibitz et al., "Flat refractive geometry" (2012). Not valid, and
//! refused, for points that do not lie beyond the window.

use super::{Camera, DIntrinsics, Refusal};
use crate::error::{Invalid, Result};
use nalgebra::{Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};

/// Number of layer parameters.
pub const LAYERS: usize = 5;

/// Names of the layer parameters with their units, in the order of every derivative.
pub const LAYER_NAMES: [&str; LAYERS] = ["distance_mm", "thickness_mm", "n_air", "n_glass", "n_water"];

/// Number of steps of a window: a turn about the three axes of its frame, then the layers.
pub const WINDOW_STEPS: usize = 3 + LAYERS;

/// Names of the steps with their units.
pub const WINDOW_STEP_NAMES: [&str; WINDOW_STEPS] =
    ["rx_rad", "ry_rad", "rz_rad", "distance_mm", "thickness_mm", "n_air", "n_glass", "n_water"];

/// A flat window in front of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Window {
    normal: Vector3<f64>,
    distance_mm: f64,
    thickness_mm: f64,
    indices: [f64; 3],
}

/// Apparent point of a point beyond the window, with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ApparentJet {
    /// The apparent point in the camera frame, mm.
    pub apparent: Vector3<f64>,
    /// Derivative by the point.
    pub by_point: Matrix3<f64>,
    /// Derivative by the layers, in the order of [`LAYER_NAMES`].
    pub by_layers: SMatrix<f64, 3, LAYERS>,
    /// Derivative by a small turn of the window (rad, about the axes of the camera frame).
    pub by_turn: Matrix3<f64>,
}

/// Image of a point beyond a window, with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WindowJet {
    /// The image, px.
    pub pixel: Vector2<f64>,
    /// Derivative by the point in the camera frame, px per mm.
    pub dq_dp: Matrix2x3<f64>,
    /// Derivative by the intrinsics.
    pub dq_dintrinsics: DIntrinsics,
    /// Derivative by the layers, in the order of [`LAYER_NAMES`].
    pub dq_dlayers: SMatrix<f64, 2, LAYERS>,
    /// Derivative by a small turn of the window, px per rad.
    pub dq_dturn: Matrix2x3<f64>,
}

/// A ray in the medium behind the window, camera frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WaterRay {
    /// Where it leaves the glass, mm.
    pub from_mm: Vector3<f64>,
    /// Its unit direction.
    pub direction: Vector3<f64>,
}

/// Ray of a point: u^2 and the depth of the apparent point, with what their derivatives need.
struct Solved {
    /// `n . p` and the square of the distance aside.
    along: f64,
    aside: Vector3<f64>,
    v: f64,
    h: f64,
}

impl Window {
    /// A window of this normal (camera frame, away from the camera; any length), distance and thickness (mm) and refractive
    /// indices of air, glass and water.
    ///
    /// # Errors
    /// [`Invalid::Value`] where a number is not finite, the distance not positive, the thickness negative, an index not
    /// between 0.5 and 5, or the normal zero.
    pub fn new(normal: Vector3<f64>, distance_mm: f64, thickness_mm: f64, indices: [f64; 3]) -> Result<Self> {
        let length = normal.norm();
        if !(length.is_finite() && length > 0.0) {
            return Err(Invalid::value("length of the window's normal", length, "a positive number").into());
        }
        if !(distance_mm.is_finite() && distance_mm > 0.0) {
            return Err(Invalid::value("distance of the window (mm)", distance_mm, "a positive number").into());
        }
        if !(thickness_mm.is_finite() && thickness_mm >= 0.0) {
            return Err(Invalid::value("thickness of the window (mm)", thickness_mm, "0 or a positive number").into());
        }
        for (name, n) in LAYER_NAMES[2..].iter().zip(indices) {
            if !(n > 0.5 && n < 5.0) {
                return Err(Invalid::value(*name, n, "a refractive index between 0.5 and 5").into());
            }
        }
        Ok(Self { normal: normal / length, distance_mm, thickness_mm, indices })
    }

    /// Unit normal in the camera frame, away from the camera.
    pub fn normal(&self) -> &Vector3<f64> {
        &self.normal
    }

    /// Distance, thickness and indices in the order of [`LAYER_NAMES`].
    pub fn layers(&self) -> [f64; LAYERS] {
        let [air, glass, water] = self.indices;
        [self.distance_mm, self.thickness_mm, air, glass, water]
    }

    /// The same window seen from another frame with the same origin.
    pub fn in_frame(&self, other_from_this: &Matrix3<f64>) -> Self {
        Self { normal: other_from_this * self.normal, ..*self }
    }

    /// The window after a turn (rad, about the axes of its frame) and a change of its layers.
    ///
    /// # Errors
    /// As [`Window::new`].
    pub fn stepped(&self, turn_rad: &Vector3<f64>, layers: &[f64; LAYERS]) -> Result<Self> {
        let now = self.layers();
        let [distance, thickness, air, glass, water] = std::array::from_fn(|k| now[k] + layers[k]);
        Self::new(crate::rigid::rotation_exp(turn_rad) * self.normal, distance, thickness, [air, glass, water])
    }

    /// Two unit vectors across the normal and each other: the axes about which a turn is felt.
    pub fn tangents(&self) -> [Vector3<f64>; 2] {
        let n = &self.normal;
        let least = (0..3).fold(0, |best, k| if n[k].abs() < n[best].abs() { k } else { best });
        let first = n.cross(&Vector3::ith(least, 1.0)).normalize();
        [first, n.cross(&first)]
    }

    /// The point beyond the window whose apparent point this is; `None` where it would lie before the far face.
    ///
    /// The inverse of [`Window::apparent`]: with `u = r / n . a` all thicknesses are known but that of the water.
    pub fn behind(&self, apparent: &Vector3<f64>) -> Option<Vector3<f64>> {
        let h = self.normal.dot(apparent);
        let aside = apparent - self.normal * h;
        let v = aside.norm_squared() / (h * h);
        let rest = h - self.distance_mm - self.thickness_mm * self.g(1, v);
        let depth_mm = rest / self.g(2, v);
        let along = self.distance_mm + self.thickness_mm + depth_mm;
        (h > 0.0 && depth_mm >= 0.0 && depth_mm.is_finite()).then(|| aside + self.normal * along)
    }

    /// `q_i` of a layer.
    fn q(&self, layer: usize, v: f64) -> f64 {
        let (air, n) = (self.indices[0], self.indices[layer]);
        n * n * (1.0 + v) - air * air * v
    }

    /// `g_i` of a layer.
    fn g(&self, layer: usize, v: f64) -> f64 {
        self.indices[0] / self.q(layer, v).sqrt()
    }

    fn depths(&self, along: f64) -> [f64; 3] {
        [self.distance_mm, self.thickness_mm, along - self.distance_mm - self.thickness_mm]
    }

    fn h(&self, depths: &[f64; 3], v: f64) -> f64 {
        depths[0] + depths[1] * self.g(1, v) + depths[2] * self.g(2, v)
    }

    /// Largest slope at which the ray still enters every layer.
    fn steepest(&self) -> f64 {
        let air = self.indices[0];
        let thinner = self.indices[1..].iter().filter(|n| **n < air);
        thinner.map(|n| n / (air * air - n * n).sqrt()).fold(f64::INFINITY, f64::min)
    }

    fn solve(&self, p: &Vector3<f64>) -> std::result::Result<Solved, Refusal> {
        let along = self.normal.dot(p);
        let aside = p - self.normal * along;
        let r = aside.norm();
        if !(along.is_finite() && r.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        let depths = self.depths(along);
        if depths[2] < 0.0 {
            return Err(Refusal::BeforeWindow { missing_mm: -depths[2] });
        }
        let (mut low, mut high) = (0.0, (r / depths[0]).min(self.steepest()));
        let mut u = (r / self.h(&depths, 0.0)).min(high);
        // Monotone Newton needs about 5 steps; bisection alone would need 53.
        for _ in 0..64 {
            let v = u * u;
            let (g1, g2) = (self.g(1, v), self.g(2, v));
            let excess = u * (depths[0] + depths[1] * g1 + depths[2] * g2) - r;
            let part =
                |layer: usize, g: f64| depths[layer] * g.powi(3) * (self.indices[layer] / self.indices[0]).powi(2);
            let step = excess / (depths[0] + part(1, g1) + part(2, g2));
            if step.abs() <= f64::EPSILON * u {
                break;
            }
            if excess > 0.0 {
                high = u
            } else {
                low = u
            }
            let next = u - step;
            u = if next > low && next < high { next } else { 0.5 * (low + high) };
        }
        let v = u * u;
        Ok(Solved { along, aside, v, h: self.h(&depths, v) })
    }

    /// Apparent point of a point beyond the window (camera frame, mm): the camera sees the one where it would see the other
    /// without a window.
    ///
    /// # Errors
    /// [`Refusal::BeforeWindow`] for a point that does not lie beyond it, [`Refusal::NotFinite`].
    pub fn apparent(&self, p: &Vector3<f64>) -> std::result::Result<Vector3<f64>, Refusal> {
        let s = self.solve(p)?;
        Ok(p - self.normal * (s.along - s.h))
    }

    /// [`Window::apparent`] with derivatives.
    ///
    /// # Errors
    /// As [`Window::apparent`].
    pub fn apparent_jet(&self, p: &Vector3<f64>) -> std::result::Result<ApparentJet, Refusal> {
        let s = self.solve(p)?;
        let (n, v, h) = (&self.normal, s.v, s.h);
        let depths = self.depths(s.along);
        let air = self.indices[0];
        let (g1, g2) = (self.g(1, v), self.g(2, v));
        // 1 / q^(3/2) of each layer.
        let power = |layer: usize| self.q(layer, v).powf(-1.5);
        let slope = |layer: usize| {
            let index = self.indices[layer];
            -0.5 * depths[layer] * air * (index * index - air * air) * power(layer)
        };
        let h_v = slope(1) + slope(2);
        let scale = 1.0 / (1.0 + 2.0 * v * h_v / h);
        let by_square = scale * h_v / (h * h);
        let by_along = scale * g2;
        // Gradient of h by the point.
        let dh = n * by_along + s.aside * (2.0 * by_square);
        let by_point = Matrix3::identity() - n * (n - dh).transpose();
        let by_index = |layer: usize| -depths[layer] * air * self.indices[layer] * (1.0 + v) * power(layer);
        let by_air: f64 = [1, 2].iter().map(|&l| depths[l] * self.indices[l].powi(2) * (1.0 + v) * power(l)).sum();
        let layers = [1.0 - g2, g1 - g2, by_air, by_index(1), by_index(2)];
        let by_layers = SMatrix::<f64, 3, LAYERS>::from_fn(|i, j| n[i] * scale * layers[j]);
        // dh by dn is along p: dH = p . dn, dQ = -2 H p . dn.
        let by_turned = p * (by_along - 2.0 * s.along * by_square);
        let by_normal = -Matrix3::identity() * (s.along - h) - n * (p - by_turned).transpose();
        // dn = w x n = -[n]x w.
        let by_turn = by_normal * -crate::rigid::skew(n);
        Ok(ApparentJet { apparent: p - n * (s.along - h), by_point, by_layers, by_turn })
    }

    /// The ray behind the window that leaves the camera in this direction (camera frame).
    ///
    /// # Errors
    /// [`Refusal::OffSensor`] where the ray does not reach the window, or is reflected in it.
    pub fn water_ray(&self, direction: &Vector3<f64>) -> std::result::Result<WaterRay, Refusal> {
        let d = direction.normalize();
        let cosine = self.normal.dot(&d);
        if !(cosine > 0.0) {
            return Err(if cosine.is_nan() { Refusal::NotFinite } else { Refusal::OffSensor });
        }
        let mut at = d * (self.distance_mm / cosine);
        let mut direction = d;
        for (layer, depth) in [(1, self.thickness_mm), (2, 0.0)] {
            // Snell along the surface: the part of n times direction across the normal is kept.
            let ratio = self.indices[layer - 1] / self.indices[layer];
            let across = (direction - self.normal * self.normal.dot(&direction)) * ratio;
            let rest = 1.0 - across.norm_squared();
            if !(rest > 0.0) {
                return Err(Refusal::OffSensor);
            }
            direction = across + self.normal * rest.sqrt();
            at += direction * (depth / rest.sqrt());
        }
        Ok(WaterRay { from_mm: at, direction })
    }
}

impl Camera {
    /// Image of a point beyond a window, with derivatives by the point, the intrinsics and the window.
    ///
    /// # Errors
    /// [`Refusal`] where the point has no image.
    pub fn project_through(&self, window: &Window, p: &Vector3<f64>) -> std::result::Result<WindowJet, Refusal> {
        let a = window.apparent_jet(p)?;
        let jet = self.jet_in_air(&a.apparent)?;
        Ok(WindowJet {
            pixel: jet.pixel,
            dq_dp: jet.dq_dp * a.by_point,
            dq_dintrinsics: jet.dq_dintrinsics,
            dq_dlayers: jet.dq_dp * a.by_layers,
            dq_dturn: jet.dq_dp * a.by_turn,
        })
    }

    /// Ray behind a window of a pixel.
    ///
    /// # Errors
    /// [`Refusal`] where no ray reaches that place of the sensor, or none passes the window.
    pub fn unproject_through(&self, window: &Window, q: &Vector2<f64>) -> std::result::Result<WaterRay, Refusal> {
        window.water_ray(&self.ideal_of_pixel(q)?.push(1.0))
    }
}
