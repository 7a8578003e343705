#!/usr/bin/env bash
# The most memory that the program's commands hold at a time on the examples, against that recorded in benches/memory.txt: fails where one has
# grown by more than a fifth (which thread comes first makes 5 %).
#   benches/memory.sh            compares
#   benches/memory.sh --renew    records anew: after a change that is worth its price
#
# A row is NAME MB: what examples/peak_memory.rs counts of its own allocations, two threads. The resident memory says less: a command of 15 MB
# has 4 to 13 MB of the program's file in it, as the system's page cache has it.
set -euo pipefail
cd "$(dirname "$0")/.."

list=benches/memory.txt
# As the tests are built: allocations do not depend on optimisation.
benches/programs.sh
program=${CARGO_TARGET_DIR:-target}/debug/examples/peak_memory

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

# measured NAME ARGUMENTS...: a line with the name and the peak in MB. Exit code 1 says that something is not determined.
measured() {
    local name=$1 code=0
    shift
    "$program" "$@" -q --threads 2 >"$work/said" 2>&1 || code=$?
    if [ $code -gt 1 ]; then
        cat "$work/said" >&2
        exit $code
    fi
    echo "$name $(sed -n 's/^peak of allocated memory: \(.*\) MB$/\1/p' "$work/said")"
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
    { grep '^#' "$list"; cat "$work/rows"; } >"$work/renewed"
    cp "$work/renewed" "$list"
fi
failed=0
while read -r name recorded; do
    now=$(sed -n "s/^$name //p" "$work/rows")
    echo "$name: ${now:-nothing measured} MB, recorded $recorded MB"
    if ! awk -v now="$now" -v recorded="$recorded" 'BEGIN { exit !(now + 0 > 0 && now + 0 <= 1.2 * recorded) }'; then
        echo "FAILED: $name: more than a fifth above what is recorded, or nothing measured"
        failed=1
    fi
done < <(grep -v '^#' "$list")
exit $failed
