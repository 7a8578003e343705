//! Numbers of the keys: each is given once, for ever; a new thing gets a new number.

// Keys of spivcal_detection_set_number.

/// 0: find out per image (default), 1: bright discs, 2: dark discs.
pub const SPIVCAL_DETECT_POLARITY: i32 = 1;
/// Smallest minor semi-axis, px; default 1.5.
pub const SPIVCAL_DETECT_MIN_SEMI_MINOR_PX: i32 = 2;
/// Largest major semi-axis, px; default 2000.
pub const SPIVCAL_DETECT_MAX_SEMI_MAJOR_PX: i32 = 3;
/// Smallest ratio of minor to major semi-axis, above 0 to 1; default 0.2.
pub const SPIVCAL_DETECT_MIN_AXIS_RATIO: i32 = 4;
/// Smallest ratio of the grey step across the edge to the noise; default 3.
pub const SPIVCAL_DETECT_MIN_CONTRAST_TO_NOISE: i32 = 5;
/// Smallest part of the contour that must be seen, above 0 to 1; default 0.7.
pub const SPIVCAL_DETECT_MIN_COVERAGE: i32 = 6;
/// 1: bright discs are known to be full of smoke (bubbles cut by the sheet, up to 24 in an image), so that sigmas hold for weak smoke behind a blur
/// and for fast or slow smoke in large discs; 2: they are known to be printed, without any, so that few of them tell a blur that is no Gaussian's;
/// 0: each disc is asked (default).
pub const SPIVCAL_DETECT_FULL_OF_SMOKE: i32 = 7;

// Keys of spivcal_detection_array_copy.

/// Centres of the ellipses, u, px; one per disc.
pub const SPIVCAL_DISC_U_PX: i32 = 101;
/// Centres of the ellipses, v, px; one per disc.
pub const SPIVCAL_DISC_V_PX: i32 = 102;
/// Major semi-axes, px; one per disc.
pub const SPIVCAL_DISC_SEMI_MAJOR_PX: i32 = 103;
/// Minor semi-axes, px; one per disc.
pub const SPIVCAL_DISC_SEMI_MINOR_PX: i32 = 104;
/// Angles from +u towards +v of the major axes, rad, in (-pi/2, pi/2]; one per disc.
pub const SPIVCAL_DISC_ANGLE_RAD: i32 = 105;
/// Standard deviations of SPIVCAL_DISC_U_PX, px; one per disc.
pub const SPIVCAL_DISC_SIGMA_U_PX: i32 = 111;
/// Standard deviations of SPIVCAL_DISC_V_PX, px; one per disc.
pub const SPIVCAL_DISC_SIGMA_V_PX: i32 = 112;
/// Standard deviations of SPIVCAL_DISC_SEMI_MAJOR_PX, px; one per disc.
pub const SPIVCAL_DISC_SIGMA_SEMI_MAJOR_PX: i32 = 113;
/// Standard deviations of SPIVCAL_DISC_SEMI_MINOR_PX, px; one per disc.
pub const SPIVCAL_DISC_SIGMA_SEMI_MINOR_PX: i32 = 114;
/// Standard deviations of SPIVCAL_DISC_ANGLE_RAD, rad; one per disc.
pub const SPIVCAL_DISC_SIGMA_ANGLE_RAD: i32 = 115;
/// Standard deviations of the blur of the edges, px; one per disc.
pub const SPIVCAL_DISC_BLUR_PX: i32 = 121;
/// Grey steps across the edges, grey levels; one per disc.
pub const SPIVCAL_DISC_CONTRAST: i32 = 122;
/// 1 where the disc is brighter than its surroundings, else 0; one per disc.
pub const SPIVCAL_DISC_IS_BRIGHT: i32 = 123;
/// Covariance of (u, v, semi_major, semi_minor, angle) of one disc in px and rad, 5 x 5 row-major: 25 doubles.
pub const SPIVCAL_DISC_COVARIANCE: i32 = 130;
/// Subpixel edge points of one disc, u, px, corrected for blur; as many as the contour has.
pub const SPIVCAL_CONTOUR_U_PX: i32 = 131;
/// Subpixel edge points of one disc, v, px.
pub const SPIVCAL_CONTOUR_V_PX: i32 = 132;
/// Standard deviations of the edge points normal to the contour, px: of what is each point's own. What is uncertain of blur and light moves all
/// points of a contour together; that is in the covariance of its ellipse, which independent points alone would understate.
pub const SPIVCAL_CONTOUR_SIGMA_PX: i32 = 133;
/// Where candidates were turned down, u, px; one per rejection.
pub const SPIVCAL_REJECTION_U_PX: i32 = 141;
/// Where candidates were turned down, v, px; one per rejection.
pub const SPIVCAL_REJECTION_V_PX: i32 = 142;

