#!/usr/bin/env python3
"""Tables of a sweep: python3 table.py SWEEP_FOLDER writes steady.csv and transients.csv beside this script.

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
done = [json.load(open(f)) for f in sorted(glob.glob(os.path.join(sys.argv[1], "runs", "*", "done.json")))]


def mean_and_error(values, errors):
    n = len(values)
    mean = sum(values) / n
    spread = math.sqrt(sum((v - mean) ** 2 for v in values) / (n - 1) / n) if n > 1 else 0
    return mean, max(spread, math.sqrt(sum(e * e for e in errors)) / n)


def write(name, header, rows):
    with open(os.path.join(here, name), "w", newline="") as file:
        out = csv.writer(file, lineterminator="\n")
        out.writerow(header)
        out.writerows(rows)


steady = collections.defaultdict(list)
for run in done:
    if run["kind"] == "steady":
        steady[run["shearing"]["I_driven"]].append(run)
rows = []
for driven in sorted(steady):
    runs = steady[driven]
    row = ["%g" % driven, len(runs)]
    for key in ("I", "mu", "phi", "N1", "N2", "beta"):
        results = [r["result"][key] for r in runs]
        row += ["%.6g" % x for x in mean_and_error([r["value"] for r in results],
                                                   [r["standard_error"] for r in results])]
    row.append("%.5g" % (sum(r["evidence"]["wall_mu"] for r in runs) / len(runs)))
    for key in ("temperature", "coordination", "fabric_xz", "strain"):
        row.append("%.4g" % (sum(r["result"][key] for r in runs) / len(runs)))
    row.append("%.3g" % (sum(r["evidence"]["overlap_over_d"] for r in runs) / len(runs)))
    row.append("%.0f" % sum(r["cost"]["cpu_seconds"] for r in runs))
    rows.append(row)
write("steady.csv",
      ["I_driven", "seeds", "I", "I_se", "mu", "mu_se", "phi", "phi_se", "N1", "N1_se", "N2", "N2_se", "beta", "beta_se",
       "wall_mu", "temperature", "coordination", "fabric_xz", "strain", "overlap_over_d", "core_seconds"], rows)

transients = collections.defaultdict(list)
for run in done:
    if "s" in run["result"]:
        shearing = run["shearing"]
        transients[(run["kind"], run["sample"]["packing_friction"], run["I_before"], shearing["I_driven"],
                    shearing["pressure"])].append(run)
rows = []
print("change of volume: integral of beta against ln(phi_0/phi_end), mean over seeds, difference in its standard errors")
for key in sorted(transients):
    runs = transients[key]
    length = min(len(r["result"]["s"]) for r in runs)
    for k in range(length):
        row = [key[0]] + ["%.6g" % x for x in key[1:]] + [len(runs), "%g" % runs[0]["result"]["s"][k]]
        for name in ("phi", "beta", "mu", "p", "I"):
            row += ["%.5g" % x for x in mean_and_error([r["result"][name][k] for r in runs], [0] * len(runs))]
        rows.append(row)
    # phi of a window is that of its middle: the integral goes there.
    window = runs[0]["window"]
    closure = []
    opened = []
    for r in runs:
        beta, phi = r["result"]["beta"], r["result"]["phi"]
        integral = window * (sum(beta) - 0.5 * beta[-1])
        opened.append(integral)
        closure.append(integral - math.log(r["result"]["phi_0"] / phi[-1]))
    mean, error = mean_and_error(closure, [0] * len(closure))
    print("%-14s packing friction %-4g I %g -> %-9.4g P %g: %+.4f  difference %+.5f +- %.5f (%+.1f)"
          % (*key, sum(opened) / len(opened), mean, error, mean / error))
write("transients.csv",
      ["kind", "packing_friction", "I_before", "I_driven", "pressure", "seeds", "s", "phi", "phi_se", "beta", "beta_se", "mu",
       "mu_se", "p", "p_se", "I", "I_se"], rows)
