"""Sweeps as strangers bring them, judged: errors, intervals, what was refused, warned of, and wrong in silence.

``python tests/exam/sweep_strangers.py docs/sweep_strangers_table.md [--draws 300] [--jobs 2]`` writes the table. Draws
that are done are kept beside the cache, and found again. No threshold was chosen on the seeds from `FIRST` on.
"""

from __future__ import annotations

import argparse
import json
import sys
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1] / "measured"))
    import conftest  # noqa: F401

import numpy as np
from accuracy.strangers import stranger_passes
from scipy import stats
from truth.sweep_strangers import draw, measure

from smfe import LocalPolynomial, identify_sweep

FIRST = 70000
"""Seed of the first draw; thresholds were chosen on 5000 to 6100."""

BAND = (25.0, 75.0)
WRONG = 2.0
"""Rms error over the stated standard deviation from which an estimate is wrong."""

CHATTERS, STABLE = 0.35, 0.1
"""Rms of the force without noise between the orders of the spindle over that at them; in between is mild chatter."""

Row = dict[str, Any]


def examine(seed: int) -> Row:
    """Identify one draw and compare with the truth; every other one states its speeds."""
    warnings.simplefilter("ignore", RuntimeWarning)
    this = draw(seed)
    records = measure(this, seed)
    stated = seed % 2 == 0
    column = this.column if this.tells == "speed" else 0.0
    row: Row = {
        "seed": seed,
        "clock": abs(this.clock) if this.clock and (stated or this.tells == "speed") else 0.0,
        "untold": abs(this.clock) if this.clock and not (stated or this.tells == "speed") else 0.0,
        "column": abs(column),
        "late": abs(this.late),
        "between": max(r["between_orders"] for r in records),
        "touch": max(this.rub) > 0.0 or this.fade > 0.0,
        "air": int(this.lead > 0.0) + int(this.tail > 0.0),
        "force_noise": this.force_noise,
        "quiet": this.force_noise < 0.1 and this.motion_noise < 1e-3,
    }
    try:
        found = identify_sweep(
            "s", stranger_passes(this, records, stated), BAND, LocalPolynomial(resolution=0.5), teeth=this.teeth
        )
    except ValueError as error:
        return row | {"refused": str(error)}
    phi, std = found.compliance["compliance"].values, found.compliance["compliance_std"].values
    truth = this.modes.compliance(found.compliance["frequency"].values)
    error, solved = phi - truth, np.isfinite(phi) & np.isfinite(std)
    t = stats.t.isf(0.025, found.compliance["degrees_of_freedom"].values) * std / np.sqrt(2.0)
    inside = [np.abs(part)[solved] <= t[solved] for part in (error.real, error.imag)]
    size = float(np.sqrt(np.mean(np.abs(truth) ** 2)))
    return row | {
        "refused": "",
        "solved": float(solved.mean()),
        "error": float(np.sqrt(np.mean(np.abs(error[solved]) ** 2))) / size,
        "ratio": float(np.sqrt(np.mean(np.abs(error[solved] / std[solved]) ** 2))),
        "inside": float(np.mean(inside)),
        "warnings": list(found.warnings),
    }


def _interval(count: int, of: int) -> str:
    """Count, per cent, and the 95 % interval of Clopper and Pearson."""
    if of == 0:
        return "-"
    low = stats.beta.ppf(0.025, count, of - count + 1) if count else 0.0
    high = stats.beta.ppf(0.975, count + 1, of - count) if count < of else 1.0
    return f"{count} ({100.0 * low:.0f} to {100.0 * high:.0f} %)"


