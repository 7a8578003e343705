/* spivcal - stereo PIV calibration directly in the laser sheet. The stable C interface.

   Generated from src/ffi; SPIVCAL_WRITE_HEADERS=1 cargo test --test c_header writes it anew.

   STORY
     spivcal_context_create -> spivcal_rig_load (or spivcal_rig_create and setters, images from memory)
     -> spivcal_calibration_run (or spivcal_job_start, spivcal_job_poll, spivcal_job_result)
     -> spivcal_calibration_number, ..._array_copy, ..._text_copy, ..._save
     -> spivcal_calibration_sheet_from_pixel and its companions
     -> spivcal_calibration_sheet_grid, ..._dewarp (both exposures of both cameras; displacements by your own correlation), ..._components
     -> spivcal_context_destroy.

   HANDLES  Objects are named by numbers, not by pointers. 0 names none. A handle that was destroyed, is of another type, or never was
     one gives an error code, never a crash. Handles stay below 2^52. Every object belongs to the context it was made in and ends with
     it. An object that is destroyed while another thread uses it ends when that call returns; a context waits for such calls (by their
     first argument: an object of another context may be a further argument, and lives until the call returns).

   STATUS  Every function but spivcal_abi_version returns one: 0 done, negative: error, positive: done with a warning.
     After an error spivcal_error_text(handle) says why, with numbers and what to do next; handle is the FIRST argument of the call
     that failed. On an error no output is written, except the number of elements needed where a buffer is too small.
     Every function may give SPIVCAL_ERROR_HANDLE, _HANDLE_TYPE, _POISONED, _PANIC and _INTERNAL; with a pointer _NULL, with a text _UTF8,
     with a number, key or text _ARGUMENT, with an index _INDEX, with a buffer _BUFFER_TOO_SMALL, and where something is made or
     threads are needed _MEMORY. Others are named by their function.

   POINTERS  The caller owns all memory; nothing that the library gives has to be freed. No input is looked at after its call has
     returned. Arrays that are written must not overlap those that are read, nor each other where both results are wanted. Pointers may
     have any alignment. A pointer must not be NULL unless its function says so. Arrays and buffers must have the stated number of
     elements: that is the one thing that the library cannot check. Texts are UTF-8 with a closing zero.

   BUFFERS  (buffer, capacity, needed): capacity and needed count elements (bytes of a text, with its zero). capacity 0 asks for needed
     alone. Too small: SPIVCAL_ERROR_BUFFER_TOO_SMALL, needed is written, buffer is not.

   UNITS AND FRAMES  Lengths mm, angles rad (deg where a name ends in _DEG), image coordinates px; (0, 0) is the centre of the first
     pixel, u right, v down. Rig frame: first camera, x right, y down, z forward along the lens axis. Sheet frame: z = 0 in the sheet,
     z towards the first camera, x right, y up as it sees them. Matrices are row-major, a_from_b maps coordinates of b to those of a.
     Points are structures of arrays of double.

   THREADS
     function                                   may run beside                         blocks
     create, load, parse, destroy, status       anything                               for its own files
     ..._destroy of a context or a job          anything; running jobs are stopped     until their threads and calls have ended
     calls on two different objects             each other                             -
     reading one image, calibration or job      each other                             -
     setters and reads of one rig or detection  each other: they wait for each other   shortly
     spivcal_calibration_run, ..._run_sheet     anything                               until it is done
     spivcal_detection_run, ..._dewarp          anything                               until it is done
     spivcal_job_wait                           anything                               until the job ends or the time is over
     The library keeps no global state but the table of handles. Threads that it starts for a call have ended when the call returns;
     the thread of a job has ended when the job is destroyed: neither may be done where threads cannot end, as in DllMain and in the
     destructors of global objects of a DLL. Results do not depend on the number of threads, to the bit. It never
     prints, ends the process, or changes locale, signals, folder or floating-point mode. Floating-point exceptions must be masked in the
     threads that call it, as C leaves them (not Delphi, nor feenableexcept): it computes with NaN and infinity. Numbers in files
     always use '.'.

   KEYS  Values are chosen by integer keys; a new value gets a new number, old numbers keep their meaning.
     SPIVCAL_DETECT_*     spivcal_detection_set_number, spivcal_detection_unset
     SPIVCAL_DISC_*, SPIVCAL_CONTOUR_*, SPIVCAL_REJECTION_*          spivcal_detection_array_copy
     SPIVCAL_COUNT_*      spivcal_detection_count, spivcal_calibration_count
     SPIVCAL_CAMERA_*, SPIVCAL_BASELINE_MM, SPIVCAL_AXES_ANGLE_DEG, SPIVCAL_SHEET_*, SPIVCAL_TARGET_*, SPIVCAL_FIT_*, SPIVCAL_VIEW_*
                          spivcal_calibration_number
     SPIVCAL_ARRAY_*      spivcal_calibration_array_copy
     SPIVCAL_TEXT_*       spivcal_calibration_text_copy, spivcal_detection_text_copy
     SPIVCAL_JOB_*        states of a job
     SPIVCAL_POINT_*      status of a point
     SPIVCAL_KERNEL_*     spivcal_calibration_dewarp
     SPIVCAL_RIG_*        spivcal_rig_set_number, spivcal_rig_set_text, spivcal_rig_unset
     SPIVCAL_PARAMETER_*  spivcal_rig_set_known, spivcal_rig_unset_known
     SPIVCAL_SCALE_*      spivcal_rig_set_scale */

#ifndef SPIVCAL_H
#define SPIVCAL_H

#include <stdint.h>

/**
 * Version of this interface. It grows only when something that a program uses changes its meaning; further functions and keys
 * leave it as it is.
 */
#define SPIVCAL_ABI_VERSION 1

/**
 * Done.
 */
#define SPIVCAL_OK 0

/**
 * Done, but something must be looked at before the result is used: see SPIVCAL_TEXT_HEADLINE, SPIVCAL_TEXT_FLAG,
 * SPIVCAL_TEXT_UNDETERMINED.
 */
#define SPIVCAL_WARNING_FLAGGED 1

/**
 * Done, but some points have no meaning: their results are NaN, their point status says why.
 */
#define SPIVCAL_WARNING_POINTS 2

/**
 * The time is over and the job still runs.
 */
#define SPIVCAL_WARNING_RUNNING 3

/**
 * The handle is 0, was destroyed, or never was one.
 */
#define SPIVCAL_ERROR_HANDLE -1

/**
 * The handle names an object of another type.
 */
#define SPIVCAL_ERROR_HANDLE_TYPE -2

/**
 * A pointer is NULL that must not be.
 */
#define SPIVCAL_ERROR_NULL -3

/**
 * A number or key is none of those allowed.
 */
#define SPIVCAL_ERROR_ARGUMENT -4

/**
 * An index counts beyond what there is.
 */
#define SPIVCAL_ERROR_INDEX -5

/**
 * The buffer is too small; the number of elements needed was written, nothing else.
 */
#define SPIVCAL_ERROR_BUFFER_TOO_SMALL -6

/**
 * A text is not UTF-8.
 */
#define SPIVCAL_ERROR_UTF8 -7

/**
 * There is not enough memory, or the system starts no further thread.
 */
#define SPIVCAL_ERROR_MEMORY -8

/**
 * The object has no such part, for example a calibration without a sheet.
 */
#define SPIVCAL_ERROR_NOT_AVAILABLE -9

/**
 * The job has not ended yet.
 */
#define SPIVCAL_ERROR_RUNNING -10

/**
 * The work was stopped by spivcal_job_cancel.
 */
#define SPIVCAL_ERROR_CANCELLED -11

/**
 * An earlier call on this object ended in SPIVCAL_ERROR_PANIC; it can only be destroyed and asked for its error text.
 */
#define SPIVCAL_ERROR_POISONED -12

/**
 * A defect of the library. A rig or a detection is poisoned, all other objects are as they were. A context, an image and a calibration, which
 * never change, are not: what was to be made was not made, and the call may be tried again with other input. Of a job only its result is lost.
 */
#define SPIVCAL_ERROR_PANIC -13

/**
 * A file, a key or a number of the job is wrong: it is the caller's turn.
 */
#define SPIVCAL_ERROR_INVALID_INPUT -20

/**
 * The images are too few or degenerate: it is the experimenter's turn.
 */
#define SPIVCAL_ERROR_INSUFFICIENT -21

/**
 * There is a result, but it cannot be used.
 */
#define SPIVCAL_ERROR_UNUSABLE -22

/**
 * A defect of the library that it noticed itself.
 */
#define SPIVCAL_ERROR_INTERNAL -23

/**
 * 0: find out per image (default), 1: bright discs, 2: dark discs.
 */
#define SPIVCAL_DETECT_POLARITY 1

/**
 * Smallest minor semi-axis, px; default 1.5.
 */
