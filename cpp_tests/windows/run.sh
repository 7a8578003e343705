#!/usr/bin/env bash
# spivcal.dll for Windows (x86_64) with .def and import .lib, and its clients in C under wine: the frozen one, the misuse suite, and the
# story, whose numbers must be those of the program built for this machine.
#   cpp_tests/windows/run.sh [WORK]        run by ./check --windows; WORK is target/windows and keeps what is to be shipped in WORK/dist
# Rust's standard library for the target comes from rustup; where rustup does not have it, it is built from its source (nightly, rust-src).
# Compiler and linker are Debian's mingw; where it cannot be had, zig from PyPI. SPIVCAL_WINDOWS=zig and SPIVCAL_WINDOWS=build-std
# take these other routes although the first is open.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
root=$(cd "$here/../.." && pwd)
work=${1:-$root/target/windows}
triple=x86_64-pc-windows-gnu
lint=(python3 "$root/cpp_tests/interface/lint.py")
header=$root/include/spivcal.h
# shellcheck source=../packages.sh
. "$root/cpp_tests/packages.sh"
fail() {
    echo "windows: $*" >&2
    exit 1
}

mkdir -p "$work/dist"
need python3 python3 || fail "python3 is missing: apt-get install python3"
need cmake cmake || fail "cmake is missing: apt-get install cmake"
need objdump binutils || fail "objdump is missing: apt-get install binutils"
package wine64 && need wine wine || fail "wine is missing: apt-get install wine64 wine"

# --- compiler and linker -----------------------------------------------------------------------------------------------------
if [ "${SPIVCAL_WINDOWS:-}" != zig ] && need x86_64-w64-mingw32-gcc gcc-mingw-w64-x86-64; then
    echo "== mingw"
    compile=(x86_64-w64-mingw32-gcc)
    dlltool=(x86_64-w64-mingw32-dlltool -m i386:x86-64)
else
    echo "== zig in place of mingw"
    python3 -m pip --version >/dev/null 2>&1 || package python3-pip || fail "neither mingw nor pip: apt-get install gcc-mingw-w64-x86-64"
    python3 -m pip install --quiet --upgrade --target "$work/zig" ziglang==0.13.0 || fail "pip cannot install ziglang"
    export PYTHONPATH="$work/zig${PYTHONPATH:+:$PYTHONPATH}" CARGO_TARGET_X86_64_PC_WINDOWS_GNU_LINKER=$here/zig_linker.sh
    compile=(python3 -m ziglang cc -target x86_64-windows-gnu)
    dlltool=(python3 -m ziglang dlltool -m i386:x86-64)
fi
# The import library that Microsoft's linker likes best, where LLVM is there.
if have llvm-dlltool; then dlltool=(llvm-dlltool -m i386:x86-64); fi

# --- the library -------------------------------------------------------------------------------------------------------------
has_std() { [ -d "$(rustc --print sysroot)/lib/rustlib/$triple/lib" ]; }
if [ "${SPIVCAL_WINDOWS:-}" != build-std ] && { has_std || { have rustup && rustup target add $triple && has_std; }; }; then
    std=()
else
    echo "== the standard library from its source"
    [ -d "$(rustc +nightly --print sysroot 2>/dev/null)/lib/rustlib/src/rust/library" ] ||
        { have rustup && rustup toolchain install nightly --profile minimal --component rust-src; } ||
        fail "rustup has neither the target $triple nor a nightly toolchain with rust-src"
    toolchain=nightly
    std=(-Zbuild-std=std,panic_unwind)
fi
RUSTUP_TOOLCHAIN=${toolchain:-${RUSTUP_TOOLCHAIN:-}} cmake -DROOT="$root" -DTARGET="$work" -DTRIPLE=$triple \
    -DRUSTC="cargo rustc ${std[*]:-}" -P "$root/cmake/build_library.cmake"
dll=$work/$triple/release/spivcal.dll
cp "$dll" "$work/dist/"
cp "$header" "$root/include/spivcal.hpp" "$root/include/spivcal_labview.h" "$work/dist/"
cd "$work/dist"
"${lint[@]}" def "$header" spivcal.def
"${dlltool[@]}" -d spivcal.def -l spivcal.lib
objdump -p spivcal.dll >"$work/listing"
"${lint[@]}" exports "$header" "$work/listing"
"${lint[@]}" paths spivcal.dll "$root" "$HOME/"
imports=$(sed -n 's/^\s*DLL Name: //p' "$work/listing" | sort -uf)
echo "$(stat -c %s spivcal.dll) bytes, sha256 $(sha256sum <spivcal.dll | cut -c1-16), needs" $imports
# A compiler's own libraries would have to be shipped too.
if grep -qiE '^lib' <<<"$imports"; then fail "the library needs more than Windows has"; fi

# --- clients under wine ------------------------------------------------------------------------------------------------------
export WINEPREFIX=$work/prefix WINEDEBUG=-all WINEDLLOVERRIDES="mscoree,mshtml="
wine wineboot --init >/dev/null 2>&1 || fail "wine does not start"
flags=(-std=c99 -O1 -Wall -Wextra -Wno-unused-parameter)
"${compile[@]}" "${flags[@]}" -I"$root/include" "$root/ffi_examples/story.c" spivcal.lib -o story.exe
"${compile[@]}" "${flags[@]}" -I"$root/include" "$root/cpp_tests/interface/misuse.c" spivcal.lib -o misuse.exe
"${compile[@]}" "${flags[@]}" -I"$root/cpp_tests/interface/frozen" "$root/cpp_tests/interface/frozen/client.c" spivcal.lib -o frozen.exe
mkdir -p "$work/clients"
mv story.exe misuse.exe frozen.exe "$work/clients/"
cp spivcal.dll "$work/clients/"
if [ ! -e "$WINEPREFIX/drive_c/windows/system32/bcryptprimitives.dll" ]; then
    echo "== wine lacks bcryptprimitives.dll: a stand-in"
    "${compile[@]}" -O1 -shared "$here/bcryptprimitives.c" -ladvapi32 -o "$work/clients/bcryptprimitives.dll"
fi
cd "$work/clients"
example=$root/examples/printed
# Exit code 1 says "flagged", which is an answer.
(cd "$root" && cargo build --quiet --bin spivcal)
"${CARGO_TARGET_DIR:-$root/target}/debug/spivcal" calibrate --quiet "$example/rig.toml" -o "$work/program" || [ $? = 1 ]
json=$work/program/calibration.json
for client in frozen misuse; do
    echo "== $client"
    wine $client.exe "$json"
done
echo "== story"
# Functions of the C library differ in their last bits between systems, the adjustment ends within its own tolerance.
python3 "$root/ffi_examples/compare.py" --sigmas 1e-6 "$json" wine story.exe "$example/rig.toml" "$example" "$work/saved.json"
wineserver -k 2>/dev/null || true
echo "spivcal.dll, spivcal.def and spivcal.lib are in $work/dist"
