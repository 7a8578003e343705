//! What a calibration says about itself beyond its sigmas: keys `fit.diagnosis` and `mapping_uncertainty`.

use super::number::{maybe, maybe_array, maybe_list, maybe_rows};
use super::schema::Record;
use crate::stats::NORMAL_95;
use serde::{Deserialize, Serialize};

/// Tests of a calibration against its own assumptions.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Diagnosis {
    /// The numbers that influence and bias are stated for, with their standard deviations.
    #[serde(default)]
    pub key_quantities: Vec<KeyQuantity>,
    /// Every prior against the images.
    #[serde(default)]
    pub priors: Vec<Prior>,
    /// Whether the model lacks something.
    #[serde(default)]
    pub model_tests: Vec<ModelTest>,
    /// What each view contributes, and whether it agrees with the others.
    #[serde(default)]
    pub views: Vec<ViewInfluence>,
    /// Discs that were set aside, each with a reason.
    #[serde(default)]
    pub outliers: Vec<OutlierReason>,
}

/// Key quantities that the sheet is part of.
pub(crate) const SHEET_QUANTITIES: [&str; 3] =
    ["distance of the sheet", "angle of the sheet to the baseline", "out-of-plane gain"];

impl Record {
    /// Drops what was said with a sheet that is no longer there.
    pub(crate) fn forget_sheet(&mut self) {
        let of_sheet = |name: &String| SHEET_QUANTITIES.contains(&name.as_str());
        self.mapping_uncertainty = None;
        let Some(said) = &mut self.fit.diagnosis else { return };
        said.key_quantities.retain(|k| !of_sheet(&k.name));
        said.views.retain(|v| ![&v.sigma_growth_of, &v.shift_of, &v.z_of].into_iter().chain(&v.lost).any(of_sheet));
    }
}

/// Lower and upper end; none for an end that was not found.
pub type Interval = [Option<f64>; 2];

/// A number that a user relies on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct KeyQuantity {
    /// What it is, in words.
    pub name: String,
    /// Its unit; empty: none.
    pub unit: String,
    /// Its value.
    #[serde(with = "maybe")]
    pub value: f64,
    /// Its standard deviation.
    #[serde(with = "maybe")]
    pub sigma: f64,
    /// What holds the number 95 times in 100: 1.96 standard deviations either way, or by the profile of the likelihood where equations bend within the standard
    /// deviations. Unknown where the number is not determined.
    #[serde(default)]
    pub interval_95: Option<Interval>,
    /// The standard deviation that the views tell by what changes without each of them: larger than `sigma` by more than chance where something that the
    /// model does not have differs from view to view. Unknown where too few views tell, or one of them alone fixes the number.
    #[serde(with = "maybe", default = "maybe::unknown")]
    pub sigma_by_views: f64,
}

impl KeyQuantity {
    /// Whether the interval is another than the standard deviation tells, by a tenth of either side.
    pub fn bends(&self) -> bool {
        const FELT: f64 = 0.1;
        let straight = NORMAL_95 * self.sigma;
        let felt = |end: &Option<f64>| end.is_none_or(|x| ((x - self.value).abs() / straight - 1.0).abs() > FELT);
        self.interval_95.as_ref().is_some_and(|ends| ends.iter().any(felt))
    }
}

/// One prior against the images.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Prior {
    /// What it is about, in words.
    pub name: String,
    /// Whether the rig file states it (false: a default of the program).
    pub stated: bool,
    /// Unit of the numbers below.
    pub unit: String,
    /// What was known beforehand.
    #[serde(with = "maybe")]
    pub prior: f64,
    /// Its standard deviation.
    #[serde(with = "maybe")]
    pub prior_sigma: f64,
    /// The estimate.
    #[serde(with = "maybe")]
    pub estimate: f64,
    /// Standard deviation of the estimate over that of the prior: near 1 only the prior speaks.
    #[serde(with = "maybe")]
    pub sigma_ratio: f64,
    /// What the images say without this prior; unknown where they say nothing.
    #[serde(with = "maybe")]
    pub images_alone: f64,
    /// Standard deviation of it.
    #[serde(with = "maybe")]
    pub images_alone_sigma: f64,
    /// Prior less images in standard deviations of their difference: standard normal where the prior is true.
    #[serde(with = "maybe")]
    pub z: f64,
    /// Whether prior and images contradict each other (1 % false alarms over all priors together).
    pub conflict: bool,
    /// The finding in words.
    pub words: String,
}

/// A length that is given without a sigma has this part of itself: far below what many discs together tell of a length (2e-6 of a radius).
pub const EXACT: f64 = 1e-7;

