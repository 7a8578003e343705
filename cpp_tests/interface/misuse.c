/* What a host may do wrong: every function with handles, pointers, sizes, keys and numbers that are none of its own.
   Usage: misuse CALIBRATION.json        (a real one, with a sheet; made by the program) */

#include "spivcal.h"

#include "check.h"
#include "scene.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define CANARY 0x5a
static const uint64_t NONE_BUT[] = {0, 1, 42, ~(uint64_t)0, (uint64_t)1 << 63, (uint64_t)1 << 52, (uint64_t)7 << 48};

/* Every function with `h` as its first handle and everything else in order; `status` must come back, whatever the function. */
static void all_with(uint64_t h, uint64_t other, int32_t wanted, const char *what) {
    uint64_t out = 77, n = 0;
    uint32_t w = 0, hh = 0;
    int32_t state = 77;
    double x[2] = {1, 2}, y[2] = {1, 2}, z[2] = {1, 2}, a[2], b[2], c[2], value = 77, sigma = 77;
    int32_t ps[2];
    char text[10];
    uint8_t data[4] = {0};
    uint16_t data16[4] = {0};
    float data32[4] = {0};
    int before = check_failures;
    CHECK(spivcal_image_create_u8(h, data, 2, 2, 2, &out) == wanted);
    CHECK(spivcal_image_create_u16(h, data16, 2, 2, 4, &out) == wanted);
    CHECK(spivcal_image_create_f32(h, data32, 2, 2, 8, &out) == wanted);
    CHECK(spivcal_image_load(h, "nothing.png", &out) == wanted);
    CHECK(spivcal_image_size(h, &w, &hh) == wanted);
    CHECK(spivcal_detection_create(h, &out) == wanted);
    CHECK(spivcal_detection_set_number(h, SPIVCAL_DETECT_POLARITY, 0) == wanted);
    CHECK(spivcal_detection_run(h, other) == wanted);
    CHECK(spivcal_detection_count(h, SPIVCAL_COUNT_DISCS, &n) == wanted);
    CHECK(spivcal_detection_array_copy(h, SPIVCAL_DISC_U_PX, 0, x, 2, &n) == wanted);
    CHECK(spivcal_detection_text_copy(h, SPIVCAL_TEXT_JSON, 0, NULL, text, 10, &n) == wanted);
    CHECK(spivcal_rig_create(h, &out) == wanted);
    CHECK(spivcal_rig_parse(h, "", "", &out) == wanted);
    CHECK(spivcal_rig_load(h, "nothing.toml", "", &out) == wanted);
    CHECK(spivcal_rig_add_camera(h, "left", &out) == wanted);
    CHECK(spivcal_rig_add_view(h, &out) == wanted);
    CHECK(spivcal_rig_add_mark(h, "ring", 0, 0, 0) == wanted);
    CHECK(spivcal_rig_set_number(h, SPIVCAL_RIG_TARGET_SPACING_MM, 0, 1) == wanted);
    CHECK(spivcal_rig_set_text(h, SPIVCAL_RIG_TARGET_KIND, 0, "bubbles") == wanted);
    CHECK(spivcal_rig_set_known(h, 0, 0, 1, 1) == wanted);
    CHECK(spivcal_rig_set_scale(h, SPIVCAL_SCALE_BASELINE, 0, 0, 1, 0) == wanted);
    CHECK(spivcal_rig_set_image(h, 0, 0, other) == wanted);
    CHECK(spivcal_rig_set_image_file(h, 0, 0, "a") == wanted);
    CHECK(spivcal_rig_unset(h, SPIVCAL_RIG_TARGET_KIND, 0) == wanted);
    CHECK(spivcal_rig_unset_known(h, 0, 0) == wanted);
    CHECK(spivcal_rig_unset_scale(h) == wanted);
    CHECK(spivcal_rig_unset_image(h, 0, 0) == wanted);
    CHECK(spivcal_rig_remove_view(h, 0) == wanted);
    CHECK(spivcal_rig_remove_marks(h) == wanted);
    CHECK(spivcal_rig_check(h) == wanted);
    CHECK(spivcal_rig_text_copy(h, text, 10, &n) == wanted);
    CHECK(spivcal_calibration_run(h, &out) == wanted);
    CHECK(spivcal_calibration_run_sheet(h, other, &out) == wanted);
    CHECK(spivcal_job_start(h, &out) == wanted);
    CHECK(spivcal_job_start_sheet(h, other, &out) == wanted);
    CHECK(spivcal_job_poll(h, &state, NULL, NULL, NULL, NULL) == wanted);
    CHECK(spivcal_job_wait(h, 0, &state) == wanted);
    CHECK(spivcal_job_cancel(h) == wanted);
    CHECK(spivcal_job_result(h, &out) == wanted);
    CHECK(spivcal_calibration_load(h, "nothing.json", &out) == wanted);
    CHECK(spivcal_calibration_parse(h, "{}", &out) == wanted);
    CHECK(spivcal_calibration_save(h, "nowhere/x.json") == wanted);
    CHECK(spivcal_calibration_count(h, SPIVCAL_COUNT_CAMERAS, &n) == wanted);
    CHECK(spivcal_calibration_number(h, SPIVCAL_CAMERA_F_PX, 0, &value, &sigma) == wanted);
    CHECK(spivcal_calibration_array_copy(h, SPIVCAL_ARRAY_COVARIANCE, 0, x, 2, &n) == wanted);
    CHECK(spivcal_calibration_text_copy(h, SPIVCAL_TEXT_JSON, 0, text, 10, &n) == wanted);
    CHECK(spivcal_calibration_project(h, 0, 2, x, y, z, a, b, ps) == wanted);
    CHECK(spivcal_calibration_unproject(h, 0, 2, x, y, a, b, c, ps) == wanted);
    CHECK(spivcal_calibration_sight_from_pixel(h, 0, 2, x, y, a, b, c, a, b, c, ps) == wanted);
    CHECK(spivcal_calibration_sheet_from_pixel(h, 0, 2, x, y, a, b, ps) == wanted);
    CHECK(spivcal_calibration_pixel_from_sheet(h, 0, 2, x, y, a, b, ps) == wanted);
    CHECK(spivcal_calibration_sheet_grid(h, 0.0, &value, &value, &sigma, &w, &hh) == wanted);
    CHECK(spivcal_calibration_dewarp(h, 0, other, 0, 0.0, 0.0, 1.0, 0.0, 1, 1, data32, NULL) == wanted);
    CHECK(spivcal_calibration_components(h, 2, x, y, x, y, x, y, a, b, c, a, b, c, a, ps) == wanted);
    CHECK(data32[0] == 0);
    CHECK(out == 77 && state == 77 && value == 77 && sigma == 77);
    if (check_failures != before) fprintf(stderr, "... with %s\n", what);
}

