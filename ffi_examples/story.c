/* The story in C: two images per view, calibrate, print sheet and sigmas, map points.
   Usage: story_c RIG.toml IMAGE_DIR SAVED.json          (make it: see README.md, "Linking it") */

#include "spivcal.h"

#include <stdio.h>
#include <stdlib.h>

/* Ends with the error text of `handle` where a call failed; a real program would do its own thing. */
static void must(int32_t status, uint64_t handle, const char *what) {
    char words[2000] = "";
    uint64_t needed = 0;
    if (status >= 0) return;
    if (spivcal_error_text(handle, words, sizeof words, &needed) < 0)
        spivcal_status_text(status, words, sizeof words, &needed);
    fprintf(stderr, "%s: %s (status %d)\n", what, words, (int)status);
    exit(1);
}

static void print_number(uint64_t calibration, const char *name, int32_t key, uint64_t index) {
    double value = 0, sigma = 0;
    must(spivcal_calibration_number(calibration, key, index, &value, &sigma), calibration, name);
    printf("%s %.17g %.17g\n", name, value, sigma);
}

int main(int argc, char **argv) {
    uint64_t context = 0, rig = 0, calibration = 0, again = 0, view, camera, needed = 0, cameras = 0;
    double u[3] = {100.0, 511.5, 900.0}, v[3] = {80.0, 383.5, 700.0}, x[3], y[3], u_back[3], v_back[3];
    int32_t point_status[3], status;
    char headline[500];
    int i;
    if (argc != 4) {
        fprintf(stderr, "usage: %s RIG.toml IMAGE_DIR SAVED.json\n", argv[0]);
        return 2;
    }
    if (spivcal_abi_version() != SPIVCAL_ABI_VERSION) return 2;
    must(spivcal_context_create(0, &context), 0, "context");

    /* The rig file says what the target is; here two of its images come from memory instead of from their files, as a camera
       would deliver them. spivcal_rig_create and the setters do without a file at all. */
    must(spivcal_rig_load(context, argv[1], argv[2], &rig), context, "rig");
    for (camera = 0; camera < 2; camera++) {
        char path[1000];
        uint64_t image = 0;
        view = 0;
        snprintf(path, sizeof path, "%s/v01_%s.png", argv[2], camera == 0 ? "left" : "right");
        must(spivcal_image_load(context, path, &image), context, "image");
        must(spivcal_rig_set_image(rig, view, camera, image), rig, "set image");
        must(spivcal_image_destroy(image), 0, "image");
    }

    status = spivcal_calibration_run(rig, &calibration);
    must(status, rig, "calibrate");
    must(spivcal_calibration_text_copy(calibration, SPIVCAL_TEXT_HEADLINE, 0, headline, sizeof headline, &needed), calibration,
         "headline");
    fprintf(stderr, "%s\n", headline);
    printf("flagged %d\n", status == SPIVCAL_WARNING_FLAGGED);

    must(spivcal_calibration_count(calibration, SPIVCAL_COUNT_CAMERAS, &cameras), calibration, "cameras");
    for (camera = 0; camera < cameras; camera++) {
        print_number(calibration, "f_px", SPIVCAL_CAMERA_F_PX, camera);
        print_number(calibration, "beta_rad", SPIVCAL_CAMERA_BETA_RAD, camera);
    }
    print_number(calibration, "baseline_mm", SPIVCAL_BASELINE_MM, 0);
    print_number(calibration, "distance_mm", SPIVCAL_SHEET_DISTANCE_MM, 0);
    print_number(calibration, "a_per_mm", SPIVCAL_SHEET_A_PER_MM, 0);
    print_number(calibration, "b_per_mm", SPIVCAL_SHEET_B_PER_MM, 0);
    print_number(calibration, "c_per_mm", SPIVCAL_SHEET_C_PER_MM, 0);
    print_number(calibration, "angle_to_baseline_deg", SPIVCAL_SHEET_ANGLE_TO_BASELINE_DEG, 0);

    /* From pixels to millimetres in the sheet, and back; a calibration that was saved and loaded gives the same bits. */
    must(spivcal_calibration_save(calibration, argv[3]), calibration, "save");
    must(spivcal_calibration_load(context, argv[3], &again), context, "load");
    must(spivcal_calibration_sheet_from_pixel(again, 0, 3, u, v, x, y, point_status), again, "map");
    must(spivcal_calibration_pixel_from_sheet(again, 0, 3, x, y, u_back, v_back, NULL), again, "map back");
    for (i = 0; i < 3; i++) {
        printf("map %.17g %.17g\n", x[i], y[i]);
        if (point_status[i] != SPIVCAL_POINT_OK || !(u_back[i] - u[i] < 1e-8 && u[i] - u_back[i] < 1e-8) ||
            !(v_back[i] - v[i] < 1e-8 && v[i] - v_back[i] < 1e-8)) {
            fprintf(stderr, "point %d does not come back\n", i);
            return 1;
        }
    }
    must(spivcal_context_destroy(context), 0, "context");
    return 0;
}