GROUPS: dict[str, Callable[[Row], bool]] = {
    "all": lambda r: True,
    "nothing wrong with clock, channels or cut": lambda r: (
        not (r["clock"] or r["untold"] or r["column"] or r["late"] or r["between"] > STABLE)
    ),
    "of these: rubs or fades": lambda r: GROUPS["nothing wrong with clock, channels or cut"](r) and r["touch"],
    "of these: no air": lambda r: GROUPS["nothing wrong with clock, channels or cut"](r) and r["air"] == 0,
    "of these: force noise above 5 N": lambda r: (
        GROUPS["nothing wrong with clock, channels or cut"](r) and r["force_noise"] > 5.0
    ),
    "of these: quiet sensors (below 0.1 N and 1e-3 m/s²)": lambda r: (
        GROUPS["nothing wrong with clock, channels or cut"](r) and r["quiet"]
    ),
    "time base or speed column wrong by 0.3 to 1 %": lambda r: 0.0 < max(r["clock"], r["column"]) <= 0.01,
    "time base or speed column wrong by 1 to 5 %": lambda r: max(r["clock"], r["column"]) > 0.01,
    "time base wrong, nothing states the speed": lambda r: r["untold"] > 0.0,
    "acceleration late by up to 0.2 ms": lambda r: r["late"] > 0.0,
    "a pass chatters": lambda r: r["between"] > CHATTERS,
    "between stable and chatter": lambda r: STABLE < r["between"] <= CHATTERS,
}


def page(rows: Sequence[Row]) -> str:
    """Return the table."""
    lines = [
        f"{len(rows)} draws, seeds {FIRST} to {FIRST + len(rows) - 1}; in brackets 95 % intervals (Clopper and "
        "Pearson). Error: rms over 25 to 75 Hz of all entries over that of the compliance, median and 90 %. Wrong: rms "
        "error above twice the stated standard deviation; in silence: without any warning. Warned: any warning. Not "
        "solved: share of frequencies that are left empty.",
        "",
        "| | draws | refused | warned | error, median (90 %) [%] | in the 95 % interval [%] | not solved [%] "
        "| wrong, warned "
        "| wrong in silence |",
        "| --- |" + " --- |" * 8,
    ]
    for name, member in GROUPS.items():
        here = [r for r in rows if member(r)]
        done = [r for r in here if not r["refused"]]
        warned = [r for r in done if r["warnings"]]
        cells = [str(len(here)), _interval(len(here) - len(done), len(here)), _interval(len(warned), len(done))]
        if done:
            error = 100.0 * np.array([r["error"] for r in done])
            cells.append(f"{np.median(error):.2g} ({np.quantile(error, 0.9):.2g})")
            cells.append(f"{100.0 * np.mean([r['inside'] for r in done]):.1f}")
            cells.append(f"{100.0 * np.mean([1.0 - r['solved'] for r in done]):.1f}")
        else:
            cells += ["-"] * 3
        wrong = [r for r in done if r["ratio"] > WRONG]
        cells.append(_interval(sum(bool(r["warnings"]) for r in wrong), len(done)))
        cells.append(_interval(sum(not r["warnings"] for r in wrong), len(done)))
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    names = ("chatters", "teeth pass")
    stable = [r for r in rows if r["between"] <= STABLE]
    loud = [r for r in rows if r["between"] > CHATTERS]
    right = [r for r in rows if not (r["clock"] or r["column"] or r["untold"])]
    off = [r for r in rows if r["clock"] or r["column"]]

    def said(here: Sequence[Row], word: str) -> int:
        return sum(word in r["refused"] or any(word in w for w in r.get("warnings", ())) for r in here)

    lines += [
        "",
        "| what is said | said where it is so | said where it is not so |",
        "| --- | --- | --- |",
        f"| a pass chatters | {_interval(said(loud, names[0]), len(loud))} of {len(loud)} | "
        f"{_interval(said(stable, names[0]), len(stable))} of {len(stable)} |",
        f"| speed and tooth passing disagree | {_interval(said(off, names[1]), len(off))} of {len(off)} | "
        f"{_interval(said(right, names[1]), len(right))} of {len(right)} |",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Examine what is not done yet, and write the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    kept = Path(".cache/sweep_strangers.jsonl")
    kept.parent.mkdir(exist_ok=True)
    lines = kept.read_text().splitlines() if kept.exists() else []
    done = {row["seed"]: row for row in map(json.loads, lines)}
    wanted = range(FIRST, FIRST + arguments.draws)
    with ProcessPoolExecutor(arguments.jobs) as pool, kept.open("a") as out:
        for row in pool.map(examine, [s for s in wanted if s not in done]):
            done[row["seed"]] = row
            out.write(json.dumps(row) + "\n")
            out.flush()
    arguments.out.write_text(page([done[s] for s in wanted]), encoding="utf-8")


if __name__ == "__main__":
    main()
