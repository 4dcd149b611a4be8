#!/usr/bin/env bash
# Runs the studies of studies.toml into OUT, one folder whose runs they share, and writes studies.csv beside this
# script; three quarters of a core-hour.
#   bash studies.sh OUT [dem2sph]
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
out="$1"
program="${2:-dem2sph}"
study() {  # KEY VALUES...
  local key="$1" value
  shift
  for value in "$@"; do "$program" sweep "$here/studies.toml" -o "$out" --jobs 2 -q --set "$key=$value"; done
}
study shear_cell.core_margin 2 4 6
study shear_cell.grains 900 2400
study shear_cell.time_step_fraction 0.125
study material.kappa 10000
# The same state without dimensions, but softer grains under a smaller load: LIGGGHTS takes no Young's modulus above 1 GPa
# in SI units.
"$program" sweep "$here/studies.toml" -o "$out" --jobs 2 -q --set material.kappa=100000 --set 'shear_cell.pressure=31 Pa'
python3 "$here/table.py" --studies "$out"
