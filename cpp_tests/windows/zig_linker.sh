#!/usr/bin/env bash
# Links a Windows library for rustc with zig from PyPI (on PYTHONPATH), in place of mingw's gcc:
#   CARGO_TARGET_X86_64_PC_WINDOWS_GNU_LINKER=zig_linker.sh
# Three things that `zig cc` would do otherwise: it knows no .def files, so that the exports are written as directives into an object; the
# unwinder it brings exports its own functions, so that its sources are compiled without; and its compiler-rt repeats what Rust brings.
set -euo pipefail
zig=(python3 -m ziglang)
target=(-target x86_64-windows-gnu)
unwind=$(python3 -c 'import ziglang, os; print(os.path.dirname(ziglang.__file__))')/lib/libunwind
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
out=
given=()
while [ $# -gt 0 ]; do
    case $1 in
        -o)
            out=$2
            shift
            ;;
        -Wl,*.def)
            {
                echo '.section .drectve,"yni"'
                sed -n 's/^ *"\(.*\)".*/.ascii " -export:\1"/p' "${1#-Wl,}"
            } >"$work/exports.s"
            ;;
        # Flags of gcc's linker that say nothing of what goes into the library.
        -Wl,*) ;;
        # gcc's own libraries.
        -lgcc* | -lmingw* | -lmsvcrt | -l:*) ;;
        # zig goes by the ending.
        *.rlib)
            library=$work/$(basename "$1" .rlib).a
            cp "$1" "$library"
            given+=("$library")
            ;;
        -l* | *.o | *.a) given+=("$1") ;;
        *) ;;
    esac
    shift
done
if [ ! -e "$work/exports.s" ] || [ -z "$out" ]; then
    echo "zig_linker.sh: expected -o FILE and a .def file of exports, as rustc gives them for a cdylib" >&2
    exit 1
fi
flags=(-O2 -DNDEBUG -D_LIBUNWIND_HIDE_SYMBOLS -D_LIBUNWIND_IS_NATIVE_ONLY -fno-exceptions -funwind-tables -I"$unwind/include")
objects=()
for source in libunwind.cpp Unwind-seh.cpp UnwindLevel1.c UnwindLevel1-gcc-ext.c UnwindRegistersSave.S UnwindRegistersRestore.S; do
    case $source in
        *.cpp) compile=(c++ -fno-rtti) ;;
        *) compile=(cc) ;;
    esac
    "${zig[@]}" "${compile[@]}" "${target[@]}" "${flags[@]}" -w -c "$unwind/src/$source" -o "$work/$source.o"
    objects+=("$work/$source.o")
done
"${zig[@]}" cc "${target[@]}" -w -c "$work/exports.s" -o "$work/exports.o"
"${zig[@]}" build-lib -dynamic "${target[@]}" -OReleaseFast -fstrip -fno-compiler-rt -lc \
    "${given[@]}" "${objects[@]}" "$work/exports.o" -femit-bin="$out" -fno-emit-implib
