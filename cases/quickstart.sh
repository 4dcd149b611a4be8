#!/usr/bin/env bash
# The main job, from nothing: installs what is missing, builds, runs grains in LIGGGHTS, fits the law, runs the calibrated
# column collapse with and without dilation, writes the report. About ten minutes on two cores; run again, it resumes.
#   bash cases/quickstart.sh [FOLDER]      FOLDER defaults to out/quickstart
set -euo pipefail
folder=${1:+$(realpath -m "$1")}
cd "$(dirname "$0")/.."
folder=${folder:-out/quickstart}
started=$SECONDS

bash cases/install_packages.sh
echo "dem2sph: packages ready after $((SECONDS - started)) s; building" >&2
cmake --preset release -DDEM2SPH_TESTS=OFF >&2
cmake --build --preset release --target dem2sph >&2
echo "dem2sph: built after $((SECONDS - started)) s; running" >&2
build/release/dem2sph run cases/column_collapse/case.toml -o "$folder"
echo "dem2sph: all done after $((SECONDS - started)) s" >&2
