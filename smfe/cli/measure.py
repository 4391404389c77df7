"""Verbs about what was measured: `plan`, `check`, `identify`, `modal`, `compare`, `coefficients`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from smfe.cli.terminal import Outcome, Terminal
from smfe.cli.verb import MEASURE, OUT, CampaignFile, any_files, verb

KEPT = "nothing was written, and what was identified is kept beside the results"


@verb(
    MEASURE,
    gives="the passes to cut with speeds, depth and feed, the expected error of each compliance; plan.html for the "
    "operator, plan.csv, plan.toml to run afterwards.",
    examples=["smfe plan campaign.toml", "smfe plan campaign.toml -o planned --verify"],
    keys="page, passes, worst_error, median_error, summary, confirmed",
)
def plan(
    terminal: Terminal,
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option(*OUT, help="Folder of the plan.")] = Path("planned"),
    verified: Annotated[bool, typer.Option("--verify", help="Simulate and identify the plan as well.")] = False,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of noise to verify with.")] = 3,
) -> Outcome:
    """Say before cutting which sweep will work, and how well."""
    import smfe
    from smfe.planning import recommend, verification

    with terminal.bar() as progress:
        found = smfe.plan(campaign, output, progress, terminal.show)
    lines = recommend.summary(found).splitlines()
    content = {
        "page": str(output / "plan.html"),
        "passes": str(output / "plan.csv"),
        "worst_error": found.worst,
        "median_error": found.median,
        "summary": list(lines),
    }
    confirmed = True
    if verified:
        with terminal.bar() as progress:
            result = verification.verify(found, output, tuple(range(1, seeds + 1)), progress)
        lines += verification.explain(result).splitlines()
        confirmed = result.confirmed
        content["confirmed"] = confirmed
    lines.append(f"written: {output / 'plan.html'}; next: cut {output / 'plan.csv'}")
    return Outcome(lines, content, found.warnings, fault=not confirmed)


@verb(
    MEASURE,
    gives="each suspicion with its place, the evidence and what to do; faults first. Exit status 3 where there is one.",
    examples=["smfe check campaign.toml", "smfe check campaign.toml --json"],
    keys="suspects, counts",
)
def check(terminal: Terminal, campaign: CampaignFile) -> Outcome:
    """Audit the data of a campaign, and try in short all that it asks for."""
    import smfe

    with terminal.bar() as progress:
        table = smfe.check(campaign, progress, terminal.show)
    counts = {level: int((table["level"] == level).sum()) for level in ("fault", "warning", "note")}
    lines = [f"{row.level}, {row.cause}: {row.where}: {row.evidence}; {row.advice}" for row in table.itertuples()]
    lines.append(", ".join(f"{count} {level}s" for level, count in counts.items()) if len(table) else _NOTHING)
    lines.append(
        f"next: smfe run {campaign}" if not counts["fault"] else "next: correct the faults, or run without them"
    )
    content = {"suspects": table.to_dict("records"), "counts": counts}
    return Outcome(lines, content, fault=counts["fault"] > 0)


_NOTHING = "nothing suspicious"


@verb(
    MEASURE,
    gives="frf.nc: the compliance of each measurement with its standard deviation and coherence; loops.nc and "
    "drives.csv beside it where the campaign has records of drives.",
    examples=["smfe identify campaign.toml -o frf.nc", "smfe compare frf.nc"],
    keeps=KEPT,
    keys="output, measurements, drives",
)
def identify(
    terminal: Terminal,
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option(*OUT, help="NetCDF file of the compliances.")] = Path("frf.nc"),
) -> Outcome:
    """Identify the compliances of a campaign."""
    import smfe
    from smfe.identification.drive.drives import DRIVE_FILE, LOOP_FILE, drive_lines, loop_lines
    from smfe.results import Failures

    failures: Failures = []
    with terminal.bar() as progress:
        found = smfe.identify(campaign, output, progress, terminal.show, failures)
    lines, content = [], {}
    for name, item in found.items():
        size = {d: item.compliance.sizes[d] for d in ("frequency", "response", "excitation")}
        shown = " x ".join(str(count) for count in size.values())
        lines.append(f"{name}: {item.method}, {shown} (frequencies x responses x excitations)")
        content[name] = {"method": item.method, **size}
    drives = [*loop_lines(output.with_name(LOOP_FILE)), *drive_lines(output.with_name(DRIVE_FILE))]
    lines += [*drives, f"written: {output}; next: smfe compare {output}"]
    warnings = [f"{name}: {warning}" for name, item in found.items() for warning in item.warnings]
    return Outcome(lines, {"output": str(output), "measurements": content, "drives": drives}, warnings, failures)


@verb(
    MEASURE,
    gives="modal.toml: frequency, damping and stiffness of each mode with its interval, as a [[model]] to paste into a "
    "campaign; a table and a stabilisation diagram beside it.",
    examples=["smfe modal campaign.toml", 'smfe modal frf.nc --measurement hammer --band "20 Hz" "80 Hz"'],
    keeps=KEPT,
    keys="output, modes",
)
def modal(
    terminal: Terminal,
    source: Annotated[
        Path,
        typer.Argument(help="Campaign file, frf.nc, or universal file.", show_default=False, autocompletion=any_files),
    ],
    output: Annotated[Path, typer.Option(*OUT, help="Modes as TOML or JSON.")] = Path("modal.toml"),
    measurement: Annotated[
        str | None, typer.Option(help="Only this measurement; default: all.", show_default=False)
    ] = None,
    band: Annotated[
        tuple[str, str] | None, typer.Option(help='Only these frequencies, "20 Hz" "80 Hz".', show_default=False)
    ] = None,
) -> Outcome:
    """Fit modes to measured compliances and write them as models for a campaign file."""
    import smfe
    from smfe.results import Failures

    failures: Failures = []
    with terminal.bar() as progress:
        fits = smfe.modal(source, output, measurement, band, progress, terminal.show, failures)
    tables = {name: fit.table().to_dict("records") for name, fit in fits.items()}
    lines = []
    for name, rows in tables.items():
        for row in rows:
            stiffness = f", {row['stiffness_N_um']:.4g} N/um" if "stiffness_N_um" in row else ""
            lines.append(f"{name}: {row['frequency_Hz']:.5g} Hz, {100 * row['damping']:.3g} %{stiffness}")
    lines.append(f"written: {output}; next: paste it into a campaign file, name it in [[lobes]]")
    warnings = [f"{name}: {warning}" for name, fit in fits.items() for warning in fit.warnings]
    return Outcome(lines, {"output": str(output), "modes": tables}, warnings, failures)


@verb(
    MEASURE,
    gives="comparison.csv: for each pair of measurements and entry the frequency, damping and amplitude of each peak "
    "and their differences with uncertainty.",
    examples=["smfe compare frf.nc", "smfe compare results/frf.nc -o comparison.csv"],
    keys="output, rows, pairs",
)
def compare(
    terminal: Terminal,
    frf: Annotated[
        Path, typer.Argument(help="Compliance file (frf.nc).", show_default=False, autocompletion=any_files)
    ],
    output: Annotated[Path, typer.Option(*OUT, help="CSV file of the comparison.")] = Path("comparison.csv"),
) -> Outcome:
    """Compare the measurements of a compliance file, peak by peak."""
    import smfe

    with terminal.bar() as progress:
        progress("comparing", 0, 1)
        table = smfe.compare(frf, output)
    pairs = 0 if table.empty else len(table[["measurement_a", "measurement_b"]].drop_duplicates())
    said = f"{len(table)} rows of {pairs} pairs of measurements written: {output}"
    return Outcome([said], {"output": str(output), "rows": len(table), "pairs": pairs})


@verb(
    MEASURE,
    gives="Ktc, Krc, Kac, Kte, Kre, Kae with 95 % intervals, as a [material] to paste into a campaign.",
    examples=["smfe coefficients slots.toml -o material.toml"],
    keys="output, fits",
)
def coefficients(
    terminal: Terminal,
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option(*OUT, help="File for the table of the material, to paste.")] = Path(
        "material.toml"
    ),
) -> Outcome:
    """Find the cutting coefficients from measured cuts, with intervals."""
    import smfe

    with terminal.bar() as progress:
        found = smfe.coefficients(campaign, output, progress, terminal.show)
    lines = []
    for fit in found:
        lines += fit.material(fit.method).splitlines()
        lines += [f"# residual {100.0 * fit.residual:.3g} % of the forces", ""]
    lines.append(f"written: {output}; next: paste one of the tables into a campaign file")
    warnings = [f"{fit.method}: {warning}" for fit in found for warning in fit.warnings]
    content = [
        {"method": f.method, "values": f.values, "intervals": f.intervals, "residual": f.residual} for f in found
    ]
    return Outcome(lines, {"output": str(output), "fits": content}, warnings)
