"""Errors of the sweep estimators against noise, teeth, immersion, run-out, sweep rate -> docs/accuracy_table.md.

Time simulations that regenerate the chip; 60 s of sweep, 0.8 mm depth, noise of 1.5 N and 0.012 m/s2 rms at 5 kHz.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from process import engagement
from process.compliance import ModalModel
from process.simulate import MillingCut, Spindle, simulate_milling
from process.tool import Tool
from smfe import LocalPolynomial, Segments, SingleReference, SweepPass, identify_sweep
from smfe.demo_campaign import MATERIAL
from smfe.spindle_orders import Orders

RATE = 1000.0
BAND = (20.0, 80.0)


@dataclass(frozen=True)
class Setting:
    """One row: everything that is varied, in SI; noise relative to the nominal."""

    noise: float = 1.0
    teeth: int = 2
    width: float = 0.012
    runout: float = 8e-6
    rate: float = 1.5

    @property
    def seconds(self) -> float:
        """Time in which the tooth passing goes from 20 to about 47 Hz with two teeth."""
        return 57.0 * 1.5 / self.rate


ROWS = {
    "nominal": Setting(),
    "without noise": Setting(noise=0.0),
    "noise x 3": Setting(noise=3.0),
    "noise x 10": Setting(noise=10.0),
    "one insert": Setting(teeth=1, runout=0.0),
    "four inserts": Setting(teeth=4),
    "width 40 mm": Setting(width=0.040),
    "width 72 mm": Setting(width=0.072),
    "no run-out": Setting(runout=0.0),
    "run-out 20 um": Setting(runout=20e-6),
    "sweep twice as fast": Setting(rate=3.0),
    "sweep four times as fast": Setting(rate=6.0),
}


def machine(seed: int) -> ModalModel:
    """Return three to five modes between 25 and 75 Hz in any direction."""
    rng = np.random.default_rng(seed)
    n = 3 + seed % 3
    direction = rng.standard_normal((n, 3))
    return ModalModel(
        np.sort(rng.uniform(25.0, 75.0, n)),
        rng.uniform(0.02, 0.06, n),
        rng.uniform(25e6, 60e6, n),
        direction / np.linalg.norm(direction, axis=1)[:, None],
    )


def passes(setting: Setting, seed: int) -> list[SweepPass]:
    """Return down, up and central milling with the noise of the setting."""
    rng = np.random.default_rng(seed)
    offsets = setting.runout * np.cos(2.0 * math.pi * np.arange(setting.teeth) / setting.teeth)
    tool = Tool(0.08, setting.teeth, math.pi / 4.0, runout=tuple(float(v) for v in offsets) if setting.runout else None)
    # The same tooth passing frequencies for any number of teeth.
    spindle = Spindle(20.0 * math.pi * 2.0 / setting.teeth, setting.rate * 2.0 / setting.teeth)
    scale = setting.noise * math.sqrt(RATE / 5000.0)
    out = []
    for cut in ("down", "up", "central"):
        arc = engagement(cut, setting.width, 0.08)
        mill = MillingCut(tool, arc, MATERIAL, 0.8e-3, feed_rate=1e-4 * 20.0)
        record = simulate_milling(machine(seed), mill, spindle, setting.seconds, RATE, 0.5, 2.0)
        record = record.drop_vars("displacement")
        for channel, level in (("force", 1.5), ("acceleration", 0.012)):
            record[channel] = record[channel] + scale * level * rng.standard_normal(record[channel].shape)
        out.append(SweepPass(record, cut, arc))
    return out


def estimators(setting: Setting) -> dict[str, tuple[object, bool]]:
    """Return what stands in the columns: estimator, and whether it is constrained to be reciprocal."""
    full = LocalPolynomial()
    return {
        "default": (full, False),
        "reciprocal": (full, True),
        "no model": (replace(full, rational=False), False),
        "bands to 1 Hz": (LocalPolynomial(half_widths=(0.125, 0.25, 0.5, 1.0), rational=False), False),
        "teeth as instrument": (replace(full, instrument_teeth=setting.teeth), False),
        "segments": (Segments(), False),
        "orders": (Orders(setting.teeth), False),
        "force x alone": (SingleReference(), False),
    }


def entry_errors(setting: Setting, seed: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the relative rms error of the nine entries for each estimator."""
    data = passes(setting, seed)
    for name, (estimator, tied) in estimators(setting).items():
        try:
            found = identify_sweep("s", data, BAND, estimator, reciprocal=tied).compliance
        except ValueError:
            yield name, np.full(9, np.nan)
            continue
        truth = machine(seed).matrix(found["frequency"].values)
        error = np.abs(found["compliance"].values - truth) ** 2
        yield name, np.sqrt(np.nanmean(error, axis=0) / np.mean(np.abs(truth) ** 2, axis=0)).ravel()


def main(target: Path, seeds: int) -> None:
    """Write the tables."""
    columns = list(estimators(Setting()))
    rows, entries = [], []
    for name, setting in ROWS.items():
        found: dict[str, list[np.ndarray]] = {c: [] for c in columns}
        for seed in range(1, seeds + 1):
            for column, error in entry_errors(setting, seed):
                found[column].append(error)
        medians = [float(np.median(np.mean(v, axis=0))) for v in found.values()]
        rows.append(f"| {name} | " + " | ".join("-" if np.isnan(m) else f"{100.0 * m:.2g}" for m in medians) + " |")
        print(rows[-1], flush=True)
        for column in ("default", "force x alone"):
            values = " | ".join(f"{100.0 * v:.2g}" for v in np.mean(found[column], axis=0))
            entries.append(f"| {name}, {column} | {values} |")
        target.write_text(_text(columns, rows, entries, seeds), encoding="utf-8")


def _text(columns: list[str], rows: list[str], entries: list[str], seeds: int) -> str:
    """Return both tables."""
    pairs = [a + b for a in "xyz" for b in "xyz"]
    lines = [
        f"Median entry [%], mean over seeds 1 to {seeds} (4, 5, 3 modes and so on):",
        "",
        "| | " + " | ".join(columns) + " |",
        "| --- |" + " --- |" * len(columns),
        *rows,
        "",
        "Each of the nine entries [%]:",
        "",
        "| | " + " | ".join(pairs) + " |",
        "| --- |" + " --- |" * 9,
        *entries,
        "",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 3)
