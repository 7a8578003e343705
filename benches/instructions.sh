#!/usr/bin/env bash
# Instructions of single calls against those recorded in benches/instructions.txt: fails where one has grown by more than a tenth.
#   benches/instructions.sh            compares
#   benches/instructions.sh --renew    records anew: after a change that is worth its price, or of the compiler
#
# A row is NAME COUNT; `export_problem --once NAME` makes the call inside of a function `measured`, where alone callgrind counts; of a calibration
# from images (calibrate_*), which has a thread of its own, the whole program counts. A new
# row needs a name in examples/export_problem/once.rs, a line with count 0 in the file, and --renew. valgrind shows
# processors with AVX2 but without AVX-512, so that counts are alike on all machines that have AVX2. They are those of the development profile, in which the
# tests are built: what grows there grows in what ships, and a build for release takes longer than all counts.
set -euo pipefail
cd "$(dirname "$0")/.."

list=benches/instructions.txt
if ! command -v valgrind >/dev/null 2>&1; then
    echo "SKIPPED: instruction counts (valgrind is missing: apt-get install valgrind)"
    exit 0
fi
if ! grep -qw avx2 /proc/cpuinfo 2>/dev/null; then
    echo "SKIPPED: instruction counts (recorded on processors with AVX2)"
    exit 0
fi
benches/programs.sh
program=${CARGO_TARGET_DIR:-target}/debug/examples/export_problem

out=$(mktemp)
trap 'rm -f "$out"' EXIT
count() {
    local counted='--toggle-collect=*measured*'
    case $1 in calibrate_*) counted=--collect-atstart=yes ;; esac
    valgrind --tool=callgrind --callgrind-out-file="$out" "$counted" "$program" --once "$1" >/dev/null 2>&1
    sed -n 's/^totals: *//p' "$out"
}

failed=0
rows=$(grep -v '^#' "$list")
head=$(grep '^#' "$list")
renewed=$head
while read -r name recorded; do
    now=$(count "$name")
    renewed+=$'\n'"$name $now"
    echo "$name: $now instructions, recorded $recorded"
    # A count near zero would mean that nothing was counted.
    if [ "$now" -lt 10000 ]; then echo "FAILED: $name: nothing was counted" && failed=1; fi
    if [ "${1:-}" != --renew ] && [ $((now * 10)) -gt $((recorded * 11)) ]; then
        echo "FAILED: $name needs $now instructions, more than a tenth above the $recorded recorded (benches/instructions.sh --renew)"
        failed=1
    fi
done <<<"$rows"
if [ "${1:-}" = --renew ] && [ $failed = 0 ]; then echo "$renewed" >"$list"; fi
exit $failed
