#!/usr/bin/env python3
"""What the header declares, seen by others.

lint.py symbols HEADER LIBRARY      the exported symbols are those of the header, no more and no less
lint.py types HEADER                pycparser reads it; every type is one of the list
lint.py stub HEADER SOURCE          writes a library of empty functions with the header's types, for abidiff
lint.py break HEADER OTHER          writes the header with one parameter's type changed: abidiff must see it
lint.py shorten HEADER OTHER        writes the header without one function: abidiff must see that too
lint.py paths LIBRARY PATH...       none of the paths is in the library
lint.py bindings HEADER RUST        bindgen's translation has every function with its types, and every constant with its value
lint.py matlab HEADER SCRIPT        calls of a MATLAB script: functions that there are, arguments in number and type, constants
lint.py def HEADER FILE             writes the module definition of the Windows library
lint.py exports HEADER LISTING      the listing of a DLL (objdump -p) exports the header's functions, no more and no less
"""
import re
import subprocess
import sys

# The sources stay as they are.
sys.dont_write_bytecode = True
import matlab  # noqa: E402

TYPES = {"int32_t", "uint32_t", "uint64_t", "uint16_t", "uint8_t", "float", "double", "char"}


def declarations(header):
    with open(header, encoding="utf-8") as file:
        text = re.sub(r"/\*.*?\*/", "", file.read(), flags=re.S)
    text = "\n".join(line for line in text.splitlines() if not line.startswith("#") and 'extern "C"' not in line)
    return [" ".join(d.split()) for d in text.split(";") if "(" in d]


def name_of(declaration):
    return re.search(r"(\w+)\(", declaration).group(1)


def parameters(declaration):
    """Types of the parameters as the header spells them, without const and names: ["uint64_t", "double *"]."""
    inside = declaration[declaration.index("(") + 1:declaration.rindex(")")].replace("const ", "")
    return [] if inside == "void" else [re.sub(r"\w+$", "", p.strip()).strip() for p in inside.split(",")]


def constants(header):
    with open(header, encoding="utf-8") as file:
        return {n: int(v) for n, v in re.findall(r"^#define (SPIVCAL_\w+) (-?\d+)$", file.read(), flags=re.M)}


def symbols(header, library):
    wanted = {name_of(d) for d in declarations(header)}
    out = subprocess.run(["nm", "--dynamic", "--defined-only", library], check=True, stdout=subprocess.PIPE).stdout.decode()
    found = {line.split()[-1] for line in out.splitlines()}
    assert len(wanted) > 30
    assert found == wanted, f"only in the library: {sorted(found - wanted)}, only in the header: {sorted(wanted - found)}"
    soname = subprocess.run(["readelf", "-d", library], check=True, stdout=subprocess.PIPE).stdout.decode()
    assert "[libspivcal.so.1]" in soname, soname
    print(f"{len(wanted)} symbols")


def types(header):
    try:
        from pycparser import c_ast, c_parser
    except ImportError:
        print("SKIPPED: the header read by pycparser (pip install pycparser)")
        sys.exit(77)
    with open(header, encoding="utf-8") as file:
        text = re.sub(r"/\*.*?\*/", "", file.read(), flags=re.S)
    # pycparser reads preprocessed text: comments and the preprocessor's lines are not its business.
    text = re.sub(r"#ifdef __cplusplus.*?#endif[^\n]*", "", text, flags=re.S)
    text = "\n".join("" if line.startswith("#") else line for line in text.splitlines())
    known = "".join(f"typedef int {t};\n" for t in sorted(TYPES) if t.endswith("_t"))

    def check(tree):
        faults, count = [], 0
        for node in tree.ext:
            if isinstance(node, c_ast.Typedef):
                continue
            count += 1
            assert isinstance(node, c_ast.Decl) and isinstance(node.type, c_ast.FuncDecl), node.name
            for p in ([node.type] + list(node.type.args.params)):
                kind, stars = p.type, 0
                while isinstance(kind, c_ast.PtrDecl):
                    kind, stars = kind.type, stars + 1
                words = kind.type.names if isinstance(kind, c_ast.TypeDecl) and hasattr(kind.type, "names") else ["?"]
                alone = words == ["void"] and len(node.type.args.params) == 1 and stars == 0
                if not alone and (stars > 1 or len(words) != 1 or words[0] not in TYPES):
                    faults.append(f"{node.name}: {words} {'*' * stars}")
        return faults, count

    faults, count = check(c_parser.CParser().parse(known + text))
    assert not faults and count > 30, faults
    for wrong in ["int32_t f(double **a);", "int32_t f(void *a);", "int32_t f(long a);", "void f(struct s *a);"]:
        assert check(c_parser.CParser().parse(known + wrong))[0], f"the lint lets {wrong} pass"
    print(f"{count} functions")


