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
# All of them first, so that the time is that of fuzzing.
cargo +nightly fuzz build
for target in "${targets[@]}"; do
    learned=fuzz/target/learned/$target
    mkdir -p "$learned"
    echo "== $target: $seconds s"
    cargo +nightly fuzz run "$target" "$learned" "fuzz/corpus/$target" -- \
        -max_total_time="$seconds" -max_len=65536 -timeout=120 -rss_limit_mb=4096 -print_final_stats=1
done
