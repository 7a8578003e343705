#!/usr/bin/env bash
# Builds the library for release from two folders of different names and depths, and compares the bytes.
#   cpp_tests/install/reproducible.sh [WORK]        run by ./check --reproducible; minutes, since each build begins from nothing
set -euo pipefail
root=$(cd "$(dirname "$0")/../.." && pwd)
work=${1:-$(mktemp -d)}
# What nobody named nobody will look for.
if [ $# = 0 ]; then trap 'rm -rf "$work"' EXIT; fi
sums=()
for folder in one "another place/deeper"; do
    rm -rf "${work:?}/$folder"
    mkdir -p "$work/$folder/sources"
    # The files of the commit, as somebody else would have them.
    git -C "$root" archive HEAD | tar -x -C "$work/$folder/sources"
    cmake -DROOT="$work/$folder/sources" -DTARGET="$work/$folder/built" -P "$work/$folder/sources/cmake/build_library.cmake"
    sums+=("$(sha256sum <"$work/$folder/built/release/libspivcal.so")")
    echo "$folder: ${sums[-1]}"
done
if [ "${sums[0]}" != "${sums[1]}" ]; then
    echo "the two libraries differ:" >&2
    cmp -l "$work/one/built/release/libspivcal.so" "$work/another place/deeper/built/release/libspivcal.so" | wc -l >&2
    exit 1
fi
echo "equal: $(stat -c %s "$work/one/built/release/libspivcal.so") bytes"