// Keys of spivcal_detection_count and spivcal_calibration_count.

/// Discs of a detection.
pub const SPIVCAL_COUNT_DISCS: i32 = 201;
/// Candidates that a detection turned down.
pub const SPIVCAL_COUNT_REJECTIONS: i32 = 202;
/// Cameras of a calibration: 1 or 2; the first is the rig frame.
pub const SPIVCAL_COUNT_CAMERAS: i32 = 211;
/// Views of a calibration, also the unused ones.
pub const SPIVCAL_COUNT_VIEWS: i32 = 212;
/// 1 where the calibration has a laser sheet, else 0.
pub const SPIVCAL_COUNT_SHEETS: i32 = 213;
/// Directions that the images do not determine: as many SPIVCAL_TEXT_UNDETERMINED.
pub const SPIVCAL_COUNT_UNDETERMINED: i32 = 214;
/// Things to look at before the result is used: as many SPIVCAL_TEXT_FLAG.
pub const SPIVCAL_COUNT_FLAGS: i32 = 215;
/// Rows of the covariance matrix: as many SPIVCAL_TEXT_COVARIANCE_NAME.
pub const SPIVCAL_COUNT_COVARIANCE: i32 = 216;
/// Radii of the target.
pub const SPIVCAL_COUNT_TARGET_RADII: i32 = 217;
/// Points of the target that were adjusted one by one.
pub const SPIVCAL_COUNT_TARGET_POINTS: i32 = 218;

// Keys of spivcal_calibration_number with a camera as index.

