#!/usr/bin/env bash
# Stands before the compiler (RUSTC_WRAPPER): adds what it took, in processor seconds, to the file $SPIVCAL_BUILD_TIMES, as `own S NAME` of the crates
# of this package and `other S NAME` of all that it depends on. (Cargo asks the compiler about itself as the crate `___`.)
"$@"
code=$?
name=
while [ $# -gt 1 ]; do
    if [ "$1" = --crate-name ]; then name=$2; fi
    shift
done
if [ -n "${SPIVCAL_BUILD_TIMES:-}" ] && [ -n "$name" ] && [ "$name" != ___ ]; then
    # The second line of `times` is that of children: user and system, as 1m2.345s. A pipe would have children of its own.
    said=$(mktemp)
    times >"$said"
    taken=$(awk 'NR == 2 { split($1, t, /[ms]/); print 60 * t[1] + t[2] }' "$said")
    rm -f "$said"
    whose=other
    if [ -n "${CARGO_PRIMARY_PACKAGE:-}" ]; then whose=own; fi
    echo "$whose $taken $name" >>"$SPIVCAL_BUILD_TIMES"
fi
exit $code