static void destroys(uint64_t h, int32_t wanted) {
    CHECK(spivcal_context_destroy(h) == wanted);
    CHECK(spivcal_image_destroy(h) == wanted);
    CHECK(spivcal_detection_destroy(h) == wanted);
    CHECK(spivcal_rig_destroy(h) == wanted);
    CHECK(spivcal_job_destroy(h) == wanted);
    CHECK(spivcal_calibration_destroy(h) == wanted);
}

static void no_handles(void) {
    size_t i;
    uint64_t context = 0, image = 0, stale;
    uint8_t data[6] = {0};
    char text[100];
    uint64_t n;
    for (i = 0; i < sizeof NONE_BUT / sizeof NONE_BUT[0]; i++) {
        all_with(NONE_BUT[i], NONE_BUT[i], SPIVCAL_ERROR_HANDLE, "a number that is no handle");
        destroys(NONE_BUT[i], SPIVCAL_ERROR_HANDLE);
        CHECK(spivcal_error_text(NONE_BUT[i], text, sizeof text, &n) == SPIVCAL_ERROR_HANDLE);
    }
    CHECK(spivcal_context_create(1, &context) == SPIVCAL_OK && context != 0);
    CHECK(context < (uint64_t)1 << 52 && (uint64_t)(double)context == context);
    CHECK(spivcal_image_create_u8(context, data, 3, 2, 3, &image) == SPIVCAL_OK);
    CHECK(spivcal_image_destroy(image) == SPIVCAL_OK);
    stale = image;
    CHECK(spivcal_image_create_u8(context, data, 3, 2, 3, &image) == SPIVCAL_OK);
    CHECK(image != stale);
    all_with(stale, stale, SPIVCAL_ERROR_HANDLE, "a stale handle whose place is taken");
    destroys(stale, SPIVCAL_ERROR_HANDLE);
    CHECK(spivcal_context_destroy(context) == SPIVCAL_OK);
    all_with(image, image, SPIVCAL_ERROR_HANDLE, "an image whose context is gone");
    destroys(image, SPIVCAL_ERROR_HANDLE);
    destroys(context, SPIVCAL_ERROR_HANDLE);
}

static void wrong_types(uint64_t context, uint64_t image, uint64_t calibration) {
    uint64_t out = 5;
    double a[1] = {0};
    CHECK(spivcal_rig_check(context) == SPIVCAL_ERROR_HANDLE_TYPE);
    CHECK(spivcal_image_size(calibration, NULL, NULL) == SPIVCAL_ERROR_HANDLE_TYPE);
    CHECK(spivcal_calibration_project(image, 0, 1, a, a, a, a, a, NULL) == SPIVCAL_ERROR_HANDLE_TYPE);
    CHECK(spivcal_job_cancel(calibration) == SPIVCAL_ERROR_HANDLE_TYPE);
    CHECK(spivcal_rig_create(image, &out) == SPIVCAL_ERROR_HANDLE_TYPE);
    CHECK(spivcal_image_destroy(context) == SPIVCAL_ERROR_HANDLE_TYPE);
    CHECK(spivcal_context_destroy(image) == SPIVCAL_ERROR_HANDLE_TYPE);
    CHECK(out == 5);
}

