#!/usr/bin/env python3
"""Rewrites the tables of sph/README.md from the figures that the verification tests have recorded.

usage: table.py FIGURES.jsonl README.md

Each line of FIGURES is {"test", "formulation", "quantity", "measured", "bar", "unit"}; of repeated ones the last counts.
The tables stand between the lines <!-- verification --> and <!-- /verification -->.
"""
import json
import re
import sys

INGREDIENT = "ingredient: "
BEGIN, END = "<!-- verification -->", "<!-- /verification -->"
COLLAPSE = ["front_99 over L0", "centre height over L0", "time to rest over sqrt(H0/g)",
            "energy unaccounted over set free", "processor time"]


def number(value, digits=3):
    if value is None:
        return "-"
    if value == 0:
        return "0"
    return f"{value:.{digits}g}" if 1e-3 <= abs(value) < 1e4 else f"{value:.1e}"


def with_unit(value, unit, digits=3):
    return number(value, digits) + ("" if unit in ("1", "") or value is None else " " + unit)


def read(path):
    figures = {}
    with open(path, encoding="utf-8") as lines:
        for line in lines:
            f = json.loads(line)
            # A collapse either ends or stops with an error: what it does now replaces what it did before.
            ends = f["quantity"] == COLLAPSE[0]
            if ends or f["quantity"].startswith("stopped"):
                for key in [k for k in figures if k[:2] == (f["test"], f["formulation"]) and
                            (k[2].startswith("stopped") if ends else k[2] in COLLAPSE)]:
                    del figures[key]
            figures[(f["test"], f["formulation"], f["quantity"])] = f
    return list(figures.values())


def cell(figure):
    missed = figure["bar"] is not None and not abs(figure["measured"] or float("nan")) <= figure["bar"]
    return with_unit(figure["measured"], figure["unit"], digits=4) + (" **missed**" if missed else "")


def collapse_table(figures, title, strip=""):
    rows = {}
    stopped = {}
    for f in figures:
        key = (f["test"], f["formulation"])
        if f["quantity"] in COLLAPSE:
            rows.setdefault(key, {})[f["quantity"]] = f
        elif f["quantity"].startswith("stopped"):
            rows.setdefault(key, {})
            stopped[key] = f["quantity"]
    if not rows:
        return []
    out = [f"### {title}", "",
           "| | formulation | front_99/L0 | centre height/L0 | time to rest/tau | energy unaccounted | processor time |",
           "|---|---|---|---|---|---|---|"]
    by_name = strip != INGREDIENT  # those stand in the order in which they were run
    for (test, formulation), values in sorted(rows.items(), key=lambda row: row[0][::-1]) if by_name else rows.items():
        if (test, formulation) in stopped:
            cells = [stopped[(test, formulation)], "", "", "", ""]
        else:
            cells = [cell(values[q]) if q in values else "" for q in COLLAPSE]
        out.append(f"| {test.removeprefix(strip)} | {formulation} | " + " | ".join(cells) + " |")
    return out + [""]


def main():
    figures_path, readme_path = sys.argv[1:3]
    figures = read(figures_path)
    ingredients = [f for f in figures if f["test"].startswith(INGREDIENT)]
    collapse = [f for f in figures if f["test"].startswith("collapse") and
                (f["quantity"] in COLLAPSE or f["quantity"].startswith("stopped"))]
    ids = {id(f) for f in ingredients} | {id(f) for f in collapse}
    rest = [f for f in figures if id(f) not in ids]
    out = [BEGIN, "", "### Against exact solutions and invariants", "",
           "Of several figures of one kind (dimensions, resolutions, kernels: the count is in brackets) the least and the largest.", "",
           "| test | formulation | quantity | measured | bar |", "|---|---|---|---|---|"]
    groups = {}
    for f in rest:
        # "2D, 20 particles a wavelength: what" is one of many figures of its kind.
        what = re.sub(r"^.*?[23]D[^:]*: ", "", f["quantity"]).replace(" (no bar)", "")
        groups.setdefault((f["test"], f["formulation"], what, f["bar"], f["unit"]), []).append(f["measured"])
    for (test, formulation, what, bar, unit), measured in groups.items():
        values = [m for m in measured if m is not None]
        low, high = (min(values), max(values)) if values else (None, None)
        text = with_unit(low, unit) if low == high else f"{number(low)} to {with_unit(high, unit)} ({len(values)})"
        if bar is None:
            bar_text = "reported"
        else:
            at_least = "observed order" in what
            missed = len(values) < len(measured) or any(m < bar if at_least else abs(m) > abs(bar) for m in values)
            bar_text = ("at least " if at_least else "") + with_unit(bar, unit) + (" **missed**" if missed else "")
        out.append(f"| {test} | {formulation} | {what} | {text} | {bar_text} |")
    out.append("")
    out += collapse_table(collapse, "Collapse", "collapse, ")
    out += collapse_table(ingredients, "What each ingredient buys: a = 1, mu = 0.6, H/dx = 40", INGREDIENT)
    out.append(END)
    with open(readme_path, encoding="utf-8") as readme:
        text = readme.read()
    begin, end = text.index(BEGIN), text.index(END) + len(END)
    with open(readme_path, "w", encoding="utf-8") as readme:
        readme.write(text[:begin] + "\n".join(out) + text[end:])


if __name__ == "__main__":
    main()