impl Prior {
    /// Whether it was given without a sigma.
    pub fn exact(&self) -> bool {
        self.prior_sigma <= 1.001 * EXACT * self.prior.abs()
    }
}

/// A test whether the model lacks something.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelTest {
    /// The question in words.
    pub question: String,
    /// Chi-square where nothing is lacking.
    pub statistic: f64,
    /// Its degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Probability of so large a statistic by chance.
    pub p_value: f64,
    /// Estimate of what is lacking.
    #[serde(with = "maybe")]
    pub size: f64,
    /// Its standard deviation.
    #[serde(with = "maybe")]
    pub sigma: f64,
    /// Unit of both.
    pub unit: String,
    /// Largest change of a key quantity if it were added, in that quantity's standard deviations.
    #[serde(with = "maybe")]
    pub bias_sigmas: f64,
    /// Which quantity.
    #[serde(default)]
    pub bias_of: String,
    /// Whether the images ask for it (1 % false alarms over all tests together).
    pub needed: bool,
    /// The finding in words.
    pub words: String,
}

/// What a view contributes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ViewInfluence {
    /// View, as [`super::View::index`].
    pub view: usize,
    /// Largest growth of the standard deviation of a key quantity when the view is left out; unknown where it is then undetermined.
    #[serde(with = "maybe")]
    pub sigma_growth: f64,
    /// Which quantity.
    #[serde(default)]
    pub sigma_growth_of: String,
    /// Key quantities that no image determines without this view.
    #[serde(default)]
    pub lost: Vec<String>,
    /// Largest change of a key quantity without the view, in its standard deviations, predicted from the normal equations.
    #[serde(with = "maybe")]
    pub predicted_shift_sigmas: f64,
    /// The same by an adjustment without the view.
    #[serde(with = "maybe")]
    pub shift_sigmas: f64,
    /// Which quantity.
    #[serde(default)]
    pub shift_of: String,
    /// The most significant change, in standard deviations of the change itself: standard normal where the view agrees.
    #[serde(with = "maybe")]
    pub z: f64,
    /// Which quantity.
    #[serde(default)]
    pub z_of: String,
    /// Whether the view contradicts the others (1 % false alarms over all views and quantities together).
    pub contradicts: bool,
    /// The finding in words.
    pub words: String,
}

/// End of the reason of a disc that is off in several views.
pub const OFF_ITSELF: &str = "the dot itself is misplaced or damaged on the target";

/// A disc that was set aside.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct OutlierReason {
    /// View.
    pub view: usize,
    /// Camera name.
    pub camera: String,
    /// Lattice label: column, row, level.
    pub disc: [i32; 3],
    /// Distance from where the others expect it, px.
    pub distance_px: f64,
    /// Why, as far as the images show.
    pub reason: String,
}

/// What the uncertainty of a calibration does to measurements in the sheet, one standard deviation each; the noise of the
/// measurement itself comes on top.
///
/// `displacement[i][j]`: error of component i (u, v, w in the sheet frame) per true component j. The diagonal holds the gains, the
/// rest the leaks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MappingUncertainty {
    /// At the middle of what both cameras see.
    pub middle: MappingSigma,
    /// The largest of each over what both cameras see.
    pub largest: MappingSigma,
    /// The points of `map`.
    pub map: MappingMap,
    /// What of it is not determined, in words; empty: nothing.
    #[serde(default)]
    pub undetermined: Vec<String>,
    /// What the views say of these standard deviations; none where they say nothing.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by_views: Option<MappingByViews>,
    /// What equations that bend add to them; none where they are straight.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub by_likelihood: Option<MappingByLikelihood>,
}

/// By how much a number may be off beyond its standard deviation, where equations bend: with h the larger distance to an end of the interval that holds it 95 times
/// in 100 by the likelihood of the images, in the middle of the sheet or at that of four points about it where it is largest,
/// ```text
/// e^2 = max(0, (h / 1.96)^2 - sigma^2)          to be added to sigma^2 everywhere in the sheet
/// ```
/// 0 where equations are straight; an end beyond thirty standard deviations counts as those.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MappingByLikelihood {
    /// Of [`MappingSigma::disparity_px`].
    #[serde(with = "maybe")]
    pub disparity_px: f64,
    /// Of [`MappingSigma::in_plane_mm`].
    #[serde(with = "maybe")]
    pub in_plane_mm: f64,
    /// Of [`MappingSigma::in_plane_scale`].
    #[serde(with = "maybe")]
    pub in_plane_scale: f64,
    /// Of [`MappingSigma::out_of_plane_gain`].
    #[serde(with = "maybe")]
    pub out_of_plane_gain: f64,
    /// Of [`MappingSigma::displacement`].
    #[serde(with = "maybe_rows")]
    pub displacement: Vec<Vec<f64>>,
}

