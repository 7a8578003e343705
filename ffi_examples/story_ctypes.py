#!/usr/bin/env python3
"""The story in Python with ctypes alone: two images per view, calibrate, print sheet and sigmas, map points.

Usage: story_ctypes.py LIBRARY RIG.toml IMAGE_DIR SAVED.json      (LIBRARY: libspivcal.so.1 or spivcal.dll)
"""
import ctypes as c
import sys

# Constants of spivcal.h.
(ABI_VERSION, OK, WARNING_FLAGGED) = (1, 0, 1)
COUNT_CAMERAS, CAMERA_F_PX, CAMERA_BETA_RAD, BASELINE_MM = 211, 301, 306, 401
SHEET_DISTANCE_MM, SHEET_A_PER_MM, SHEET_B_PER_MM, SHEET_C_PER_MM, SHEET_ANGLE_TO_BASELINE_DEG = 411, 415, 416, 417, 421
TEXT_HEADLINE = 604

HANDLE, INDEX, P_F64 = c.c_uint64, c.c_uint64, c.POINTER(c.c_double)


def load(path):
    """The library with the signatures that the story needs: without them ctypes would cut handles to 32 bits."""
    lib = c.CDLL(path)
    p_handle, p_i32, text = c.POINTER(HANDLE), c.POINTER(c.c_int32), c.c_char_p
    copy = [text, c.c_uint64, c.POINTER(c.c_uint64)]
    mapping = [HANDLE, INDEX, c.c_uint64] + [P_F64] * 4 + [p_i32]
    signatures = {
        "abi_version": [],
        "status_text": [c.c_int32] + copy,
        "error_text": [HANDLE] + copy,
        "context_create": [c.c_int32, p_handle],
        "context_destroy": [HANDLE],
        "rig_load": [HANDLE, text, text, p_handle],
        "image_load": [HANDLE, text, p_handle],
        "rig_set_image": [HANDLE, INDEX, INDEX, HANDLE],
        "calibration_run": [HANDLE, p_handle],
        "calibration_count": [HANDLE, c.c_int32, c.POINTER(c.c_uint64)],
        "calibration_number": [HANDLE, c.c_int32, INDEX, P_F64, P_F64],
        "calibration_text_copy": [HANDLE, c.c_int32, INDEX] + copy,
        "calibration_save": [HANDLE, text],
        "calibration_load": [HANDLE, text, p_handle],
        "calibration_sheet_from_pixel": mapping,
        "calibration_pixel_from_sheet": mapping,
    }
    for name, arguments in signatures.items():
        function = getattr(lib, "spivcal_" + name)
        function.argtypes, function.restype = arguments, c.c_int32
    return lib


def text(copy, *arguments):
    """A text: first its size, then the text."""
    needed = c.c_uint64()
    if copy(*arguments, None, 0, c.byref(needed)) < 0:
        return ""
    buffer = c.create_string_buffer(needed.value)
    copy(*arguments, buffer, needed.value, c.byref(needed))
    return buffer.value.decode("utf-8")


def main(library, rig_file, images, saved):
    lib = load(library)
    assert lib.spivcal_abi_version() == ABI_VERSION

    def must(status, handle):
        if status < 0:
            words = text(lib.spivcal_error_text, handle) or text(lib.spivcal_status_text, status)
            sys.exit(f"{words} (status {status})")
        return status

    def made(function, handle, *arguments):
        out = HANDLE()
        status = must(function(handle, *arguments, c.byref(out)), handle)
        return out.value, status

    context = HANDLE()
    must(lib.spivcal_context_create(0, c.byref(context)), 0)
    context = context.value
    rig, _ = made(lib.spivcal_rig_load, context, rig_file.encode(), images.encode())
    for camera, name in enumerate(["left", "right"]):
        image, _ = made(lib.spivcal_image_load, context, f"{images}/v01_{name}.png".encode())
        must(lib.spivcal_rig_set_image(rig, 0, camera, image), rig)

    calibration, status = made(lib.spivcal_calibration_run, rig)
    print(text(lib.spivcal_calibration_text_copy, calibration, TEXT_HEADLINE, 0), file=sys.stderr)
    print("flagged", int(status == WARNING_FLAGGED))

    def show(name, key, index=0):
        value, sigma = c.c_double(), c.c_double()
        must(lib.spivcal_calibration_number(calibration, key, index, c.byref(value), c.byref(sigma)), calibration)
        print(f"{name} {value.value:.17g} {sigma.value:.17g}")

    cameras = c.c_uint64()
    must(lib.spivcal_calibration_count(calibration, COUNT_CAMERAS, c.byref(cameras)), calibration)
    for camera in range(cameras.value):
        show("f_px", CAMERA_F_PX, camera)
        show("beta_rad", CAMERA_BETA_RAD, camera)
    show("baseline_mm", BASELINE_MM)
    show("distance_mm", SHEET_DISTANCE_MM)
    show("a_per_mm", SHEET_A_PER_MM)
    show("b_per_mm", SHEET_B_PER_MM)
    show("c_per_mm", SHEET_C_PER_MM)
    show("angle_to_baseline_deg", SHEET_ANGLE_TO_BASELINE_DEG)

    must(lib.spivcal_calibration_save(calibration, saved.encode()), calibration)
    again, _ = made(lib.spivcal_calibration_load, context, saved.encode())
    array, status3 = c.c_double * 3, c.c_int32 * 3
    u, v = array(100.0, 511.5, 900.0), array(80.0, 383.5, 700.0)
    x, y, u_back, v_back, point_status = array(), array(), array(), array(), status3()
    must(lib.spivcal_calibration_sheet_from_pixel(again, 0, 3, u, v, x, y, point_status), again)
    must(lib.spivcal_calibration_pixel_from_sheet(again, 0, 3, x, y, u_back, v_back, None), again)
    for i in range(3):
        print(f"map {x[i]:.17g} {y[i]:.17g}")
        assert point_status[i] == OK and abs(u_back[i] - u[i]) < 1e-8 and abs(v_back[i] - v[i]) < 1e-8
    must(lib.spivcal_context_destroy(context), 0)


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])
