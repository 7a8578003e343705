#!/usr/bin/env bash
# The programs that tests of other languages and counts of instructions run, by one command for all: cargo chooses features of dependencies for each
# command, and builds them again where they differ.
set -euo pipefail
cd "$(dirname "$0")/.."
# What ships is counted. The program, which one test asks for numbers, is the one that the tests have built: with an example, for their features.
cargo build --quiet --release --example export_problem
exec cargo build --quiet --bin spivcal --example peak_memory
