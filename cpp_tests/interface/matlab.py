"""Calls of a shared library in a MATLAB script, held against its header: what can be checked where there is no MATLAB."""
import re

NUMBERS = {"int32_t": "int32", "uint32_t": "uint32", "uint64_t": "uint64", "double": "double", "float": "single"}


def split(arguments):
    """Splits at commas outside brackets and quotes."""
    parts, depth, quoted, start = [], 0, False, 0
    for i, c in enumerate(arguments):
        if c == "'" and (quoted or i == 0 or arguments[i - 1] in " ,([{"):
            quoted = not quoted
        elif not quoted and c in "([{":
            depth += 1
        elif not quoted and c in ")]}":
            depth -= 1
        elif not quoted and c == "," and depth == 0:
            parts.append(arguments[start:i].strip())
            start = i + 1
    return parts + [arguments[start:].strip()]


def calls(text):
    """Arguments of each calllib(alias, NAME, ...)."""
    for hit in re.finditer(r"\bcalllib\(", text):
        depth, end = 1, hit.end()
        while depth:
            depth += {"(": 1, ")": -1}.get(text[end], 0)
            end += 1
        yield split(text[hit.end():end - 1])[1:]


def fits(argument, kind, pointers):
    """Whether an argument can be what the header wants; variables whose type the script does not say are let pass."""
    base, pointer = kind.rstrip("* "), kind.endswith("*")
    cast = re.fullmatch(r"(u?int(?:8|16|32|64)|single|double)\(.*\)", argument, flags=re.S)
    if argument.startswith("'") or argument.startswith("blanks("):
        return kind == "char *"
    if argument in pointers:
        return pointer and pointers[argument] == NUMBERS.get(base, "?") + "Ptr"
    # A value where a pointer is wanted becomes a pointer to a copy of it.
    return cast is None or NUMBERS.get(base) == cast.group(1)


def check(script, functions, constants):
    """Faults, number of calls, number of constants. `functions`: name -> types of the parameters."""
    text = re.sub(r"%.*", "", script.replace("%.17g", "").replace("%d", "").replace("%s", ""))
    text = re.sub(r"\.\.\.\s*\n", " ", text)
    faults = [f"there is no function {n}" for n in set(re.findall(r"'(spivcal_\w+)'", text)) if n not in functions]
    pointers = dict(re.findall(r"(\w+) = libpointer\('(\w+)'", text))
    # A pointer that was unwrapped under its own name is a number from there on.
    for name in re.findall(r"(\w+) = \1\.Value", text):
        pointers.pop(name, None)
    count = 0
    for name, *arguments in calls(text):
        count += 1
        chosen = [name.strip("'")] if name.startswith("'") else re.findall(rf"\b{name} = '(spivcal_\w+)'", text)
        if not chosen:
            faults.append(f"calllib of {name}: no function is named")
        for function in chosen:
            wanted = functions.get(function, [])
            if len(arguments) != len(wanted):
                faults.append(f"{function}: {len(arguments)} arguments {arguments}, the header has {len(wanted)}")
            faults += [f"{function}: {a} is no {k}" for a, k in zip(arguments, wanted) if not fits(a, k, pointers)]
    named = re.findall(r"\b([A-Z][A-Z0-9_]+) = (-?\d+);", text)
    faults += [f"{n} = {v}, the header says {constants.get('SPIVCAL_' + n)}" for n, v in named if constants.get("SPIVCAL_" + n) != int(v)]
    return faults, count, len(named)