impl MappingByLikelihood {
    /// Standard deviations with what is added to them.
    fn added_to(&self, s: &MappingSigma) -> MappingSigma {
        let rows = s.displacement.iter().zip(&self.displacement);
        let in_plane_mm = s.in_plane_mm.hypot(self.in_plane_mm);
        MappingSigma {
            point_mm: s.point_mm,
            in_plane_px: s.in_plane_px * (in_plane_mm / s.in_plane_mm),
            in_plane_mm,
            disparity_px: s.disparity_px.hypot(self.disparity_px),
            in_plane_scale: s.in_plane_scale.hypot(self.in_plane_scale),
            out_of_plane_gain: s.out_of_plane_gain.hypot(self.out_of_plane_gain),
            displacement: rows.map(|(s, e)| s.iter().zip(e).map(|(s, e)| s.hypot(*e)).collect()).collect(),
        }
    }

    /// In a frame that is turned within the sheet: of what is along x and along y the larger holds for both.
    pub(crate) fn turned(&self) -> Self {
        Self { displacement: turned(&self.displacement), ..self.clone() }
    }
}

/// Entries of u, v, w by u, v, w in a frame that is turned within the sheet.
fn turned(displacement: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let largest = |places: &[[usize; 2]]| {
        let all = places.iter().map(|[i, j]| displacement[*i][*j]);
        all.fold(f64::NAN, f64::max)
    };
    let within = largest(&[[0, 0], [0, 1], [1, 0], [1, 1]]);
    let [into, from] = [largest(&[[0, 2], [1, 2]]), largest(&[[2, 0], [2, 1]])];
    vec![vec![within, within, into], vec![within, within, into], vec![from, from, displacement[2][2]]]
}

/// How many times larger than stated the views tell standard deviations, by what changes without each of them: one factor for the whole of the
/// sheet. Unknown where too few views tell, or one of them alone fixes the numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MappingByViews {
    /// Whether the views differ by more than their noise (1 % false alarms); only then standard deviations of displacements are enlarged.
    pub beyond_noise: bool,
    /// Of [`MappingSigma::disparity_px`].
    #[serde(with = "maybe")]
    pub disparity: f64,
    /// Of [`MappingSigma::in_plane_px`].
    #[serde(with = "maybe")]
    pub in_plane: f64,
    /// Of [`MappingSigma::in_plane_scale`].
    #[serde(with = "maybe")]
    pub in_plane_scale: f64,
    /// Of [`MappingSigma::out_of_plane_gain`].
    #[serde(with = "maybe")]
    pub out_of_plane_gain: f64,
    /// Of [`MappingSigma::displacement`].
    #[serde(with = "maybe_rows")]
    pub displacement: Vec<Vec<f64>>,
}

/// What views and likelihood say of measurements beside their standard deviations.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct MappingTold {
    /// [`MappingUncertainty::by_views`].
    pub by_views: Option<MappingByViews>,
    /// [`MappingUncertainty::by_likelihood`].
    pub by_likelihood: Option<MappingByLikelihood>,
}

impl MappingTold {
    /// In a frame that is turned within the sheet.
    pub(crate) fn turned(self) -> Self {
        Self {
            by_views: self.by_views.map(|v| v.turned()),
            by_likelihood: self.by_likelihood.map(|bent| bent.turned()),
        }
    }
}

impl Record {
    /// What is told of measurements beside their standard deviations.
    pub(crate) fn told_of_mapping(&self) -> MappingTold {
        let told = |m: &MappingUncertainty| MappingTold {
            by_views: m.by_views.clone(),
            by_likelihood: m.by_likelihood.clone(),
        };
        self.mapping_uncertainty.as_ref().map_or_else(MappingTold::default, told)
    }

    /// The same for a sheet that is found otherwise.
    pub(crate) fn told_of_another_sheet(&self) -> MappingTold {
        let MappingTold { by_views, by_likelihood } = self.told_of_mapping();
        let by_views = by_views.map(|v| v.of_another_sheet());
        MappingTold { by_views, by_likelihood: by_likelihood.map(|bent| bent.turned()) }
    }
}

impl MappingUncertainty {
    /// The largest of each over what both cameras see, with what equations that bend add.
    pub fn at_worst(&self) -> MappingSigma {
        self.by_likelihood.as_ref().map_or_else(|| self.largest.clone(), |bent| bent.added_to(&self.largest))
    }

