"""Exam of the modal fit on records drawn at random: modes found, named, missed, made up; whether intervals hold.

``python tests/exam/modes.py docs/modes_table.md [--draws 60] [--first 50000] [--jobs 1]``
"""

from __future__ import annotations

import argparse
import itertools
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats
from truth.modes import Draw, draw, evidence

from process.errors import InputError
from smfe.modes.fit_modes import fit_modes
from smfe.modes.response_matrix import ResponseMatrix

FOUND, NAMED, BURIED, SILENT = "found", "named", "in the noise", "missed in silence"


def record(seed: int) -> tuple[Draw, ResponseMatrix]:
    """Return a draw and the compliance that its owner would give."""
    own = draw(seed)
    turned = own.turned[:, None, None]
    std = None if own.std is None else own.std / np.abs(turned)
    return own, ResponseMatrix(own.frequency, own.values / turned, own.response, own.excitation, std)


def outcome(seed: int) -> dict[str, object]:
    """Return what became of the modes of one record."""
    own, matrix = record(seed)
    paired = {k for pair in own.pairs for k in pair}
    row: dict[str, object] = {"seed": seed, "kind": own.kind, "lines": own.frequency.size, "curves": own.sigma.size}
    row |= {"stated": own.std is not None, "clean": not own.sigma.any()}
    asked = float(stats.chi2.isf(1e-9, 2 + 2 * own.sigma.size))
    begun = time.process_time()
    try:
        fit = fit_modes(matrix)
        table, named = fit.table(), np.array(fit.unexplained)
        perhaps = fit.free.poles[np.isfinite(fit.perhaps_two), 0]
    except InputError as error:
        row |= {"refused": str(error)}
        table, named, perhaps = pd.DataFrame(columns=["frequency_Hz"]), np.empty(0), np.empty(0)
    row["time"] = time.process_time() - begun
    found = table["frequency_Hz"].to_numpy(dtype=float)
    spacing = float(own.frequency[1] - own.frequency[0])
    counts = dict.fromkeys([f"{c} {w}" for c in ("alone", "pair") for w in (FOUND, NAMED, BURIED, SILENT)], 0)
    held: dict[str, list[bool]] = {"frequency": [], "damping": []}
    free, details = list(range(found.size)), []
    for k in np.argsort([-evidence(own, m) for m in range(len(own.modes))]):
        natural, zeta = own.modes[k]
        close = [j for j in free if abs(found[j] - natural) < max(zeta * natural, spacing)]
        kind = "pair" if k in paired else "alone"
        if close:
            j = min(close, key=lambda i: abs(found[i] - natural))
            free.remove(j)
            what = FOUND
            for name, end, truth in (("frequency", "_Hz", natural), ("damping", "", zeta)):
                held[name].append(bool(table[f"{name}_low{end}"][j] <= truth <= table[f"{name}_high{end}"][j]))
        else:
            near = np.abs(found - natural)
            blurred = near.size and near.min() < float(table["resolution_Hz"][int(near.argmin())])
            uncertain = any(abs(p - natural) < max(2.0 * zeta * natural, 2.0 * spacing) for p in perhaps)
            seen = any(abs(p - natural) < max(zeta * natural, 1.5 * spacing) for p in named)
            unseen = not own.sigma.any() or evidence(own, int(k)) > asked
            what = NAMED if blurred or uncertain or seen else SILENT if unseen else BURIED
            details.append((round(float(natural), 3), float(zeta), kind, what, f"{evidence(own, int(k)):.3g}"))
        counts[f"{kind} {what}"] += 1
    row |= counts | {"false": len(free), "held": held, "missed": details, "extra": [float(found[j]) for j in free]}
    return row


def table(rows: pd.DataFrame, first: int) -> str:
    """Return the outcomes as Markdown."""
    lines = [
        "| records | draws | modes | found | missed, named | beneath the noise | missed in silence | false modes |"
    ]
    lines += ["| --- " * 8 + "|"]
    for name, pick in (
        ("modes apart", "alone"),
        ("of pairs .05 to 1 % apart", "pair"),
    ):
        numbers = [int(rows[f"{pick} {what}"].sum()) for what in (FOUND, NAMED, BURIED, SILENT)]
        false = str(int(rows["false"].sum())) if pick == "alone" else ""
        lines += [f"| {name} | {len(rows)} | {sum(numbers)} | " + " | ".join(map(str, numbers)) + f" | {false} |"]
    parts = {
        "noise stated": rows["stated"],
        "noise not stated": ~rows["stated"] & ~rows["clean"],
        "no noise": rows["clean"],
    }
    lines += ["", "| noise | draws | silent | false | 95 % intervals of frequency | of damping |", "| --- " * 6 + "|"]
    for name, at in parts.items():
        own = rows[at]
        silent = int((own[f"alone {SILENT}"] + own[f"pair {SILENT}"]).sum())
        share = []
        for what in ("frequency", "damping"):
            each = [h for held in own["held"] for h in held[what]]
            share.append(f"{100.0 * np.mean(each):.1f} % of {len(each)}" if each else "-")
        lines += [f"| {name} | {len(own)} | {silent} | {int(own['false'].sum())} | {share[0]} | {share[1]} |"]
    lines += ["", "| lines | draws | curves, median | CPU time, median | longest |", "| --- " * 5 + "|"]
    edges = [0, 1500, 6000, 20_000, 10**9]
    for low, high in itertools.pairwise(edges):
        own = rows[(rows["lines"] >= low) & (rows["lines"] < high)]
        if len(own):
            name = f"{own['lines'].min()} to {own['lines'].max()}"
            t = own["time"]
            lines += [f"| {name} | {len(own)} | {own['curves'].median():.0f} | {t.median():.1f} s | {t.max():.1f} s |"]
    return "\n".join([*lines, "", f"Seeds {first} to {first + len(rows) - 1}.", ""])


def main() -> None:
    """Draw, fit, count."""
    parser = argparse.ArgumentParser()
    parser.add_argument("target", type=Path)
    parser.add_argument("--draws", type=int, default=60)
    parser.add_argument("--first", type=int, default=50_000)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    with ProcessPoolExecutor(given.jobs) as pool:
        rows = []
        for row in pool.map(outcome, range(given.first, given.first + given.draws)):
            rows.append(row)
            if row["missed"] or row["false"] or "refused" in row:
                print({k: v for k, v in row.items() if k not in ("held",) and v not in (0, [])}, flush=True)
    given.target.write_text(table(pd.DataFrame(rows), given.first))
    print(given.target.read_text())


if __name__ == "__main__":
    main()
