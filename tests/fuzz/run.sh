#!/usr/bin/env bash
# Fuzzes every parser with ASan and UBSan for SECONDS each (600 by default), or those that are named:
#   bash tests/fuzz/run.sh [SECONDS [PARSER...]]
# Corpora stay in build/fuzz/corpus, what is found in build/fuzz/found; the exit code is 1 if anything was.
set -euo pipefail
cd "$(dirname "$0")/../.."
seconds="${1:-600}"
shift || true
parsers=("$@")
[ ${#parsers[@]} -gt 0 ] || parsers=(grain_dump contact_dump wall_series observables frame law case)
bash cases/install_packages.sh
command -v clang++-19 > /dev/null ||
  apt-get install -y --no-install-recommends clang-19 libclang-rt-19-dev > /dev/null
cmake -S . -B build/fuzz -G Ninja -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_C_COMPILER=clang-19 \
  -DCMAKE_CXX_COMPILER=clang++-19 -DDEM2SPH_FUZZ=ON -DDEM2SPH_SANITIZE=fuzzer-no-link,address,undefined > /dev/null
cmake --build build/fuzz --target make_seeds "${parsers[@]/#/fuzz_}"
found=0
for parser in "${parsers[@]}"; do
  corpus="build/fuzz/corpus/$parser"
  mkdir -p "$corpus" build/fuzz/found build/fuzz/seeds
  build/fuzz/tests/fuzz/make_seeds build/fuzz/seeds
  echo "== $parser, $seconds s"
  UBSAN_OPTIONS=halt_on_error=1:print_stacktrace=1 "build/fuzz/tests/fuzz/fuzz_$parser" "$corpus" \
    "build/fuzz/seeds/$parser" -max_total_time="$seconds" -max_len=65536 -timeout=20 -rss_limit_mb=2048 \
    -print_final_stats=1 -artifact_prefix="build/fuzz/found/$parser-" > "build/fuzz/$parser.log" 2>&1 ||
    { found=1; echo "   found something: build/fuzz/$parser.log"; }
  grep -E "stat::number_of_executed_units|stat::average_exec_per_sec|cov:" "build/fuzz/$parser.log" | tail -3 || true
done
rm -f /dev/shm/dem2sph-fuzz-*
exit $found
