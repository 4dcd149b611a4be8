#!/usr/bin/env bash
# Installs what is missing, builds (release with assertions) and runs every test but those labelled `long`.
# Any argument goes to ctest: `bash tests/run.sh -R Bagnold`.
set -euo pipefail
cd "$(dirname "$0")/.."
bash cases/install_packages.sh
cmake --preset release-assert
cmake --build --preset release-assert
exec ctest --test-dir build/release-assert --output-on-failure -LE long -j "$(nproc)" "$@"