static void null_pointers(uint64_t context, uint64_t calibration) {
    uint8_t data[6] = {0};
    uint64_t out = 5, rig = 0, detection = 0, n = 5;
    double x[2] = {0, 0}, y[2] = {0, 0};
    uint32_t w = 5;
    char text[10];
    const int32_t null = SPIVCAL_ERROR_NULL;
    CHECK(spivcal_context_create(1, NULL) == null);
    CHECK(spivcal_version_copy(NULL, 10, &n) == null && spivcal_version_copy(text, 10, NULL) == null);
    CHECK(spivcal_status_text(0, NULL, 10, &n) == null);
    CHECK(spivcal_error_text(context, text, 10, NULL) == null);
    CHECK(spivcal_image_create_u8(context, NULL, 3, 2, 3, &out) == null);
    CHECK(spivcal_image_create_u16(context, NULL, 3, 2, 6, &out) == null);
    CHECK(spivcal_image_create_f32(context, NULL, 3, 2, 12, &out) == null);
    CHECK(spivcal_image_create_u8(context, data, 3, 2, 3, NULL) == null);
    CHECK(spivcal_image_load(context, NULL, &out) == null && spivcal_image_load(context, "x", NULL) == null);
    CHECK(spivcal_detection_create(context, NULL) == null);
    CHECK(spivcal_rig_create(context, NULL) == null);
    CHECK(spivcal_rig_parse(context, NULL, NULL, &out) == null && spivcal_rig_parse(context, "", NULL, NULL) == null);
    CHECK(spivcal_rig_load(context, NULL, NULL, &out) == null && spivcal_rig_load(context, "", NULL, NULL) == null);
    CHECK(spivcal_calibration_load(context, NULL, &out) == null);
    CHECK(spivcal_calibration_parse(context, NULL, &out) == null);
    CHECK(out == 5);
    CHECK(spivcal_rig_create(context, &rig) == SPIVCAL_OK);
    CHECK(spivcal_rig_add_camera(rig, NULL, &out) == null && spivcal_rig_add_camera(rig, "a", NULL) == null);
    CHECK(spivcal_rig_add_view(rig, NULL) == null && spivcal_rig_add_mark(rig, NULL, 0, 0, 0) == null);
    CHECK(spivcal_rig_set_text(rig, SPIVCAL_RIG_TARGET_KIND, 0, NULL) == null);
    CHECK(spivcal_rig_set_image_file(rig, 0, 0, NULL) == null);
    CHECK(spivcal_rig_text_copy(rig, NULL, 5, &n) == null && spivcal_rig_text_copy(rig, text, 5, NULL) == null);
    CHECK(spivcal_calibration_run(rig, NULL) == null && spivcal_job_start(rig, NULL) == null);
    CHECK(spivcal_detection_create(context, &detection) == SPIVCAL_OK);
    CHECK(spivcal_detection_count(detection, SPIVCAL_COUNT_DISCS, NULL) == SPIVCAL_ERROR_NOT_AVAILABLE);
    CHECK(spivcal_image_create_u8(context, data, 3, 2, 3, &out) == SPIVCAL_OK);
    CHECK(spivcal_image_size(out, NULL, &w) == null && spivcal_image_size(out, &w, NULL) == null && w == 5);
    CHECK(spivcal_calibration_save(calibration, NULL) == null);
    CHECK(spivcal_calibration_count(calibration, SPIVCAL_COUNT_VIEWS, NULL) == null);
    CHECK(spivcal_calibration_number(calibration, SPIVCAL_CAMERA_F_PX, 0, NULL, x) == null);
    CHECK(spivcal_calibration_number(calibration, SPIVCAL_CAMERA_F_PX, 0, x, NULL) == SPIVCAL_OK && x[0] > 0);
    CHECK(spivcal_calibration_array_copy(calibration, SPIVCAL_ARRAY_CAM_FROM_RIG, 0, NULL, 16, &n) == null);
    CHECK(spivcal_calibration_array_copy(calibration, SPIVCAL_ARRAY_CAM_FROM_RIG, 0, x, 0, NULL) == null);
    CHECK(spivcal_calibration_text_copy(calibration, SPIVCAL_TEXT_JSON, 0, NULL, 1, &n) == null);
    CHECK(spivcal_calibration_project(calibration, 0, 2, NULL, y, y, x, x, NULL) == null);
    CHECK(spivcal_calibration_project(calibration, 0, 2, y, y, y, NULL, x, NULL) == null);
    CHECK(spivcal_calibration_unproject(calibration, 0, 2, y, NULL, x, x, x, NULL) == null);
    CHECK(spivcal_calibration_sight_from_pixel(calibration, 0, 2, x, y, x, x, x, x, NULL, x, NULL) == null);
    CHECK(spivcal_calibration_sheet_from_pixel(calibration, 0, 2, x, y, NULL, y, NULL) == null);
    CHECK(spivcal_calibration_pixel_from_sheet(calibration, 0, 2, x, y, y, NULL, NULL) == null);
    CHECK(spivcal_calibration_sheet_grid(calibration, 0.0, x, y, NULL, &w, &w) == null);
    CHECK(spivcal_calibration_sheet_grid(calibration, 0.0, x, y, x, &w, NULL) == null && w == 5);
    CHECK(spivcal_calibration_components(calibration, 2, x, y, x, y, x, y, x, x, x, x, NULL, x, x, NULL) == null);
    /* Nothing to do needs no memory. */
    CHECK(spivcal_calibration_project(calibration, 0, 0, NULL, NULL, NULL, NULL, NULL, NULL) == SPIVCAL_OK);
    CHECK(n == 5);
}

