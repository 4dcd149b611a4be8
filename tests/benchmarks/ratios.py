"""Tables of what bench_step measured: medians over the repetitions, and ratios to the yardstick of the same run."""
import json
import statistics
import sys


def medians(path):
    """Name of a benchmark -> (million particle-steps a second, counters)."""
    rates, counters = {}, {}
    for entry in json.load(open(path))["benchmarks"]:
        if entry["run_type"] != "iteration":
            continue
        name = entry["run_name"].replace("/process_time/real_time", "")
        rates.setdefault(name, []).append(entry["items_per_second"] / 1e6)
        counters[name] = entry
    return {name: (statistics.median(values), counters[name]) for name, values in rates.items()}


def main(paths):
    runs = {}
    for path in paths:
        threads = int(path.rsplit("/", 1)[1].split(".")[0])
        runs[threads] = medians(path)
    for threads, found in sorted(runs.items()):
        print(f"\n{threads} thread{'s' if threads > 1 else ''}\n")
        print("| | Mps/s | of the yardstick | bytes a particle, walls included | lane pairs a particle |\n|---|---|---|---|---|")
        for name, (rate, entry) in sorted(found.items()):
            dimension = "3D" if "3D" in name else "2D"
            passes = "4_passes" if "source" in name else "2_passes"
            yardstick = found[f"yardstick/{passes}/{dimension}"][0]
            bytes_ = entry["bytes"] * entry["particles"] / (entry["particles"] + entry["walls"]) if "bytes" in entry else 0
            ratio = f"{100 * rate / yardstick:.0f} %" if name.startswith(("step", "size")) else ""
            print(f"| {name} | {rate:.3f} | {ratio} | {bytes_:.0f} | {entry.get('pairs', 0):.0f} |")
    if len(runs) > 1:
        one, many = min(runs), max(runs)
        print(f"\nspeed-up, {many} threads over {one}\n\n| | |\n|---|---|")
        for name in sorted(set(runs[one]) & set(runs[many])):
            print(f"| {name} | {runs[many][name][0] / runs[one][name][0]:.2f} |")


main(sys.argv[1:])