/// Index: camera. Image distance over pixel pitch, px.
pub const SPIVCAL_CAMERA_F_PX: i32 = 301;
/// Index: camera. Pixel pitch in u over pixel pitch in v, without unit.
pub const SPIVCAL_CAMERA_ASPECT: i32 = 302;
/// Index: camera. Where the lens axis meets the sensor, u, px.
pub const SPIVCAL_CAMERA_CX_PX: i32 = 303;
/// Index: camera. Where the lens axis meets the sensor, v, px.
pub const SPIVCAL_CAMERA_CY_PX: i32 = 304;
/// Index: camera. Tilt of the sensor about its u axis, rad.
pub const SPIVCAL_CAMERA_ALPHA_RAD: i32 = 305;
/// Index: camera. Tilt of the sensor about its v axis, rad.
pub const SPIVCAL_CAMERA_BETA_RAD: i32 = 306;
/// Index: camera. Radial distortion, r^2 term, on the untilted plane at unit distance, without unit. SPIVCAL_CAMERA_RADIAL says
/// which way the polynomial of K1 to K3 goes.
pub const SPIVCAL_CAMERA_K1: i32 = 307;
/// Index: camera. Radial distortion, r^4 term, without unit.
pub const SPIVCAL_CAMERA_K2: i32 = 308;
/// Index: camera. Radial distortion, r^6 term, without unit.
pub const SPIVCAL_CAMERA_K3: i32 = 309;
/// Index: camera. Exit over entrance pupil, without unit; 1 where it is not modelled.
pub const SPIVCAL_CAMERA_PUPIL_RATIO: i32 = 310;
/// Index: camera. Focal length of the untilted pinhole with the same image without distortion, px.
pub const SPIVCAL_CAMERA_EFFECTIVE_F_PX: i32 = 311;
/// Index: camera. Principal point of that pinhole, u, px.
pub const SPIVCAL_CAMERA_EFFECTIVE_CX_PX: i32 = 312;
/// Index: camera. Principal point of that pinhole, v, px.
pub const SPIVCAL_CAMERA_EFFECTIVE_CY_PX: i32 = 313;
/// Index: camera. Root mean square residual of this camera, px. No sigma.
pub const SPIVCAL_CAMERA_RMS_PX: i32 = 321;
/// Index: camera. Width of its images, px. No sigma.
pub const SPIVCAL_CAMERA_WIDTH_PX: i32 = 322;
/// Index: camera. Height of its images, px. No sigma.
pub const SPIVCAL_CAMERA_HEIGHT_PX: i32 = 323;
/// Index: camera. Edge points of this camera. No sigma.
pub const SPIVCAL_CAMERA_OBSERVATIONS: i32 = 324;
/// Index: camera. Pixel pitch as the rig description gives it, mm. No sigma.
pub const SPIVCAL_CAMERA_PIXEL_PITCH_MM: i32 = 325;
/// Index: camera. Direction of the radial polynomial. 0: it takes the ideal place to the distorted one (Brown's, as OpenCV's), 1: the
/// distorted place to the ideal one (photogrammetry). No sigma.
pub const SPIVCAL_CAMERA_RADIAL: i32 = 326;
/// Index: camera. Unit normal of its flat window in the camera frame, away from the camera, x. SPIVCAL_ERROR_NOT_AVAILABLE, as for all
/// keys of the window, where it looks through none. Sigma: see SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD.
pub const SPIVCAL_CAMERA_WINDOW_NORMAL_X: i32 = 331;
/// Index: camera. The same, y. Sigma: see SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD.
pub const SPIVCAL_CAMERA_WINDOW_NORMAL_Y: i32 = 332;
/// Index: camera. The same, z. Sigma: see SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD.
pub const SPIVCAL_CAMERA_WINDOW_NORMAL_Z: i32 = 333;
/// Index: camera. From the projection centre to the glass along the normal, mm.
pub const SPIVCAL_CAMERA_WINDOW_DISTANCE_MM: i32 = 334;
/// Index: camera. Thickness of the glass, mm.
pub const SPIVCAL_CAMERA_WINDOW_THICKNESS_MM: i32 = 335;
/// Index: camera. Refractive index before the glass.
pub const SPIVCAL_CAMERA_WINDOW_N_AIR: i32 = 336;
/// Index: camera. Refractive index of the glass.
pub const SPIVCAL_CAMERA_WINDOW_N_GLASS: i32 = 337;
/// Index: camera. Refractive index behind the glass.
pub const SPIVCAL_CAMERA_WINDOW_N_WATER: i32 = 338;

// Keys of spivcal_calibration_number without index.

