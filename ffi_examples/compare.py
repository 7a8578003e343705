#!/usr/bin/env python3
"""Runs a story and compares what it prints with the calibration.json that the program wrote, to the bit.

Usage: compare.py [--sigmas S] PROGRAM.json COMMAND...

With --sigmas numbers may differ by S standard deviations and these by 1e-5: for a program of another system, whose C library rounds
the sine in another way.
"""
import json
import subprocess
import sys


def wanted(record):
    """The lines that a story prints, but for the mapped points."""
    def camera(name):
        return [(name, c[name], c["sigma"][name]) for c in record["cameras"]]
    sheet, sigma = record["sheet"], record["sheet"]["sigma"]
    rows = [r for pair in zip(camera("f_px"), camera("beta_rad")) for r in pair]
    rows.append(("baseline_mm", record["rig"]["baseline_mm"], record["rig"]["sigma"]["baseline_mm"]))
    rows.append(("distance_mm", sheet["distance_mm"], sigma["distance_mm"]))
    rows += [(f"{n}_per_mm", sheet["abc_per_mm"][i], sigma["abc_per_mm"][i]) for i, n in enumerate("abc")]
    rows.append(("angle_to_baseline_deg", sheet["angle_to_baseline_deg"], sigma["angle_to_baseline_deg"]))
    return rows


def sheet_from_pixel(record, u, v):
    """The mapping of the first camera, written independently of the library (the module `camera` says the formulas)."""
    from math import cos, sin
    c = record["cameras"][0]
    a, b = c["alpha_rad"], c["beta_rad"]
    tx, ty = (u - c["cx_px"]) / c["f_px"], (v - c["cy_px"]) / (c["aspect"] * c["f_px"])
    h = 1 + (tx * sin(b) + ty * sin(a) * cos(b)) / c["pupil_ratio"]
    xd, yd = (tx * cos(b) - ty * sin(a) * sin(b)) / h, ty * cos(a) / h
    x, y = xd, yd
    for _ in range(100):
        s = x * x + y * y
        g = 1 + c["k1"] * s + c["k2"] * s * s + c["k3"] * s ** 3
        x, y = xd / g, yd / g
    n, d = record["sheet"]["normal_in_rig"], record["sheet"]["distance_mm"]
    depth = d / (n[0] * x + n[1] * y + n[2])
    pose = record["sheet"]["rig_from_sheet"]
    p = [depth * x - pose["translation_mm"][0], depth * y - pose["translation_mm"][1], depth - pose["translation_mm"][2]]
    return [sum(pose["rotation"][i][k] * p[i] for i in range(3)) for k in range(2)]


def main(program_json, command, sigmas=0.0):
    with open(program_json, encoding="utf-8") as file:
        record = json.load(file)
    out = subprocess.run(command, check=True, stdout=subprocess.PIPE, universal_newlines=True).stdout
    lines = [line.split() for line in out.splitlines()]
    rows = [line for line in lines if line[0] not in ("flagged", "map")]
    expected = wanted(record)
    assert len(rows) == len(expected), out
    apart = 0.0
    for (name, value, sigma), row in zip(expected, rows):
        assert row[0] == name, (row, name)
        differ = [abs(float(row[1]) - value), abs(float(row[2]) - sigma)]
        assert differ[0] <= sigmas * sigma and differ[1] <= (1e-5 * sigma if sigmas else 0), f"{name}: {row[1:]} is not {value}, {sigma}"
        apart = max(apart, differ[0] / sigma if sigma else 0.0)
    maps = [[float(x) for x in line[1:]] for line in lines if line[0] == "map"]
    pixels = [(100.0, 80.0), (511.5, 383.5), (900.0, 700.0)]
    assert len(maps) == len(pixels), out
    for (u, v), got in zip(pixels, maps):
        want = sheet_from_pixel(record, u, v)
        assert max(abs(a - b) for a, b in zip(got, want)) < (1e-6 if sigmas else 1e-8), (got, want)
    how = f"to {apart:.1e} standard deviations" if apart else "to the bit"
    print(f"{len(rows)} numbers equal those of the program {how}, {len(maps)} mapped points to {1e-6 if sigmas else 1e-8:.0e} mm")


if __name__ == "__main__":
    arguments, allowed = sys.argv[1:], 0.0
    if arguments[:1] == ["--sigmas"]:
        allowed, arguments = float(arguments[1]), arguments[2:]
    if len(arguments) < 2:
        sys.exit(__doc__)
    main(arguments[0], arguments[1:], allowed)