static void small_buffers(uint64_t calibration) {
    char text[64], one = CANARY;
    double pose[20];
    unsigned char *raw = (unsigned char *)pose;
    uint64_t needed = 0, i;
    memset(text, CANARY, sizeof text);
    memset(pose, CANARY, sizeof pose);
    CHECK(spivcal_version_copy(NULL, 0, &needed) == SPIVCAL_OK && needed > 5 && needed < 20);
    CHECK(spivcal_version_copy(text, needed - 1, &needed) == SPIVCAL_ERROR_BUFFER_TOO_SMALL && text[0] == CANARY);
    CHECK(spivcal_version_copy(text, needed, &needed) == SPIVCAL_OK && strlen(text) + 1 == needed);
    CHECK(text[needed] == CANARY);
    CHECK(spivcal_status_text(-1, &one, 1, &needed) == SPIVCAL_ERROR_BUFFER_TOO_SMALL && one == CANARY && needed > 1);
    needed = 0;
    for (i = 1; i < 16; i++) {
        CHECK(spivcal_calibration_array_copy(calibration, SPIVCAL_ARRAY_CAM_FROM_RIG, 1, pose, i, &needed) ==
              SPIVCAL_ERROR_BUFFER_TOO_SMALL);
        CHECK(needed == 16 && raw[0] == CANARY);
    }
    CHECK(spivcal_calibration_array_copy(calibration, SPIVCAL_ARRAY_CAM_FROM_RIG, 1, pose, 16, &needed) == SPIVCAL_OK);
    CHECK(pose[15] == 1.0 && pose[12] == 0.0 && raw[16 * sizeof(double)] == CANARY);
    CHECK(spivcal_error_text(calibration, text, sizeof text, &needed) == SPIVCAL_OK);
    CHECK(strstr(text, "16 are needed") != NULL);
}

static void any_alignment(uint64_t context, uint64_t calibration) {
    enum { N = 5, W = 37, H = 23 };
    static unsigned char room[8 * N * 6 + 64], pixels[2 * W * H * 2 + 16];
    int shift, i;
    for (shift = 1; shift < 8; shift++) {
        unsigned char *base = room + shift;
        double *u = (double *)(void *)base, *v = u + N, *x = u + 2 * N, *y = u + 3 * N, value;
        int32_t *status = (int32_t *)(void *)(u + 4 * N);
        uint64_t *out = (uint64_t *)(void *)(u + 5 * N), handle;
        uint32_t *width = (uint32_t *)(void *)(base + 8 * N * 5 + 16), w;
        for (i = 0; i < N; i++) {
            value = 100.0 * (i + 1);
            memcpy(base + 8 * i, &value, 8);
            memcpy(base + 8 * (N + i), &value, 8);
        }
        CHECK(spivcal_calibration_sheet_from_pixel(calibration, 0, N, u, v, x, y, status) == SPIVCAL_OK);
        memcpy(&value, base + 8 * 2 * N, 8);
        CHECK(isfinite(value));
        CHECK(spivcal_image_create_u16(context, (const uint16_t *)(void *)(pixels + shift), W, H, 2 * W + 3, out) == SPIVCAL_OK);
        memcpy(&handle, out, 8);
        CHECK(spivcal_image_size(handle, width, width + 1) == SPIVCAL_OK);
        memcpy(&w, width, 4);
        CHECK(w == W);
        CHECK(spivcal_image_destroy(handle) == SPIVCAL_OK);
    }
}

