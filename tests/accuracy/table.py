"""Errors of the sweep estimators on passes of an independent generator -> docs/accuracy_table.md.

Against noise, teeth, immersion, run-out and sweep rate; with and without each correction; and what was asked for:
less than 1 % median entry error. Median and worst of several machines. ``table.py FILE [seeds]``.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import xarray as xr
from truth.sweep import CUTS, Campaign, clean, measure, required

from accuracy.passes import BAND, entry_errors, sweep_passes
from smfe import LocalPolynomial, SingleReference, SweepPass, identify_sweep
from smfe.identification.errors.difference import symmetric
from smfe.identification.sweep.order_tracking import Orders
from smfe.records.dynamometer import Dynamometer, compensate

RATE = 1000.0
"""Rate of the records [Hz]; the density of their noise is that of 1.5 N and 0.012 m/s2 at 5 kHz."""


def _setting(teeth: int = 2, faster: float = 1.0, **more: Any) -> dict[str, Any]:
    """Return changes of a campaign; tooth passing from 20 Hz at 0.48 Hz/s with any number of teeth."""
    same = {"teeth": teeth, "rotation": 20.0 * math.pi * 2.0 / teeth, "acceleration": 1.5 * faster * 2.0 / teeth}
    return same | {"seconds": 60.0 / faster, "setting": ()} | more


def _louder(times: float) -> dict[str, Any]:
    return {"force_noise": 1.5 * times, "motion_noise": 0.012 * times}


ROWS = {
    "nominal": {},
    "without noise": _louder(0.0) | {"bits": 40},
    "noise x 3": _louder(3.0),
    "noise x 10": _louder(10.0),
    "one insert": _setting(1),
    "four inserts": _setting(4),
    "width 40 mm": {"widths": (0.04,) * 3},
    "width 72 mm": {"widths": (0.072,) * 3},
    "no run-out": {"runout": 0.0, "setting": ()},
    "run-out 20 um": {"runout": 20e-6},
    "sweep twice as fast": _setting(faster=2.0),
    "sweep four times as fast": _setting(faster=4.0),
}


@dataclass(frozen=True)
class Correction:
    """Something wrong, and what takes it out: an air cut, a dynamometer that is compensated, a fit over position."""

    changes: dict[str, Any]
    background: bool = False
    dynamometer: Dynamometer | None = None
    position: bool = False
    without_noise: bool = field(default=False)


CORRECTIONS = {
    "force noise x 3": Correction({"force_noise": 4.5}, without_noise=True),
    "force noise x 10": Correction({"force_noise": 15.0}, without_noise=True),
    "spindle order 2 at -20 dB": Correction({"turning": (2, -20.0)}, background=True),
    "spindle order 3 at -20 dB": Correction({"turning": (3, -20.0)}, background=True),
    "dynamometer of 400 Hz": Correction({"dynamometer": 400.0}, dynamometer=Dynamometer(frequency=400.0)),
    "60 kg plate, 10 % of the motion": Correction({"plate": 6.0}, dynamometer=Dynamometer(mass=6.0)),
    "both": Correction({"dynamometer": 400.0, "plate": 6.0}, dynamometer=Dynamometer(6.0, 400.0)),
    "stiffness ±2 % along the pass": Correction({"posture": 0.02}, position=True),
    "stiffness ±10 % along the pass": Correction({"posture": 0.1}, position=True),
}


def campaign(seed: int, changes: dict[str, Any]) -> Campaign:
    """Return one machine of three to five modes; a background given in dB is scaled to it."""
    modes = 3 + seed % 3
    plain = required(modes, seed, rate=RATE)
    order, level = changes.get("turning", (0, 0.0))
    if level < 0.0:
        rng = np.random.default_rng(seed)
        response = clean(plain, "down", rng)[2]
        unit = clean(replace(plain, turning=(order, 1.0)), "air", rng)[2]
        size = float(np.linalg.norm(response) / np.linalg.norm(unit)) * 10.0 ** (level / 20.0)
        changes = changes | {"turning": (order, size)}
    return replace(plain, **changes)


def estimators(teeth: int) -> dict[str, Any]:
    """Return what stands in the columns."""
    full = LocalPolynomial()
    return {
        "default": full,
        "no model": replace(full, rational=False),
        "bands to 1 Hz": LocalPolynomial(half_widths=(0.125, 0.25, 0.5, 1.0), rational=False),
        "teeth as instrument": replace(full, instrument_teeth=teeth),
        "orders": Orders(teeth),
        "force x alone": SingleReference(),
    }


COLUMNS = ("default", "reciprocal", *list(estimators(2))[1:])


def each_estimator(seed: int, changes: dict[str, Any]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the relative error of the nine entries for each column."""
    this = campaign(seed, changes)
    data = sweep_passes(measure(this, seed), this)
    for name, estimator in estimators(this.teeth).items():
        found = _found(data, estimator)
        yield name, np.full(9, np.nan) if found is None else entry_errors(found, this)
        if name == "default" and found is not None:
            yield "reciprocal", entry_errors(symmetric(found), this)


