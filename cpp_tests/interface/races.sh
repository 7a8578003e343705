#!/usr/bin/env bash
# The hosts with many threads and the misuse suite under ThreadSanitizer, library, standard library and hosts instrumented.
#   cpp_tests/interface/races.sh [WORK] [CALIBRATION.json]        run by ./check --races; WORK is target/races
# Needs nightly with rust-src (installed where rustup may) and g++. The runtime is that of the Rust compiler, the only one in the process.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=${1:-$root/target/races}
triple=$(rustc -vV | sed -n 's/^host: //p')
json=${2:-$root/fuzz/corpus/calibration/scene.json}

sysroot=$(rustc +nightly --print sysroot 2>/dev/null) || true
if [ ! -d "${sysroot:-/nowhere}/lib/rustlib/src/rust/library" ]; then
    rustup toolchain install nightly --profile minimal --component rust-src
    sysroot=$(rustc +nightly --print sysroot)
fi
runtime=$sysroot/lib/rustlib/$triple/lib/librustc-nightly_rt.tsan.a
cd "$root"
# Races do not hide behind optimisation, and less of it is built in half the time. Reads and writes of more than 16 bytes would not be watched.
RUSTFLAGS="-Zsanitizer=thread --cfg spivcal_narrow" CARGO_TARGET_DIR="$work" cargo +nightly rustc --quiet --lib --no-default-features \
    --crate-type staticlib --target "$triple" -Zbuild-std --config 'profile.dev.package."*".opt-level=1'
library=$work/$triple/debug/libspivcal.a
host() {
    local name=$1 compiler=$2
    shift 2
    # Instrumented by this compiler, but linked with the other's runtime.
    "$compiler" "$@" -fsanitize=thread -g -O1 -fPIE -I"$root/include" -I"$here" -c -o "$work/$name.o"
    g++ "$work/$name.o" "$library" -Wl,--whole-archive "$runtime" -Wl,--no-whole-archive -rdynamic -pie -lpthread -ldl -lm -lrt -o "$work/$name"
}
host race_is_seen g++ -std=c++17 "$here/race_is_seen.cpp"
host concurrent g++ -std=c++17 "$here/concurrent.cpp"
host misuse gcc -std=c99 "$here/misuse.c"
export TSAN_OPTIONS="halt_on_error=0 exitcode=66 second_deadlock_stack=1"
echo "== a race in the library's writes must be seen"
if "$work/race_is_seen" "$json" 2>"$work/seen.txt"; then
    echo "ThreadSanitizer saw nothing" >&2
    exit 1
fi
grep -q "WARNING: ThreadSanitizer: data race" "$work/seen.txt" && grep -q "spivcal" "$work/seen.txt"
for name in concurrent misuse; do
    echo "== $name"
    "$work/$name" "$json"
done
