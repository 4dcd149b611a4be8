#!/usr/bin/env python3
"""Tables of finished sweeps, written beside this script.

  python3 table.py NAME SWEEP_FOLDER...   NAME_steady.csv and NAME_transients.csv; several folders are one data set
  python3 table.py --studies FOLDER       studies.csv from what studies.sh left in FOLDER

Reads SWEEP_FOLDER/runs/*/done.json. Means over seeds; the error of a mean is the larger of the seeds' spread over the
root of their number and of their own standard errors, combined.
"""
import collections
import csv
import glob
import json
import math
import os
import sys

here = os.path.dirname(os.path.abspath(__file__))


def runs_of(folder):
    return [json.load(open(f)) for f in sorted(glob.glob(os.path.join(folder, "runs", "*", "done.json")))]


def mean_and_error(values, errors=()):
    n = len(values)
    mean = sum(values) / n
    spread = math.sqrt(sum((v - mean) ** 2 for v in values) / (n - 1) / n) if n > 1 else 0
    return mean, max(spread, math.sqrt(sum(e * e for e in errors)) / n)


def write(name, header, rows):
    with open(os.path.join(here, name), "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(header)
        out.writerows(rows)


def average(values):
    return sum(values) / len(values)


steady_header = ["seeds", "I", "I_se", "mu", "mu_se", "phi", "phi_se", "N1", "N1_se", "N2", "N2_se", "beta", "beta_se",
                 "wall_mu", "temperature", "coordination", "fabric_xz", "strain", "overlap_over_d", "core_seconds"]


def steady_row(runs):
    row = [len(runs)]
    for key in ("I", "mu", "phi", "N1", "N2", "beta"):
        results = [r["result"][key] for r in runs]
        row += ["%.6g" % x for x in mean_and_error([r["value"] for r in results],
                                                   [r["standard_error"] for r in results])]
    row.append("%.5g" % average([r["evidence"]["wall_mu"] for r in runs]))
    for key in ("temperature", "coordination", "fabric_xz", "strain"):
        row.append("%.4g" % average([r["result"][key] for r in runs]))
    row.append("%.3g" % average([r["evidence"]["overlap_over_d"] for r in runs]))
    row.append("%.0f" % sum(r["cost"]["cpu_seconds"] for r in runs))
    return row


def studies(folder):
    """Runs that differ from the base, studies.toml, in one thing."""
    def features(run):
        sample = run["sample"]
        kappa = (sample["material"]["youngs_modulus"] / sample["pressure"]) ** (2 / 3)
        return {"core_margin": run["core_margin"], "grains": sample["grains"],
                "time_step_fraction": sample["time_step_fraction"], "kappa": float("%.3g" % kappa)}

    base = {"core_margin": 4, "grains": 1200, "time_step_fraction": 0.25, "kappa": 1000}
    groups = collections.defaultdict(list)
    for run in runs_of(folder):
        if run["kind"] == "steady" and run["shearing"]["I_driven"] == 0.1:
            changed = [(key, value) for key, value in features(run).items() if value != base[key]]
            groups[changed[0] if changed else ("base", 0)].append(run)
    write("studies.csv", ["changed", "to"] + steady_header,
          [[key, "%g" % value] + steady_row(groups[(key, value)]) for key, value in sorted(groups)])


def tables(name, folders):
    done = [run for folder in folders for run in runs_of(folder)]
    steady = collections.defaultdict(list)
    transients = collections.defaultdict(list)
    for run in done:
        shearing = run.get("shearing")
        if run["kind"] == "steady":
            steady[shearing["I_driven"]].append(run)
        elif "s" in run["result"]:
            transients[(run["kind"], run["sample"]["packing_friction"], run["I_before"], shearing["I_driven"],
                        shearing["pressure"])].append(run)
    write(name + "_steady.csv", ["I_driven"] + steady_header,
          [["%g" % driven] + steady_row(steady[driven]) for driven in sorted(steady)])

    rows = []
    print("change of volume: integral of beta; its difference to ln(phi_0/phi_end), mean over seeds with standard error")
    for key in sorted(transients):
        runs = transients[key]
        length = min(len(r["result"]["s"]) for r in runs)
        for k in range(length):
            row = [key[0]] + ["%.6g" % x for x in key[1:]] + [len(runs), "%g" % runs[0]["result"]["s"][k]]
            for quantity in ("phi", "beta", "mu", "p", "I"):
                row += ["%.5g" % x for x in mean_and_error([r["result"][quantity][k] for r in runs])]
            rows.append(row)
        # phi of a window is that of its middle: the integral goes there.
        window = runs[0]["window"]
        opened, closure = [], []
        for r in runs:
            beta, phi = r["result"]["beta"], r["result"]["phi"]
            opened.append(window * (sum(beta) - 0.5 * beta[-1]))
            closure.append(opened[-1] - math.log(r["result"]["phi_0"] / phi[-1]))
        mean, error = mean_and_error(closure)
        print("%-14s packing friction %-4g I %g -> %-9.4g P %g: %+.4f  difference %+.5f +- %.5f (%+.1f)"
              % (*key, average(opened), mean, error, mean / error))
    write(name + "_transients.csv",
          ["kind", "packing_friction", "I_before", "I_driven", "pressure", "seeds", "s", "phi", "phi_se", "beta", "beta_se",
           "mu", "mu_se", "p", "p_se", "I", "I_se"], rows)


if len(sys.argv) == 3 and sys.argv[1] == "--studies":
    studies(sys.argv[2])
elif len(sys.argv) >= 3 and not sys.argv[1].startswith("-"):
    tables(sys.argv[1], sys.argv[2:])
else:
    sys.exit(__doc__)
