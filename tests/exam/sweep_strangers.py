"""Sweeps as strangers bring them, judged: errors, intervals, what was refused, warned of, and wrong in silence.

``python tests/exam/sweep_strangers.py docs/sweep_strangers_table.md [--draws 300] [--jobs 2]`` writes the table. Draws
that are done are kept beside the cache, and found again. No threshold was chosen on the seeds from `FIRST` on.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

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
    column = this.column if this.speed_signal == "speed" else 0.0
    row: Row = {
        "seed": seed,
        "clock": abs(this.clock) if this.clock and (stated or this.speed_signal == "speed") else 0.0,
        "unstated": abs(this.clock) if this.clock and not (stated or this.speed_signal == "speed") else 0.0,
        "column": abs(column),
        "late": abs(this.late),
        "speed_signal": this.speed_signal,
        "stated": stated,
        "between": max(r["between_orders"] for r in records),
        "touch": max(this.touch_share) > 0.0 or this.fade > 0.0,
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


def _healthy(r: Row) -> bool:
    return not (r["clock"] or r["unstated"] or r["column"] or r["late"] or r["between"] > CHATTERS)


def _off(r: Row) -> float:
    """Relative error of what a record states of time or speed."""
    return float(max(r["clock"], r["column"]))


GROUPS: dict[str, Callable[[Row], bool]] = {
    "all": lambda r: True,
    "nothing wrong with clock and channels, no pass chatters": _healthy,
    "of these: touches in the air or fades": lambda r: _healthy(r) and r["touch"],
    "of these: no air": lambda r: _healthy(r) and r["air"] == 0,
    "of these: force noise above 5 N": lambda r: _healthy(r) and r["force_noise"] > 5.0,
    "of these: quiet sensors (below 0.1 N and 1e-3 m/s²)": lambda r: _healthy(r) and r["quiet"],
    "time base or speed column wrong by 0.3 to 1 %": lambda r: 0.0 < _off(r) <= 0.01,
    "of these: only stated speeds say so": lambda r: 0.0 < _off(r) <= 0.01 and r["speed_signal"] != "speed",
    "time base or speed column wrong by 1 to 5 %": lambda r: _off(r) > 0.01,
    "of these: only stated speeds say so ": lambda r: _off(r) > 0.01 and r["speed_signal"] != "speed",
    "time base wrong by 0.3 to 5 %, nothing states the speed": lambda r: r["unstated"] > 0.0,
    "acceleration late or early by up to 0.2 ms": lambda r: r["late"] > 0.0,
    "a pass chatters": lambda r: r["between"] > CHATTERS,
    "between stable and chatter": lambda r: STABLE < r["between"] <= CHATTERS,
}

SAID = {"chatter": "chatters", "clock": "teeth pass", "late": "against the force"}
"""Words of what is said of each cause."""


def _says(r: Row, cause: str) -> bool:
    return SAID[cause] in r["refused"] or any(SAID[cause] in w for w in r.get("warnings", ()))


def _cause_said(r: Row) -> bool:
    """Whether what is wrong with a draw is said; any warning where nothing is known to be wrong."""
    causes = [
        *(["clock"] if r["clock"] or r["column"] or r["unstated"] else []),
        *(["late"] if r["late"] else []),
        *(["chatter"] if r["between"] > CHATTERS else []),
    ]
    return any(_says(r, c) for c in causes) if causes else bool(r["warnings"])


def _judged(here: Sequence[Row]) -> list[str]:
    """Return the cells of those draws of a group that gave a compliance."""
    done = [r for r in here if not r["refused"]]
    cells = [_interval(sum(bool(r["warnings"]) for r in done), len(done))]
    if done:
        error = 100.0 * np.array([r["error"] for r in done])
        held = 100.0 * np.array([r["inside"] for r in done])
        half = 1.96 * float(np.std(held, ddof=1)) / np.sqrt(held.size) if held.size > 2 else np.nan
        cells.append(f"{np.median(error):.2g} ({np.quantile(error, 0.9):.2g})")
        cells.append(f"{held.mean():.1f}" + (f" ± {half:.1f}" if held.size > 2 else ""))
        cells.append(f"{100.0 * np.mean([1.0 - r['solved'] for r in done]):.1f}")
    else:
        cells += ["-"] * 3
    wrong = [r for r in done if r["ratio"] > WRONG]
    cells.append(_interval(sum(_cause_said(r) for r in wrong), len(done)))
    cells.append(_interval(sum(not _cause_said(r) for r in wrong), len(done)))
    return cells


def page(rows: Sequence[Row]) -> str:
    """Return the table."""
    lines = [
        f"{len(rows)} draws, seeds {FIRST} to {FIRST + len(rows) - 1}; in brackets 95 % intervals (Clopper and "
        "Pearson). Error: rms over 25 to 75 Hz of all entries over that of the compliance, median and 90 %. Wrong: rms "
        "error above twice the stated standard deviation; said: a warning names the cause that was drawn (clock, "
        "delay, chatter), or there is any warning where none was. Not solved: share of frequencies left empty.",
        "",
        "| | draws | refused | warned | error, median (90 %) [%] | in the 95 % interval [%] | not solved [%] "
        "| wrong, said "
        "| wrong, cause not said |",
        "| --- |" + " --- |" * 8,
    ]
    for name, member in GROUPS.items():
        here = [r for r in rows if member(r)]
        refused = _interval(sum(bool(r["refused"]) for r in here), len(here))
        lines.append(f"| {name.strip()} | {len(here)} | {refused} | " + " | ".join(_judged(here)) + " |")
    lines += [
        "",
        "Of the draws that were not refused for something else (a pass chatters above "
        f"{CHATTERS:g}, and is stable below {STABLE:g} of force between the orders over that at them):",
        "",
        "| what is said | said where it is so | said where it is not so |",
        "| --- | --- | --- |",
    ]
    stable = [r for r in rows if r["between"] <= STABLE]
    unstable = [r for r in rows if r["between"] > CHATTERS]
    right = [r for r in rows if not (r["clock"] or r["column"] or r["unstated"])]
    for text, cause, so, not_so in (
        ("a pass chatters", "chatter", unstable, stable),
        ("speed and tooth passing disagree, by 1 to 5 %", "clock", [r for r in rows if _off(r) > 0.01], right),
        ("the same, by 0.3 to 1 %", "clock", [r for r in rows if 0.0 < _off(r) <= 0.01], right),
        ("the motion is late or early, by 50 to 200 µs", "late", [r for r in rows if r["late"] > 5e-5], []),
        ("the same, by up to 50 µs", "late", [r for r in rows if 0.0 < r["late"] <= 5e-5], []),
        ("the same, not at all", "late", [], [r for r in rows if not r["late"]]),
    ):
        cells = []
        for here in (so, not_so):
            open_to = [r for r in here if not r["refused"] or _says(r, cause)]
            said = sum(_says(r, cause) for r in open_to)
            cells.append(f"{_interval(said, len(open_to))} of {len(open_to)}" if open_to else "")
        lines.append(f"| {text} | {cells[0]} | {cells[1]} |")
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
