"""The verb of many campaigns: `catalogue`."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from smfe.cli.terminal import Outcome, Terminal
from smfe.cli.verb import FILES, OUT, any_files, result_folders, verb

if TYPE_CHECKING:
    import pandas as pd

SHOWN = 20
"""Rows that are printed; all of them go to a file."""


@verb(
    FILES,
    gives="the rows that were asked for as CSV; with --draw pictures of how machines drift, how a fleet scatters and "
    "which campaigns to doubt; with --prior the modes to be expected of such a machine, with their covariance.",
    examples=[
        "smfe catalogue results",
        'smfe catalogue results --where "frequency_Hz > 30" --since 2025-01-01',
        "smfe catalogue results --kind peak -o peaks.csv",
        "smfe catalogue results --draw pictures",
        'smfe catalogue results --machine "Mill 01" --prior prior.toml',
    ],
    keys="rows, campaigns, machines, output, pictures, prior, drift, fleet, doubts",
)
def catalogue(
    terminal: Terminal,
    root: Annotated[
        Path,
        typer.Argument(
            help="Folder of the results of many campaigns.", show_default=False, autocompletion=result_folders
        ),
    ],
    machine: Annotated[list[str] | None, typer.Option(help="Only this machine; may be repeated.")] = None,
    where: Annotated[
        list[str] | None, typer.Option(help='Only rows for which this holds, "frequency_Hz > 30"; may be repeated.')
    ] = None,
    since: Annotated[
        str | None, typer.Option(help="Only what was measured on this day or later, 2025-01-31.", show_default=False)
    ] = None,
    until: Annotated[
        str | None, typer.Option(help="Only what was measured on this day or before.", show_default=False)
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(help="Only rows of this kind: peak, limit, cutting_test, warning, ...", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(*OUT, help="CSV file of the rows.", show_default=False, autocompletion=any_files),
    ] = None,
    draw: Annotated[
        Path | None,
        typer.Option(help="Folder for pictures.", show_default=False, autocompletion=result_folders),
    ] = None,
    prior: Annotated[
        Path | None,
        typer.Option(
            help="File for the modes to be expected: .toml, with mean and covariance as .json beside it, or .json.",
            show_default=False,
            autocompletion=any_files,
        ),
    ] = None,
) -> Outcome:
    """Ask the table of many campaigns: filter it, draw machines over time, write a prior."""
    import smfe

    with terminal.bar() as progress:
        progress("reading the catalogue", 0, 1)
        found = smfe.catalogue(root, machine or (), where or (), since, until, kind, output, draw, prior)
        drift, fleet, doubts = found.drift(), found.fleet(), found.doubts()
    rows = found.rows
    days = rows["date"].dropna()
    span = f", {days.min()} to {days.max()}" if len(days) else ""
    machines = sorted(rows["machine"].dropna().unique())
    lines = [f"{len(rows)} rows of {rows['campaign'].nunique()} campaigns, {len(machines)} machines{span}"]
    if output is None:
        shown = rows.head(SHOWN).dropna(axis="columns", how="all")
        lines += _csv(shown)
        if len(rows) > SHOWN:
            lines.append(f"... {len(rows) - SHOWN} more; all of them: -o rows.csv")
    sure = drift[(drift["low"] > 0.0) | (drift["high"] < 0.0)]
    sure = sure[sure["quantity"] == "frequency"].sort_values("percent_per_year", key=abs, ascending=False)
    lines += [
        f"drifts: {r.machine}, {r.entry} mode {r.mode}: frequency {r.percent_per_year:+.2g} % a year "
        f"({r.low:+.2g} to {r.high:+.2g}, 95 %)"
        for r in sure.head(5).itertuples()
    ]
    lines += [
        f"doubt: {r['campaign']}: " + (r["why"] or f"{r['faults']} faults or failures, {r['warnings']} warnings")
        for r in doubts.head(5).to_dict("records")
        if r["why"] or r["faults"]
    ]
    pictures = [str(p) for p in sorted(draw.glob("*.png"))] if draw is not None else []
    lines += [f"written: {path}" for path in (output, *pictures, prior) if path is not None]
    content = {
        "rows": len(rows),
        "campaigns": int(rows["campaign"].nunique()),
        "machines": machines,
        "output": output,
        "pictures": pictures,
        "prior": prior,
        "drift": drift.to_dict("records"),
        "fleet": fleet.to_dict("records"),
        "doubts": doubts.to_dict("records"),
    }
    return Outcome(lines, content)


def _csv(frame: pd.DataFrame) -> list[str]:
    from smfe.results import defused

    stream = io.StringIO()
    defused(frame).to_csv(stream, index=False, lineterminator="\n")
    return stream.getvalue().splitlines()