static void numbers_without_meaning(uint64_t context, uint64_t calibration) {
    const double bad[] = {NAN, INFINITY, -INFINITY, 1e308, -1e308, 0.0, -0.0, 5e-324};
    enum { N = sizeof bad / sizeof bad[0] };
    double x[N], y[N], z[N];
    int32_t status[N];
    uint64_t rig = 0, detection = 0, image = 0, out = 5, i, k;
    float grey[4] = {1, 2, NAN, 4};
    const uint64_t huge[] = {~(uint64_t)0, (uint64_t)1 << 63, (uint64_t)1 << 61, (uint64_t)1 << 41};
    for (k = 0; k < 3; k++) {
        double p[3][N];
        for (i = 0; i < N; i++) p[0][i] = p[1][i] = 10, p[2][i] = 500;
        for (i = 0; i < N; i++) p[k][i] = bad[i];
        CHECK(spivcal_calibration_project(calibration, 0, N, p[0], p[1], p[2], x, y, status) == SPIVCAL_WARNING_POINTS);
        for (i = 0; i < N; i++) CHECK((status[i] == SPIVCAL_POINT_OK) == (isfinite(x[i]) && isfinite(y[i])));
        CHECK(status[0] == SPIVCAL_POINT_NOT_FINITE && isnan(x[0]) && isnan(y[0]));
    }
    CHECK(spivcal_calibration_unproject(calibration, 1, N, bad, bad, x, y, z, status) == SPIVCAL_WARNING_POINTS);
    for (i = 0; i < N; i++) CHECK((status[i] == SPIVCAL_POINT_OK) == (isfinite(x[i]) && isfinite(z[i])));
    CHECK(spivcal_calibration_sight_from_pixel(calibration, 1, N, bad, bad, x, y, z, x, y, z, status) == SPIVCAL_WARNING_POINTS);
    CHECK(spivcal_calibration_sheet_from_pixel(calibration, 1, N, bad, bad, x, y, status) == SPIVCAL_WARNING_POINTS);
    CHECK(spivcal_calibration_pixel_from_sheet(calibration, 1, N, bad, bad, x, y, NULL) == SPIVCAL_WARNING_POINTS);
    CHECK(spivcal_calibration_components(calibration, N, bad, bad, bad, bad, bad, bad, x, y, z, x, y, z, x, status) ==
          SPIVCAL_WARNING_POINTS);
    for (i = 0; i < 3; i++) CHECK(status[i] == SPIVCAL_POINT_NOT_FINITE && isnan(y[i]));
    for (i = 0; i < N; i++) {
        uint32_t w = 5, h = 5;
        if (bad[i] == 0.0) continue;
        CHECK(spivcal_calibration_sheet_grid(calibration, bad[i], x, y, z, &w, &h) == SPIVCAL_ERROR_INVALID_INPUT ||
              (bad[i] > 1 && isfinite(bad[i]) && w == 1 && h == 1));
    }
    CHECK(spivcal_calibration_project(calibration, 2, 1, x, x, x, x, x, NULL) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_calibration_project(calibration, ~(uint64_t)0, 1, x, x, x, x, x, NULL) == SPIVCAL_ERROR_INDEX);
    for (i = 0; i < 4; i++) {
        CHECK(spivcal_calibration_project(calibration, 0, huge[i], x, x, x, x, x, NULL) == SPIVCAL_ERROR_ARGUMENT);
        CHECK(spivcal_image_create_u8(context, (const uint8_t *)grey, 2, 2, huge[i], &out) == SPIVCAL_ERROR_ARGUMENT);
        CHECK(spivcal_calibration_array_copy(calibration, SPIVCAL_ARRAY_CAM_FROM_RIG, huge[i], x, 1, &out) == SPIVCAL_ERROR_INDEX);
    }
    out = 5;
    CHECK(spivcal_image_create_u8(context, (const uint8_t *)grey, 0, 2, 2, &out) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_image_create_u8(context, (const uint8_t *)grey, 2, 2, 1, &out) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_image_create_u8(context, (const uint8_t *)grey, UINT32_MAX, UINT32_MAX, UINT32_MAX, &out) ==
          SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_image_create_f32(context, grey, 2, 2, 8, &out) == SPIVCAL_ERROR_ARGUMENT && out == 5);
    CHECK(spivcal_context_create(-1, &out) == SPIVCAL_ERROR_ARGUMENT && out == 5);
    CHECK(spivcal_context_create(INT32_MAX, &out) == SPIVCAL_ERROR_ARGUMENT && out == 5);
    CHECK(spivcal_rig_create(context, &rig) == SPIVCAL_OK);
    CHECK(spivcal_rig_set_number(rig, SPIVCAL_RIG_TARGET_SPACING_MM, 0, NAN) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_set_number(rig, SPIVCAL_RIG_TARGET_ROWS, 0, 2.5) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_set_number(rig, SPIVCAL_RIG_VIEW_SHEET, 0, 1) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_rig_set_number(rig, 123456, 0, 1) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_set_number(rig, SPIVCAL_RIG_TARGET_RADIUS_MM, ~(uint64_t)0, 1) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_rig_set_text(rig, -5, 0, "x") == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_set_text(rig, SPIVCAL_RIG_TARGET_KIND, 0, "\xff\xfe") == SPIVCAL_ERROR_UTF8);
    CHECK(spivcal_rig_set_known(rig, 0, SPIVCAL_PARAMETER_F_PX, 1, NAN) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_set_known(rig, 0, 99, 1, 1) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_set_known(rig, 0, SPIVCAL_PARAMETER_WINDOW_DISTANCE_MM, 300, 0) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_rig_set_number(rig, SPIVCAL_RIG_CAMERA_WINDOW_TILT_SIGMA_DEG, 0, 1) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_rig_set_scale(rig, 99, 0, 0, 1, 0) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_set_scale(rig, SPIVCAL_SCALE_SPACING, ~(uint64_t)0, 0, 1, -1) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_unset(rig, 123456, 0) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_unset(rig, SPIVCAL_RIG_TARGET_ROWS, 1) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_rig_unset(rig, SPIVCAL_RIG_VIEW_SHEET, 0) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_rig_unset(rig, SPIVCAL_RIG_TARGET_RADIUS_MM, ~(uint64_t)0) == SPIVCAL_OK);
    CHECK(spivcal_rig_unset_known(rig, 0, 99) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_unset_known(rig, ~(uint64_t)0, SPIVCAL_PARAMETER_K1) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_rig_unset_image(rig, 0, ~(uint64_t)0) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_rig_remove_view(rig, 0) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_rig_check(rig) == SPIVCAL_ERROR_INVALID_INPUT);
    CHECK(spivcal_calibration_run(rig, &out) == SPIVCAL_ERROR_INVALID_INPUT && out == 5);
    CHECK(spivcal_detection_create(context, &detection) == SPIVCAL_OK);
    CHECK(spivcal_detection_set_number(detection, SPIVCAL_DETECT_MIN_COVERAGE, NAN) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_detection_set_number(detection, SPIVCAL_DETECT_POLARITY, 3) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_detection_set_number(detection, SPIVCAL_DETECT_FULL_OF_SMOKE, 0.5) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_detection_set_number(detection, SPIVCAL_DETECT_FULL_OF_SMOKE, 3) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_detection_set_number(detection, SPIVCAL_DETECT_FULL_OF_SMOKE, 2) == SPIVCAL_OK);
    CHECK(spivcal_detection_set_number(detection, SPIVCAL_DETECT_FULL_OF_SMOKE, 1) == SPIVCAL_OK);
    CHECK(spivcal_detection_set_number(detection, 99, 3) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_detection_unset(detection, 99) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_detection_run(detection, context) == SPIVCAL_ERROR_HANDLE_TYPE);
    CHECK(spivcal_image_create_f32(context, grey, 1, 2, 4, &image) == SPIVCAL_OK);
    CHECK(spivcal_detection_run(detection, image) == SPIVCAL_OK);
    CHECK(spivcal_detection_count(detection, SPIVCAL_COUNT_DISCS, &out) == SPIVCAL_OK && out == 0);
    CHECK(spivcal_detection_array_copy(detection, SPIVCAL_CONTOUR_U_PX, 0, x, 1, &out) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_calibration_number(calibration, -1, 0, x, y) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_calibration_number(calibration, SPIVCAL_VIEW_USED, 1000, x, y) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_calibration_number(calibration, SPIVCAL_CAMERA_WINDOW_N_WATER, 0, x, y) == SPIVCAL_ERROR_NOT_AVAILABLE);
    CHECK(spivcal_calibration_array_copy(calibration, SPIVCAL_ARRAY_WINDOW_NORMAL_SIGMA_RAD, 0, x, N, &out) ==
          SPIVCAL_ERROR_NOT_AVAILABLE);
    CHECK(spivcal_calibration_text_copy(calibration, SPIVCAL_TEXT_FLAG, ~(uint64_t)0, NULL, 0, &out) == SPIVCAL_ERROR_INDEX);
    CHECK(spivcal_calibration_text_copy(calibration, SPIVCAL_TEXT_RESIDUALS_CSV, 0, NULL, 0, &out) ==
          SPIVCAL_ERROR_NOT_AVAILABLE);
    CHECK(spivcal_calibration_save(calibration, "no/such/\xff") == SPIVCAL_ERROR_UTF8);
    CHECK(spivcal_calibration_save(calibration, "/") == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_calibration_parse(context, "{\"format\": 1}", &out) == SPIVCAL_ERROR_INVALID_INPUT);
    CHECK(spivcal_rig_parse(context, "camera = 3", "", &out) == SPIVCAL_ERROR_INVALID_INPUT);
}

