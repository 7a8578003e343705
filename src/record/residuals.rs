//! Residuals of an adjustment, one row per observed point, structure of arrays.

use crate::target::DotId;

/// What was observed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FeatureKind {
    /// One subpixel point of a disc's contour; the residual is normal to the contour.
    Edge,
    /// A point feature of a pair (tangency point, intersection).
    Point,
    /// Centre of a disc.
    DiscCentre,
}

impl FeatureKind {
    /// Word in `residuals.csv`.
    pub fn word(self) -> &'static str {
        match self {
            FeatureKind::Edge => "edge",
            FeatureKind::Point => "point",
            FeatureKind::DiscCentre => "disc-centre",
        }
    }
}

/// One row of a [`ResidualTable`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Residual {
    /// View, as [`crate::record::View::index`].
    pub view: usize,
    /// Camera, position in [`crate::record::Record::cameras`].
    pub camera: usize,
    /// Disc of the target.
    pub disc: DotId,
    /// What was observed.
    pub kind: FeatureKind,
    /// Observed position, px.
    pub u_px: f64,
    /// Observed position, px.
    pub v_px: f64,
    /// Observed less predicted, px.
    pub du_px: f64,
    /// Observed less predicted, px.
    pub dv_px: f64,
    /// Signed distance normal to the contour, px (edges; `NaN` for other kinds).
    pub normal_px: f64,
    /// Standard deviation that the observation was given, px.
    pub sigma_px: f64,
    /// Weight of the robust loss, 0 to 1.
    pub weight: f64,
}

/// All residuals; the vectors have one length.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ResidualTable {
    /// View of each row.
    pub view: Vec<u32>,
    /// Camera of each row, position in [`crate::record::Record::cameras`].
    pub camera: Vec<u32>,
    /// Disc of each row.
    pub disc: Vec<DotId>,
    /// Kind of each row.
    pub kind: Vec<FeatureKind>,
    /// Observed position, px.
    pub u_px: Vec<f64>,
    /// Observed position, px.
    pub v_px: Vec<f64>,
    /// Observed less predicted, px.
    pub du_px: Vec<f64>,
    /// Observed less predicted, px.
    pub dv_px: Vec<f64>,
    /// Signed distance normal to the contour, px.
    pub normal_px: Vec<f64>,
    /// Standard deviation given, px.
    pub sigma_px: Vec<f64>,
    /// Weight of the robust loss, 0 to 1.
    pub weight: Vec<f64>,
    /// 0: not an outlier; otherwise 1 + position in `reasons`.
    outlier: Vec<u16>,
    reasons: Vec<String>,
}

impl ResidualTable {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.view.len()
    }
    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.view.is_empty()
    }
    /// Adds a row; `outlier` is the reason why it was left out, where it was.
    pub fn push(&mut self, row: &Residual, outlier: Option<&str>) {
        self.view.push(u32::try_from(row.view).unwrap_or(u32::MAX));
        self.camera.push(u32::try_from(row.camera).unwrap_or(u32::MAX));
        self.disc.push(row.disc);
        self.kind.push(row.kind);
        self.u_px.push(row.u_px);
        self.v_px.push(row.v_px);
        self.du_px.push(row.du_px);
        self.dv_px.push(row.dv_px);
        self.normal_px.push(row.normal_px);
        self.sigma_px.push(row.sigma_px);
        self.weight.push(row.weight);
        let code = outlier.map_or(0, |reason| self.reason_code(reason));
        self.outlier.push(code);
    }
    fn reason_code(&mut self, reason: &str) -> u16 {
        let at = self.reasons.iter().position(|r| r == reason).unwrap_or_else(|| {
            // Beyond 65534 different reasons the last one stands for all further ones.
            if self.reasons.len() < usize::from(u16::MAX) - 1 {
                self.reasons.push(reason.into());
            }
            self.reasons.len() - 1
        });
        u16::try_from(at + 1).unwrap_or(u16::MAX)
    }
    /// Why row `i` was left out of the adjustment; `None` where it was used.
    pub fn outlier(&self, i: usize) -> Option<&str> {
        let code = usize::from(*self.outlier.get(i)?);
        self.reasons.get(code.checked_sub(1)?).map(String::as_str)
    }
    /// Row `i`, or `None` beyond the end.
    pub fn row(&self, i: usize) -> Option<Residual> {
        (i < self.len()).then(|| Residual {
            view: self.view[i] as usize,
            camera: self.camera[i] as usize,
            disc: self.disc[i],
            kind: self.kind[i],
            u_px: self.u_px[i],
            v_px: self.v_px[i],
            du_px: self.du_px[i],
            dv_px: self.dv_px[i],
            normal_px: self.normal_px[i],
            sigma_px: self.sigma_px[i],
            weight: self.weight[i],
        })
    }
}
