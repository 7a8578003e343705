//! Keys of a rig description, and where each stands in the rig file.

// Keys of spivcal_rig_set_number; lengths and tolerances are as in the rig file.

/// Index: camera. Distance of neighbouring pixels, mm.
pub const SPIVCAL_RIG_CAMERA_PIXEL_PITCH_MM: i32 = 1;
/// Index: camera. Nominal focal length of the lens, mm.
pub const SPIVCAL_RIG_CAMERA_FOCAL_LENGTH_MM: i32 = 2;
/// Index: camera. It looks through a flat window (see SPIVCAL_PARAMETER_WINDOW_DISTANCE_MM) that is parallel to the sheet with this
/// standard deviation, degrees; default 1.
pub const SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG: i32 = 3;
/// Index: camera. From the drawing of the rig, with pixel pitch and focal length a start for image distance and tilts: distance from the lens to
/// the sheet along the lens axis, mm.
pub const SPIVCAL_RIG_CAMERA_DESIGN_OBJECT_DISTANCE_MM: i32 = 4;
/// Index: camera. The same: angle between lens axis and sheet normal along image x, degrees; positive: what is right in the image is nearer.
pub const SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_DEG: i32 = 5;
/// Index: camera. The same along image y; positive: what is low in the image is nearer; default 0.
pub const SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_VERTICAL_DEG: i32 = 6;
/// Index: camera. The drawing is also known to hold: relative standard deviation of the image distance f.
pub const SPIVCAL_RIG_CAMERA_DESIGN_F_SIGMA: i32 = 7;
/// Index: camera. The same: standard deviation of the tilts, degrees.
pub const SPIVCAL_RIG_CAMERA_DESIGN_TILT_SIGMA_DEG: i32 = 8;
/// Two discs: distance of the centres; grid: pitch; plate: pitch on one level, mm. A standard deviation that it has stays.
pub const SPIVCAL_RIG_TARGET_SPACING_MM: i32 = 11;
/// Index: disc (0 or 1, in this order; 0 for grids and plates). Radius, mm.
pub const SPIVCAL_RIG_TARGET_RADIUS_MM: i32 = 12;
/// With SPIVCAL_RIG_TARGET_ADJUST "points": how far a dot may be from its nominal place, mm.
pub const SPIVCAL_RIG_TARGET_POINT_SIGMA_MM: i32 = 13;
/// Grid: columns of dots.
pub const SPIVCAL_RIG_TARGET_COLUMNS: i32 = 14;
/// Grid: rows of dots.
pub const SPIVCAL_RIG_TARGET_ROWS: i32 = 15;
/// Plate: depth of the back level below the front level, mm.
pub const SPIVCAL_RIG_TARGET_STEP_MM: i32 = 16;
/// Standard deviation of SPIVCAL_RIG_TARGET_SPACING_MM, mm; 0: exact (default). The spacing has to be set before.
pub const SPIVCAL_RIG_TARGET_SPACING_SIGMA_MM: i32 = 17;
/// The sheet is where the cameras are focused: tolerance of its tilt, degrees.
pub const SPIVCAL_RIG_FOCUS_TILT_SIGMA_DEG: i32 = 21;
/// The same: relative tolerance of its distance.
pub const SPIVCAL_RIG_FOCUS_DISTANCE_SIGMA: i32 = 22;
/// Index: view. 1: recorded in the laser sheet that is to be measured, 0: not (default).
pub const SPIVCAL_RIG_VIEW_SHEET: i32 = 31;
/// Index: view. Known position along a traverse, mm. A standard deviation that it has stays.
pub const SPIVCAL_RIG_VIEW_PLANE_Z_MM: i32 = 32;
/// Index: view. Standard deviation of that position, mm; 0: as SPIVCAL_SCALE_TRAVERSE says, else exact (default). The position has to be set before.
pub const SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM: i32 = 33;
/// Index: view. 1: parallel to the sheet at a position that nobody has read; 0: no longer so.
pub const SPIVCAL_RIG_VIEW_PLANE_Z_UNKNOWN: i32 = 34;
/// Index: 0, 1, 2 for x, y, z, in this order. The origin of the sheet frame is this point of the rig frame, dropped onto the sheet, mm. Default:
/// where the axis of the first camera meets the sheet. Of this and a disc the one that was set last counts.
pub const SPIVCAL_RIG_SHEET_ORIGIN_MM: i32 = 41;
/// The origin of the sheet frame is a disc or mark of the target, dropped onto the sheet: as it stands in this view.
pub const SPIVCAL_RIG_SHEET_ORIGIN_VIEW: i32 = 42;
/// Its column; default 0. Two discs are columns 0 and 1 of row 0.
pub const SPIVCAL_RIG_SHEET_ORIGIN_COLUMN: i32 = 43;
/// Its row; default 0.
pub const SPIVCAL_RIG_SHEET_ORIGIN_ROW: i32 = 44;
/// Its level: 0 front (default), 1 back.
pub const SPIVCAL_RIG_SHEET_ORIGIN_LEVEL: i32 = 45;
/// The x axis of the sheet frame runs along the target's x axis in this view, laid into the sheet. Default: along the rig's x axis.
pub const SPIVCAL_RIG_SHEET_X_AXIS_VIEW: i32 = 46;
/// 1: x and y of the sheet frame turned over; z (and so w) stays towards the first camera. 0: not (default).
pub const SPIVCAL_RIG_SHEET_FLIP_X: i32 = 47;

