#!/usr/bin/env python3
"""Rewrites the tables of sph/README.md from the figures that the verification tests have recorded.

usage: table.py FIGURES.jsonl README.md

Each line of FIGURES is {"test", "formulation", "quantity", "measured", "bar", "unit"}; of repeated ones the last counts.
The tables stand between the lines <!-- verification --> and <!-- /verification -->.
"""
import json
import sys

BEGIN, END = "<!-- verification -->", "<!-- /verification -->"
COLLAPSE = ["front_99 over L0", "centre height over L0", "time to rest over sqrt(H0/g)",
            "energy unaccounted over set free", "processor time"]


def number(value):
    if value is None:
        return "-"
    if value == 0:
        return "0"
    return f"{value:.3g}" if 1e-3 <= abs(value) < 1e4 else f"{value:.1e}"


def with_unit(value, unit):
    return number(value) + ("" if unit in ("1", "") or value is None else " " + unit)


def read(path):
    figures = {}
    with open(path, encoding="utf-8") as lines:
        for line in lines:
            f = json.loads(line)
            figures[(f["test"], f["formulation"], f["quantity"])] = f
    return list(figures.values())


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
    for (test, formulation), values in rows.items():
        if (test, formulation) in stopped:
            cells = [stopped[(test, formulation)], "", "", "", ""]
        else:
            cells = [with_unit(values[q]["measured"], values[q]["unit"]) if q in values else "" for q in COLLAPSE]
        out.append(f"| {test[len(strip):]} | {formulation} | " + " | ".join(cells) + " |")
    return out + [""]


def main():
    figures_path, readme_path = sys.argv[1:3]
    figures = read(figures_path)
    ingredients = [f for f in figures if f["test"].startswith("ingredient: ")]
    collapse = [f for f in figures if f["test"].startswith("collapse") and
                (f["quantity"] in COLLAPSE or f["quantity"].startswith("stopped"))]
    ids = {id(f) for f in ingredients} | {id(f) for f in collapse}
    rest = [f for f in figures if id(f) not in ids]
    out = [BEGIN, "", "### Against exact solutions and invariants", "",
           "| test | formulation | quantity | measured | bar |", "|---|---|---|---|---|"]
    for f in rest:
        missed = f["bar"] is not None and f["measured"] is not None and abs(f["measured"]) > abs(f["bar"]) \
            and "order" not in f["quantity"]
        bar = "reported" if f["bar"] is None else with_unit(f["bar"], f["unit"]) + (" **missed**" if missed else "")
        out.append(f"| {f['test']} | {f['formulation']} | {f['quantity']} | "
                   f"{with_unit(f['measured'], f['unit'])} | {bar} |")
    out.append("")
    out += collapse_table(collapse, "Collapse", "collapse, ")
    out += collapse_table(ingredients, "What each ingredient buys: a = 1, mu = 0.6, H/dx = 40", "ingredient: ")
    out.append(END)
    with open(readme_path, encoding="utf-8") as readme:
        text = readme.read()
    begin, end = text.index(BEGIN), text.index(END) + len(END)
    with open(readme_path, "w", encoding="utf-8") as readme:
        readme.write(text[:begin] + "\n".join(out) + text[end:])


if __name__ == "__main__":
    main()
