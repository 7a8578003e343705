#!/usr/bin/env python3
"""The story in Python with cffi, which reads the header itself: constants and signatures need not be written again.

Usage: story_cffi.py SPIVCAL_H LIBRARY RIG.toml IMAGE_DIR SAVED.json
"""
import re
import sys

from cffi import FFI


def load(header, library):
    """The library as `spivcal.h` declares it; cffi knows stdint.h but no preprocessor."""
    with open(header, encoding="utf-8") as file:
        source = re.sub(r"/\*.*?\*/", "", file.read(), flags=re.S)
    constants = dict(re.findall(r"^#define (SPIVCAL_\w+) (-?\d+)$", source, flags=re.M))
    code = re.sub(r'#ifdef __cplusplus.*?#endif.*?$', "", source, flags=re.S | re.M)
    code = "\n".join(line for line in code.splitlines() if not line.startswith("#"))
    ffi = FFI()
    ffi.cdef("\n".join(f"#define {name} {value}" for name, value in constants.items()) + code)
    return ffi, ffi.dlopen(library)


def main(header, library, rig_file, images, saved):
    ffi, lib = load(header, library)
    assert lib.spivcal_abi_version() == lib.SPIVCAL_ABI_VERSION

    def text(copy, *arguments):
        needed = ffi.new("uint64_t *")
        if copy(*arguments, ffi.NULL, 0, needed) < 0:
            return ""
        buffer = ffi.new("char[]", needed[0])
        copy(*arguments, buffer, needed[0], needed)
        return ffi.string(buffer).decode("utf-8")

    def must(status, handle):
        if status < 0:
            words = text(lib.spivcal_error_text, handle) or text(lib.spivcal_status_text, status)
            sys.exit(f"{words} (status {status})")
        return status

    def made(function, handle, *arguments):
        out = ffi.new("uint64_t *")
        status = must(function(handle, *arguments, out), handle)
        return out[0], status

    out = ffi.new("uint64_t *")
    must(lib.spivcal_context_create(0, out), 0)
    context = out[0]
    rig, _ = made(lib.spivcal_rig_load, context, rig_file.encode(), images.encode())
    for camera, name in enumerate(["left", "right"]):
        image, _ = made(lib.spivcal_image_load, context, f"{images}/v01_{name}.png".encode())
        must(lib.spivcal_rig_set_image(rig, 0, camera, image), rig)

    calibration, status = made(lib.spivcal_calibration_run, rig)
    print(text(lib.spivcal_calibration_text_copy, calibration, lib.SPIVCAL_TEXT_HEADLINE, 0), file=sys.stderr)
    print("flagged", int(status == lib.SPIVCAL_WARNING_FLAGGED))

    def show(name, key, index=0):
        value, sigma = ffi.new("double *"), ffi.new("double *")
        must(lib.spivcal_calibration_number(calibration, key, index, value, sigma), calibration)
        print(f"{name} {value[0]:.17g} {sigma[0]:.17g}")

    count = ffi.new("uint64_t *")
    must(lib.spivcal_calibration_count(calibration, lib.SPIVCAL_COUNT_CAMERAS, count), calibration)
    for camera in range(count[0]):
        show("f_px", lib.SPIVCAL_CAMERA_F_PX, camera)
        show("beta_rad", lib.SPIVCAL_CAMERA_BETA_RAD, camera)
    show("baseline_mm", lib.SPIVCAL_BASELINE_MM)
    show("distance_mm", lib.SPIVCAL_SHEET_DISTANCE_MM)
    show("a_per_mm", lib.SPIVCAL_SHEET_A_PER_MM)
    show("b_per_mm", lib.SPIVCAL_SHEET_B_PER_MM)
    show("c_per_mm", lib.SPIVCAL_SHEET_C_PER_MM)
    show("angle_to_baseline_deg", lib.SPIVCAL_SHEET_ANGLE_TO_BASELINE_DEG)

    must(lib.spivcal_calibration_save(calibration, saved.encode()), calibration)
    again, _ = made(lib.spivcal_calibration_load, context, saved.encode())
    u, v = ffi.new("double[]", [100.0, 511.5, 900.0]), ffi.new("double[]", [80.0, 383.5, 700.0])
    x, y, u_back, v_back = (ffi.new("double[3]") for _ in range(4))
    point_status = ffi.new("int32_t[3]")
    must(lib.spivcal_calibration_sheet_from_pixel(again, 0, 3, u, v, x, y, point_status), again)
    must(lib.spivcal_calibration_pixel_from_sheet(again, 0, 3, x, y, u_back, v_back, ffi.NULL), again)
    for i in range(3):
        print(f"map {x[i]:.17g} {y[i]:.17g}")
        assert point_status[i] == lib.SPIVCAL_POINT_OK
        assert abs(u_back[i] - u[i]) < 1e-8 and abs(v_back[i] - v[i]) < 1e-8
    must(lib.spivcal_context_destroy(context), 0)


if __name__ == "__main__":
    if len(sys.argv) != 6:
        sys.exit(__doc__)
    main(*sys.argv[1:])
