#!/usr/bin/env bash
# The C door under libFuzzer with AddressSanitizer, its time shared by the targets; fails where one finds something.
#   fuzz/run.sh [SECONDS]        600 where none are given; run by ./check --fuzz
# Needs a nightly toolchain; cargo-fuzz is installed where it is missing. What the fuzzer learns stays in fuzz/target; fuzz/corpus is
# read only. An input that fails is kept in fuzz/artifacts and its file named: `cargo +nightly fuzz run TARGET FILE` runs it again.
set -euo pipefail
cd "$(dirname "$0")/.."
targets=(calls rig calibration image)
seconds=$((${1:-600} / ${#targets[@]}))

if ! rustc +nightly --version >/dev/null 2>&1; then rustup toolchain install nightly --profile minimal; fi
if ! cargo fuzz --version >/dev/null 2>&1; then cargo install --quiet --locked cargo-fuzz; fi
# All of them first, so that the time is that of fuzzing; then the programs themselves, since `cargo fuzz run` builds anew where a file
# was touched meanwhile.
cargo +nightly fuzz build
built=fuzz/target/$(rustc +nightly -vV | sed -n 's/^host: //p')/release
# As cargo-fuzz sets it: the library is in the program once as its own and once as a shared one.
export ASAN_OPTIONS="detect_odr_violation=0${ASAN_OPTIONS:+:$ASAN_OPTIONS}"
for target in "${targets[@]}"; do
    learned=fuzz/target/learned/$target
    mkdir -p "$learned" "fuzz/artifacts/$target"
    echo "== $target: $seconds s"
    "$built/$target" "$learned" "fuzz/corpus/$target" -artifact_prefix="fuzz/artifacts/$target/" \
        -max_total_time="$seconds" -max_len=65536 -timeout=120 -rss_limit_mb=4096 -print_final_stats=1
done