def stub(header, source):
    with open(source, "w", encoding="utf-8") as file:
        file.write('#include "spivcal.h"\n')
        for d in declarations(header):
            arguments = re.findall(r"(\w+)(?=[,)])", d[d.index("("):])
            used = "".join(f" (void){a};" for a in arguments if a != "void")
            file.write(f"{d} {{{used} return 0; }}\n")


def break_header(header, other):
    with open(header, encoding="utf-8") as file:
        text = file.read()
    assert "const double *z_mm" in text
    with open(other, "w", encoding="utf-8") as file:
        file.write(text.replace("const double *z_mm", "const float *z_mm"))


def shorten(header, other):
    with open(header, encoding="utf-8") as file:
        text, removed = re.subn(r"int32_t spivcal_job_wait\([^;]*;", "", file.read())
    assert removed == 1
    with open(other, "w", encoding="utf-8") as file:
        file.write(text)


def paths(library, *unwanted):
    with open(library, "rb") as file:
        content = file.read()
    found = [p for p in unwanted if p and p.encode() in content]
    assert not found, f"the library holds paths of the machine that built it: {found}"
    print(f"none of {len(unwanted)} paths")


RUST = {"int32_t": "i32", "uint32_t": "u32", "uint64_t": "u64", "uint16_t": "u16", "uint8_t": "u8", "float": "f32", "double": "f64",
        "char": "::std::os::raw::c_char"}


def bindings(header, rust):
    with open(rust, encoding="utf-8") as file:
        text = " ".join(file.read().split())
    found = {}
    for name, inside, result in re.findall(r"pub fn (spivcal_\w+)\((.*?)\) -> (\w+);", text):
        found[name] = ([p.split(": ", 1)[1].strip() for p in inside.split(", ") if p], result)

    def spelled(declaration):
        out = []
        for p in declaration[declaration.index("(") + 1:declaration.rindex(")")].split(","):
            word = re.search(r"\b(" + "|".join(RUST) + r")\b", p)
            pointer = ("*const " if "const " in p else "*mut ") if "*" in p else ""
            out += [pointer + RUST[word.group(1)]] if word else []
        return out, RUST[declaration.split()[0]]

    wanted = {name_of(d): spelled(d) for d in declarations(header)}
    assert len(wanted) > 30 and found == wanted, {n: (found.get(n), wanted.get(n)) for n in {*found, *wanted} if found.get(n) != wanted.get(n)}
    values = {n: int(v) for n, v in re.findall(r"pub const (SPIVCAL_\w+): [iu]32 = (-?\d+);", text)}
    assert values == constants(header), set(values.items()) ^ set(constants(header).items())
    print(f"{len(wanted)} functions, {len(values)} constants")


def matlab_script(header, script):
    functions = {name_of(d): parameters(d) for d in declarations(header)}
    with open(script, encoding="utf-8") as file:
        text = file.read()
    faults, calls, named = matlab.check(text, functions, constants(header))
    assert not faults, "\n".join(faults)
    # The check itself: what is wrong must be found.
    for right, wrong in [("'spivcal_rig_load'", "'spivcal_rig_lode'"), ("uint64(0), uint64(3), u", "uint64(3), u"),
                         ("int32(key), uint64(index)", "uint64(key), uint64(index)"), ("COUNT_CAMERAS = 211", "COUNT_CAMERAS = 212"),
                         ("x = libpointer('doublePtr'", "x = libpointer('singlePtr'"), ("context, rig_file", "rig_file")]:
        assert right in text and matlab.check(text.replace(right, wrong), functions, constants(header))[0], f"{wrong} passes"
    print(f"{calls} calls, {named} constants")


def definition(header, path):
    with open(path, "w", encoding="utf-8") as file:
        file.write("LIBRARY spivcal.dll\nEXPORTS\n" + "".join(f"    {name_of(d)}\n" for d in declarations(header)))


def exports(header, listing):
    with open(listing, encoding="utf-8") as file:
        table = file.read().split("[Ordinal/Name Pointer] Table", 1)[1]
    found = set(re.findall(r"^\s*\[\s*\d+\].*?\s(\w+)$", table.split("\n\n", 1)[0], flags=re.M))
    wanted = {name_of(d) for d in declarations(header)}
    assert found == wanted, f"only in the library: {sorted(found - wanted)}, only in the header: {sorted(wanted - found)}"
    print(f"{len(found)} exports")


if __name__ == "__main__":
    tasks = {"symbols": symbols, "types": types, "stub": stub, "break": break_header, "shorten": shorten, "paths": paths, "bindings": bindings,
             "matlab": matlab_script, "def": definition, "exports": exports}
    tasks[sys.argv[1]](*sys.argv[2:])
