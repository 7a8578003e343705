//! Targets: which discs there are, where they nominally lie, how they are labelled.
//!
//! Target frame: pattern in the plane z = 0 (the front level of a two-level plate), x along columns, y along rows,
//! z towards the viewer of the printed side; lengths in mm. Seen from its front, x to the right, y is up.

/// Label of a disc of a target: integer coordinates on the pattern's lattice.
///
/// * two discs, bubbles: column 0 and 1, row 0, level 0.
/// * dot grid: column and row counted from the origin mark (negative where the grid goes on beyond it), level 0.
/// * two-level plate: column and row in units of half the pitch, since the dots of the two levels are staggered;
///   level 0 is the front level (towards the cameras), 1 the back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DotId {
    /// Along target x.
    pub column: i32,
    /// Along target y.
    pub row: i32,
    /// 0 front, 1 back.
    pub level: u8,
}

/// Whether discs are brighter or darker than what is around them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Polarity {
    /// Find out per image.
    #[default]
    Auto,
    /// Bright discs on a dark ground (bubbles with smoke, white dots).
    Bright,
    /// Dark discs on a bright ground (printed dots).
    Dark,
}

/// Shape of a mark that fixes origin or axes of a pattern.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum MarkKind {
    /// A disc with a hole of the opposite polarity (DICe's "donut").
    Ring,
    /// A disc clearly larger than the others.
    Large,
    /// A filled square.
    Square,
    /// A filled triangle.
    Triangle,
}

/// A mark at a place of the pattern.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Its shape.
    pub kind: MarkKind,
    /// Where it is on the lattice (see [`DotId`]).
    pub at: DotId,
}

/// What the user knows about the target.
#[derive(Debug, Clone, PartialEq)]
pub enum Target {
    /// Two discs on one plate, the same in every view.
    TwoDiscs(Pair),
    /// Two bubbles cut by the sheet: radii and spacing of their own in each view.
    Bubbles(Pair),
    /// A regular grid of equal dots.
    DotGrid(Grid),
    /// A plate with two levels of dots, staggered.
    TwoLevelPlate(Plate),
}

/// Kind of a target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TargetKind {
    TwoDiscs,
    Bubbles,
    DotGrid,
    TwoLevelPlate,
}

impl TargetKind {
    /// All kinds, by the words for them in files.
    pub(crate) const WORDS: [(&'static str, Self); 4] = [
        ("two-discs", Self::TwoDiscs),
        ("bubbles", Self::Bubbles),
        ("dot-grid", Self::DotGrid),
        ("two-level-plate", Self::TwoLevelPlate),
    ];

    pub(crate) fn word(self) -> &'static str {
        Self::WORDS.iter().find(|(_, kind)| *kind == self).map_or("", |(word, _)| word)
    }

    /// Whether there are two discs, not a pattern.
    pub(crate) fn is_pair(self) -> bool {
        matches!(self, Self::TwoDiscs | Self::Bubbles)
    }
}

impl Target {
    pub(crate) fn kind(&self) -> TargetKind {
        match self {
            Self::TwoDiscs(_) => TargetKind::TwoDiscs,
            Self::Bubbles(_) => TargetKind::Bubbles,
            Self::DotGrid(_) => TargetKind::DotGrid,
            Self::TwoLevelPlate(_) => TargetKind::TwoLevelPlate,
        }
    }
}

/// Two discs.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Pair {
    /// Distance of the centres, mm, where it is known.
    pub spacing_mm: Option<f64>,
    /// Radii, mm, where they are known; disc 0 first.
    pub radii_mm: Option<[f64; 2]>,
}

/// A regular grid of dots.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    /// Pitch along both axes, mm, where it is known.
    pub spacing_mm: Option<f64>,
    /// Columns of the full grid, where the user counts them.
    pub columns: Option<usize>,
    /// Rows of the full grid, where the user counts them.
    pub rows: Option<usize>,
    /// Radius of a dot, mm, where it is known.
    pub radius_mm: Option<f64>,
    /// Marks that fix origin and axes; empty where there are none.
    pub marks: Vec<Mark>,
}

/// A plate with two levels.
#[derive(Debug, Clone, PartialEq)]
pub struct Plate {
    /// Pitch of the dots on one level, mm; the other level is shifted by half of it in x and y.
    pub spacing_mm: f64,
    /// Depth of the back level below the front level, mm (positive).
    pub step_mm: f64,
    /// Radius of a dot, mm, where it is known.
    pub radius_mm: Option<f64>,
    /// Square and triangle marks that fix origin and axes.
    pub marks: Vec<Mark>,
}
