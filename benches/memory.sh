#!/usr/bin/env bash
# Peak resident memory of the program's commands on the examples, against that recorded in benches/memory.txt: fails where one has grown by
# more than a quarter.
#   benches/memory.sh            compares
#   benches/memory.sh --renew    records anew: after a change that is worth its price
#
# A row is NAME MB. Two threads; what the system maps for a program of this size without work, some 5 MB, is part of each.
set -euo pipefail
cd "$(dirname "$0")/.."

list=benches/memory.txt
if [ ! -x /usr/bin/time ]; then
    echo "SKIPPED: peak memory (/usr/bin/time is missing: apt-get install time)"
    exit 0
fi
benches/programs.sh
program=${CARGO_TARGET_DIR:-target}/release/spivcal

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# measured NAME ARGUMENTS...: a line with the name, the peak in MB and the seconds. Exit code 1 says that something is not determined.
measured() {
    local name=$1 code=0
    shift
    /usr/bin/time -q -f '%M %e' -o "$work/time" "$program" "$@" -q --threads 2 >"$work/said" 2>&1 || code=$?
    if [ $code -gt 1 ]; then
        cat "$work/said" >&2
        exit $code
    fi
    awk -v name="$name" 'END { printf "%s %.0f %.1f\n", name, $1 / 1024, $2 }' "$work/time"
}

vortex=examples/vortex
{
    measured detect-two-discs detect examples/printed/v01_left.png -o "$work/discs"
    measured calibrate-printed calibrate examples/printed/rig.toml -o "$work/printed"
    measured calibrate-bubbles calibrate examples/bubbles/rig.toml -o "$work/bubbles"
    measured calibrate-vortex calibrate $vortex/rig.toml -o "$work/vortex"
    measured check-refine check "$work/vortex/calibration.json" --pairs "$vortex/p*_left.png" "$vortex/p*_right.png" --refine -o "$work/sheet"
    measured dewarp dewarp "$work/sheet/calibration.json" $vortex/p01a_left.png $vortex/p01a_right.png -o "$work/dewarped"
    measured simulate-dot-grid simulate --preset dot-grid -o "$work/dots"
    measured calibrate-dot-grid calibrate "$work/dots/rig.toml" -o "$work/grid"
} >"$work/rows"

if [ "${1-}" = --renew ]; then
    { grep '^#' "$list"; cut -d ' ' -f 1,2 "$work/rows"; } >"$work/renewed"
    cp "$work/renewed" "$list"
fi
failed=0
while read -r name now seconds; do
    recorded=$(sed -n "s/^$name //p" "$list")
    echo "$name: $now MB in $seconds s, recorded ${recorded:-nothing} MB"
    if [ -z "$recorded" ] || [ $((4 * now)) -gt $((5 * recorded)) ]; then
        echo "FAILED: $name: more than a quarter above what is recorded"
        failed=1
    fi
done <"$work/rows"
exit $failed