/* Every key that there could be, with every index near the edge: an answer or an error, never a crash. */
static void all_keys(uint64_t context, uint64_t calibration) {
    static double room[200 * 200];
    static uint8_t pixels[240 * 160];
    static char text[400000];
    uint64_t rig = 0, image = 0, detection = 0, n, answered = 0;
    int32_t key;
    uint64_t index;
    CHECK(spivcal_rig_create(context, &rig) == SPIVCAL_OK);
    scene_u8(pixels, 240, 160, 240);
    CHECK(spivcal_image_create_u8(context, pixels, 240, 160, 240, &image) == SPIVCAL_OK);
    CHECK(spivcal_detection_create(context, &detection) == SPIVCAL_OK);
    CHECK(spivcal_detection_run(detection, image) == SPIVCAL_OK);
    CHECK(spivcal_detection_count(detection, SPIVCAL_COUNT_DISCS, &n) == SPIVCAL_OK && n == 2);
    for (key = -2; key < 700; key++) {
        if (key == SPIVCAL_TEXT_JSON || key == SPIVCAL_TEXT_REPORT) continue;
        for (index = 0; index < 4; index++) {
            double value, sigma;
            answered += spivcal_calibration_number(calibration, key, index, &value, &sigma) == SPIVCAL_OK;
            answered += spivcal_calibration_array_copy(calibration, key, index, room, 200 * 200, &n) == SPIVCAL_OK;
            answered += spivcal_calibration_text_copy(calibration, key, index, text, sizeof text, &n) == SPIVCAL_OK;
            answered += spivcal_calibration_count(calibration, key, &n) == SPIVCAL_OK;
            answered += spivcal_detection_array_copy(detection, key, index, room, 200 * 200, &n) == SPIVCAL_OK;
            answered += spivcal_detection_text_copy(detection, key, index, "a.png", text, sizeof text, &n) == SPIVCAL_OK;
            spivcal_rig_set_number(rig, key, index, 1.5);
            spivcal_rig_set_text(rig, key, index, "none");
            spivcal_rig_set_known(rig, index, key, 1.5, 0.5);
            spivcal_rig_set_scale(rig, key, index, index, 1.5, 0.5);
            spivcal_rig_unset(rig, key + 1, index);
            spivcal_rig_unset_known(rig, index, key + 1);
        }
    }
    CHECK(answered > 100);
    CHECK(spivcal_rig_check(rig) == SPIVCAL_ERROR_INVALID_INPUT);
}

