//! What a user feels, as functions of the calibration at a few points of the sheet: of their changes without single views the factors follow by
//! which the views tell larger standard deviations ([`super::spread`]).
//!
//! | symbol | identifier | shape | meaning |
//! |---|---|---|---|
//! | r | [`StereoSheet::change`] | 15 a point | disparity, misplacements, measured from true displacement |
//! | L | `felt` | functions x 15 a point | what is felt of r: misplacements beside a common shift and turn, scale and gain to first order |
//! | x | `rows` | functions x names | change of L r by the named parameters |

use super::field::SeenSheet;
use super::mapping::{PLACES, beside_shift_and_turn};
use super::spread::{Number, common_factor};
use crate::bundle::{NamedCovariance, Natural};
use crate::record::{MappingByLikelihood, MappingByViews};
use crate::sheet::{RESPONSES, StereoSheet, gain_row, in_plane_scale_row, unit};
use nalgebra::{DMatrix, DVector, SVector};

/// Kinds of functions, the nine numbers of measured from true displacement last.
const DISPARITY: usize = 0;
const PLACE: usize = 1;
const SCALE: usize = 2;
const GAIN: usize = 3;
const DISPLACEMENT: usize = 4;
const KINDS: usize = DISPLACEMENT + 9;
/// Functions of one point by itself, which stand before those of all points together.
const OF_POINT: usize = 13;

/// Functions of the calibration at points of the sheet.
pub(super) struct Probes {
    stereo: StereoSheet,
    points: Vec<[f64; 2]>,
    felt: DMatrix<f64>,
    /// Kind of each function.
    kinds: Vec<usize>,
    /// Derivatives by named parameters.
    pub(super) rows: Vec<Vec<(String, f64)>>,
    /// Whether nothing undetermined moves them.
    pub(super) determined: Vec<bool>,
}

impl Probes {
    /// At a few points all over the field; `None` where one is not seen.
    pub(super) fn of(covariance: &NamedCovariance, sheet: &SeenSheet) -> Option<Self> {
        Self::at(covariance, sheet, spread_out(&sheet.field.points))
    }

    /// The same, and in the middle of the field, where errors that grow to all sides vanish to first order.
    pub(super) fn with_the_middle(covariance: &NamedCovariance, sheet: &SeenSheet) -> Option<Self> {
        Self::at(covariance, sheet, [spread_out(&sheet.field.points), vec![sheet.field.middle()]].concat())
    }

    fn at(covariance: &NamedCovariance, sheet: &SeenSheet, points: Vec<[f64; 2]>) -> Option<Self> {
        let (uncertainty, names_at) = (&sheet.uncertainty, sheet.uncertainty.names_at());
        let mut by_name = DMatrix::zeros(RESPONSES * points.len(), names_at.len());
        for (i, p) in points.iter().enumerate() {
            by_name.rows_mut(RESPONSES * i, RESPONSES).copy_from(uncertainty.at(*p)?.derivative());
        }
        let (felt, kinds) = felt(&points)?;
        let derivative = &felt * by_name;
        let mut out = Self { stereo: *uncertainty.stereo(), points, felt, kinds, rows: vec![], determined: vec![] };
        for row in derivative.row_iter() {
            let mut all = DVector::zeros(covariance.names.len());
            names_at.iter().zip(row.iter()).for_each(|(at, x)| all[*at] = *x);
            out.determined.push(covariance.stands_still(&all));
            let terms = names_at.iter().zip(row.iter()).filter(|(_, x)| **x != 0.0);
            out.rows.push(terms.map(|(at, x)| (covariance.names[*at].clone(), *x)).collect());
        }
        Some(out)
    }

    /// What a function is, in words.
    pub(super) fn name(&self, k: usize) -> String {
        const AXES: [&str; 3] = ["u", "v", "w"];
        match self.kinds[k] {
            DISPARITY => "disparity over the field".into(),
            PLACE => "place of pixels in the sheet".into(),
            SCALE => "in-plane scale over the field".into(),
            GAIN => "out-of-plane gain over the field".into(),
            kind => {
                let [measured, of] = [(kind - DISPLACEMENT) / 3, (kind - DISPLACEMENT) % 3].map(|a| AXES[a]);
                if measured == of {
                    format!("measured {of} over the field")
                } else {
                    format!("leak of {of} into {measured}")
                }
            }
        }
    }

    /// Change of each function from the estimate to another calibration of the same rig.
    pub(super) fn change(&self, n: &Natural) -> Option<DVector<f64>> {
        let cameras = [*n.cameras.first()?, *n.cameras.get(1)?];
        let other = self.stereo.found_anew(cameras, *n.cam_from_rig.get(1)?, n.rig_from_plane.as_ref()?);
        let mut all = DVector::zeros(RESPONSES * self.points.len());
        for (i, p) in self.points.iter().enumerate() {
            all.rows_mut(RESPONSES * i, RESPONSES).copy_from(&other.change(&self.stereo, *p)?);
        }
        Some(&self.felt * all)
    }