#define SPIVCAL_DETECT_MIN_SEMI_MINOR_PX 2

/**
 * Largest major semi-axis, px; default 2000.
 */
#define SPIVCAL_DETECT_MAX_SEMI_MAJOR_PX 3

/**
 * Smallest ratio of minor to major semi-axis, above 0 to 1; default 0.2.
 */
#define SPIVCAL_DETECT_MIN_AXIS_RATIO 4

/**
 * Smallest ratio of the grey step across the edge to the noise; default 3.
 */
#define SPIVCAL_DETECT_MIN_CONTRAST_TO_NOISE 5

/**
 * Smallest part of the contour that must be seen, above 0 to 1; default 0.7.
 */
#define SPIVCAL_DETECT_MIN_COVERAGE 6

/**
 * 1: bright discs are known to be full of smoke (bubbles cut by the sheet, up to 24 in an image), so that sigmas hold for weak smoke behind a blur
 * and for fast or slow smoke in large discs; 2: they are known to be printed, without any, so that few of them tell a blur that is no Gaussian's;
 * 0: each disc is asked (default).
 */
#define SPIVCAL_DETECT_FULL_OF_SMOKE 7

/**
 * Centres of the ellipses, u, px; one per disc.
 */
#define SPIVCAL_DISC_U_PX 101

/**
 * Centres of the ellipses, v, px; one per disc.
 */
#define SPIVCAL_DISC_V_PX 102

/**
 * Major semi-axes, px; one per disc.
 */
#define SPIVCAL_DISC_SEMI_MAJOR_PX 103

/**
 * Minor semi-axes, px; one per disc.
 */
#define SPIVCAL_DISC_SEMI_MINOR_PX 104

/**
 * Angles from +u towards +v of the major axes, rad, in (-pi/2, pi/2]; one per disc.
 */
#define SPIVCAL_DISC_ANGLE_RAD 105

/**
 * Standard deviations of SPIVCAL_DISC_U_PX, px; one per disc.
 */
#define SPIVCAL_DISC_SIGMA_U_PX 111

/**
 * Standard deviations of SPIVCAL_DISC_V_PX, px; one per disc.
 */
#define SPIVCAL_DISC_SIGMA_V_PX 112

/**
 * Standard deviations of SPIVCAL_DISC_SEMI_MAJOR_PX, px; one per disc.
 */
#define SPIVCAL_DISC_SIGMA_SEMI_MAJOR_PX 113

/**
 * Standard deviations of SPIVCAL_DISC_SEMI_MINOR_PX, px; one per disc.
 */
#define SPIVCAL_DISC_SIGMA_SEMI_MINOR_PX 114

/**
 * Standard deviations of SPIVCAL_DISC_ANGLE_RAD, rad; one per disc.
 */
#define SPIVCAL_DISC_SIGMA_ANGLE_RAD 115

/**
 * Standard deviations of the blur of the edges, px; one per disc.
 */
#define SPIVCAL_DISC_BLUR_PX 121

/**
 * Grey steps across the edges, grey levels; one per disc.
 */
#define SPIVCAL_DISC_CONTRAST 122

/**
 * 1 where the disc is brighter than its surroundings, else 0; one per disc.
 */
#define SPIVCAL_DISC_IS_BRIGHT 123

/**
 * Covariance of (u, v, semi_major, semi_minor, angle) of one disc in px and rad, 5 x 5 row-major: 25 doubles.
 */
#define SPIVCAL_DISC_COVARIANCE 130

/**
 * Subpixel edge points of one disc, u, px, corrected for blur; as many as the contour has.
 */
#define SPIVCAL_CONTOUR_U_PX 131

/**
 * Subpixel edge points of one disc, v, px.
 */
#define SPIVCAL_CONTOUR_V_PX 132

/**
 * Standard deviations of the edge points normal to the contour, px: of what is each point's own. What is uncertain of blur and light moves all
 * points of a contour together; that is in the covariance of its ellipse, which independent points alone would understate.
 */
#define SPIVCAL_CONTOUR_SIGMA_PX 133

/**
 * Where candidates were turned down, u, px; one per rejection.
 */
#define SPIVCAL_REJECTION_U_PX 141

/**
 * Where candidates were turned down, v, px; one per rejection.
 */
#define SPIVCAL_REJECTION_V_PX 142

/**
 * Discs of a detection.
 */
#define SPIVCAL_COUNT_DISCS 201

/**
 * Candidates that a detection turned down.
 */
#define SPIVCAL_COUNT_REJECTIONS 202

/**
 * Cameras of a calibration: 1 or 2; the first is the rig frame.
 */
#define SPIVCAL_COUNT_CAMERAS 211

/**
 * Views of a calibration, also the unused ones.
 */
#define SPIVCAL_COUNT_VIEWS 212

/**
 * 1 where the calibration has a laser sheet, else 0.
 */
#define SPIVCAL_COUNT_SHEETS 213

/**
 * Directions that the images do not determine: as many SPIVCAL_TEXT_UNDETERMINED.
 */
#define SPIVCAL_COUNT_UNDETERMINED 214

/**
 * Things to look at before the result is used: as many SPIVCAL_TEXT_FLAG.
 */
#define SPIVCAL_COUNT_FLAGS 215

/**
 * Rows of the covariance matrix: as many SPIVCAL_TEXT_COVARIANCE_NAME.
 */
#define SPIVCAL_COUNT_COVARIANCE 216

/**
 * Radii of the target.
 */
#define SPIVCAL_COUNT_TARGET_RADII 217

/**
 * Points of the target that were adjusted one by one.
 */
#define SPIVCAL_COUNT_TARGET_POINTS 218

/**
 * Index: camera. Image distance over pixel pitch, px.
 */
#define SPIVCAL_CAMERA_F_PX 301

/**
 * Index: camera. Pixel pitch in u over pixel pitch in v, without unit.
 */
#define SPIVCAL_CAMERA_ASPECT 302

/**
 * Index: camera. Where the lens axis meets the sensor, u, px.
 */
#define SPIVCAL_CAMERA_CX_PX 303

/**
 * Index: camera. Where the lens axis meets the sensor, v, px.
 */
#define SPIVCAL_CAMERA_CY_PX 304

/**
 * Index: camera. Tilt of the sensor about its u axis, rad.
 */
#define SPIVCAL_CAMERA_ALPHA_RAD 305

/**
 * Index: camera. Tilt of the sensor about its v axis, rad.
 */
#define SPIVCAL_CAMERA_BETA_RAD 306

/**
 * Index: camera. Radial distortion, r^2 term, on the untilted plane at unit distance, without unit. SPIVCAL_CAMERA_RADIAL says
 * which way the polynomial of K1 to K3 goes.
 */
#define SPIVCAL_CAMERA_K1 307

/**
 * Index: camera. Radial distortion, r^4 term, without unit.
 */
#define SPIVCAL_CAMERA_K2 308

/**
 * Index: camera. Radial distortion, r^6 term, without unit.
 */
#define SPIVCAL_CAMERA_K3 309

/**
 * Index: camera. Exit over entrance pupil, without unit; 1 where it is not modelled.
 */
#define SPIVCAL_CAMERA_PUPIL_RATIO 310

/**
 * Index: camera. Focal length of the untilted pinhole with the same image without distortion, px.
 */
#define SPIVCAL_CAMERA_EFFECTIVE_F_PX 311

/**
 * Index: camera. Principal point of that pinhole, u, px.
 */
#define SPIVCAL_CAMERA_EFFECTIVE_CX_PX 312

/**
 * Index: camera. Principal point of that pinhole, v, px.
 */
#define SPIVCAL_CAMERA_EFFECTIVE_CY_PX 313

/**
 * Index: camera. Root mean square residual of this camera, px. No sigma.
 */
#define SPIVCAL_CAMERA_RMS_PX 321

/**
 * Index: camera. Width of its images, px. No sigma.
 */
#define SPIVCAL_CAMERA_WIDTH_PX 322

/**
 * Index: camera. Height of its images, px. No sigma.
 */
#define SPIVCAL_CAMERA_HEIGHT_PX 323

/**
 * Index: camera. Edge points of this camera. No sigma.
 */
#define SPIVCAL_CAMERA_OBSERVATIONS 324

/**
 * Index: camera. Pixel pitch as the rig description gives it, mm. No sigma.
 */
#define SPIVCAL_CAMERA_PIXEL_PITCH_MM 325

/**
 * Index: camera. Direction of the radial polynomial. 0: it takes the ideal place to the distorted one (Brown's, as OpenCV's), 1: the
 * distorted place to the ideal one (photogrammetry). No sigma.
 */
#define SPIVCAL_CAMERA_RADIAL 326

/**
 * Index: camera. Unit normal of its flat window in the camera frame, away from the camera, x. SPIVCAL_ERROR_NOT_AVAILABLE, as for all
 * keys of the window, where it looks through none. Sigma: see SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD.
 */
