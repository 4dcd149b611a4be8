#!/usr/bin/env bash
# Installs the Debian 12 packages that dem2sph builds and runs with, if any is missing.
# Asks sudo when not root; where it may not install, it prints the command for someone who may.
set -euo pipefail

packages=(
  g++ cmake ninja-build git ca-certificates
  liggghts
  libeigen3-dev libhdf5-dev libceres-dev libgtest-dev libcli11-dev libtomlplusplus-dev
  libfmt-dev libspdlog-dev nlohmann-json3-dev librapidcheck-dev libbenchmark-dev libxxhash-dev
  gnuplot-nox valgrind
)

missing=()
for package in "${packages[@]}"; do
  status=$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null || true)
  [ "$status" = installed ] || missing+=("$package")
done
[ ${#missing[@]} -gt 0 ] || exit 0

echo "dem2sph: installing ${missing[*]}" >&2
as_root=()
if [ "$(id -u)" -ne 0 ]; then
  if command -v sudo >/dev/null 2>&1 && { sudo -n true 2>/dev/null || [ -t 0 ]; }; then
    as_root=(sudo)
  else
    echo "dem2sph: cannot install packages without root. Ask an administrator to run:" >&2
    echo "  apt-get update && apt-get install --no-install-recommends ${missing[*]}" >&2
    exit 2
  fi
fi
"${as_root[@]}" apt-get update -q >&2
# liggghts recommends ParaView, which is large and not needed: hence no recommended packages.
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
  apt-get install -y -q --no-install-recommends "${missing[@]}" >&2
