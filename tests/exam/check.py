"""`smfe check` on random campaigns, and the run that follows: writes a table. ``check.py TABLE [--jobs N]``.

Healthy campaigns must be silent; of campaigns with one planted fault, what the check passes the run must not refuse.
Seeds 500 to 999 are scored; thresholds were chosen on seeds from 1000, and one of them on seed 35.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import pandas as pd
from truth import workshop

from process.errors import InputError
from smfe.commands import run as run_command
from smfe.commands.check import check

DRAWN = 5
"""Every how many campaigns the report is drawn as well, which takes longer than everything else."""


def sitting(job: tuple[int, bool]) -> dict[str, object]:
    """Check and run one campaign."""
    seed, faulty = job
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fault = workshop.planted(seed, folder) if faulty else "none"
        if not faulty:
            workshop.write(workshop.healthy(seed), folder)
        start = time.process_time()
        try:
            table = check(folder / "campaign.toml")
        except InputError as error:
            refused = _runs(folder, seed) is None
            return {"seed": seed, "fault": fault, "said": "file", "evidence": str(error), "unsaid": not refused}
        seconds = time.process_time() - start
        levels = [level for level in ("fault", "warning", "note") if (table["level"] == level).any()]
        said = levels[0] if levels else "nothing"
        failed = _runs(folder, seed)
        unsaid = ["the run was refused"] if failed is None else _unsaid(table, failed)
        found = "; ".join(f"{r.level} {r.cause}: {r.where}: {r.evidence}" for r in table.itertuples())
        return {"seed": seed, "fault": fault, "said": said, "evidence": found, "unsaid": unsaid, "seconds": seconds,
                "failed": len(failed or [])}  # fmt: skip


def _runs(folder: Path, seed: int) -> list[dict[str, str]] | None:
    """Return what failed in a run; None where it was refused."""
    report = run_command.report
    if seed % DRAWN:
        run_command.report = lambda out, progress: Path(out) / "report.html"
    try:
        out = run_command.run(folder / "campaign.toml", folder / "results").parent
    except InputError:
        return None
    finally:
        run_command.report = report
    return json.loads((out / "provenance.json").read_text(encoding="utf-8"))["failures"]


def _unsaid(table: pd.DataFrame, failed: list[dict[str, str]]) -> list[str]:
    """Return failures of the run of which the check had said nothing."""
    said = list(table.loc[table["level"] == "fault", "evidence"])
    known = ("failed; its own reason says what to do",)
    return [
        f"{f['part']} {f['name']}: {f['reason']}"
        for f in failed
        if not any(text in f["reason"] or f["reason"] in text for text in said) and not f["reason"].endswith(known)
    ]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("table", type=Path)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--healthy", type=int, default=50)
    parser.add_argument("--faults", type=int, default=100)
    parser.add_argument("--first", type=int, default=500, help="first seed")
    given = parser.parse_args()
    jobs = [(given.first + k, False) for k in range(given.healthy)]
    jobs += [(given.first + k, True) for k in range(given.faults)]
    with ProcessPoolExecutor(given.jobs) as pool:
        rows = []
        for k, row in enumerate(pool.map(sitting, jobs), 1):
            rows.append(row)
            wrong = row["unsaid"] or (row["fault"] == "none" and row["said"] in ("fault", "warning"))
            print(f"{k}/{len(jobs)}", row["seed"], row["fault"], row["said"], row["unsaid"] or "", flush=True)
            if wrong or given.table.name == "-":
                print("    ", row["evidence"], flush=True)
    if given.table.name != "-":
        given.table.write_text(_table(rows), encoding="utf-8")


def _table(rows: list[dict[str, object]]) -> str:
    columns = ("file", "fault", "warning", "note", "nothing")
    lines = [
        "| campaigns | number | file refused | fault | warning | note | nothing | run refuses what the check passed |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |",
    ]
    for fault in ("none", *sorted({str(r["fault"]) for r in rows} - {"none"})):
        own = [r for r in rows if r["fault"] == fault]
        if own:
            said = Counter(str(r["said"]) for r in own)
            cells = [str(said[c]) for c in columns]
            lines.append(f"| {fault} | {len(own)} | {' | '.join(cells)} | {sum(bool(r['unsaid']) for r in own)} |")
    every = [r for r in rows if r["fault"] != "none"]
    said = Counter(str(r["said"]) for r in every)
    cells = " | ".join(f"**{said[c]}**" for c in columns)
    lines.append(f"| **all with a fault** | **{len(every)}** | {cells} | **{sum(bool(r['unsaid']) for r in every)}** |")
    times = sorted(float(str(r["seconds"])) for r in rows if "seconds" in r)
    if times:
        lines += ["", f"CPU time of a check: median {times[len(times) // 2]:.2g} s, longest {times[-1]:.2g} s."]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