#define SPIVCAL_CAMERA_WINDOW_NORMAL_X 331

/**
 * Index: camera. The same, y. Sigma: see SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD.
 */
#define SPIVCAL_CAMERA_WINDOW_NORMAL_Y 332

/**
 * Index: camera. The same, z. Sigma: see SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD.
 */
#define SPIVCAL_CAMERA_WINDOW_NORMAL_Z 333

/**
 * Index: camera. From the projection centre to the glass along the normal, mm.
 */
#define SPIVCAL_CAMERA_WINDOW_DISTANCE_MM 334

/**
 * Index: camera. Thickness of the glass, mm.
 */
#define SPIVCAL_CAMERA_WINDOW_THICKNESS_MM 335

/**
 * Index: camera. Refractive index before the glass.
 */
#define SPIVCAL_CAMERA_WINDOW_N_AIR 336

/**
 * Index: camera. Refractive index of the glass.
 */
#define SPIVCAL_CAMERA_WINDOW_N_GLASS 337

/**
 * Index: camera. Refractive index behind the glass.
 */
#define SPIVCAL_CAMERA_WINDOW_N_WATER 338

/**
 * Distance of the projection centres, mm.
 */
#define SPIVCAL_BASELINE_MM 401

/**
 * Angle between the lens axes, degrees.
 */
#define SPIVCAL_AXES_ANGLE_DEG 402

/**
 * Distance of the sheet from the first projection centre along the normal, mm.
 */
#define SPIVCAL_SHEET_DISTANCE_MM 411

/**
 * Unit normal of the sheet in the rig frame, away from the first camera, x. Sigma: see SPIVCAL_ARRAY_SHEET_NORMAL_SIGMA_RAD.
 */
#define SPIVCAL_SHEET_NORMAL_X 412

/**
 * Unit normal of the sheet in the rig frame, away from the first camera, y. Sigma: see SPIVCAL_ARRAY_SHEET_NORMAL_SIGMA_RAD.
 */
#define SPIVCAL_SHEET_NORMAL_Y 413

/**
 * Unit normal of the sheet in the rig frame, away from the first camera, z. Sigma: see SPIVCAL_ARRAY_SHEET_NORMAL_SIGMA_RAD.
 */
#define SPIVCAL_SHEET_NORMAL_Z 414

/**
 * a of the plane a x + b y + c z = 1 in the rig frame, per mm.
 */
#define SPIVCAL_SHEET_A_PER_MM 415

/**
 * b of the plane a x + b y + c z = 1 in the rig frame, per mm.
 */
#define SPIVCAL_SHEET_B_PER_MM 416

/**
 * c of the plane a x + b y + c z = 1 in the rig frame, per mm.
 */
#define SPIVCAL_SHEET_C_PER_MM 417

/**
 * Angle 1 of rig_from_sheet = Rx(angle 1) Ry(angle 2) Rz(angle 3) up to the half turn about x, degrees.
 */
#define SPIVCAL_SHEET_ANGLE1_DEG 418

/**
 * Angle 2 of rig_from_sheet = Rx(angle 1) Ry(angle 2) Rz(angle 3) up to the half turn about x, degrees.
 */
#define SPIVCAL_SHEET_ANGLE2_DEG 419

/**
 * Angle 3 of rig_from_sheet = Rx(angle 1) Ry(angle 2) Rz(angle 3) up to the half turn about x, degrees.
 */
#define SPIVCAL_SHEET_ANGLE3_DEG 420

/**
 * Angle between the sheet and the line from the first projection centre to the second, degrees, positive where the line runs towards the sheet.
 */
#define SPIVCAL_SHEET_ANGLE_TO_BASELINE_DEG 421

/**
 * Root mean square disparity of the sheet's views, px. No sigma.
 */
#define SPIVCAL_SHEET_DISPARITY_RMS_PX 422

/**
 * Distance of the centres of a pair, or pitch of a grid, mm. Bubbles, whose spacing changes from view to view, have none.
 */
#define SPIVCAL_TARGET_SPACING_MM 431

/**
 * Distance of the two levels of a plate, mm.
 */
#define SPIVCAL_TARGET_STEP_MM 432

/**
 * Root mean square shift of the points from the nominal target, mm. No sigma.
 */
#define SPIVCAL_TARGET_SHIFT_RMS_MM 433

/**
 * Root mean square residual, px. No sigma.
 */
#define SPIVCAL_FIT_RMS_PX 441

/**
 * Weighted sum of squares. No sigma.
 */
#define SPIVCAL_FIT_CHI2 442

/**
 * Observations and priors less unknowns. No sigma.
 */
#define SPIVCAL_FIT_DEGREES_OF_FREEDOM 443

/**
 * Degrees of freedom per observation. No sigma.
 */
#define SPIVCAL_FIT_REDUNDANCY 444

/**
 * Scalar observations. No sigma.
 */
#define SPIVCAL_FIT_OBSERVATIONS 445

/**
 * Iterations of the adjustment. No sigma.
 */
#define SPIVCAL_FIT_ITERATIONS 446

/**
 * Newton decrement where it stopped, in sigmas. No sigma.
 */
#define SPIVCAL_FIT_NEWTON_DECREMENT 447

/**
 * Directions that nothing determines. No sigma.
 */
#define SPIVCAL_FIT_NULLITY 448

/**
 * Outliers left out. No sigma.
 */
#define SPIVCAL_FIT_OUTLIERS 449

/**
 * 1 where the adjustment reached its minimum, else 0. No sigma.
 */
#define SPIVCAL_FIT_CONVERGED 450

/**
 * Factor by which all sigmas were enlarged because residuals exceed the noise. No sigma.
 */
#define SPIVCAL_FIT_SIGMA_SCALE 451

/**
 * 0: good, 1: look at the flags, 2: do not use; also of a calibration that was loaded. Above 0 spivcal_calibration_run gives
 * SPIVCAL_WARNING_FLAGGED. No sigma.
 */
#define SPIVCAL_FIT_VERDICT 452

/**
 * Index: radius, below SPIVCAL_COUNT_TARGET_RADII: of two discs 0 or 1, of a grid or plate 0. Radius of a disc of the target, mm.
 */
#define SPIVCAL_TARGET_RADIUS_MM 461

/**
 * Index: view. 1 where the view was recorded in the laser sheet, else 0. No sigma.
 */
#define SPIVCAL_VIEW_IN_SHEET 471

/**
 * Index: view. 1 where the view took part, else 0. No sigma.
 */
#define SPIVCAL_VIEW_USED 472

/**
 * Index: view. Distance of the two bubbles of this view, mm (bubbles only).
 */
#define SPIVCAL_VIEW_SPACING_MM 473

/**
 * Index: view. Radius of the first bubble of this view, mm (bubbles only).
 */
#define SPIVCAL_VIEW_RADIUS0_MM 474

/**
 * Index: view. Radius of the second bubble of this view, mm (bubbles only).
 */
#define SPIVCAL_VIEW_RADIUS1_MM 475

/**
 * Index: camera. 4 x 4 row-major, p_in_cam = M p_in_rig in homogeneous coordinates, mm: 16 doubles.
 */
#define SPIVCAL_ARRAY_CAM_FROM_RIG 501

/**
 * Index: camera. Sigmas of a step R' = exp(dw) R, t' = exp(dw) t + dv: dw (rad) x, y, z, dv (mm) x, y, z: 6 doubles.
 */
#define SPIVCAL_ARRAY_CAM_FROM_RIG_SIGMA 502

/**
 * Index: camera. Sigmas of the normal of its window about the x, y and z axes of the camera frame, rad: 3 doubles.
 */
#define SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD 503

/**
 * Pose of the sheet frame, as SPIVCAL_ARRAY_CAM_FROM_RIG: 16 doubles.
 */
#define SPIVCAL_ARRAY_RIG_FROM_SHEET 511

/**
 * Sigmas of the sheet's normal about the sheet's x and y axes, rad: 2 doubles.
 */
#define SPIVCAL_ARRAY_SHEET_NORMAL_SIGMA_RAD 512

/**
 * Index: view. Pose of the target, as SPIVCAL_ARRAY_CAM_FROM_RIG: 16 doubles.
 */
#define SPIVCAL_ARRAY_RIG_FROM_TARGET 521

/**
 * Index: view. As SPIVCAL_ARRAY_CAM_FROM_RIG_SIGMA: 6 doubles.
 */
#define SPIVCAL_ARRAY_RIG_FROM_TARGET_SIGMA 522

/**
 * Index: view. Root mean square residual of each camera, px, NaN where a camera does not see it: SPIVCAL_COUNT_CAMERAS doubles.
 */
#define SPIVCAL_ARRAY_VIEW_RMS_PX 523