// Keys of spivcal_rig_set_text.

/// two-discs, bubbles, dot-grid or two-level-plate.
pub const SPIVCAL_RIG_TARGET_KIND: i32 = 51;
/// bright, dark or auto (default).
pub const SPIVCAL_RIG_TARGET_POLARITY: i32 = 52;
/// none, shape (default) or points.
pub const SPIVCAL_RIG_TARGET_ADJUST: i32 = 53;
/// contour (default) or bitangent.
pub const SPIVCAL_RIG_SOLVE_OBSERVATIONS: i32 = 54;
/// none, huber (default) or cauchy.
pub const SPIVCAL_RIG_SOLVE_LOSS: i32 = 55;
/// Distortion terms that are free, separated by spaces: "k1" (default), "k1 k2", "".
pub const SPIVCAL_RIG_SOLVE_ESTIMATE: i32 = 56;
/// Index: camera. Direction of the radial polynomial: ideal-to-distorted (Brown's, default) or distorted-to-ideal (photogrammetry).
pub const SPIVCAL_RIG_CAMERA_RADIAL: i32 = 57;

// Parameters of a camera for spivcal_rig_set_known.

/// Image distance over pixel pitch, px.
pub const SPIVCAL_PARAMETER_F_PX: i32 = 0;
/// Pixel pitch in u over pixel pitch in v.
pub const SPIVCAL_PARAMETER_ASPECT: i32 = 1;
/// Where the lens axis meets the sensor, u, px.
pub const SPIVCAL_PARAMETER_CX_PX: i32 = 2;
/// Where the lens axis meets the sensor, v, px.
pub const SPIVCAL_PARAMETER_CY_PX: i32 = 3;
/// Tilt about the u axis, degrees.
pub const SPIVCAL_PARAMETER_ALPHA_DEG: i32 = 4;
/// Tilt about the v axis, degrees.
pub const SPIVCAL_PARAMETER_BETA_DEG: i32 = 5;
/// Radial distortion, r^2 term.
pub const SPIVCAL_PARAMETER_K1: i32 = 6;
/// Radial distortion, r^4 term.
pub const SPIVCAL_PARAMETER_K2: i32 = 7;
/// Radial distortion, r^6 term.
pub const SPIVCAL_PARAMETER_K3: i32 = 8;
/// Exit over entrance pupil.
pub const SPIVCAL_PARAMETER_PUPIL_RATIO: i32 = 9;
/// The camera looks through a flat window between air and water: distance from the projection centre to the glass along its normal, mm.
/// A camera with any parameter of a window needs this one.
pub const SPIVCAL_PARAMETER_WINDOW_DISTANCE_MM: i32 = 20;
/// Thickness of the glass of that window, mm; 0 where it is not stated.
pub const SPIVCAL_PARAMETER_WINDOW_THICKNESS_MM: i32 = 21;
/// Refractive index before the glass; 1 where it is not stated.
pub const SPIVCAL_PARAMETER_WINDOW_N_AIR: i32 = 22;
/// Refractive index of the glass; 1.5 where it is not stated.
pub const SPIVCAL_PARAMETER_WINDOW_N_GLASS: i32 = 23;
/// Refractive index behind the glass; 1.333 where it is not stated.
pub const SPIVCAL_PARAMETER_WINDOW_N_WATER: i32 = 24;

// Facts for spivcal_rig_set_scale.