    /// How many times larger than stated the standard deviations of u, v and w are: more than 1 only where the views differ by more than
    /// their noise and tell larger ones, or where equations bend. With s_ij the standard deviations in the middle of the sheet, f_ij the factors of component i per
    /// component j and e_ij what equations that bend add,
    /// ```text
    /// enlarged_i^2 = sum_j (max(1, f_ij)^2 s_ij^2 + e_ij^2) / sum_j s_ij^2        f_ij = 1 where the views do not tell
    /// ```
    /// as of a displacement whose components are alike in size.
    pub fn enlarged(&self) -> [f64; 3] {
        let views = self.by_views.as_ref().filter(|told| told.beyond_noise);
        [0, 1, 2].map(|i| {
            let (mut stated, mut larger) = (0.0, 0.0);
            for (j, sigma) in self.middle.displacement[i].iter().enumerate() {
                // Unknown ones stay as stated.
                let factor = views.map_or(1.0, |told| told.displacement[i][j].max(1.0));
                let added = self.by_likelihood.as_ref().map_or(0.0, |bent| bent.displacement[i][j].max(0.0));
                stated += sigma * sigma;
                larger += (factor * sigma).powi(2) + added * added;
            }
            let factor = f64::sqrt(larger / stated);
            if factor.is_finite() { factor } else { 1.0 }
        })
    }
}

impl MappingByViews {
    /// Whether the views differ by more than their noise and do not tell how much of that is in u, v or w: neither of the component's own error, nor of what
    /// w leaks into it.
    pub fn untold(&self) -> bool {
        self.beyond_noise && (0..3).any(|i| self.displacement[i][i].is_nan() && self.displacement[i][2].is_nan())
    }

    /// In a frame that is turned within the sheet: of what is along x and along y the larger factor holds for both.
    pub(crate) fn turned(&self) -> Self {
        Self { displacement: turned(&self.displacement), ..self.clone() }
    }

    /// With a sheet that was found otherwise, the cameras being the same: of the disparity in it the views do not tell.
    pub(crate) fn of_another_sheet(&self) -> Self {
        Self { disparity: f64::NAN, ..self.turned() }
    }
}

/// Standard deviations at one point of the sheet.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MappingSigma {
    /// Point of the sheet frame, mm; unknown for largest values.
    #[serde(with = "maybe_array")]
    pub point_mm: [f64; 2],
    /// Place in the sheet that a pixel is mapped to, px of the first camera (the larger of both cameras).
    #[serde(with = "maybe")]
    pub in_plane_px: f64,
    /// The same, mm.
    #[serde(with = "maybe")]
    pub in_plane_mm: f64,
    /// Both cameras' maps against each other, px of the second camera.
    #[serde(with = "maybe")]
    pub disparity_px: f64,
    /// In-plane scale, relative.
    #[serde(with = "maybe")]
    pub in_plane_scale: f64,
    /// Out-of-plane gain over in-plane scale, relative.
    #[serde(with = "maybe")]
    pub out_of_plane_gain: f64,
    /// Error of u, v, w (rows) per true u, v, w (columns).
    #[serde(with = "maybe_rows")]
    pub displacement: Vec<Vec<f64>>,
}

/// Standard deviations over the sheet, structure of arrays; a quantity that nothing determines has an empty list.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MappingMap {
    /// Columns and rows of the grid the points are taken from.
    #[serde(default)]
    pub spacing_mm: [f64; 2],
    /// Sheet x, mm.
    pub x_mm: Vec<f64>,
    /// Sheet y, mm.
    pub y_mm: Vec<f64>,
    /// As [`MappingSigma::in_plane_px`].
    #[serde(with = "maybe_list")]
    pub in_plane_px: Vec<f64>,
    /// As [`MappingSigma::disparity_px`].
    #[serde(with = "maybe_list")]
    pub disparity_px: Vec<f64>,
    /// Error of u per u.
    #[serde(with = "maybe_list")]
    pub u_per_u: Vec<f64>,
    /// Error of w per w.
    #[serde(with = "maybe_list")]
    pub w_per_w: Vec<f64>,
    /// Leak of w into u.
    #[serde(with = "maybe_list")]
    pub u_per_w: Vec<f64>,
    /// Leak of w into v.
    #[serde(with = "maybe_list")]
    pub v_per_w: Vec<f64>,
    /// Leak of u into w.
    #[serde(with = "maybe_list")]
    pub w_per_u: Vec<f64>,
    /// Error of v per v.
    #[serde(default, with = "maybe_list")]
    pub v_per_v: Vec<f64>,
    /// Leak of v into w.
    #[serde(default, with = "maybe_list")]
    pub w_per_v: Vec<f64>,
    /// Leak of v into u.
    #[serde(default, with = "maybe_list")]
    pub u_per_v: Vec<f64>,
    /// Leak of u into v.
    #[serde(default, with = "maybe_list")]
    pub v_per_u: Vec<f64>,
}