/**
 * Covariance of all estimated numbers but the places of single dots, n x n row-major, n = SPIVCAL_COUNT_COVARIANCE; units: those at the end of the two names;
 * poses: steps as of SPIVCAL_ARRAY_CAM_FROM_RIG_SIGMA, which turn the translation too. NaN in the rows and columns of numbers that nothing determines.
 */
#define SPIVCAL_ARRAY_COVARIANCE 531

/**
 * Positions of the adjusted points in the target frame, mm: all x, then all y, then all z: 3 n doubles.
 */
#define SPIVCAL_ARRAY_TARGET_POINT_XYZ_MM 541

/**
 * Their standard deviations, mm: all x, all y, all z: 3 n doubles.
 */
#define SPIVCAL_ARRAY_TARGET_POINT_SIGMA_MM 542

/**
 * Their labels: all columns, all rows, all levels: 3 n doubles.
 */
#define SPIVCAL_ARRAY_TARGET_POINT_LABEL 543

/**
 * A calibration: the text of calibration.json. A detection: everything found in the image.
 */
#define SPIVCAL_TEXT_JSON 601

/**
 * The calibration in plain words.
 */
#define SPIVCAL_TEXT_REPORT 602

/**
 * All residuals, one row per observation; not available for a calibration that was loaded, or of a sheet found alone.
 */
#define SPIVCAL_TEXT_RESIDUALS_CSV 603

/**
 * One sentence: how far the calibration is to be trusted.
 */
#define SPIVCAL_TEXT_HEADLINE 604

/**
 * Why the adjustment stopped.
 */
#define SPIVCAL_TEXT_TERMINATION 605

/**
 * Index: direction. What the images do not determine.
 */
#define SPIVCAL_TEXT_UNDETERMINED 606

/**
 * Index: flag. What to look at before the result is used.
 */
#define SPIVCAL_TEXT_FLAG 607

/**
 * Index: camera.
 */
#define SPIVCAL_TEXT_CAMERA_NAME 608

/**
 * Index: row of the covariance; such as "left.f_px", "sheet.rig_from_sheet.rx_rad", "view0.rig_from_target.tx_mm".
 */
#define SPIVCAL_TEXT_COVARIANCE_NAME 609

/**
 * two-discs, bubbles, dot-grid or two-level-plate.
 */
#define SPIVCAL_TEXT_TARGET_KIND 610

/**
 * Index: view. Empty where it was used.
 */
#define SPIVCAL_TEXT_VIEW_WHY_UNUSED 611

/**
 * Index: rejection. Why a detection turned a candidate down.
 */
#define SPIVCAL_TEXT_REJECTION 621

/**
 * It runs.
 */
#define SPIVCAL_JOB_RUNNING 0

/**
 * It has a result, perhaps with flags.
 */
#define SPIVCAL_JOB_DONE 1

/**
 * It failed; spivcal_job_result returns why.
 */
#define SPIVCAL_JOB_FAILED 2

/**
 * It was stopped.
 */
#define SPIVCAL_JOB_CANCELLED 3

/**
 * It has a result.
 */
#define SPIVCAL_POINT_OK 0

/**
 * The point is not in front of the camera.
 */
#define SPIVCAL_POINT_BEHIND_CAMERA 1

/**
 * The ray does not meet the tilted sensor.
 */
#define SPIVCAL_POINT_OFF_SENSOR 2

/**
 * Beyond the radius where the distortion polynomial stops growing.
 */
#define SPIVCAL_POINT_BEYOND_DISTORTION 3

/**
 * A coordinate is NaN or infinite.
 */
#define SPIVCAL_POINT_NOT_FINITE 4

/**
 * The pixel's ray does not meet the sheet in front of the camera.
 */
#define SPIVCAL_POINT_OFF_SHEET 5

/**
 * The camera looks through a window, and the point does not lie beyond it.
 */
#define SPIVCAL_POINT_BEFORE_WINDOW 6

/**
 * Both cameras look along one line there: nothing tells the component across the sheet.
 */
#define SPIVCAL_POINT_ONE_LINE 7

/**
 * The nearest sample.
 */
#define SPIVCAL_KERNEL_NEAREST 0

/**
 * Bilinear.
 */
#define SPIVCAL_KERNEL_LINEAR 1

/**
 * Cubic of four samples along each axis.
 */
#define SPIVCAL_KERNEL_CUBIC 2

/**
 * Lanczos of eight samples along each axis.
 */
#define SPIVCAL_KERNEL_LANCZOS 3

/**
 * Quintic B-spline: the most accurate, and what to take for correlation.
 */
#define SPIVCAL_KERNEL_BSPLINE 4

/**
 * Index: camera. Distance of neighbouring pixels, mm.
 */
#define SPIVCAL_RIG_CAMERA_PIXEL_PITCH_MM 1

/**
 * Index: camera. Nominal focal length of the lens, mm.
 */
#define SPIVCAL_RIG_CAMERA_FOCAL_LENGTH_MM 2

/**
 * Index: camera. It looks through a flat window (see SPIVCAL_PARAMETER_WINDOW_DISTANCE_MM) that is parallel to the sheet with this
 * standard deviation, degrees; default 1.
 */
#define SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG 3

/**
 * Index: camera. From the drawing of the rig, with pixel pitch and focal length a start for image distance and tilts: distance from the lens to
 * the sheet along the lens axis, mm.
 */
#define SPIVCAL_RIG_CAMERA_DESIGN_OBJECT_DISTANCE_MM 4

/**
 * Index: camera. The same: angle between lens axis and sheet normal along image x, degrees; positive: what is right in the image is nearer.
 */
#define SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_DEG 5

/**
 * Index: camera. The same along image y; positive: what is low in the image is nearer; default 0.
 */
#define SPIVCAL_RIG_CAMERA_DESIGN_VIEWING_ANGLE_VERTICAL_DEG 6

/**
 * Index: camera. The drawing is also known to hold: relative standard deviation of the image distance f.
 */
#define SPIVCAL_RIG_CAMERA_DESIGN_F_SIGMA 7

/**
 * Index: camera. The same: standard deviation of the tilts, degrees.
 */
#define SPIVCAL_RIG_CAMERA_DESIGN_TILT_SIGMA_DEG 8

/**
 * Two discs: distance of the centres; grid: pitch; plate: pitch on one level, mm. A standard deviation that it has stays.
 */
#define SPIVCAL_RIG_TARGET_SPACING_MM 11

/**
 * Index: disc (0 or 1, in this order; 0 for grids and plates). Radius, mm.
 */
#define SPIVCAL_RIG_TARGET_RADIUS_MM 12

/**
 * With SPIVCAL_RIG_TARGET_ADJUST "points": how far a dot may be from its nominal place, mm.
 */
#define SPIVCAL_RIG_TARGET_POINT_SIGMA_MM 13

/**
 * Grid: columns of dots.
 */
#define SPIVCAL_RIG_TARGET_COLUMNS 14

/**
 * Grid: rows of dots.
 */
#define SPIVCAL_RIG_TARGET_ROWS 15

/**
 * Plate: depth of the back level below the front level, mm.
 */
#define SPIVCAL_RIG_TARGET_STEP_MM 16

/**
 * Standard deviation of SPIVCAL_RIG_TARGET_SPACING_MM, mm; 0: exact (default). The spacing has to be set before.
 */
#define SPIVCAL_RIG_TARGET_SPACING_SIGMA_MM 17

/**
 * The sheet is where the cameras are focused: tolerance of its tilt, degrees.
 */
#define SPIVCAL_RIG_FOCUS_TILT_SIGMA_DEG 21

/**
 * The same: relative tolerance of its distance.
 */
#define SPIVCAL_RIG_FOCUS_DISTANCE_SIGMA 22

/**
 * Index: view. 1: recorded in the laser sheet that is to be measured, 0: not (default).
 */
#define SPIVCAL_RIG_VIEW_SHEET 31

/**
 * Index: view. Known position along a traverse, mm. A standard deviation that it has stays.
 */
#define SPIVCAL_RIG_VIEW_PLANE_Z_MM 32

/**
 * Index: view. Standard deviation of that position, mm; 0: as SPIVCAL_SCALE_TRAVERSE says, else exact (default). The position has to be set before.
 */
#define SPIVCAL_RIG_VIEW_PLANE_Z_SIGMA_MM 33

/**
 * Index: view. 1: parallel to the sheet at a position that nobody has read; 0: no longer so.
 */
#define SPIVCAL_RIG_VIEW_PLANE_Z_UNKNOWN 34

/**
 * Index: 0, 1, 2 for x, y, z, in this order. The origin of the sheet frame is this point of the rig frame, dropped onto the sheet, mm. Default:
 * where the axis of the first camera meets the sheet. Of this and a disc the one that was set last counts.
 */
#define SPIVCAL_RIG_SHEET_ORIGIN_MM 41

/**
 * The origin of the sheet frame is a disc or mark of the target, dropped onto the sheet: as it stands in this view.
 */
