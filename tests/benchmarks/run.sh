#!/usr/bin/env bash
# Whole steps beside the yardstick, in turn, on one thread and on all; prints medians of ratios.
#   bash tests/benchmarks/run.sh [--quick]
# The machine should do nothing else. With PAIR_CLUSTERS=PROGRAM a second pair-rate benchmark is run before and after:
# it takes THREADS and REPEATS and prints lines "2 passes (...) ... N Mps/s". With a `lmp` on the PATH that has the
# package SPH, LAMMPS is to be measured beside it: Debian's has not.
set -euo pipefail
cd "$(dirname "$0")/../.."
cmake --preset release >/dev/null
cmake --build --preset release --target bench_step >/dev/null
program=build/release/tests/benchmarks/bench_step
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
repeats=9
filter='.'
if [ "${1:-}" = --quick ]; then repeats=3; filter='yardstick|step|list|sort'; fi

echo "machine: $(sed -n 's/^model name[[:space:]]*: //p' /proc/cpuinfo | head -1), $(nproc) cores"
if command -v lmp >/dev/null && lmp -h | grep -q 'sph/'; then
  echo "lmp has the package SPH: measure it with the same number of particles and neighbours"
else
  echo "no lmp with the package SPH on the PATH: LAMMPS is not measured"
fi
threads_all=$(nproc)
for threads in 1 $([ "$threads_all" -gt 1 ] && echo "$threads_all"); do
  [ -z "${PAIR_CLUSTERS:-}" ] || "$PAIR_CLUSTERS" "$threads" 5 | grep -E '^##.*double|2 passes' | head -8
  OMP_NUM_THREADS=$threads OMP_PROC_BIND=true "$program" --benchmark_filter="$filter" --benchmark_min_time=0.3 \
    --benchmark_repetitions=$repeats --benchmark_enable_random_interleaving=true --benchmark_format=json \
    >"$folder/$threads.json"
done
python3 tests/benchmarks/ratios.py "$folder"/*.json
