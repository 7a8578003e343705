/* spivcal for LabVIEW: Tools > Import > Shared Library. The same functions as spivcal.h in LabVIEW's type names, one
   declaration per line, nothing to include. Generated with spivcal.h; what the functions do is said there, the constants
   and a recipe are in ffi_examples/labview.md. */

#ifndef SPIVCAL_LABVIEW_H
#define SPIVCAL_LABVIEW_H

typedef float float32;
typedef double float64;
typedef int int32;
typedef unsigned char uInt8;
typedef unsigned short uInt16;
typedef unsigned int uInt32;
typedef unsigned long long uInt64;

#ifdef __cplusplus
extern "C" {
#endif
int32 spivcal_abi_version(void);
int32 spivcal_version_copy(char *buffer, uInt64 capacity, uInt64 *needed);
int32 spivcal_status_text(int32 status, char *buffer, uInt64 capacity, uInt64 *needed);
int32 spivcal_error_text(uInt64 handle, char *buffer, uInt64 capacity, uInt64 *needed);
int32 spivcal_context_create(int32 threads, uInt64 *context);
int32 spivcal_context_destroy(uInt64 context);
int32 spivcal_image_create_u8(uInt64 context, const uInt8 *data, uInt32 width, uInt32 height, uInt64 stride_bytes, uInt64 *image);
int32 spivcal_image_create_u16(uInt64 context, const uInt16 *data, uInt32 width, uInt32 height, uInt64 stride_bytes, uInt64 *image);
int32 spivcal_image_create_f32(uInt64 context, const float32 *data, uInt32 width, uInt32 height, uInt64 stride_bytes, uInt64 *image);
int32 spivcal_image_load(uInt64 context, const char *path_utf8, uInt64 *image);
int32 spivcal_image_size(uInt64 image, uInt32 *width, uInt32 *height);
int32 spivcal_image_destroy(uInt64 image);
int32 spivcal_detection_create(uInt64 context, uInt64 *detection);
int32 spivcal_detection_set_number(uInt64 detection, int32 key, float64 value);
int32 spivcal_detection_unset(uInt64 detection, int32 key);
int32 spivcal_detection_run(uInt64 detection, uInt64 image);
int32 spivcal_detection_count(uInt64 detection, int32 key, uInt64 *count);
int32 spivcal_detection_array_copy(uInt64 detection, int32 key, uInt64 disc, float64 *buffer, uInt64 capacity, uInt64 *needed);
int32 spivcal_detection_text_copy(uInt64 detection, int32 key, uInt64 index, const char *image_name_utf8, char *buffer, uInt64 capacity, uInt64 *needed);
int32 spivcal_detection_destroy(uInt64 detection);
int32 spivcal_rig_create(uInt64 context, uInt64 *rig);
int32 spivcal_rig_parse(uInt64 context, const char *toml_utf8, const char *images_dir_utf8, uInt64 *rig);
int32 spivcal_rig_load(uInt64 context, const char *path_utf8, const char *images_dir_utf8, uInt64 *rig);
int32 spivcal_rig_add_camera(uInt64 rig, const char *name_utf8, uInt64 *camera);
int32 spivcal_rig_add_view(uInt64 rig, uInt64 *view);
int32 spivcal_rig_add_mark(uInt64 rig, const char *kind_utf8, int32 column, int32 row, int32 level);
int32 spivcal_rig_set_number(uInt64 rig, int32 key, uInt64 index, float64 value);
int32 spivcal_rig_set_text(uInt64 rig, int32 key, uInt64 index, const char *text_utf8);
int32 spivcal_rig_set_known(uInt64 rig, uInt64 camera, int32 parameter, float64 value, float64 sigma);
int32 spivcal_rig_set_scale(uInt64 rig, int32 fact, uInt64 view, uInt64 disc, float64 value_mm, float64 sigma_mm);
int32 spivcal_rig_set_image(uInt64 rig, uInt64 view, uInt64 camera, uInt64 image);
int32 spivcal_rig_set_image_file(uInt64 rig, uInt64 view, uInt64 camera, const char *path_utf8);
int32 spivcal_rig_check(uInt64 rig);
int32 spivcal_rig_text_copy(uInt64 rig, char *buffer, uInt64 capacity, uInt64 *needed);
int32 spivcal_rig_destroy(uInt64 rig);
int32 spivcal_rig_unset(uInt64 rig, int32 key, uInt64 index);
int32 spivcal_rig_unset_known(uInt64 rig, uInt64 camera, int32 parameter);
int32 spivcal_rig_unset_scale(uInt64 rig);
int32 spivcal_rig_unset_image(uInt64 rig, uInt64 view, uInt64 camera);
int32 spivcal_rig_remove_view(uInt64 rig, uInt64 view);
int32 spivcal_rig_remove_marks(uInt64 rig);
int32 spivcal_calibration_run(uInt64 rig, uInt64 *calibration);
int32 spivcal_calibration_run_sheet(uInt64 rig, uInt64 cameras, uInt64 *calibration);
int32 spivcal_job_start(uInt64 rig, uInt64 *job);
int32 spivcal_job_start_sheet(uInt64 rig, uInt64 cameras, uInt64 *job);
int32 spivcal_job_poll(uInt64 job, int32 *state, uInt64 *images_done, uInt64 *images, uInt64 *iteration, float64 *decrement);
int32 spivcal_job_wait(uInt64 job, int32 timeout_ms, int32 *state);
int32 spivcal_job_cancel(uInt64 job);
int32 spivcal_job_result(uInt64 job, uInt64 *calibration);
int32 spivcal_job_destroy(uInt64 job);
int32 spivcal_calibration_load(uInt64 context, const char *path_utf8, uInt64 *calibration);
int32 spivcal_calibration_parse(uInt64 context, const char *json_utf8, uInt64 *calibration);
int32 spivcal_calibration_save(uInt64 calibration, const char *path_utf8);
int32 spivcal_calibration_count(uInt64 calibration, int32 key, uInt64 *count);
int32 spivcal_calibration_number(uInt64 calibration, int32 key, uInt64 index, float64 *value, float64 *sigma);
int32 spivcal_calibration_array_copy(uInt64 calibration, int32 key, uInt64 index, float64 *buffer, uInt64 capacity, uInt64 *needed);
int32 spivcal_calibration_text_copy(uInt64 calibration, int32 key, uInt64 index, char *buffer, uInt64 capacity, uInt64 *needed);
int32 spivcal_calibration_destroy(uInt64 calibration);
int32 spivcal_calibration_project(uInt64 calibration, uInt64 camera, uInt64 count, const float64 *x_mm, const float64 *y_mm, const float64 *z_mm, float64 *u_px, float64 *v_px, int32 *point_status);
int32 spivcal_calibration_unproject(uInt64 calibration, uInt64 camera, uInt64 count, const float64 *u_px, const float64 *v_px, float64 *dx, float64 *dy, float64 *dz, int32 *point_status);
int32 spivcal_calibration_sight_from_pixel(uInt64 calibration, uInt64 camera, uInt64 count, const float64 *u_px, const float64 *v_px, float64 *x_mm, float64 *y_mm, float64 *z_mm, float64 *dx, float64 *dy, float64 *dz, int32 *point_status);
int32 spivcal_calibration_sheet_from_pixel(uInt64 calibration, uInt64 camera, uInt64 count, const float64 *u_px, const float64 *v_px, float64 *x_mm, float64 *y_mm, int32 *point_status);
int32 spivcal_calibration_pixel_from_sheet(uInt64 calibration, uInt64 camera, uInt64 count, const float64 *x_mm, const float64 *y_mm, float64 *u_px, float64 *v_px, int32 *point_status);
int32 spivcal_calibration_sheet_grid(uInt64 calibration, float64 mm_per_px, float64 *x0_mm, float64 *y0_mm, float64 *side_mm, uInt32 *width, uInt32 *height);
int32 spivcal_calibration_dewarp(uInt64 calibration, uInt64 camera, uInt64 image, int32 kernel, float64 x0_mm, float64 y0_mm, float64 mm_per_px, float64 z_mm, uInt32 width, uInt32 height, float32 *grey, uInt8 *seen);
int32 spivcal_calibration_components(uInt64 calibration, uInt64 count, const float64 *x_mm, const float64 *y_mm, const float64 *dx1_mm, const float64 *dy1_mm, const float64 *dx2_mm, const float64 *dy2_mm, float64 *u_mm, float64 *v_mm, float64 *w_mm, float64 *residual_mm, float64 *sigma_u, float64 *sigma_v, float64 *sigma_w, int32 *point_status);
#ifdef __cplusplus
}
#endif

#endif
