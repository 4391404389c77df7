"""The synthetic experiment on estimators of sweep milling, ours beside the figures it was first done with.

``python tests/accuracy/theory_table.py docs/sweep_table.md`` writes the tables; `make accuracy` calls it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from accuracy.synthetic import (
    DIAMETER,
    RATE,
    TRIOS,
    WINDOWS,
    Pass,
    condition,
    error,
    experiment,
    noisy,
    orders,
    own_lines,
    whole_pass,
)
from process import engagement
from process.labels import make_record
from smfe import LocalPolynomial, SweepPass, identify_sweep

TAIL = 4.0
RATES = {
    5.0: (31.0, None, 4.8, 38.0, 1.4, 38.0),
    10.0: (10.7, 0.0, 2.6, 24.0, 0.94, 1.7),
    20.0: (4.4, None, 1.8, 16.0, 0.69, 0.68),
    40.0: (2.5, None, 1.6, 9.0, 0.65, 0.64),
    80.0: (1.8, None, None, 4.7, None, None),
}
"""Duration [s] -> errors first found [%]: A without tail, A at its own lines, A, B, C with tail, C without."""

LEVELS = ((0.02, 0.0), (0.0, 10.0), (0.02, 10.0), (0.1, 50.0))
"""Noise per sample at 4096 Hz: acceleration [m/s2], force [N]."""

FIRST = {
    "A": (7.7, ((3.1, 9.3), (2.7, 9.1), (3.2, 9.3), (11.4, 14.5))),
    "B": (27.7, ((7.2, 10.9), (7.8, 9.5), (9.4, 10.9), (28.0, 35.0))),
    "C": (8.2, ((4.0, 9.5), (3.1, 9.1), (4.3, 9.6), (16.0, 17.0))),
    "E": (30.0, ((10.6, 12.4), (12.3, 9.6), (12.9, 12.4), (35.0, 44.0))),
    "D": (1e16, ((3400.0, 39.0), (117.0, 311.0), (101.0, 477.0), (52.0, 620.0))),
}
"""Trio -> condition number and errors first found [%], (A) and (B), at the levels."""


def labelled(passes: list[Pass], trio: str) -> list[SweepPass]:
    """Give the passes to the package."""
    out = []
    for p, share in zip(passes, TRIOS[trio], strict=True):
        channels = {k: dict(zip("xyz", getattr(p, k), strict=True)) for k in ("force", "acceleration")}
        record = make_record(np.arange(p.angle.size) / RATE, channels)
        out.append(SweepPass(record, p.cut, engagement(p.cut, share * DIAMETER, DIAMETER)))
    return out


def package(passes: list[Pass], trio: str, stiffer: float = 1.0, estimator: LocalPolynomial | None = None) -> float:
    """Error of the package's estimate; NaN where it refuses the passes."""
    try:
        found = identify_sweep("s", labelled(passes, trio), (22.0, 46.0), estimator or LocalPolynomial())
    except ValueError:
        return np.nan
    return error(found.compliance["compliance"].values, stiffer)


def by_rate(seconds: float) -> tuple[float, ...]:
    """Return errors in the order of `RATES`, and of the package."""
    bare, whole = experiment(seconds, 0.0), experiment(seconds, TAIL)
    lines = own_lines(whole)
    return (
        error(whole_pass(bare, 0.25)),
        error(whole_pass(whole, 1e-6, at=lines), at=lines),
        error(whole_pass(whole, 0.25)),
        min(error(orders(whole, w)) for w in WINDOWS),
        error(whole_pass(whole, 0.5, 2)),
        error(whole_pass(bare, 0.5, 2, True)),
        package(whole, "A"),
    )


def by_noise(trio: str, motion: float, force: float, seeds: int = 3) -> tuple[float, float, float]:
    """Return the errors of (A), (B) and the package (one seed), at the stiffer machine."""
    passes = experiment(40.0, TAIL, trio, 1.5e-3, 4.0)
    draws = [noisy(passes, motion, force, seed) for seed in range(1, seeds + 1)]
    plain, followed = (
        float(np.mean([error(estimate(d), 4.0) for d in draws]))
        for estimate in (lambda d: whole_pass(d, 0.25), lambda d: orders(d, 1.0))
    )
    return plain, followed, package(draws[0], trio, 4.0)


def _cell(value: float, first: float | None) -> str:
    return f"{100.0 * value:.2g}" + ("" if first is None else f" ({first:.3g})")


def main(target: Path) -> None:
    """Write both tables."""
    lines = [
        "Error [%] of a sweep from 18 to 50 Hz against its duration; in brackets the figure first found.",
        "",
        "| sweep in | rate [Hz/s] | (A) no tail | (A) 4 s tail, own lines | (A) 4 s tail, ±0.25 Hz | (B) best window | "
        "(C) 4 s tail | (C) no tail, transients | default, 4 s tail |",
        "| --- |" + " --- |" * 8,
    ]
    for seconds, first in RATES.items():
        cells = [_cell(v, f) for v, f in zip(by_rate(seconds), (*first, None), strict=True)]
        lines.append(f"| {seconds:g} s | {32.0 / seconds:.2g} | " + " | ".join(cells) + " |")
        print(lines[-1], flush=True)
    lines += [
        "",
        "Error [%] against noise per sample at 4096 Hz (40 s, 1.5 mm, four times as stiff, 4 s tail): (A) ±0.25 Hz / "
        "(B) 1 s window / default; in brackets the figures first found for (A) and (B).",
        "",
        "| trio | condition | " + " | ".join(f"{a:g} m/s², {f:g} N" for a, f in LEVELS) + " |",
        "| --- |" + " --- |" * 5,
    ]
    for trio, (number, first) in FIRST.items():
        cells = []
        for (motion, force), (a, b) in zip(LEVELS, first, strict=True):
            plain, followed, ours = by_noise(trio, motion, force)
            default = "refused" if np.isnan(ours) else f"{100.0 * ours:.2g}"
            cells.append(f"{_cell(plain, a)} / {_cell(followed, b)} / **{default}**")
        widths = "/".join(f"{w:g}" for w in TRIOS[trio]).replace("0.", ".")
        lines.append(f"| {trio} {widths} | {condition(trio):.3g} ({number:.3g}) | " + " | ".join(cells) + " |")
        print(lines[-1], flush=True)
    target.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
