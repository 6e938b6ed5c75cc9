#!/usr/bin/env bash
# Response, noise and merge beside the reference, OpenCV, pfstools and luminance-hdr, all in one run (minutes; wants a quiet machine).
# Installs what is missing, builds, prints the tables and writes them into docs/radiometry.md: ./bench/radiometry.sh
set -euo pipefail
cd "$(dirname "$0")/.."
. .ci/setup.sh

install_packages
install_packages bench/debian-packages.txt
build release bench_radiometry

say "measure (about four minutes)"
build/release/bench_radiometry --output build/release/bench/radiometry --document docs/radiometry.md --plot docs/images/radiometry.svg \
  --revision "$(git describe --always --dirty --exclude '*' 2>/dev/null || echo 'not in git')" --command ./bench/radiometry.sh
say "written: docs/radiometry.md, docs/images/radiometry.svg, build/release/bench/radiometry/radiometry.json"
