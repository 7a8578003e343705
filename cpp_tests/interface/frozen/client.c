/* A client of the first release, compiled against the header of the first release, run with the library of today.
   Neither this file nor the header beside it changes for as long as the soname is libspivcal.so.1. */

#include "spivcal.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define MUST(call)                                                                                          \
    do {                                                                                                    \
        if ((call) < 0) {                                                                                   \
            fprintf(stderr, "%s\n", #call);                                                                 \
            return 1;                                                                                       \
        }                                                                                                   \
    } while (0)

int main(int argc, char **argv) {
    uint64_t context = 0, calibration = 0, needed = 0, cameras = 0, rig = 0;
    double value = 0, sigma = 0, pose[16], x = 0, y = 0, u = 300, v = 200, u2 = 0, v2 = 0;
    int32_t point = -1;
    char name[50], words[300];
    if (argc != 2 || spivcal_abi_version() != 1) return 1;
    MUST(spivcal_context_create(1, &context));
    MUST(spivcal_calibration_load(context, argv[1], &calibration));
    MUST(spivcal_calibration_count(calibration, 211, &cameras));
    MUST(spivcal_calibration_number(calibration, 301, 0, &value, &sigma));
    MUST(spivcal_calibration_array_copy(calibration, 501, 1, pose, 16, &needed));
    MUST(spivcal_calibration_text_copy(calibration, 608, 0, name, sizeof name, &needed));
    MUST(spivcal_calibration_sheet_from_pixel(calibration, 0, 1, &u, &v, &x, &y, &point));
    MUST(spivcal_calibration_pixel_from_sheet(calibration, 0, 1, &x, &y, &u2, &v2, NULL));
    if (cameras != 2 || !(value > 0) || !(sigma > 0) || pose[15] != 1.0 || strcmp(name, "left") != 0) return 1;
    if (point != 0 || !(fabs(u - u2) + fabs(v - v2) < 1e-8)) return 1;
    if (spivcal_calibration_number(calibration, 1, 0, &value, &sigma) != -4) return 1;
    if (spivcal_rig_parse(context, "nothing", "", &rig) != -20 || rig != 0) return 1;
    MUST(spivcal_error_text(context, words, sizeof words, &needed));
    if (strstr(words, "TOML") == NULL) return 1;
    MUST(spivcal_calibration_destroy(calibration));
    if (spivcal_calibration_destroy(calibration) != -1) return 1;
    MUST(spivcal_context_destroy(context));
    printf("the interface of the first release is kept\n");
    return 0;
}