/// Distance of the projection centres, mm.
pub const SPIVCAL_BASELINE_MM: i32 = 401;
/// Angle between the lens axes, degrees.
pub const SPIVCAL_AXES_ANGLE_DEG: i32 = 402;
/// Distance of the sheet from the first projection centre along the normal, mm.
pub const SPIVCAL_SHEET_DISTANCE_MM: i32 = 411;
/// Unit normal of the sheet in the rig frame, away from the first camera, x. Sigma: see SPIVCAL_ARRAY_SHEET_NORMAL_SIGMA_RAD.
pub const SPIVCAL_SHEET_NORMAL_X: i32 = 412;
/// Unit normal of the sheet in the rig frame, away from the first camera, y. Sigma: see SPIVCAL_ARRAY_SHEET_NORMAL_SIGMA_RAD.
pub const SPIVCAL_SHEET_NORMAL_Y: i32 = 413;
/// Unit normal of the sheet in the rig frame, away from the first camera, z. Sigma: see SPIVCAL_ARRAY_SHEET_NORMAL_SIGMA_RAD.
pub const SPIVCAL_SHEET_NORMAL_Z: i32 = 414;
/// a of the plane a x + b y + c z = 1 in the rig frame, per mm.
pub const SPIVCAL_SHEET_A_PER_MM: i32 = 415;
/// b of the plane a x + b y + c z = 1 in the rig frame, per mm.
pub const SPIVCAL_SHEET_B_PER_MM: i32 = 416;
/// c of the plane a x + b y + c z = 1 in the rig frame, per mm.
pub const SPIVCAL_SHEET_C_PER_MM: i32 = 417;
/// Angle 1 of rig_from_sheet = Rx(angle 1) Ry(angle 2) Rz(angle 3) up to the half turn about x, degrees.
pub const SPIVCAL_SHEET_ANGLE1_DEG: i32 = 418;
/// Angle 2 of rig_from_sheet = Rx(angle 1) Ry(angle 2) Rz(angle 3) up to the half turn about x, degrees.
pub const SPIVCAL_SHEET_ANGLE2_DEG: i32 = 419;
/// Angle 3 of rig_from_sheet = Rx(angle 1) Ry(angle 2) Rz(angle 3) up to the half turn about x, degrees.
pub const SPIVCAL_SHEET_ANGLE3_DEG: i32 = 420;
/// Angle between the sheet and the line from the first projection centre to the second, degrees, positive where the line runs towards the sheet.
pub const SPIVCAL_SHEET_ANGLE_TO_BASELINE_DEG: i32 = 421;
/// Root mean square disparity of the sheet's views, px. No sigma.
pub const SPIVCAL_SHEET_DISPARITY_RMS_PX: i32 = 422;
/// Distance of the centres of a pair, or pitch of a grid, mm. Bubbles, whose spacing changes from view to view, have none.
pub const SPIVCAL_TARGET_SPACING_MM: i32 = 431;
/// Distance of the two levels of a plate, mm.
pub const SPIVCAL_TARGET_STEP_MM: i32 = 432;
/// Root mean square shift of the points from the nominal target, mm. No sigma.
pub const SPIVCAL_TARGET_SHIFT_RMS_MM: i32 = 433;
/// Root mean square residual, px. No sigma.
pub const SPIVCAL_FIT_RMS_PX: i32 = 441;
/// Weighted sum of squares. No sigma.
pub const SPIVCAL_FIT_CHI2: i32 = 442;
/// Observations and priors less unknowns. No sigma.
pub const SPIVCAL_FIT_DEGREES_OF_FREEDOM: i32 = 443;
/// Degrees of freedom per observation. No sigma.
pub const SPIVCAL_FIT_REDUNDANCY: i32 = 444;
/// Scalar observations. No sigma.
pub const SPIVCAL_FIT_OBSERVATIONS: i32 = 445;
/// Iterations of the adjustment. No sigma.
pub const SPIVCAL_FIT_ITERATIONS: i32 = 446;
/// Newton decrement where it stopped, in sigmas. No sigma.
pub const SPIVCAL_FIT_NEWTON_DECREMENT: i32 = 447;
/// Directions that nothing determines. No sigma.
pub const SPIVCAL_FIT_NULLITY: i32 = 448;
/// Outliers left out. No sigma.
pub const SPIVCAL_FIT_OUTLIERS: i32 = 449;
/// 1 where the adjustment reached its minimum, else 0. No sigma.
pub const SPIVCAL_FIT_CONVERGED: i32 = 450;
/// Factor by which all sigmas were enlarged because residuals exceed the noise. No sigma.
pub const SPIVCAL_FIT_SIGMA_SCALE: i32 = 451;
/// 0: good, 1: look at the flags, 2: do not use; also of a calibration that was loaded. Above 0 spivcal_calibration_run gives
/// SPIVCAL_WARNING_FLAGGED. No sigma.
pub const SPIVCAL_FIT_VERDICT: i32 = 452;

// Keys of spivcal_calibration_number with a radius of the target as index.

