#!/usr/bin/env bash
# The whole chain over its accuracy knobs, error beside time; writes docs/benchmarks.md and its plot. Wants a quiet machine.
#   ./bench/benchmarks.sh            some ten minutes
#   ./bench/benchmarks.sh --quick    two paints, two values per knob
#   ./bench/benchmarks.sh --full     also the paper's plan from raw frames on disk: 12 GB, of which 8 stay for the next run
#   ./bench/benchmarks.sh --only full  one part of the document: peers, knobs or full
#   LACQUER_BENCH_FOLDER=DIR         where sessions and frames go, instead of build/release/bench/chain-run
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/setup.sh

install_packages
build release lacquer
build release bench_chain
build/release/bench_chain "$@" --folder "${LACQUER_BENCH_FOLDER:-build/release/bench/chain-run}" --document docs/benchmarks.md --plot docs/images/benchmarks.svg \
  --revision "$(git describe --always --dirty --exclude '*' 2>/dev/null || echo 'not in git')" --command "./bench/benchmarks.sh $*"
say "written: docs/benchmarks.md, docs/images/benchmarks.svg"