/// Distance of the projection centres, mm.
pub const SPIVCAL_SCALE_BASELINE: i32 = 1;
/// Distance of the centres of the two discs in one view, mm.
pub const SPIVCAL_SCALE_SPACING: i32 = 2;
/// Radius of one disc in one view, mm.
pub const SPIVCAL_SCALE_RADIUS: i32 = 3;
/// The views' SPIVCAL_RIG_VIEW_PLANE_Z_MM; its value is not looked at, its sigma is that of each of these positions that has none of its
/// own, mm.
pub const SPIVCAL_SCALE_TRAVERSE: i32 = 4;

/// Where a key stands in the rig file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Place {
    /// `[[camera]]`, by index.
    Camera,
    /// `[camera.window]`, by index of the camera.
    Window,
    /// `[camera.design]`, by index of the camera.
    Design,
    /// `[camera.known]`, by index of the camera.
    Known,
    /// `[target]`.
    Target,
    /// `radii_mm` of `[target]`, by index.
    Radius,
    /// `[focus]`.
    Focus,
    /// `[solve]`.
    Solve,
    /// `[[view]]`, by index.
    View,
    /// `[sheet]`.
    Sheet,
    /// `point_mm` of `origin` of `[sheet]`, by index.
    Point,
    /// `origin` of `[sheet]`, a disc.
    Origin,
    /// `x_axis` of `[sheet]`.
    Axis,
}

impl Place {
    /// The list, where an index says which of its entries, and the tables within it or within the file.
    pub(super) fn way(self) -> (Option<&'static str>, &'static [&'static str]) {
        match self {
            Place::Camera => (Some("camera"), &[]),
            Place::Window => (Some("camera"), &["window"]),
            Place::Design => (Some("camera"), &["design"]),
            Place::Known => (Some("camera"), &["known"]),
            Place::View => (Some("view"), &[]),
            Place::Target | Place::Radius => (None, &["target"]),
            Place::Focus => (None, &["focus"]),
            Place::Solve => (None, &["solve"]),
            Place::Sheet => (None, &["sheet"]),
            Place::Point | Place::Origin => (None, &["sheet", "origin"]),
            Place::Axis => (None, &["sheet", "x_axis"]),
        }
    }

    /// A list that is filled in order, of which an index says which entry.
    pub(super) fn is_listed(self) -> bool {
        matches!(self, Place::Radius | Place::Point)
    }
}

/// How a number is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// Any finite number.
    Real,
    /// A whole number.
    Whole,
    /// 0 or 1, written false or true.
    Truth,
    /// The standard deviation of a number that is there.
    Sigma,
    /// 1: nobody knows it.
    Unknown,
}

/// Numbers: key of the interface, place and key of the rig file, form.
pub(super) const NUMBERS: [(i32, Place, &str, Form); 28] = [
    (SPIVCAL_RIG_CAMERA_PIXEL_PITCH_MM, Place::Camera, "pixel_pitch_mm", Form::Real),
    (SPIVCAL_RIG_CAMERA_FOCAL_LENGTH_MM, Place::Camera, "focal_length_mm", Form::Real),
    (SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, Place::Window, "tilt_sigma_deg", Form::Real),
    (SPIVCAL_RIG_CAMERA_DESIGN_OBJECT_DISTANCE_MM, Place::Design, "object_distance_mm", Form::Real),
    (SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_DEG, Place::Design, "viewing_angle_deg", Form::Real),
    (SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_VERTICAL_DEG, Place::Design, "viewing_angle_vertical_deg", Form::Real),
    (SPIVCAL_RIG_CAMERA_DESIGN_F_SIGMA, Place::Design, "f_sigma", Form::Real),
    (SPIVCAL_RIG_CAMERA_DESIGN_TILT_SIGMA_DEG, Place::Design, "tilt_sigma_deg", Form::Real),
    (SPIVCAL_RIG_TARGET_SPACING_MM, Place::Target, "spacing_mm", Form::Real),
    (SPIVCAL_RIG_TARGET_RADIUS_MM, Place::Radius, "radii_mm", Form::Real),
    (SPIVCAL_RIG_TARGET_POINT_SIGMA_MM, Place::Target, "point_sigma_mm", Form::Real),
    (SPIVCAL_RIG_TARGET_COLUMNS, Place::Target, "columns", Form::Whole),
    (SPIVCAL_RIG_TARGET_ROWS, Place::Target, "rows", Form::Whole),
    (SPIVCAL_RIG_TARGET_STEP_MM, Place::Target, "step_mm", Form::Real),
    (SPIVCAL_RIG_TARGET_SPACING_SIGMA_MM, Place::Target, "spacing_mm", Form::Sigma),
    (SPIVCAL_RIG_FOCUS_TILT_SIGMA_DEG, Place::Focus, "tilt_sigma_deg", Form::Real),
    (SPIVCAL_RIG_FOCUS_DISTANCE_SIGMA, Place::Focus, "distance_sigma", Form::Real),
    (SPIVCAL_RIG_VIEW_SHEET, Place::View, "sheet", Form::Truth),
    (SPIVCAL_RIG_VIEW_PLANE_Z_MM, Place::View, "plane_z_mm", Form::Real),
    (SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM, Place::View, "plane_z_mm", Form::Sigma),
    (SPIVCAL_RIG_VIEW_PLANE_Z_UNKNOWN, Place::View, "plane_z_mm", Form::Unknown),
    (SPIVCAL_RIG_SHEET_ORIGIN_MM, Place::Point, "point_mm", Form::Real),
    (SPIVCAL_RIG_SHEET_ORIGIN_VIEW, Place::Origin, "view", Form::Whole),
    (SPIVCAL_RIG_SHEET_ORIGIN_COLUMN, Place::Origin, "column", Form::Whole),
    (SPIVCAL_RIG_SHEET_ORIGIN_ROW, Place::Origin, "row", Form::Whole),
    (SPIVCAL_RIG_SHEET_ORIGIN_LEVEL, Place::Origin, "level", Form::Whole),
    (SPIVCAL_RIG_SHEET_X_AXIS_VIEW, Place::Axis, "view", Form::Whole),
    (SPIVCAL_RIG_SHEET_FLIP_X, Place::Sheet, "flip_x", Form::Truth),
];