/* Work that fails, and work that is stopped before it is done. */
static void jobs(uint64_t context) {
    static uint8_t pixels[240 * 160];
    uint64_t rig = 0, job = 0, image = 0, camera, view, i, calibration = 5;
    int32_t state = 9, status;
    char text[500];
    uint64_t n;
    scene_u8(pixels, 240, 160, 240);
    CHECK(spivcal_rig_create(context, &rig) == SPIVCAL_OK);
    CHECK(spivcal_rig_add_camera(rig, "left", &camera) == SPIVCAL_OK && camera == 0);
    CHECK(spivcal_rig_add_camera(rig, "left", &camera) == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_add_camera(rig, "right", &camera) == SPIVCAL_OK && camera == 1);
    CHECK(spivcal_rig_add_camera(rig, "third", &camera) == SPIVCAL_ERROR_ARGUMENT && camera == 1);
    CHECK(spivcal_rig_set_text(rig, SPIVCAL_RIG_TARGET_KIND, 0, "two-discs") == SPIVCAL_OK);
    CHECK(spivcal_rig_set_number(rig, SPIVCAL_RIG_TARGET_SPACING_MM, 0, 26) == SPIVCAL_OK);
    CHECK(spivcal_image_create_u8(context, pixels, 240, 160, 240, &image) == SPIVCAL_OK);
    CHECK(spivcal_rig_set_image(rig, 0, 0, image) == SPIVCAL_ERROR_INDEX);
    for (i = 0; i < 3; i++) {
        CHECK(spivcal_rig_add_view(rig, &view) == SPIVCAL_OK && view == i);
        CHECK(spivcal_rig_set_image(rig, view, 0, image) == SPIVCAL_OK);
        CHECK(spivcal_rig_set_image(rig, view, 1, image) == SPIVCAL_OK);
        CHECK(spivcal_rig_set_image(rig, view, 1, rig) == SPIVCAL_ERROR_HANDLE_TYPE);
    }
    CHECK(spivcal_image_destroy(image) == SPIVCAL_OK);
    CHECK(spivcal_rig_check(rig) == SPIVCAL_OK);
    /* The same picture three times says nothing about a camera. */
    CHECK(spivcal_calibration_run(rig, &calibration) == SPIVCAL_ERROR_INSUFFICIENT && calibration == 5);
    CHECK(spivcal_error_text(rig, text, sizeof text, &n) == SPIVCAL_OK && strstr(text, "one picture") != NULL);
    /* Pictures that differ in a grey level, of a target that stands still: an error, or a result with flags. */
    for (i = 0; i < 6; i++) {
        pixels[i] ^= 1;
        CHECK(spivcal_image_create_u8(context, pixels, 240, 160, 240, &image) == SPIVCAL_OK);
        CHECK(spivcal_rig_set_image(rig, i / 2, i % 2, image) == SPIVCAL_OK && spivcal_image_destroy(image) == SPIVCAL_OK);
    }
    status = spivcal_calibration_run(rig, &calibration);
    CHECK(status != SPIVCAL_OK && (status < 0) == (calibration == 5));
    if (status < 0) CHECK(spivcal_error_text(rig, text, sizeof text, &n) == SPIVCAL_OK && n > 20);
    if (status > 0) CHECK(spivcal_calibration_text_copy(calibration, SPIVCAL_TEXT_FLAG, 0, text, sizeof text, &n) == SPIVCAL_OK);
    CHECK(spivcal_job_start(rig, &job) == SPIVCAL_OK);
    CHECK(spivcal_job_wait(job, -1, &state) == SPIVCAL_OK);
    CHECK(state == (status < 0 ? SPIVCAL_JOB_FAILED : SPIVCAL_JOB_DONE));
    CHECK(spivcal_job_result(job, &calibration) == status);
    /* An image that is not there: an error of the experimenter's turn or the caller's, with its words in the job. */
    CHECK(spivcal_job_destroy(job) == SPIVCAL_OK);
    CHECK(spivcal_rig_set_image_file(rig, 1, 1, "no such file.png") == SPIVCAL_OK);
    CHECK(spivcal_job_start(rig, &job) == SPIVCAL_OK);
    CHECK(spivcal_job_wait(job, -1, &state) == SPIVCAL_OK && state == SPIVCAL_JOB_FAILED);
    calibration = 5;
    CHECK(spivcal_job_result(job, &calibration) == SPIVCAL_ERROR_INVALID_INPUT && calibration == 5);
    CHECK(spivcal_error_text(job, text, sizeof text, &n) == SPIVCAL_OK && strstr(text, "no such file.png") != NULL);
    CHECK(spivcal_job_cancel(job) == SPIVCAL_OK);
    CHECK(spivcal_job_destroy(job) == SPIVCAL_OK);
    CHECK(spivcal_job_start(rig, &job) == SPIVCAL_OK);
    CHECK(spivcal_job_cancel(job) == SPIVCAL_OK);
    CHECK(spivcal_job_wait(job, -1, &state) == SPIVCAL_OK);
    CHECK(state == SPIVCAL_JOB_CANCELLED || state == SPIVCAL_JOB_FAILED);
    CHECK(spivcal_rig_set_image_file(rig, 1, 1, "") == SPIVCAL_ERROR_ARGUMENT);
    CHECK(spivcal_rig_set_image_file(rig, 1, 1, "x.png") == SPIVCAL_OK);
    CHECK(spivcal_rig_set_text(rig, SPIVCAL_RIG_SOLVE_LOSS, 0, "some") == SPIVCAL_OK && spivcal_job_start(rig, &job) == SPIVCAL_ERROR_INVALID_INPUT);
    CHECK(spivcal_rig_set_text(rig, SPIVCAL_RIG_SOLVE_LOSS, 0, "huber") == SPIVCAL_OK);
    CHECK(spivcal_job_destroy(job) == SPIVCAL_OK);
    /* Destroyed while they run, one by one and with their context. */
    for (i = 0; i < 4; i++) CHECK(spivcal_job_start(rig, &job) == SPIVCAL_OK);
    CHECK(spivcal_job_destroy(job) == SPIVCAL_OK);
    CHECK(spivcal_rig_destroy(rig) == SPIVCAL_OK);
}

int main(int argc, char **argv) {
    uint64_t context = 0, calibration = 0, image = 0;
    uint8_t data[6] = {0};
    if (argc != 2) return 2;
    CHECK(spivcal_abi_version() == SPIVCAL_ABI_VERSION);
    no_handles();
    CHECK(spivcal_context_create(2, &context) == SPIVCAL_OK);
    CHECK(spivcal_calibration_load(context, argv[1], &calibration) == SPIVCAL_OK);
    CHECK(spivcal_image_create_u8(context, data, 3, 2, 3, &image) == SPIVCAL_OK);
    wrong_types(context, image, calibration);
    null_pointers(context, calibration);
    small_buffers(calibration);
    any_alignment(context, calibration);
    numbers_without_meaning(context, calibration);
    all_keys(context, calibration);
    jobs(context);
    CHECK(spivcal_context_destroy(context) == SPIVCAL_OK);
    return check_end();
}
