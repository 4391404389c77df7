"""Exam on records of drives: strokes, force steps and steady runs drawn at random, as a table.

``python tests/exam/drive_records.py docs/drive_records_table.md [--draws 120] [--first 10000] [--jobs 1]``
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pandas as pd
from truth.drive_rig import draw, truths

from process.errors import InputError
from process.labels import make_record
from smfe.identification.drive.parameters import identify_drive

KINDS = {"stroke": "one stroke", "strokes": "strokes to and fro", "step": "steps of the force", "runs": "steady runs"}
NAMES = {"inertia": 0, "coulomb": 1, "viscous": 2, "static": 3, "stribeck_speed": 4}


def outcomes(seed: int, kind: str) -> list[dict[str, object]]:
    """Return a row a parameter: whether a value is given, whether its interval holds, its error and width."""
    rig, r = draw(seed, kind)
    names = ("encoder_angle", "drive_torque") if rig.rotary else ("encoder_position", "drive_force")
    channels = dict(zip(names, ({"x": r["place"]}, {"x": r["force"]}), strict=True))
    head = {"record": KINDS[kind], "drive": "rotary" if rig.rotary else "linear", "seed": seed}
    try:
        found = identify_drive("m", [make_record(r["time"], channels)]).parameters
    except InputError as error:
        return [head | {"parameter": "inertia", "given": False, "sentence": str(error)}]
    rows = []
    for p in found:
        truth = truths(rig).get((p.name, p.direction))
        # Without a Stribeck curve there is no Stribeck speed that could be right.
        curved = rig.static[0] > rig.coulomb[0]
        if truth is None or (p.name == "stribeck_speed" and not curved and math.isnan(p.value)):
            continue
        row = head | {"parameter": p.name, "direction": p.direction, "given": math.isfinite(p.value)}
        if row["given"]:
            held = p.low <= truth <= p.high and (curved or p.name != "stribeck_speed")
            width = 0.5 * (p.high - p.low) / abs(p.value)
            row |= {"held": held, "error": abs(p.value / truth - 1.0), "width": width}
        rows.append(row)
    return rows


def table(rows: pd.DataFrame, first: int, draws: int) -> str:
    """Return the outcomes by record and parameter as Markdown."""
    lines = ["| record | parameter | asked | given | median error | median half width | 95 % intervals that hold |"]
    lines += ["| --- " * 7 + "|"]
    groups = [(key, part) for key, part in rows.groupby(["record", "parameter"])]
    order = list(KINDS.values())
    groups.sort(key=lambda item: (order.index(item[0][0]), NAMES[item[0][1]]))
    groups += [(("all, linear", "all"), rows[rows["drive"] == "linear"])]
    groups += [(("all, rotary", "all"), rows[rows["drive"] == "rotary"])]
    for (record, parameter), part in groups:
        given = part[part["given"]]
        text = f"| {record} | {parameter.replace('_', ' ')} | {len(part)} | {len(given)} |"
        if len(given):
            held = given["held"].astype(float)
            text += f" {100 * given['error'].median():.2g} % | {100 * given['width'].median():.2g} % |"
            text += f" {int(held.sum())} of {len(given)}, {100 * held.mean():.0f} % |"
        else:
            text += " | | |"
        lines.append(text)
    return "\n".join([*lines, "", f"{draws} records, seeds {first} to {first + draws - 1}.", ""])


def main() -> None:
    """Draw, identify, count."""
    parser = argparse.ArgumentParser()
    parser.add_argument("target", type=Path)
    parser.add_argument("--draws", type=int, default=120)
    parser.add_argument("--first", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    names = list(KINDS)
    seeds = range(given.first, given.first + given.draws)
    with ProcessPoolExecutor(given.jobs) as pool:
        parts = pool.map(outcomes, seeds, [names[k % len(names)] for k in range(given.draws)])
        rows = pd.DataFrame([row for part in parts for row in part])
    missed = rows[rows["given"] & (rows["held"] == False)]  # noqa: E712
    print(missed.to_string())
    if "sentence" in rows:
        print(rows["sentence"].dropna().to_string())
    given.target.write_text(table(rows, given.first, given.draws))
    print(given.target.read_text())


if __name__ == "__main__":
    main()
