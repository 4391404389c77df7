"""Exam on records of a shaker: machines, exciters, signals, sensors and recorders drawn at random, as a table.

``python tests/exam/excitations.py docs/excitations_table.md [--draws 42] [--first 30000] [--jobs 1]``
"""

from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr
from truth.shaker import KINDS, Shaken, draw

from process.errors import InputError
from process.labels import AXES, make_record
from smfe.identification.actuator.excitation_kind import identify_shaken
from smfe.identification.errors.intervals import interval

CASES = [(kind, None) for kind in KINDS] + [("random", e) for e in ("H1", "Hv")]
"""Kind of force and estimator."""

PEAK = 0.1
"""Share of the true peak within which the response at it is right, where its interval does not hold it."""


def records_of(drawn: Shaken) -> dict[str, list[xr.Dataset]]:
    """Return the records as the package takes them."""
    along = AXES[drawn.axis]
    return {
        along: [
            make_record(
                np.arange(f.size) / drawn.rate,
                {"force": {along: f}, drawn.channel: dict(zip(AXES, x, strict=True))},
            )
            for f, x in zip(drawn.force, drawn.motion, strict=True)
        ]
    }


def outcome(first: int, case: tuple[str, str | None], number: int) -> dict[str, object]:
    """Return what became of one draw.

    "wrong in silence": at the highest true peak of a response the error is above a tenth and above three half widths of
    its interval, or less than 80 % of all intervals hold.
    """
    kind, estimator = case
    drawn = draw(first + number, kind)
    row: dict[str, object] = {"force": kind + (f", {estimator}" if estimator else "")}
    try:
        found = identify_shaken("drawn", records_of(drawn), estimator=estimator).compliance
    except InputError as error:
        return row | {"outcome": "refused", "sentence": str(error)}
    limits, inside, peak, std = interval(found), [], [], []
    wrong = False
    for r, response in enumerate(found["response"].values):
        truth = drawn.truth(found["frequency"].values, AXES.index(str(response)))
        value = found["compliance"].values[:, r, 0]
        known = np.isfinite(value)
        value, truth = value[known], truth[known]
        half = limits["upper"].values[known, r, 0] - value
        error = value - truth
        inside += [np.abs(error.real) <= half.real, np.abs(error.imag) <= half.imag]
        at = int(np.argmax(np.abs(truth)))
        peak.append(abs(error[at] / truth[at]))
        std.append(abs(half[at]) / abs(truth[at]))
        wrong |= bool(peak[-1] > PEAK and abs(error[at]) > 3.0 * abs(half[at]))
    row["held"] = float(np.mean(np.concatenate(inside)))
    row["peak"], row["half"] = float(np.median(peak)), float(np.median(std))
    row["at peak"] = float(np.mean(np.array(peak) <= np.array(std)))
    wrong |= row["held"] < 0.8
    return row | {"outcome": "wrong in silence" if wrong else "right", "seed": first + number}


def table(rows: pd.DataFrame, first: int, draws: int) -> str:
    """Return the outcomes as Markdown."""
    lines = [
        "| force | draws | refused | wrong in silence | 95 % intervals that hold | of the worst draw | error at the "
        "peak, median | in 90 % of draws | half width stated there, median |",
        "| --- " * 9 + "|",
    ]
    for name, part in rows.groupby("force", sort=False):
        count = part["outcome"].value_counts()
        lines.append(
            f"| {name} | {len(part)} | {count.get('refused', 0)} | {count.get('wrong in silence', 0)} | "
            f"{100 * part['held'].mean():.1f} % | {100 * part['held'].min():.0f} % | "
            f"{100 * part['peak'].median():.2g} % | "
            f"{100 * part['peak'].quantile(0.9):.2g} % | {100 * part['half'].median():.2g} % |"
        )
    return "\n".join([*lines, "", f"Seeds {first} to {first + draws - 1} of each kind.", ""])


def main() -> None:
    """Draw, identify, count."""
    parser = argparse.ArgumentParser()
    parser.add_argument("target", type=Path)
    parser.add_argument("--draws", type=int, default=42)
    parser.add_argument("--first", type=int, default=30_000)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    work = [(case, k) for k in range(given.draws) for case in CASES]
    with ProcessPoolExecutor(given.jobs) as pool:
        rows = list(pool.map(partial(_one, given.first), work))
    for row in rows:
        if row["outcome"] != "right":
            print(row)
    given.target.write_text(table(pd.DataFrame(rows), given.first, given.draws))
    print(given.target.read_text())


def _one(first: int, work: tuple[tuple[str, str | None], int]) -> dict[str, object]:
    row = outcome(first, *work)
    print(work, row, flush=True)
    return row


if __name__ == "__main__":
    main()
