"""Exam on files of frequency responses that were made elsewhere: 300 files drawn at random, as a table.

``python tests/exam/frf_files.py docs/frf_files_table.md [--draws 300] [--first 10000] [--jobs 1]``
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from truth.frf_files import draw

from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.identification.errors.intervals import interval
from smfe.identification.measurement import identify_measurement

RIGHT, SAID, REFUSED, WRONG, SILENT = "right", "said", "refused", "false warning", "wrong in silence"


def outcome(seed: int, folder: Path) -> dict[str, object]:
    """Return what became of one file, and the share of its stated 95 % intervals that hold the truth."""
    file = draw(seed, folder)
    row: dict[str, object] = {"form": file.drawn["form"], "file": file.drawn["style"], "held": np.nan}
    (folder / "c.toml").write_text('[campaign]\nname = "c"\n' + file.table)
    try:
        campaign = load_campaign(folder / "c.toml")
        found = identify_measurement(campaign, campaign.measurements[0])
    except InputError as error:
        return row | {"outcome": REFUSED, "sentence": str(error)}
    entry = found.compliance["compliance"]
    at = np.abs(file.frequency[:, None] - entry["frequency"].values).argmin(axis=0)
    away = np.abs(entry.values[:, 0, 0] - file.measured[at]) / np.abs(file.measured[at])
    names = (entry["response"].item(), entry["excitation"].item()) == (file.response, file.excitation)
    right = bool(names and away.max() < 30.0 * file.digits and entry["frequency"].size >= file.frequency.size - 1)
    turned = any("conjugate = true" in w for w in found.warnings)
    if file.says:
        return row | {"outcome": SAID if turned else SILENT}
    if turned:
        return row | {"outcome": WRONG}
    if right and file.averages:
        limits = interval(found.compliance)
        low, high = (limits[name].values[:, 0, 0] for name in ("lower", "upper"))
        truth = file.truth[at]
        inside = [
            (low.real < truth.real) & (truth.real < high.real),
            (low.imag < truth.imag) & (truth.imag < high.imag),
        ]
        row["held"] = float(np.mean(inside))
    return row | {"outcome": RIGHT if right else SILENT}


def table(rows: pd.DataFrame, first: int) -> str:
    """Return the outcomes by format of the file as Markdown."""
    counts = pd.crosstab(rows["file"], rows["outcome"]).reindex(
        columns=[RIGHT, SAID, REFUSED, WRONG, SILENT], fill_value=0
    )
    counts.loc["all"] = counts.sum()
    held = rows.groupby("file")["held"].mean()
    held["all"] = rows["held"].mean()
    lines = ["| file | draws | " + " | ".join(counts.columns) + " | 95 % intervals that hold |"]
    lines += ["| --- " * (len(counts.columns) + 3) + "|"]
    for name, row in counts.iterrows():
        lines += [f"| {name} | {row.sum()} | " + " | ".join(str(v) for v in row) + f" | {100 * held[name]:.1f} % |"]
    return "\n".join([*lines, "", f"Seeds {first} to {first + len(rows) - 1}.", ""])


def main() -> None:
    """Draw, identify, count."""
    parser = argparse.ArgumentParser()
    parser.add_argument("target", type=Path)
    parser.add_argument("--draws", type=int, default=300)
    parser.add_argument("--first", type=int, default=10_000)
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = [outcome(given.first + k, Path(folder)) for k in range(given.draws)]
    for row in rows:
        if row["outcome"] in (REFUSED, WRONG, SILENT):
            print(row)
    given.target.write_text(table(pd.DataFrame(rows), given.first))
    print(given.target.read_text())


if __name__ == "__main__":
    main()
