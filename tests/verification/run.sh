#!/usr/bin/env bash
# Runs every verification test, the long ones too (about 40 minutes on two cores), and writes their figures into the tables of
# sph/README.md. Arguments go to ctest: `bash tests/verification/run.sh -R BagnoldLong`; figures of tests that are left
# out are kept from the run before.
set -euo pipefail
cd "$(dirname "$0")/../.."
bash cases/install_packages.sh
cmake --preset release
cmake --build --preset release --target dem2sph test_verification test_verification_long
figures=$PWD/build/release/verification.jsonl
DEM2SPH_RECORD=$figures ctest --test-dir build/release/tests/verification --output-on-failure -j "$(nproc)" "$@" || failed=$?
python3 tests/verification/table.py "$figures" sph/README.md
exit "${failed:-0}"
