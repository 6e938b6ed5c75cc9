# Sourced by ./run, ./test and .ci/run: say what happens, install what is missing, build. Debian 12; root or sudo for the packages.
say() { printf '\n== %s\n' "$*"; }
fail() { printf '\n%s: %s\n' "$(basename "$0")" "$*" >&2; exit 1; }

# install_packages [LIST]
install_packages() {
  command -v dpkg-query >/dev/null || fail "this script installs Debian packages and found no dpkg; install the packages of cmake/debian-packages.txt by hand"
  local missing
  missing=$(while read -r package; do
    [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || echo "$package"
  done < "${1:-cmake/debian-packages.txt}")
  if [ -z "$missing" ]; then
    say "packages: all installed"
    return
  fi
  say "packages: installing $(echo $missing)"
  local as_root=""
  if [ "$(id -u)" != 0 ]; then
    command -v sudo >/dev/null || fail "packages are missing and this is neither root nor a machine with sudo; install them and run again: $(echo $missing)"
    as_root=sudo
  fi
  $as_root apt-get update -qq || fail "apt-get update failed; is the network there?"
  $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >/dev/null ||
    fail "apt-get could not install: $(echo $missing)"
}

# build PRESET [TARGET]
build() {
  export CCACHE_SLOPPINESS=pch_defines,time_macros,include_file_mtime,include_file_ctime  # else nothing with a precompiled header is cached
  say "build: preset $1 -> build/$1 (the first time takes minutes)"
  cmake --preset "$1" -DLACQUER_PCH=ON -DCMAKE_CXX_COMPILER_LAUNCHER="$(command -v ccache || true)" >"build-$1.log.tmp" 2>&1 ||
    { cat "build-$1.log.tmp"; rm -f "build-$1.log.tmp"; fail "cmake could not configure preset $1"; }
  rm -f "build-$1.log.tmp"
  cmake --build --preset "$1" --parallel "$(nproc)" --target "${2:-all}" || fail "the build of preset $1 failed"
}
