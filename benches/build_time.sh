#!/usr/bin/env bash
# What it takes to build this package and its tests, over what its dependencies take: both in processor seconds of one build from nothing, so that a slower
# machine changes little. Fails where the ratio has grown by more than a third over that in benches/build_time.txt.
#   benches/build_time.sh TIMES            compares
#   benches/build_time.sh TIMES --renew    records anew: after a change that is worth its price
#
# TIMES is what benches/build_time/rustc.sh wrote of a build in a clean clone:
#   RUSTC_WRAPPER=$PWD/benches/build_time/rustc.sh SPIVCAL_BUILD_TIMES=$PWD/TIMES cargo test --no-run --lib --bins --tests
set -euo pipefail
times=$(realpath "$1")
cd "$(dirname "$0")/.."

list=benches/build_time.txt
# nalgebra is among the first of the dependencies that are built.
if ! grep -q '^other .* nalgebra$' "$times" || ! grep -q '^own .* spivcal$' "$times"; then
    echo "SKIPPED: build time (a part of the build was at hand; in a clean clone all of it is made)"
    exit 0
fi
awk '{ seconds[$1] += $2 } END { printf "own %.0f s, dependencies %.0f s, ratio %.2f\n", seconds["own"], seconds["other"], seconds["own"] / seconds["other"] }' "$times"
now=$(awk '{ seconds[$1] += $2 } END { printf "%.2f", seconds["own"] / seconds["other"] }' "$times")
if [ "${2-}" = --renew ]; then
    { grep '^#' "$list"; echo "$now"; } >"$times.renewed"
    mv "$times.renewed" "$list"
fi
recorded=$(grep -v '^#' "$list")
if ! awk -v now="$now" -v recorded="$recorded" 'BEGIN { exit !(now <= 1.34 * recorded) }'; then
    echo "FAILED: $now times what the dependencies take, more than a third above the $recorded recorded (benches/build_time.sh TIMES --renew)"
    exit 1
fi
