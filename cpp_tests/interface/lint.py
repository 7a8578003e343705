#!/usr/bin/env python3
"""What the header declares, seen by others.

lint.py symbols HEADER LIBRARY      the exported symbols are those of the header, no more and no less
lint.py types HEADER                pycparser reads it; every type is one of the list
lint.py stub HEADER SOURCE          writes a library of empty functions with the header's types, for abidiff
lint.py break HEADER OTHER          writes the header with one parameter's type changed: abidiff must see it
lint.py paths LIBRARY PATH...       none of the paths is in the library
"""
import re
import subprocess
import sys

TYPES = {"int32_t", "uint32_t", "uint64_t", "uint16_t", "uint8_t", "float", "double", "char"}


def declarations(header):
    with open(header, encoding="utf-8") as file:
        text = re.sub(r"/\*.*?\*/", "", file.read(), flags=re.S)
    text = "\n".join(line for line in text.splitlines() if not line.startswith("#") and 'extern "C"' not in line)
    return [" ".join(d.split()) for d in text.split(";") if "(" in d]


def name_of(declaration):
    return re.search(r"(\w+)\(", declaration).group(1)


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


def paths(library, *unwanted):
    with open(library, "rb") as file:
        content = file.read()
    found = [p for p in unwanted if p and p.encode() in content]
    assert not found, f"the library holds paths of the machine that built it: {found}"
    print(f"none of {len(unwanted)} paths")


if __name__ == "__main__":
    {"symbols": symbols, "types": types, "stub": stub, "break": break_header, "paths": paths}[sys.argv[1]](*sys.argv[2:])
