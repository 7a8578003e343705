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
# Of a hundred and fifty dependencies; where a few were built anew the ratio says nothing.
if [ "$(grep -c '^other ' "$times")" -lt 100 ] || ! grep -q '^own .* spivcal$' "$times"; then
    echo "SKIPPED: build time (a part of the build was at hand; in a clean clone all of it is made)"
    exit 0
fi
read -r own other now < <(awk '{ s[$1] += $2 } END { printf "%.0f %.0f %.2f\n", s["own"], s["other"], s["own"] / s["other"] }' "$times")
echo "own $own s, dependencies $other s, ratio $now"
if [ "${2-}" = --renew ]; then
    { grep '^#' "$list"; echo "$now"; } >"$times.renewed"
    mv "$times.renewed" "$list"
fi
recorded=$(grep -v '^#' "$list")
if ! awk -v now="$now" -v recorded="$recorded" 'BEGIN { exit !(now <= 1.34 * recorded) }'; then
    echo "FAILED: $now times what the dependencies take, more than a third above the $recorded recorded (benches/build_time.sh TIMES --renew)"
    exit 1
fi