def _found(data: Sequence[SweepPass], estimator: Any, background: Sequence[SweepPass] = ()) -> xr.Dataset | None:
    """Return the compliance, or None where the passes are refused."""
    try:
        return identify_sweep("s", data, BAND, estimator, background=background).compliance
    except ValueError:
        return None


def corrected(seed: int, what: Correction) -> tuple[float, float]:
    """Return the median entry error without and with the correction."""
    this = campaign(seed, what.changes)
    cuts = (*CUTS, "air") if what.background else CUTS
    *data, last = sweep_passes(measure(this, seed, cuts), this)
    data, air = (data, [last]) if what.background else ([*data, last], [])
    unaware = (
        mock.patch("smfe.identification.sweep.local_polynomial._known_noise", return_value=None)
        if what.without_noise
        else nullcontext()
    )
    bands = LocalPolynomial(1.0, (0.25, 0.5, 1.0), rational=False)
    with unaware:
        before = _found(data, bands)
    if what.dynamometer is not None:
        data = [replace(p, record=compensate(p.record, what.dynamometer)) for p in data]
    after = _found(data, replace(bands, position_dependent=what.position), air)
    return tuple(
        math.nan if found is None else float(np.median(entry_errors(found, this))) for found in (before, after)
    )


def _cell(values: Sequence[float]) -> str:
    """Median and worst of the machines [%]."""
    if not np.all(np.isfinite(values)):
        return "-"
    return f"{100.0 * float(np.median(values)):.2g} ({100.0 * max(values):.2g})"


def asked_for(seeds: int, say: Any) -> list[str]:
    """Return the table of what was asked for: three machines a seed, other seeds than those of the other tables."""
    lines = [
        "Asked for: median entry error below 1 % of the rms compliance, and at most half of the mean error of force x "
        "alone; errors [%]:",
        "",
        "| modes | seed | default, median of the rms compliance | default, worst entry of it | default, mean entry | "
        "force x alone, mean entry | ratio |",
        "| --- |" + " --- |" * 6,
    ]
    for modes in (3, 4, 5):
        for seed in range(31, 31 + seeds):
            this = required(modes, seed, rate=RATE)
            data = sweep_passes(measure(this, seed), this)
            ours, theirs = (_found(data, e) for e in (LocalPolynomial(), SingleReference()))
            whole, own, other = entry_errors(ours, this, False), entry_errors(ours, this), entry_errors(theirs, this)
            cells = [np.median(whole), whole.max(), own.mean(), other.mean()]
            shown = " | ".join(f"{100.0 * c:.2g}" for c in cells)
            lines.append(f"| {modes} | {seed} | {shown} | {own.mean() / other.mean():.2g} |")
            say(lines[-1])
    return lines


def against(numbers: Sequence[int], say: Any) -> list[str]:
    """Return the tables of all estimators against noise, teeth, immersion, run-out and rate."""
    lines = [
        f"Median entry [%], median and worst of {len(numbers)} machines (4, 5, 3 modes and so on):",
        "",
        "| | " + " | ".join(COLUMNS) + " |",
        "| --- |" + " --- |" * len(COLUMNS),
    ]
    entries = []
    for name, changes in ROWS.items():
        found: dict[str, list[np.ndarray]] = {c: [] for c in COLUMNS}
        for seed in numbers:
            for column, error in each_estimator(seed, changes):
                found[column].append(error)
        lines.append(
            f"| {name} | " + " | ".join(_cell([float(np.median(e)) for e in v]) for v in found.values()) + " |"
        )
        say(lines[-1])
        for column in ("default", "force x alone"):
            values = " | ".join(f"{100.0 * v:.2g}" for v in np.median(found[column], axis=0))
            entries.append(f"| {name}, {column} | {values} |")
    lines += ["", "Each of the nine entries [%], median of the machines:", ""]
    return [*lines, "| | " + " | ".join(a + b for a in "xyz" for b in "xyz") + " |", "| --- |" + " --- |" * 9, *entries]


def with_corrections(numbers: Sequence[int], say: Any) -> list[str]:
    """Return the table of what the corrections are worth."""
    lines = ["Median entry [%] of bands to ±1 Hz (no model), median and worst of the machines:", ""]
    lines += ["| | without correction | with it |", "| --- | --- | --- |"]
    for name, what in CORRECTIONS.items():
        pairs = [corrected(seed, what) for seed in numbers]
        lines.append(f"| {name} | " + " | ".join(_cell(v) for v in zip(*pairs, strict=True)) + " |")
        say(lines[-1])
    return lines


def main(target: Path, seeds: int) -> None:
    """Write the tables."""
    started = time.process_time()

    def say(line: str) -> None:
        print(f"{time.process_time() - started:5.0f} s  {line}", flush=True)

    numbers = range(1, seeds + 1)
    lines = asked_for(seeds, say)
    for section in (with_corrections, against):
        lines += ["", *section(numbers, say)]
        target.write_text("\n".join(lines) + "\n", encoding="utf-8")
    say(f"written to {target}")


if __name__ == "__main__":
    warnings.simplefilter("ignore", RuntimeWarning)
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 3)