#define SPIVCAL_RIG_SHEET_ORIGIN_VIEW 42

/**
 * Its column; default 0. Two discs are columns 0 and 1 of row 0.
 */
#define SPIVCAL_RIG_SHEET_ORIGIN_COLUMN 43

/**
 * Its row; default 0.
 */
#define SPIVCAL_RIG_SHEET_ORIGIN_ROW 44

/**
 * Its level: 0 front (default), 1 back.
 */
#define SPIVCAL_RIG_SHEET_ORIGIN_LEVEL 45

/**
 * The x axis of the sheet frame runs along the target's x axis in this view, laid into the sheet. Default: along the rig's x axis.
 */
#define SPIVCAL_RIG_SHEET_X_AXIS_VIEW 46

/**
 * 1: x and y of the sheet frame turned over; z (and so w) stays towards the first camera. 0: not (default).
 */
#define SPIVCAL_RIG_SHEET_FLIP_X 47

/**
 * two-discs, bubbles, dot-grid or two-level-plate.
 */
#define SPIVCAL_RIG_TARGET_KIND 51

/**
 * bright, dark or auto (default).
 */
#define SPIVCAL_RIG_TARGET_POLARITY 52

/**
 * none, shape (default) or points.
 */
#define SPIVCAL_RIG_TARGET_ADJUST 53

/**
 * contour (default) or bitangent.
 */
#define SPIVCAL_RIG_SOLVE_OBSERVATIONS 54

/**
 * none, huber (default) or cauchy.
 */
#define SPIVCAL_RIG_SOLVE_LOSS 55

/**
 * Distortion terms that are free, separated by spaces: "k1" (default), "k1 k2", "".
 */
#define SPIVCAL_RIG_SOLVE_ESTIMATE 56

/**
 * Index: camera. Direction of the radial polynomial: ideal-to-distorted (Brown's, default) or distorted-to-ideal (photogrammetry).
 */
#define SPIVCAL_RIG_CAMERA_RADIAL 57

/**
 * Image distance over pixel pitch, px.
 */
#define SPIVCAL_PARAMETER_F_PX 0

/**
 * Pixel pitch in u over pixel pitch in v.
 */
#define SPIVCAL_PARAMETER_ASPECT 1

/**
 * Where the lens axis meets the sensor, u, px.
 */
#define SPIVCAL_PARAMETER_CX_PX 2

/**
 * Where the lens axis meets the sensor, v, px.
 */
#define SPIVCAL_PARAMETER_CY_PX 3

/**
 * Tilt about the u axis, degrees.
 */
#define SPIVCAL_PARAMETER_ALPHA_DEG 4

/**
 * Tilt about the v axis, degrees.
 */
#define SPIVCAL_PARAMETER_BETA_DEG 5

/**
 * Radial distortion, r^2 term.
 */
#define SPIVCAL_PARAMETER_K1 6

/**
 * Radial distortion, r^4 term.
 */
#define SPIVCAL_PARAMETER_K2 7

/**
 * Radial distortion, r^6 term.
 */
#define SPIVCAL_PARAMETER_K3 8

/**
 * Exit over entrance pupil.
 */
#define SPIVCAL_PARAMETER_PUPIL_RATIO 9

/**
 * The camera looks through a flat window between air and water: distance from the projection centre to the glass along its normal, mm.
 * A camera with any parameter of a window needs this one.
 */
#define SPIVCAL_PARAMETER_WINDOW_DISTANCE_MM 20

/**
 * Thickness of the glass of that window, mm; 0 where it is not stated.
 */
#define SPIVCAL_PARAMETER_WINDOW_THICKNESS_MM 21

/**
 * Refractive index before the glass; 1 where it is not stated.
 */
#define SPIVCAL_PARAMETER_WINDOW_N_AIR 22

/**
 * Refractive index of the glass; 1.5 where it is not stated.
 */
#define SPIVCAL_PARAMETER_WINDOW_N_GLASS 23

/**
 * Refractive index behind the glass; 1.333 where it is not stated.
 */
#define SPIVCAL_PARAMETER_WINDOW_N_WATER 24

/**
 * Distance of the projection centres, mm.
 */
#define SPIVCAL_SCALE_BASELINE 1

/**
 * Distance of the centres of the two discs in one view, mm.
 */
#define SPIVCAL_SCALE_SPACING 2

/**
 * Radius of one disc in one view, mm.
 */
#define SPIVCAL_SCALE_RADIUS 3

/**
 * The views' SPIVCAL_RIG_VIEW_PLANE_Z_MM; its value is not looked at, its sigma is that of each of these positions that has none of its
 * own, mm.
 */
#define SPIVCAL_SCALE_TRAVERSE 4

