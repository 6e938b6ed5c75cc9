#!/usr/bin/env bash
# Runs the hard cases of every stage, prints what each does with its figure, and writes the tables of docs/stability.md: ./bench/stability.sh
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/setup.sh

install_packages
build release bench_stability
build/release/bench_stability --document docs/stability.md
say "written: docs/stability.md"
