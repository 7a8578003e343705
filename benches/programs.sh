#!/usr/bin/env bash
# The programs that tests of other languages, counts of instructions and benchmarks run, by one command for all: cargo chooses features of dependencies for
# each command, and builds them again where they differ.
#   benches/programs.sh              as the tests are built, whose library is at hand: the check runs these
#   benches/programs.sh --release    as they ship: for what is timed
set -euo pipefail
cd "$(dirname "$0")/.."
exec cargo build --quiet "$@" --bin spivcal --example export_problem --example peak_memory
