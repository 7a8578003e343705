"""What the library for release must be: no path of the machine that built it, stripped, few dependencies, its soname, not large.

    release.py LIBRARY SOURCES...      the folders whose paths must not be in it, besides those of the user and of cargo

Prints size and dependencies. The program that is tested on itself first: a path planted in a copy must be found.
"""
import os
import re
import subprocess
import sys
from pathlib import Path

# All of them belong to the C library and the compiler of every Linux.
ALLOWED = {"libc.so.6", "libm.so.6", "libgcc_s.so.1", "ld-linux-x86-64.so.2", "ld-linux-aarch64.so.1", "libpthread.so.0", "libdl.so.2"}

# A tenth more than the library had when it was measured last (docs/measurements.md).
MOST_BYTES = 12_000_000


def forbidden(sources):
    """Folders of this machine, longest first."""
    home = Path.home()
    folders = {str(home), os.environ.get("CARGO_HOME", str(home / ".cargo")), os.environ.get("RUSTUP_HOME", str(home / ".rustup"))}
    folders |= {str(Path(s).resolve()) for s in sources} | {os.environ.get("TMPDIR", "/tmp")}
    return sorted((f.rstrip("/") + "/" for f in folders if len(f) > 1), key=len, reverse=True)


def paths_in(content, folders):
    found = []
    for folder in folders:
        for hit in re.finditer(re.escape(folder.encode()), content):
            end = min((content.find(b, hit.start()) % (len(content) + 1) for b in (b"\0", b"\n")), default=len(content))
            found.append(content[hit.start():min(end, hit.start() + 120)].decode("latin-1"))
    return found


def sections_and_needed(library):
    text = subprocess.run(["readelf", "--wide", "--sections", "--dynamic", library], check=True, capture_output=True, text=True).stdout
    return set(re.findall(r"\] (\.\S+)", text)), set(re.findall(r"\(NEEDED\).*\[(.*)\]", text)), re.findall(r"\((?:SONAME|RPATH|RUNPATH)\).*", text)


def main():
    library, folders = sys.argv[1], forbidden(sys.argv[2:])
    content = Path(library).read_bytes()
    planted = content + b"\0" + folders[0].encode() + b"src/lib.rs\0"
    assert len(paths_in(planted, folders[:1])) == len(paths_in(content, folders[:1])) + 1, "the search finds nothing"
    faults = [f"a path of this machine: {p}" for p in sorted(set(paths_in(content, folders)))[:20]]
    sections, needed, names = sections_and_needed(library)
    faults += [f"not stripped: it has the section {s}" for s in sections if s == ".symtab" or s.startswith(".debug")]
    faults += [f"needs {n}" for n in needed - ALLOWED]
    if len(names) != 1 or "[libspivcal.so.1]" not in names[0]:
        faults.append(f"soname and search paths: {names}")
    if len(content) > MOST_BYTES:
        faults.append(f"{len(content)} bytes, more than {MOST_BYTES}")
    print(f"{len(content)} bytes, needs {' '.join(sorted(needed))}; {len(sections)} sections")
    # An empty string would be a failure too.
    sys.exit("\n".join(faults) or 0)


if __name__ == "__main__":
    main()