    /// Number of functions.
    pub(super) fn count(&self) -> usize {
        self.kinds.len()
    }

    /// The functions of each kind, those of the last point by themselves.
    pub(super) fn of_kinds(&self) -> Vec<[Vec<usize>; 2]> {
        let last = (OF_POINT * (self.points.len() - 1)..OF_POINT * self.points.len()).collect::<Vec<_>>();
        let of = |kind: usize| (0..self.count()).filter(|k| self.kinds[*k] == kind).partition(|k| !last.contains(k));
        (0..KINDS).map(|kind| of(kind).into()).collect()
    }

    /// One number of each kind under its name.
    pub(super) fn by_kind(numbers: &[f64]) -> MappingByLikelihood {
        MappingByLikelihood {
            disparity_px: numbers[DISPARITY],
            in_plane_mm: numbers[PLACE],
            in_plane_scale: numbers[SCALE],
            out_of_plane_gain: numbers[GAIN],
            displacement: numbers[DISPLACEMENT..].chunks(3).map(<[f64]>::to_vec).collect(),
        }
    }

    /// How many times larger the views tell what is felt, by the numbers that the functions are; none where they neither tell nor differ.
    pub(super) fn by_views(&self, numbers: &[Option<Number>], beyond_noise: bool) -> Option<MappingByViews> {
        let factors: Vec<f64> = (0..KINDS).map(|kind| self.factor(kind, numbers).unwrap_or(f64::NAN)).collect();
        (beyond_noise || factors.iter().any(|f| f.is_finite())).then(|| MappingByViews {
            beyond_noise,
            disparity: factors[DISPARITY],
            in_plane: factors[PLACE],
            in_plane_scale: factors[SCALE],
            out_of_plane_gain: factors[GAIN],
            displacement: factors[DISPLACEMENT..].chunks(3).map(<[f64]>::to_vec).collect(),
        })
    }

    fn factor(&self, kind: usize, numbers: &[Option<Number>]) -> Option<f64> {
        let own = self.kinds.iter().zip(numbers).filter(|(k, _)| **k == kind);
        let own: Option<Vec<&Number>> = own.map(|(_, n)| n.as_ref()).collect();
        common_factor(&own?)
    }
}

/// Four points of the field, each half way from its middle to a corner, as far as there are so many.
fn spread_out(field: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let side = |a: usize, f: fn(f64, f64) -> f64| field.iter().map(|p| p[a]).reduce(f).unwrap_or(0.0);
    let [low, high] = [f64::min, f64::max].map(|f| [0, 1].map(|a| side(a, f)));
    let mut out = vec![];
    for part in [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]] {
        let wanted = [0, 1].map(|a| low[a] + part[a] * (high[a] - low[a]));
        let apart = |p: &[f64; 2]| (p[0] - wanted[0]).hypot(p[1] - wanted[1]);
        let nearest = field.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)));
        out.extend(nearest.filter(|p| !out.contains(*p)));
    }
    out
}

/// L, and the kind of each of its rows.
fn felt(points: &[[f64; 2]]) -> Option<(DMatrix<f64>, Vec<usize>)> {
    let places = 4 * points.len();
    let beside = beside_shift_and_turn(points, points.len(), &DMatrix::identity(places, places))?;
    let mut rows = vec![];
    for i in 0..points.len() {
        let mut at_point = |kind: usize, of_point: SVector<f64, RESPONSES>| {
            let mut row = DVector::zeros(RESPONSES * points.len());
            row.rows_mut(RESPONSES * i, RESPONSES).copy_from(&of_point);
            rows.push((kind, row));
        };
        at_point(DISPARITY, unit(0));
        at_point(DISPARITY, unit(1));
        at_point(SCALE, in_plane_scale_row());
        at_point(GAIN, gain_row());
        (0..9).for_each(|k| at_point(DISPLACEMENT + k, unit(RESPONSES - 9 + k)));
    }
    for place in beside.row_iter() {
        let mut row = DVector::zeros(RESPONSES * points.len());
        place.iter().enumerate().for_each(|(j, x)| row[RESPONSES * (j / 4) + PLACES + j % 4] = *x);
        rows.push((PLACE, row));
    }
    let felt = DMatrix::from_fn(rows.len(), RESPONSES * points.len(), |r, c| rows[r].1[c]);
    Some((felt, rows.into_iter().map(|(kind, _)| kind).collect()))
}
