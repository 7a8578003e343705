#!/usr/bin/env bash
# The optimised programs that tests and benchmarks run, by one command for all: cargo chooses features of dependencies for each command, and
# builds them again where they differ.
set -euo pipefail
cd "$(dirname "$0")/.."
exec cargo build --quiet --release --bin spivcal --example export_problem
