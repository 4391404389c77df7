"""The ram machine of the paper, measured and cut in simulation: who predicts its sixty cutting tests, over five seeds.

``python -m exam.ram docs/ram_table.md --jobs 2`` writes the table that `docs/paper/section_6.md` shows; `make ram`
calls it. Scenario, records, identification, lobes and verdicts are those of the package, by `smfe simulate` and
`smfe run`: what is shown is what the paper's procedure gives on a machine that is known, not that the simulation is
right.
"""

from __future__ import annotations

import argparse
import re
import tempfile
import warnings
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pandas as pd
from places import DATASETS

import smfe
from smfe.results import read_groups

SEEDS = (6, 7, 8, 9, 10)
LEVELS = ("1 mm", "1.5 mm", "2 mm")


def scenario(seed: int, depths: tuple[str, ...]) -> str:
    """Return the scenario with another seed, sweeps at these depths under K2, and without the actuator."""
    text = (DATASETS / "scenarios" / "paper" / "ram.toml").read_text(encoding="utf-8")
    blocks = re.split(r"(?m)^(?=\[\[(?:trial|lobes)\]\])", text)
    kept = [block for block in blocks if 'method = "actuator"' not in block]
    listed = ", ".join(f'"{d}"' for d in depths)
    kept = [re.sub(r"depth_of_cut = \[.*\]", f"depth_of_cut = [{listed}]", b) if _sweep(b) else b for b in kept]
    sources = ", ".join(f'"sweep_{d.replace(" ", "")}"' for d in depths)
    kept = [re.sub(r'("hammer_f560_K2"), .*\]', rf"\1, {sources}]", block) for block in kept]
    return re.sub(r"(?m)^seed = \d+", f"seed = {seed}", "".join(kept), count=1)


def _sweep(block: str) -> bool:
    return 'name = "sweep"' in block


def sit(seed: int) -> tuple[int, pd.DataFrame, list[float], bool]:
    """Simulate and run one seed: its ranking, the levels of its sweeps [%], whether a difference is significant."""
    first = seed == SEEDS[0]
    depths = ("0.5 mm", *LEVELS) if first else ("0.5 mm", "1 mm")
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore", smfe.SmfeWarning)
        folder = Path(name)
        (folder / "ram.toml").write_text(scenario(seed, depths), encoding="utf-8")
        results = smfe.run(smfe.simulate(folder / "ram.toml", folder / "c"), folder / "r").parent
        ranking = pd.read_csv(results / "ranking.csv", keep_default_na=False)
        differences = pd.read_csv(results / "ranking_differences.csv").query("controller == 'all'")
        levels = _levels(results) if first else []
    pair = differences[
        (differences["method_a"].str.startswith("sweep")) & (differences["method_b"] == "hammer at rest")
    ]
    return seed, ranking, levels, bool(pair["significant"].any())


def _levels(results: Path) -> list[float]:
    """Return by how much the peak of xx between 30 and 37 Hz changes from 1 mm to 1.5 and 2 mm [%]."""
    found = read_groups(results / "frf.nc")
    peaks = []
    for depth in LEVELS:
        phi = found[f"sweep_{depth.replace(' ', '')}"]["compliance"].sel(response="x", excitation="x")
        peaks.append(float(np.nanmax(abs(phi.sel(frequency=slice(30.0, 37.0))))))
    return [100.0 * (p / peaks[0] - 1.0) for p in peaks[1:]]


def table(sittings: list[tuple[int, pd.DataFrame, list[float], bool]]) -> str:
    """Return the text of the table."""
    rows = []
    for seed, ranking, _, _ in sittings:
        for method in dict.fromkeys(ranking["method"]):
            own = ranking[(ranking["method"] == method) & (ranking["spindle_speed_rpm"] == "")].set_index("controller")
            cells = [_share(own.loc[c]) if c in own.index else "-" for c in ("all", "K1", "K2")]
            undecided = own.loc["all", "undecided"]
            rows.append((method, seed, *cells, undecided))
    rows.sort(key=lambda row: (row[0], row[1]))
    out = ["| measured by | seed | right of decided | K1 | K2 | undecided |", "| --- | --- | --- | --- | --- | --- |"]
    out += ["| " + " | ".join(map(str, row)) + " |" for row in rows]
    levels = next(levels for _, _, levels, _ in sittings if levels)
    significant = sum(s for *_, s in sittings)
    out += [
        "",
        f"A sweep is better than the hammer at rest by more than chance with {significant} of {len(sittings)} seeds.",
        f"Peak of xx by sweeps of 1.5 and 2 mm against 1 mm: {levels[0]:.1f} and {levels[1]:.1f} % (seed {SEEDS[0]}).",
    ]
    return "\n".join(out) + "\n"


def _share(row: pd.Series) -> str:
    return f"{row['right']} of {row['right'] + row['falsely_stable'] + row['falsely_unstable']}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("target", type=Path)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    arguments = parser.parse_args()
    with ProcessPoolExecutor(arguments.jobs) as pool:
        found = list(pool.map(sit, arguments.seeds))
    arguments.target.write_text(table(found), encoding="utf-8")