/// Numbers that say no more than what holds without them.
pub(super) const DEFAULTS: [(i32, f64); 7] = [
    (SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, 1.0),
    (SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_VERTICAL_DEG, 0.0),
    (SPIVCAL_RIG_VIEW_SHEET, 0.0),
    (SPIVCAL_RIG_SHEET_ORIGIN_COLUMN, 0.0),
    (SPIVCAL_RIG_SHEET_ORIGIN_ROW, 0.0),
    (SPIVCAL_RIG_SHEET_ORIGIN_LEVEL, 0.0),
    (SPIVCAL_RIG_SHEET_FLIP_X, 0.0),
];

/// Words: key of the interface, place and key of the rig file.
pub(super) const WORDS: [(i32, Place, &str); 7] = [
    (SPIVCAL_RIG_CAMERA_RADIAL, Place::Camera, "radial"),
    (SPIVCAL_RIG_TARGET_KIND, Place::Target, "kind"),
    (SPIVCAL_RIG_TARGET_POLARITY, Place::Target, "polarity"),
    (SPIVCAL_RIG_TARGET_ADJUST, Place::Target, "adjust"),
    (SPIVCAL_RIG_SOLVE_OBSERVATIONS, Place::Solve, "observations"),
    (SPIVCAL_RIG_SOLVE_LOSS, Place::Solve, "loss"),
    (SPIVCAL_RIG_SOLVE_ESTIMATE, Place::Solve, "estimate"),
];

/// Parameters: number of the interface, place and key of the rig file.
pub(super) const PARAMETERS: [(i32, Place, &str); 15] = [
    (SPIVCAL_PARAMETER_F_PX, Place::Known, "f_px"),
    (SPIVCAL_PARAMETER_ASPECT, Place::Known, "aspect"),
    (SPIVCAL_PARAMETER_CX_PX, Place::Known, "cx_px"),
    (SPIVCAL_PARAMETER_CY_PX, Place::Known, "cy_px"),
    (SPIVCAL_PARAMETER_ALPHA_DEG, Place::Known, "alpha_deg"),
    (SPIVCAL_PARAMETER_BETA_DEG, Place::Known, "beta_deg"),
    (SPIVCAL_PARAMETER_K1, Place::Known, "k1"),
    (SPIVCAL_PARAMETER_K2, Place::Known, "k2"),
    (SPIVCAL_PARAMETER_K3, Place::Known, "k3"),
    (SPIVCAL_PARAMETER_PUPIL_RATIO, Place::Known, "pupil_ratio"),
    (SPIVCAL_PARAMETER_WINDOW_DISTANCE_MM, Place::Window, "distance_mm"),
    (SPIVCAL_PARAMETER_WINDOW_THICKNESS_MM, Place::Window, "thickness_mm"),
    (SPIVCAL_PARAMETER_WINDOW_N_AIR, Place::Window, "n_air"),
    (SPIVCAL_PARAMETER_WINDOW_N_GLASS, Place::Window, "n_glass"),
    (SPIVCAL_PARAMETER_WINDOW_N_WATER, Place::Window, "n_water"),
];
