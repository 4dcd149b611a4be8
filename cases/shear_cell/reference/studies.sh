#!/usr/bin/env bash
# Runs the studies of studies.toml into OUT and writes studies.csv beside this script; half a core-hour.
#   bash studies.sh OUT [dem2sph]
set -euo pipefail
here="$(cd "$(dirname "$0")" && pwd)"
out="$1"
program="${2:-dem2sph}"
mkdir -p "$out"
study() {  # NAME KEY VALUES...
  local name="$1" key="$2" value
  shift 2
  for value in "$@"; do
    "$program" sweep "$here/studies.toml" -o "$out/$name-$value" --jobs 2 -q --set "$key=$value"
  done
}
study margin shear_cell.core_margin 1 2 3 4 6
study height shear_cell.grains 900 1200 2400
study time_step shear_cell.time_step_fraction 0.25 0.125 0.0625
study stiffness material.kappa 1000 10000 100000
python3 "$here/table.py" --studies "$out"