#ifdef __cplusplus
extern "C" {
#endif

/**
 * Version of the interface that the library offers; compare with SPIVCAL_ABI_VERSION of the header.
 *
 * Returns that number, not a status. Any thread.
 */
int32_t spivcal_abi_version(void);

/**
 * Version of the library, such as "0.1.0".
 *
 * `buffer`: `capacity` bytes, receives the text with its closing zero. `needed`: receives the number of bytes with the zero.
 * `capacity` 0 asks for `needed` alone; `buffer` may then be NULL. Any thread.
 */
int32_t spivcal_version_copy(char *buffer,
                             uint64_t capacity,
                             uint64_t *needed);

/**
 * What a status means, in a few English words; for unknown numbers "unknown status".
 *
 * `buffer`, `capacity`, `needed`: as in spivcal_version_copy. Any thread.
 */
int32_t spivcal_status_text(int32_t status, char *buffer, uint64_t capacity, uint64_t *needed);

/**
 * Why the last failed call with `handle` as its first argument failed: one or more English sentences with numbers and what to do
 * next. Empty where none failed. Works for every type of handle, also for poisoned objects.
 *
 * `buffer`, `capacity`, `needed`: as in spivcal_version_copy.
 * Two threads that use one object at once may see the text of each other's failure.
 */
int32_t spivcal_error_text(uint64_t handle,
                           char *buffer,
                           uint64_t capacity,
                           uint64_t *needed);

/**
 * Makes a context. All other objects are made in one, and end with it.
 *
 * `threads`: threads that each calibration or detection may use, 1 to 1024; 0: as many as the machine has. They are started by the
 * call or job that needs them and have ended when it returns or is destroyed. Results do not depend on their number, to the bit. The context keeps
 * the memory in which images were searched (some 6 bytes per pixel, at most 128 MB for each search at a time) for the next.
 * `context`: receives the handle. Any thread. Where it fails there is no object to hold an error text: SPIVCAL_ERROR_INVALID_INPUT means too many threads or
 * that the system gives none.
 */
int32_t spivcal_context_create(int32_t threads,
                               uint64_t *context);

/**
 * Destroys a context and everything that was made in it; jobs that still run are stopped and waited for.
 *
 * All those handles are stale afterwards. It waits for the calls that are under way in other threads: calibrations stop as jobs do and
 * fail with SPIVCAL_ERROR_HANDLE, the others end.
 * Destroy every context before the library is unloaded.
 */
int32_t spivcal_context_destroy(uint64_t context);

/**
 * Image of 8-bit grey levels from memory; see spivcal_image_create_u16.
 */
int32_t spivcal_image_create_u8(uint64_t context,
                                const uint8_t *data,
                                uint32_t width,
                                uint32_t height,
                                uint64_t stride_bytes,
                                uint64_t *image);

/**
 * Image of 16-bit grey levels from memory (10, 12 and 14 bit cameras deliver them too), in the machine's byte order.
 *
 * `data`: first sample of the first row; rows follow from top to bottom, samples from left to right. Any alignment. Copied: the
 * memory may be used again when the call returns.
 * `width`, `height`: px, at least 1 each.
 * `stride_bytes`: bytes from one row to the next, at least those of a row; larger where rows are padded.
 * `image`: receives the handle.
 */
int32_t spivcal_image_create_u16(uint64_t context,
                                 const uint16_t *data,
                                 uint32_t width,
                                 uint32_t height,
                                 uint64_t stride_bytes,
                                 uint64_t *image);

/**
 * Image of floating-point grey levels from memory, all finite; see spivcal_image_create_u16.
 */
int32_t spivcal_image_create_f32(uint64_t context,
                                 const float *data,
                                 uint32_t width,
                                 uint32_t height,
                                 uint64_t stride_bytes,
                                 uint64_t *image);

/**
 * Image from a file: PNG, TIFF (8, 16 bit, floating point), BMP, PGM, JPEG. Colours become grey; of several pages the first is
 * read, give others by spivcal_image_create_u8 and its like.
 *
 * `path_utf8`: zero-terminated. `image`: receives the handle. SPIVCAL_ERROR_INVALID_INPUT where it cannot be read.
 */
int32_t spivcal_image_load(uint64_t context,
                           const char *path_utf8,
                           uint64_t *image);

/**
 * Size of an image.
 *
 * `width`, `height`: receive it, px.
 */
int32_t spivcal_image_size(uint64_t image, uint32_t *width, uint32_t *height);

/**
 * Destroys an image. Rigs it was given to keep it.
 */
int32_t spivcal_image_destroy(uint64_t image);

/**
 * Makes an empty detection with the options that serve any target.
 *
 * `detection`: receives the handle.
 */
int32_t spivcal_detection_create(uint64_t context, uint64_t *detection);

/**
 * Sets an option of a detection.
 *
 * `key`: one of SPIVCAL_DETECT_*, which say unit and default. `value`: a finite number.
 */
int32_t spivcal_detection_set_number(uint64_t detection, int32_t key, double value);

/**
 * Takes an option of a detection back to its default.
 *
 * `key`: one of SPIVCAL_DETECT_*.
 */
int32_t spivcal_detection_unset(uint64_t detection, int32_t key);

/**
 * Finds the discs of an image. What an earlier run found is replaced.
 *
 * `image`: handle of the image. Blocks until it is done, some milliseconds for the image of a target, many seconds for one of particles, each of which is
 * looked at; SPIVCAL_DETECT_MIN_SEMI_MINOR_PX near the size of the discs spares most of that. SPIVCAL_OK also where no disc was found: see SPIVCAL_COUNT_DISCS.
 */
int32_t spivcal_detection_run(uint64_t detection,
                              uint64_t image);

/**
 * How many of something a detection holds.
 *
 * `key`: SPIVCAL_COUNT_DISCS or SPIVCAL_COUNT_REJECTIONS. `count`: receives the number. SPIVCAL_ERROR_NOT_AVAILABLE before
 * spivcal_detection_run.
 */
int32_t spivcal_detection_count(uint64_t detection,
                                int32_t key,
                                uint64_t *count);

/**
 * Numbers of all discs (SPIVCAL_DISC_*, `disc` is not looked at), or of one disc (SPIVCAL_DISC_COVARIANCE and SPIVCAL_CONTOUR_*).
 *
 * `key`: says what, its length and its unit. `disc`: from 0.
 * `buffer`: `capacity` doubles. `needed`: receives their number. `capacity` 0 asks for `needed` alone. SPIVCAL_ERROR_NOT_AVAILABLE before
 * spivcal_detection_run.
 */
int32_t spivcal_detection_array_copy(uint64_t detection,
                                     int32_t key,
                                     uint64_t disc,
                                     double *buffer,
                                     uint64_t capacity,
                                     uint64_t *needed);

/**
 * Texts of a detection.
 *
 * `key`: SPIVCAL_TEXT_JSON (everything that was found, with contours, features of a pair and rejections) or
 * SPIVCAL_TEXT_REJECTION (why candidate `index` was turned down; 0 with the other key). `image_name_utf8`: named in the JSON, may be NULL.
 * `buffer`, `capacity`, `needed`: bytes, as in spivcal_version_copy. SPIVCAL_ERROR_NOT_AVAILABLE before spivcal_detection_run.
 */
int32_t spivcal_detection_text_copy(uint64_t detection,
                                    int32_t key,
                                    uint64_t index,
                                    const char *image_name_utf8,
                                    char *buffer,
                                    uint64_t capacity,
                                    uint64_t *needed);

/**
 * Destroys a detection.
 */
int32_t spivcal_detection_destroy(uint64_t detection);

/**
 * Makes an empty rig description, to be filled by the functions below.
 *
 * It needs cameras, a target, one length in mm (of the target, or spivcal_rig_set_scale), views and their images. Error texts name lines and keys
 * of the text that spivcal_rig_text_copy gives. What was set can be replaced, and taken back (spivcal_rig_unset).
 * `rig`: receives the handle.
 */
int32_t spivcal_rig_create(uint64_t context,
                           uint64_t *rig);

/**
 * Makes a rig description from the text of a rig file (TOML).
 *
 * `toml_utf8`: zero-terminated. `images_dir_utf8`: folder that relative paths of images begin at; NULL or "": the current one.
 * `rig`: receives the handle. SPIVCAL_ERROR_INVALID_INPUT with line and what was expected in the error text of the context.
 */
int32_t spivcal_rig_parse(uint64_t context,
                          const char *toml_utf8,
                          const char *images_dir_utf8,
                          uint64_t *rig);

/**
 * Makes a rig description from a rig file.
 *
 * `path_utf8`: the file. `images_dir_utf8`: folder that relative paths of images begin at; NULL or "": that of the file.
 * `rig`: receives the handle; SPIVCAL_ERROR_INVALID_INPUT as for spivcal_rig_parse. Images are read when a calibration asks for them.
 */
int32_t spivcal_rig_load(uint64_t context,
                         const char *path_utf8,
                         const char *images_dir_utf8,
                         uint64_t *rig);

/**
 * Adds a camera; the first one is the rig frame, two are the most.
 *
 * `name_utf8`: up to 64 bytes of letters, digits, '-', '_', but not "sheet" or "plane_z_mm"; it names the camera in results, and differs
 * from that of the other by more than capitals. `camera`: receives its index, from 0.
 */
int32_t spivcal_rig_add_camera(uint64_t rig,
                               const char *name_utf8,
                               uint64_t *camera);

/**
 * Adds a view: one position of the target, seen by the cameras at the same moment.
 *
 * `view`: receives its index, from 0.
 */
int32_t spivcal_rig_add_view(uint64_t rig, uint64_t *view);

/**
 * Adds a mark of a grid or plate.
 *
 * `kind_utf8`: ring, large, square or triangle. `column`, `row`: its place on the lattice. `level`: 0 front, 1 back (plates).
 */
int32_t spivcal_rig_add_mark(uint64_t rig,
                             const char *kind_utf8,
                             int32_t column,
                             int32_t row,
                             int32_t level);

/**
 * Sets a number of the description.
 *
 * `key`: one of the number keys SPIVCAL_RIG_*, which say unit and what `index` counts. `index`: 0 where nothing is counted.
 * `value`: a finite number. Whether it makes sense beside all others is asked by spivcal_rig_check and by whatever uses the description:
 * SPIVCAL_ERROR_INVALID_INPUT there, as it would be of a rig file.
 */
int32_t spivcal_rig_set_number(uint64_t rig,
                               int32_t key,
                               uint64_t index,
                               double value);

/**
 * Sets a word of the description.
 *
 * `key`: one of the text keys SPIVCAL_RIG_*, which list the words and say what `index` counts. `index`: 0 where nothing is counted.
 * `text_utf8`: zero-terminated.
 */
int32_t spivcal_rig_set_text(uint64_t rig,
                             int32_t key,
                             uint64_t index,
                             const char *text_utf8);

/**
 * States what is known of a parameter of a camera beforehand.
 *
 * `camera`: from 0. `parameter`: SPIVCAL_PARAMETER_*, with the unit of `value` and `sigma`. `sigma` > 0: a prior; 0: the value is exact.
 */
int32_t spivcal_rig_set_known(uint64_t rig,
                              uint64_t camera,
                              int32_t parameter,
                              double value,
                              double sigma);

/**
 * States the one fact that makes lengths metric, where the target gives none; a later call replaces an earlier one.
 *
 * `fact`: SPIVCAL_SCALE_*. `view`, `disc`: which one, where the fact belongs to one. `value_mm`: the length.
 * `sigma_mm`: its standard deviation, 0 where it is exact.
 */
int32_t spivcal_rig_set_scale(uint64_t rig,
                              int32_t fact,
                              uint64_t view,
                              uint64_t disc,
                              double value_mm,
                              double sigma_mm);

/**
 * Gives the image that a camera saw in a view. It takes the place of a file that the description names.
 *
 * `view`, `camera`: from 0. `image`: handle; the rig keeps the image, the handle may be destroyed. Results and error texts call it
 * "view0_camera1", with its numbers.
 */
int32_t spivcal_rig_set_image(uint64_t rig,
                              uint64_t view,
                              uint64_t camera,
                              uint64_t image);

/**
 * Names the file of the image that a camera saw in a view; it is read when a calibration asks for it.
 *
 * `view`, `camera`: from 0. `path_utf8`: the file, zero-terminated; a relative path begins at the folder of the images,
 * which of spivcal_rig_create is the current one of the process.
 */
int32_t spivcal_rig_set_image_file(uint64_t rig,
                                   uint64_t view,
                                   uint64_t camera,
                                   const char *path_utf8);

/**
 * Checks a description for sense without opening an image: SPIVCAL_OK, or SPIVCAL_ERROR_INVALID_INPUT with an error text.
 */
int32_t spivcal_rig_check(uint64_t rig);

/**
 * The description as the text of a rig file (TOML). An image from memory has the name that results and error texts give it there, and is to be
 * given again to a description that is made from this text.
 *
 * `buffer`, `capacity`, `needed`: bytes, as in spivcal_version_copy.
 */
int32_t spivcal_rig_text_copy(uint64_t rig,
                              char *buffer,
                              uint64_t capacity,
                              uint64_t *needed);

/**
 * Destroys a rig description. Jobs that were started with it go on.
 */
int32_t spivcal_rig_destroy(uint64_t rig);

/**
 * Takes back what spivcal_rig_set_number or spivcal_rig_set_text said, so that the default holds again. What was not said may be unset, too.
 *
 * `key`: one of SPIVCAL_RIG_*. `index`: as there; of the radii of a target and of the point of an origin it takes this entry and those after it.
 * The standard deviation of a number goes with the number, column, row and level with SPIVCAL_RIG_SHEET_ORIGIN_VIEW, and a position along a traverse
 * that nobody has read with SPIVCAL_RIG_VIEW_PLANE_Z_MM, too.
 */
int32_t spivcal_rig_unset(uint64_t rig,
                          int32_t key,
                          uint64_t index);

/**
 * Takes back what spivcal_rig_set_known said of a parameter of a camera.
 *
 * `camera`: from 0. `parameter`: SPIVCAL_PARAMETER_*. A camera without any parameter of a window, and without
 * SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, looks through none.
 */
int32_t spivcal_rig_unset_known(uint64_t rig, uint64_t camera, int32_t parameter);

/**
 * Takes back what spivcal_rig_set_scale said.
 */
int32_t spivcal_rig_unset_scale(uint64_t rig);

/**
 * A camera has no image in a view, whether it came from memory or was named as a file.
 *
 * `view`, `camera`: from 0.
 */
int32_t spivcal_rig_unset_image(uint64_t rig, uint64_t view, uint64_t camera);

/**
 * Removes a view with its images. The views after it are counted one less from then on, also in what names a view, and in the names that images
 * from memory have; calibrations and jobs that there are keep their numbers.
 *
 * `view`: from 0. SPIVCAL_ERROR_ARGUMENT where the scale, or the origin or x axis of the sheet frame, is stated in this view.
 */
int32_t spivcal_rig_remove_view(uint64_t rig,
                                uint64_t view);

/**
 * Removes all marks of a grid or plate.
 */
int32_t spivcal_rig_remove_marks(uint64_t rig);

/**
 * Calibrates cameras, rig, target and sheet; blocks until it is done.
 *
 * `rig`: the description with its images, in which discs are looked for as its target asks (detections are of no use here). `calibration`: receives
 * the handle of the result. Nothing but the end of its context stops it: a host that lets its user cancel takes spivcal_job_start.
 * SPIVCAL_OK; SPIVCAL_WARNING_FLAGGED with a result that must be looked at; SPIVCAL_ERROR_INVALID_INPUT,
 * SPIVCAL_ERROR_INSUFFICIENT or SPIVCAL_ERROR_UNUSABLE without one. The error text belongs to `rig`.
 */
int32_t spivcal_calibration_run(uint64_t rig,
                                uint64_t *calibration);

/**
 * Finds the laser sheet alone, from the views of `rig` recorded in the sheet, with the cameras of a calibration held.
 *
 * `cameras`: handle of that calibration; its sigmas are part of those of the sheet. `calibration`: receives the handle of the
 * result, a calibration with the new sheet. Its views are those of `cameras`, none of them in the sheet any more, and after them those of `rig` that found it,
 * not used for the cameras; fit and verdict are those of the cameras, and there is no table of residuals. Cameras behind windows are refused. Blocks; status and
 * error text as for spivcal_calibration_run.
 */
int32_t spivcal_calibration_run_sheet(uint64_t rig,
                                      uint64_t cameras,
                                      uint64_t *calibration);

/**
 * Starts spivcal_calibration_run in a thread of its own.
 *
 * The description is copied: `rig` may be changed or destroyed meanwhile. `job`: receives the handle. What is wrong with the description
 * itself is found here (SPIVCAL_ERROR_INVALID_INPUT), with the images by spivcal_job_result.
 */
int32_t spivcal_job_start(uint64_t rig,
                          uint64_t *job);

/**
 * Starts spivcal_calibration_run_sheet in a thread of its own; as spivcal_job_start.
 */
int32_t spivcal_job_start_sheet(uint64_t rig, uint64_t cameras, uint64_t *job);

/**
 * How far a job is; returns at once.
 *
 * `state`: receives SPIVCAL_JOB_*. The others may be NULL: `images_done` and `images` count searched images, `iteration` counts the
 * steps of the adjustment that runs (there are several), `decrement` is how far its last step was from the minimum, in sigmas (NaN
 * before the first).
 */
int32_t spivcal_job_poll(uint64_t job,
                         int32_t *state,
                         uint64_t *images_done,
                         uint64_t *images,
                         uint64_t *iteration,
                         double *decrement);

/**
 * Waits until a job has ended, or the time is over.
 *
 * `timeout_ms`: milliseconds; negative: as long as it takes. `state`: receives SPIVCAL_JOB_*.
 * SPIVCAL_OK where it has ended, SPIVCAL_WARNING_RUNNING where it still runs.
 */
int32_t spivcal_job_wait(uint64_t job, int32_t timeout_ms, int32_t *state);

/**
 * Asks a job to stop; returns at once. It ends after the discs that are just fitted, the iteration that just runs, or the part of the
 * diagnosis that is at work; finding the sheet alone is not interrupted once its images are searched.
 */
int32_t spivcal_job_cancel(uint64_t job);

/**
 * The result of a job that has ended.
 *
 * `calibration`: receives a handle, which lives on when the job is destroyed; a further call gives a further handle.
 * Status as for spivcal_calibration_run, the error text is that of the job from this call on; SPIVCAL_ERROR_RUNNING where it has not ended, SPIVCAL_ERROR_CANCELLED where it was stopped.
 */
int32_t spivcal_job_result(uint64_t job,
                           uint64_t *calibration);

/**
 * Destroys a job; where it still runs, it is stopped and waited for.
 */
int32_t spivcal_job_destroy(uint64_t job);

/**
 * Loads a calibration from the file calibration.json that the program or spivcal_calibration_save wrote.
 *
 * `path_utf8`: the file. `calibration`: receives the handle. SPIVCAL_ERROR_INVALID_INPUT where it cannot be read or holds no calibration.
 * SPIVCAL_OK also where the calibration must be looked at before it is used: ask for SPIVCAL_FIT_VERDICT.
 */
int32_t spivcal_calibration_load(uint64_t context,
                                 const char *path_utf8,
                                 uint64_t *calibration);

/**
 * Makes a calibration from the text of a calibration.json.
 *
 * `json_utf8`: zero-terminated. `calibration`: receives the handle. SPIVCAL_ERROR_INVALID_INPUT where it holds no calibration.
 * Otherwise as spivcal_calibration_load.
 */
int32_t spivcal_calibration_parse(uint64_t context,
                                  const char *json_utf8,
                                  uint64_t *calibration);

/**
 * Saves a calibration as calibration.json (schema version 1), which the program reads too, and every number of which is read back
 * to the bit.
 *
 * `path_utf8`: the file; written under a temporary name and renamed, so that a failure leaves the old file. Missing folders are made.
 * SPIVCAL_ERROR_INVALID_INPUT where it cannot be written.
 */
int32_t spivcal_calibration_save(uint64_t calibration,
                                 const char *path_utf8);

/**
 * How many of something a calibration holds.
 *
 * `key`: SPIVCAL_COUNT_*. `count`: receives the number.
 */
int32_t spivcal_calibration_count(uint64_t calibration, int32_t key, uint64_t *count);

/**
 * A number of a calibration with its standard deviation.
 *
 * `key`: SPIVCAL_CAMERA_*, SPIVCAL_BASELINE_MM, SPIVCAL_AXES_ANGLE_DEG, SPIVCAL_SHEET_*, SPIVCAL_TARGET_*, SPIVCAL_FIT_* or
 * SPIVCAL_VIEW_*, which say unit and what `index` counts (0 where nothing). `value`: receives the number.
 * `sigma`: receives the standard deviation: 0 where the number was held, NaN where it is unknown or the number has none. May be NULL.
 * SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no such number.
 */
int32_t spivcal_calibration_number(uint64_t calibration,
                                   int32_t key,
                                   uint64_t index,
                                   double *value,
                                   double *sigma);

/**
 * An array of a calibration.
 *
 * `key`: SPIVCAL_ARRAY_*, which says length, order, unit and what `index` counts (0 where nothing).
 * `buffer`: `capacity` doubles. `needed`: receives their number. `capacity` 0 asks for `needed` alone. SPIVCAL_ERROR_NOT_AVAILABLE where
 * the calibration has no such array.
 */
int32_t spivcal_calibration_array_copy(uint64_t calibration,
                                       int32_t key,
                                       uint64_t index,
                                       double *buffer,
                                       uint64_t capacity,
                                       uint64_t *needed);

/**
 * A text of a calibration.
 *
 * `key`: SPIVCAL_TEXT_*, which says what `index` counts (0 where nothing).
 * `buffer`, `capacity`, `needed`: bytes, as in spivcal_version_copy. SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no such text.
 */
int32_t spivcal_calibration_text_copy(uint64_t calibration,
                                      int32_t key,
                                      uint64_t index,
                                      char *buffer,
                                      uint64_t capacity,
                                      uint64_t *needed);

/**
 * Destroys a calibration.
 */
int32_t spivcal_calibration_destroy(uint64_t calibration);

/**
 * Images of points of the rig frame.
 *
 * `camera`: from 0. `x_mm`, `y_mm`, `z_mm`: `count` doubles each, mm, rig frame (that of the first camera: x right, y down, z forward).
 * `u_px`, `v_px`: receive `count` doubles each; (0, 0) is the centre of the first pixel. NaN where a point has no image.
 * `point_status`: receives `count` SPIVCAL_POINT_*; may be NULL. Arrays that are written must not overlap those that are read
 * (SPIVCAL_ERROR_ARGUMENT). A point has the same
 * result, to the bit, alone and among others: a call with many points is what is quick.
 * SPIVCAL_OK, or SPIVCAL_WARNING_POINTS where at least one point has no image.
 */
int32_t spivcal_calibration_project(uint64_t calibration,
                                    uint64_t camera,
                                    uint64_t count,
                                    const double *x_mm,
                                    const double *y_mm,
                                    const double *z_mm,
                                    double *u_px,
                                    double *v_px,
                                    int32_t *point_status);

/**
 * Rays of pixels.
 *
 * `u_px`, `v_px`: `count` doubles each, px. `dx`, `dy`, `dz`: receive `count` doubles each: unit directions in the rig frame, away from
 * the camera. The rays begin at the projection centre: the translation of the inverse of SPIVCAL_ARRAY_CAM_FROM_RIG. Of a camera
 * behind a window they are the rays in the air, up to the glass: spivcal_calibration_sight_from_pixel says where they go on.
 * NaN, `point_status` and status as in spivcal_calibration_project.
 */
int32_t spivcal_calibration_unproject(uint64_t calibration,
                                      uint64_t camera,
                                      uint64_t count,
                                      const double *u_px,
                                      const double *v_px,
                                      double *dx,
                                      double *dy,
                                      double *dz,
                                      int32_t *point_status);

/**
 * Lines on which pixels see the scene, for every camera: of one behind a window those in the water.
 *
 * `u_px`, `v_px`: `count` doubles each, px. `x_mm`, `y_mm`, `z_mm`: receive `count` doubles each: a point of each line, mm, rig frame: the
 * projection centre, or where the ray leaves the glass. `dx`, `dy`, `dz`: receive `count` doubles each: unit directions in the rig
 * frame, away from the camera. NaN, `point_status` and status as in spivcal_calibration_project.
 */
int32_t spivcal_calibration_sight_from_pixel(uint64_t calibration,
                                             uint64_t camera,
                                             uint64_t count,
                                             const double *u_px,
                                             const double *v_px,
                                             double *x_mm,
                                             double *y_mm,
                                             double *z_mm,
                                             double *dx,
                                             double *dy,
                                             double *dz,
                                             int32_t *point_status);

/**
 * Where the rays of pixels meet the laser sheet.
 *
 * `u_px`, `v_px`: `count` doubles each, px. `x_mm`, `y_mm`: receive `count` doubles each, mm, sheet frame (x right, y up as the first
 * camera sees it; SPIVCAL_ARRAY_RIG_FROM_SHEET is its pose). NaN, `point_status` and status as in spivcal_calibration_project.
 * SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no sheet.
 */
int32_t spivcal_calibration_sheet_from_pixel(uint64_t calibration,
                                             uint64_t camera,
                                             uint64_t count,
                                             const double *u_px,
                                             const double *v_px,
                                             double *x_mm,
                                             double *y_mm,
                                             int32_t *point_status);

/**
 * Images of points of the laser sheet.
 *
 * `x_mm`, `y_mm`: `count` doubles each, mm, sheet frame. `u_px`, `v_px`: receive `count` doubles each, px.
 * NaN, `point_status` and status as in spivcal_calibration_project. SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no sheet.
 */
int32_t spivcal_calibration_pixel_from_sheet(uint64_t calibration,
                                             uint64_t camera,
                                             uint64_t count,
                                             const double *x_mm,
                                             const double *y_mm,
                                             double *u_px,
                                             double *v_px,
                                             int32_t *point_status);

/**
 * Grid of dewarped images: square pixels in the sheet that cover what all cameras see.
 *
 * `mm_per_px`: side of a pixel, mm; 0 takes the finest that any of the cameras has there. `x0_mm`, `y0_mm`: receive the centre of the
 * first (upper left) pixel, mm, sheet frame. `side_mm`: receives the side of a pixel s, mm: pixel (i, j), column and row counted from 0, is
 * centred on (x0 + s i, y0 - s j). `width`, `height`: receive the size, px. SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no
 * sheet, SPIVCAL_ERROR_INSUFFICIENT where the cameras see nothing in common in it, SPIVCAL_ERROR_INVALID_INPUT where the side is no number,
 * negative, or so small that the grid has more than 32768 px along a side.
 */
int32_t spivcal_calibration_sheet_grid(uint64_t calibration,
                                       double mm_per_px,
                                       double *x0_mm,
                                       double *y0_mm,
                                       double *side_mm,
                                       uint32_t *width,
                                       uint32_t *height);

/**
 * An image of a camera as it would look from above the sheet: dewarped.
 *
 * `camera`: from 0. `image`: its handle, of the size that the camera was calibrated with. `kernel`: SPIVCAL_KERNEL_*.
 * `x0_mm`, `y0_mm`, `mm_per_px`, `width`, `height`: the grid, as spivcal_calibration_sheet_grid gives it, or any other; 1 to 32768 px
 * along a side. `z_mm`: plane parallel to the sheet in which the grid lies, mm, positive towards the first camera; 0: the sheet itself.
 * `grey`: receives width x height floats, rows from top to bottom without gaps: grey levels as those of the image, not rounded; 0 where the
 * camera sees nothing. `seen`: receives width x height bytes, 1 where the camera sees the pixel, else 0; may be NULL.
 * Uses the threads of the context; the result does not depend on their number. SPIVCAL_ERROR_INVALID_INPUT where sizes do not fit,
 * SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no sheet.
 */
int32_t spivcal_calibration_dewarp(uint64_t calibration,
                                   uint64_t camera,
                                   uint64_t image,
                                   int32_t kernel,
                                   double x0_mm,
                                   double y0_mm,
                                   double mm_per_px,
                                   double z_mm,
                                   uint32_t width,
                                   uint32_t height,
                                   float *grey,
                                   uint8_t *seen);

/**
 * Three components of displacement from the planar displacements that both cameras show at points of the sheet.
 *
 * `x_mm`, `y_mm`: `count` doubles each, mm, sheet frame: the middles of the paths, as windows that are shifted symmetrically give them.
 * `dx1_mm`, `dy1_mm`, `dx2_mm`, `dy2_mm`: `count` doubles each: displacements in the dewarped images of the first and the second
 * camera along x and y (up) of the sheet frame, mm; of images whose rows run down, dy is minus the displacement along the rows. NaN
 * where a camera has none.
 * `u_mm`, `v_mm`, `w_mm`: receive `count` doubles each, mm: displacement along x, y and z of the sheet frame; w is positive towards
 * the first camera. `residual_mm`: receives `count` doubles: root of the sum of squares of what the four equations leave, one degree of
 * freedom, about the standard deviation of a planar component where all is well.
 * `sigma_u`, `sigma_v`, `sigma_w`: receive `count` doubles each: standard deviations of u, v, w for independent planar components of
 * standard deviation 1; times that of yours they are those of the vector by its noise, without the part of the calibration.
 * `point_status`: as in spivcal_calibration_project. SPIVCAL_ERROR_NOT_AVAILABLE where the calibration has no sheet or one camera.
 */
int32_t spivcal_calibration_components(uint64_t calibration,
                                       uint64_t count,
                                       const double *x_mm,
                                       const double *y_mm,
                                       const double *dx1_mm,
                                       const double *dy1_mm,
                                       const double *dx2_mm,
                                       const double *dy2_mm,
                                       double *u_mm,
                                       double *v_mm,
                                       double *w_mm,
                                       double *residual_mm,
                                       double *sigma_u,
                                       double *sigma_v,
                                       double *sigma_w,
                                       int32_t *point_status);

#ifdef __cplusplus
}
#endif

#endif  /* SPIVCAL_H */