/// Index: radius, below SPIVCAL_COUNT_TARGET_RADII: of two discs 0 or 1, of a grid or plate 0. Radius of a disc of the target, mm.
pub const SPIVCAL_TARGET_RADIUS_MM: i32 = 461;

// Keys of spivcal_calibration_number with a view as index.

/// Index: view. 1 where the view was recorded in the laser sheet, else 0. No sigma.
pub const SPIVCAL_VIEW_IN_SHEET: i32 = 471;
/// Index: view. 1 where the view took part, else 0. No sigma.
pub const SPIVCAL_VIEW_USED: i32 = 472;
/// Index: view. Distance of the two bubbles of this view, mm (bubbles only).
pub const SPIVCAL_VIEW_SPACING_MM: i32 = 473;
/// Index: view. Radius of the first bubble of this view, mm (bubbles only).
pub const SPIVCAL_VIEW_RADIUS0_MM: i32 = 474;
/// Index: view. Radius of the second bubble of this view, mm (bubbles only).
pub const SPIVCAL_VIEW_RADIUS1_MM: i32 = 475;

// Keys of spivcal_calibration_array_copy.

/// Index: camera. 4 x 4 row-major, p_in_cam = M p_in_rig in homogeneous coordinates, mm: 16 doubles.
pub const SPIVCAL_ARRAY_CAM_FROM_RIG: i32 = 501;
/// Index: camera. Sigmas of a step R' = exp(dw) R, t' = exp(dw) t + dv: dw (rad) x, y, z, dv (mm) x, y, z: 6 doubles.
pub const SPIVCAL_ARRAY_CAM_FROM_RIG_SIGMA: i32 = 502;
/// Index: camera. Sigmas of the normal of its window about the x, y and z axes of the camera frame, rad: 3 doubles.
pub const SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD: i32 = 503;
/// Pose of the sheet frame, as SPIVCAL_ARRAY_CAM_FROM_RIG: 16 doubles.
pub const SPIVCAL_ARRAY_RIG_FROM_SHEET: i32 = 511;
/// Sigmas of the sheet's normal about the sheet's x and y axes, rad: 2 doubles.
pub const SPIVCAL_ARRAY_SHEET_NORMAL_SIGMA_RAD: i32 = 512;
/// Index: view. Pose of the target, as SPIVCAL_ARRAY_CAM_FROM_RIG: 16 doubles.
pub const SPIVCAL_ARRAY_RIG_FROM_TARGET: i32 = 521;
/// Index: view. As SPIVCAL_ARRAY_CAM_FROM_RIG_SIGMA: 6 doubles.
pub const SPIVCAL_ARRAY_RIG_FROM_TARGET_SIGMA: i32 = 522;
/// Index: view. Root mean square residual of each camera, px, NaN where a camera does not see it: SPIVCAL_COUNT_CAMERAS doubles.
pub const SPIVCAL_ARRAY_VIEW_RMS_PX: i32 = 523;
/// Covariance of all estimated numbers but the places of single dots, n x n row-major, n = SPIVCAL_COUNT_COVARIANCE; units: those at the end of the two names;
/// poses: steps as of SPIVCAL_ARRAY_CAM_FROM_RIG_SIGMA, which turn the translation too. NaN in the rows and columns of numbers that nothing determines.
pub const SPIVCAL_ARRAY_COVARIANCE: i32 = 531;
/// Positions of the adjusted points in the target frame, mm: all x, then all y, then all z: 3 n doubles.
pub const SPIVCAL_ARRAY_TARGET_POINT_XYZ_MM: i32 = 541;
/// Their standard deviations, mm: all x, all y, all z: 3 n doubles.
pub const SPIVCAL_ARRAY_TARGET_POINT_SIGMA_MM: i32 = 542;
/// Their labels: all columns, all rows, all levels: 3 n doubles.
pub const SPIVCAL_ARRAY_TARGET_POINT_LABEL: i32 = 543;

// Keys of spivcal_calibration_text_copy and spivcal_detection_text_copy.

/// A calibration: the text of calibration.json. A detection: everything found in the image.
pub const SPIVCAL_TEXT_JSON: i32 = 601;
/// The calibration in plain words.
pub const SPIVCAL_TEXT_REPORT: i32 = 602;
/// All residuals, one row per observation; not available for a calibration that was loaded, or of a sheet found alone.
pub const SPIVCAL_TEXT_RESIDUALS_CSV: i32 = 603;
/// One sentence: how far the calibration is to be trusted.
pub const SPIVCAL_TEXT_HEADLINE: i32 = 604;
/// Why the adjustment stopped.
pub const SPIVCAL_TEXT_TERMINATION: i32 = 605;
/// Index: direction. What the images do not determine.
pub const SPIVCAL_TEXT_UNDETERMINED: i32 = 606;
/// Index: flag. What to look at before the result is used.
pub const SPIVCAL_TEXT_FLAG: i32 = 607;
/// Index: camera.
pub const SPIVCAL_TEXT_CAMERA_NAME: i32 = 608;
/// Index: row of the covariance; such as "left.f_px", "sheet.rig_from_sheet.rx_rad", "view0.rig_from_target.tx_mm".
pub const SPIVCAL_TEXT_COVARIANCE_NAME: i32 = 609;
/// two-discs, bubbles, dot-grid or two-level-plate.
pub const SPIVCAL_TEXT_TARGET_KIND: i32 = 610;
/// Index: view. Empty where it was used.
pub const SPIVCAL_TEXT_VIEW_WHY_UNUSED: i32 = 611;
/// Index: rejection. Why a detection turned a candidate down.
pub const SPIVCAL_TEXT_REJECTION: i32 = 621;

// States of a job (spivcal_job_poll, spivcal_job_wait).

/// It runs.
pub const SPIVCAL_JOB_RUNNING: i32 = 0;
/// It has a result, perhaps with flags.
pub const SPIVCAL_JOB_DONE: i32 = 1;
/// It failed; spivcal_job_result returns why.
pub const SPIVCAL_JOB_FAILED: i32 = 2;
/// It was stopped.
pub const SPIVCAL_JOB_CANCELLED: i32 = 3;

// Status of a point (mapping functions).

/// It has a result.
pub const SPIVCAL_POINT_OK: i32 = 0;
/// The point is not in front of the camera.
pub const SPIVCAL_POINT_BEHIND_CAMERA: i32 = 1;
/// The ray does not meet the tilted sensor.
pub const SPIVCAL_POINT_OFF_SENSOR: i32 = 2;
/// Beyond the radius where the distortion polynomial stops growing.
pub const SPIVCAL_POINT_BEYOND_DISTORTION: i32 = 3;
/// A coordinate is NaN or infinite.
pub const SPIVCAL_POINT_NOT_FINITE: i32 = 4;
/// The pixel's ray does not meet the sheet in front of the camera.
pub const SPIVCAL_POINT_OFF_SHEET: i32 = 5;
/// The camera looks through a window, and the point does not lie beyond it.
pub const SPIVCAL_POINT_BEFORE_WINDOW: i32 = 6;
/// Both cameras look along one line there: nothing tells the component across the sheet.
pub const SPIVCAL_POINT_ONE_LINE: i32 = 7;

// How grey levels between pixels are found (spivcal_calibration_dewarp).

/// The nearest sample.
pub const SPIVCAL_KERNEL_NEAREST: i32 = 0;
/// Bilinear.
pub const SPIVCAL_KERNEL_LINEAR: i32 = 1;
/// Cubic of four samples along each axis.
pub const SPIVCAL_KERNEL_CUBIC: i32 = 2;
/// Lanczos of eight samples along each axis.
pub const SPIVCAL_KERNEL_LANCZOS: i32 = 3;
/// Quintic B-spline: the most accurate, and what to take for correlation.
pub const SPIVCAL_KERNEL_BSPLINE: i32 = 4;
