"""The command line: parses, calls, prints."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as RichProgress
from rich.table import Table

import smfe
from process.errors import InputError
from process.units import parse
from smfe._version import __version__
from smfe.commands.demo import DEMO_SEED
from smfe.diagnosis.inference.finding import explain
from smfe.identification.drive.drives import DRIVE_FILE, LOOP_FILE, drive_lines, loop_lines
from smfe.planning import recommend, verification
from smfe.progress import Progress
from smfe.records.look import summary as summary_of_look
from smfe.results import Failures, unpack, unpack_warnings

app = typer.Typer(
    help="Machine-tool dynamics: measured records -> compliance -> stability lobes -> chatter verdicts.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
console = Console(stderr=True)
out = Console()

CampaignFile = Annotated[Path, typer.Argument(help="Campaign file (TOML).", show_default=False)]


def _version(asked: bool) -> None:
    if asked:
        out.print(f"smfe {__version__}", highlight=False)
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Machine-tool dynamics on measured data."""


@app.command()
def demo(
    folder: Annotated[Path, typer.Option("--out", help="Folder for records, campaign file and results.")] = Path(
        "demo"
    ),
    seed: Annotated[int, typer.Option(help="Seed of the sensor noise.")] = DEMO_SEED,
) -> None:
    """Simulate a whole measuring campaign and run it."""
    with _bar() as progress:
        report = smfe.demo(folder, seed, progress)
    _finish(report)


@app.command()
def run(
    campaign: CampaignFile,
    folder: Annotated[Path, typer.Option("--out", help="Folder of the results.")] = Path("results"),
    fresh: Annotated[bool, typer.Option("--fresh", help="Read nothing back from an earlier run.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print report, warnings and failures as JSON.")] = False,
) -> None:
    """Do everything a campaign asks for: compliances, comparison, lobes, verdicts, report."""
    with _bar() as progress:
        report = smfe.run(campaign, folder, fresh, progress, _show)
    _finish(report, as_json)


@app.command()
def identify(
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option("-o", "--output", help="NetCDF file of the compliances.")] = Path("frf.nc"),
) -> None:
    """Identify the compliances of a campaign."""
    failures: Failures = []
    with _bar() as progress:
        found = smfe.identify(campaign, output, progress, _show, failures)
    for name, item in found.items():
        sizes = " x ".join(str(item.compliance.sizes[d]) for d in ("frequency", "response", "excitation"))
        out.print(f"{name}: {item.method}, {sizes} (frequencies x responses x excitations)", highlight=False)
        for warning in item.warnings:
            console.print(f"warning, {name}: {warning}", markup=False, highlight=False)
    for line in [*loop_lines(output.with_name(LOOP_FILE)), *drive_lines(output.with_name(DRIVE_FILE))]:
        out.print(line, markup=False, highlight=False, soft_wrap=True)
    out.print(f"written: {output}", highlight=False)
    _fail(failures)


@app.command()
def compare(
    frf: Annotated[Path, typer.Argument(help="Compliance file (frf.nc).", show_default=False)],
    output: Annotated[Path, typer.Option("-o", "--output", help="CSV file of the comparison.")] = Path(
        "comparison.csv"
    ),
) -> None:
    """Compare the measurements of a compliance file, peak by peak."""
    table = smfe.compare(frf, output)
    out.print(f"{len(table)} rows written: {output}", highlight=False)


@app.command()
def modal(
    source: Annotated[Path, typer.Argument(help="Campaign file, frf.nc, or universal file.", show_default=False)],
    output: Annotated[Path, typer.Option("-o", "--output", help="Modes as TOML or JSON.")] = Path("modal.toml"),
    measurement: Annotated[
        str | None, typer.Option(help="Only this measurement; default: all.", show_default=False)
    ] = None,
    band: Annotated[
        tuple[str, str] | None, typer.Option(help='Only these frequencies, "20 Hz" "80 Hz".', show_default=False)
    ] = None,
) -> None:
    """Fit modes to measured compliances and write them as models for a campaign file."""
    failures: Failures = []
    with _bar() as progress:
        fits = smfe.modal(source, output, measurement, band, progress, _show, failures)
    for name, fit in fits.items():
        for row in fit.table().to_dict("records"):
            stiffness = f", {row['stiffness_N_um']:.4g} N/um" if "stiffness_N_um" in row else ""
            out.print(f"{name}: {row['frequency_Hz']:.5g} Hz, {100 * row['damping']:.3g} %{stiffness}", highlight=False)
        for warning in fit.warnings:
            console.print(f"warning, {name}: {warning}", markup=False, highlight=False)
    out.print(f"written: {output}", highlight=False)
    _fail(failures)


@app.command()
def lobes(
    campaign: CampaignFile,
    frf: Annotated[Path | None, typer.Option(help="Use these compliances instead of identifying.")] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="NetCDF file of the lobes.")] = Path("lobes.nc"),
    table: Annotated[Path, typer.Option(help="CSV lobe table.")] = Path("lobe_table.csv"),
) -> None:
    """Compute the stability lobes that a campaign asks for."""
    failures: Failures = []
    with _bar() as progress:
        results = smfe.lobes(campaign, output, table, frf, progress, failures)
    heads = ("lobes", "source", "smallest limit [mm]", "at [rpm]", "largest limit [mm]", "at [rpm]")
    shown = Table(*map(escape, heads))
    for r in results:
        depth, speed = r.lobes["limit_depth"].values, r.lobes["spindle_speed"].values
        low, high = int(depth.argmin()), int(depth.argmax())
        shown.add_row(
            r.request, r.source, f"{depth[low]:.3g}", f"{speed[low]:g}", f"{depth[high]:.3g}", f"{speed[high]:g}"
        )
        for warning in unpack_warnings(r.lobes):
            console.print(f"warning, {r.request}, {r.source}: {warning}", markup=False, highlight=False)
    out.print(shown)
    out.print(f"written: {output}, {table}", highlight=False)
    _fail(failures)


@app.command()
def chatter(
    record: Annotated[Path, typer.Argument(help="Record of a cut.", show_default=False)],
    teeth: Annotated[int, typer.Option(help="Number of teeth.", show_default=False)],
    speed: Annotated[
        str | None,
        typer.Option(help='Spindle speed with its unit, "500 rpm"; default: from the record.', show_default=False),
    ] = None,
    campaign: Annotated[Path | None, typer.Option(help="Campaign file that declares the channels.")] = None,
    interval: Annotated[
        tuple[str, str] | None, typer.Option(help='Part to judge, "2 s" "6 s"; default: the cut that is found.')
    ] = None,
    axes: Annotated[str | None, typer.Option(help='Axes to judge, "x,y"; default: all.', show_default=False)] = None,
    frequency_range: Annotated[
        tuple[str, str] | None, typer.Option(help='Band, "20 Hz" "400 Hz".', show_default=False)
    ] = None,
    quantity: Annotated[
        str | None, typer.Option(help="acceleration, displacement, force or sound.", show_default=False)
    ] = None,
    floor: Annotated[
        float | None, typer.Option(help="Least amplitude that counts [m/s^2, m, N, Pa].", show_default=False)
    ] = None,
    half_order_reference: Annotated[
        float | None, typer.Option(help="half_order_ratio of a stable cut with the same tool.", show_default=False)
    ] = None,
) -> None:
    """Judge one cut by the spectral chatter criterion: WAV, CSV, TDMS, whatever smfe reads."""
    verdict = smfe.chatter(
        record,
        speed,
        teeth,
        campaign,
        quantity=quantity,
        interval=None if interval is None else (parse(interval[0], "time"), parse(interval[1], "time")),
        axes=None if axes is None else [a.strip() for a in axes.split(",")],
        frequency_range=None
        if frequency_range is None
        else (parse(frequency_range[0], "frequency"), parse(frequency_range[1], "frequency")),
        floor=floor,
        half_order_reference=half_order_reference,
    )
    out.print(f"{verdict.verdict}: {verdict.reason}", markup=False, highlight=False)
    begin, entered, left, end = verdict.cut_s
    out.print(
        f"cut from {begin:.3g} to {end:.3g} s (entered by {entered:.3g}, left from {left:.3g} s), judged from "
        f"{verdict.interval_s[0]:.3g} to {verdict.interval_s[1]:.3g} s",
        highlight=False,
    )
    out.print(
        f"ratio {verdict.ratio:.3g}, spindle speed {verdict.spindle_speed_rpm:.5g} rpm, judged on {verdict.quantity}, "
        f"half_order_ratio {verdict.half_order_ratio:.3g}",
        highlight=False,
    )
    if verdict.try_rpm:
        out.print(f"speeds to try: {', '.join(f'{s:.0f}' for s in verdict.try_rpm)} rpm", highlight=False)
    for note in verdict.notes:
        out.print(f"note: {note}", markup=False, highlight=False)


@app.command()
def simulate(
    scenario: Annotated[Path, typer.Argument(help="Scenario file (TOML).", show_default=False)],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for records and campaign file.")] = Path(
        "simulated"
    ),
    workers: Annotated[int | None, typer.Option(min=1, help="Records at a time; default: one a core.")] = None,
) -> None:
    """Simulate the trials of a scenario; write their records and the campaign file that reads them."""
    with _bar() as progress:
        campaign = smfe.simulate(scenario, output, workers, progress)
    out.print(f"written: {campaign}; next: smfe run {campaign}", highlight=False, soft_wrap=True)


@app.command()
def plan(
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder of the plan.")] = Path("planned"),
    verified: Annotated[bool, typer.Option("--verify", help="Simulate and identify the plan as well.")] = False,
    seeds: Annotated[int, typer.Option(min=1, help="Seeds of noise to verify with.")] = 3,
) -> None:
    """Say before cutting which sweep will work: passes, speeds, depth, expected error of each compliance."""
    with _bar() as progress:
        found = smfe.plan(campaign, output, progress, _show)
    for warning in found.warnings:
        console.print(f"note: {warning}", markup=False, highlight=False, soft_wrap=True)
    out.print(recommend.summary(found), markup=False, highlight=False, soft_wrap=True)
    if verified:
        with _bar() as progress:
            result = verification.verify(found, output, tuple(range(1, seeds + 1)), progress)
        out.print(verification.explain(result), markup=False, highlight=False, soft_wrap=True)
    out.print(f"written: {output / 'plan.html'}; next: cut {output / 'plan.csv'}", highlight=False, soft_wrap=True)
    if verified and not result.confirmed:
        raise typer.Exit(3)


@app.command()
def check(
    campaign: CampaignFile,
    as_json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
) -> None:
    """Audit the data of a campaign, and try in short all that it asks for: exit code 3 where there is a fault."""
    with _bar() as progress:
        table = smfe.check(campaign, progress, _show)
    if as_json:
        typer.echo(table.to_json(orient="records", indent=2, force_ascii=False))
        raise typer.Exit(3 if (table["level"] == "fault").any() else 0)
    for row in table.itertuples():
        out.print(
            f"{row.level}, {row.cause}: {row.where}: {row.evidence}; {row.advice}",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    counts = ", ".join(f"{int((table['level'] == level).sum())} {level}s" for level in ("fault", "warning", "note"))
    out.print(counts if len(table) else "nothing suspicious", highlight=False)
    if (table["level"] == "fault").any():
        raise typer.Exit(3)


@app.command()
def diagnose(
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option("-o", "--output", help="JSON file of the finding.")] = Path("finding.json"),
    seed: Annotated[int, typer.Option(help="Seed of all draws.")] = 0,
    held_out: Annotated[
        list[str] | None, typer.Option("--held-out", help="Measurement to hold out and compare once, at the very end.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; default: one a core, at most 8, on Linux; else one.")
    ] = None,
) -> None:
    """Say what the baseline of a campaign gets wrong, why, and what the repaired model gains."""
    with _bar() as progress:
        finding = smfe.diagnose(campaign, output, seed, tuple(held_out or ()), progress, _show, workers)
    out.print(explain(finding), markup=False, highlight=False, soft_wrap=True)
    # `smfe report` looks for this name.
    then = f"; next: smfe report {output.parent}" if output.name == "finding.json" else ""
    out.print(f"written: {output}{then}", highlight=False, soft_wrap=True)


@app.command()
def convert(
    source: Annotated[Path, typer.Argument(help="Record to read, in any format.", show_default=False)],
    target: Annotated[Path, typer.Argument(help="File to write: .nc, .csv, .mat, .uff, .unv.", show_default=False)],
    campaign: Annotated[Path | None, typer.Option(help="Campaign file that declares the channels.")] = None,
) -> None:
    """Write a record in another format, in SI units and with the corrections of its channels."""
    with _bar() as progress:
        left: list[str] = []
        written = smfe.convert(source, target, campaign, progress, left.append)
    for text in left:
        console.print(f"warning, {text}", markup=False, highlight=False, soft_wrap=True)
    for path in written:
        out.print(f"written: {path}", highlight=False, soft_wrap=True)


@app.command()
def coefficients(
    campaign: CampaignFile,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="File for the table of the material, to paste.")
    ] = Path("material.toml"),
) -> None:
    """Find the cutting coefficients from measured cuts, with intervals, as a table of the material to paste."""
    with _bar() as progress:
        found = smfe.coefficients(campaign, output, progress, _show)
    for fit in found:
        out.print(fit.material(fit.method), markup=False, highlight=False)
        out.print(f"# residual {100.0 * fit.residual:.3g} % of the forces\n", highlight=False)
        for warning in fit.warnings:
            console.print(f"warning, {fit.method}: {warning}", markup=False, highlight=False, soft_wrap=True)
    out.print(f"written: {output}", highlight=False, soft_wrap=True)


@app.command()
def look(
    record: Annotated[Path, typer.Argument(help="Any file of measured data.", show_default=False)],
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for the picture and the campaign file.")
    ] = Path("."),
) -> None:
    """Say what a file holds and what it seems to be; draw it; write a campaign file to start from."""
    target = output / f"{record.name}.look.toml"
    kept = target.exists()
    found = smfe.look(record, output)
    out.print(summary_of_look(found), markup=False, highlight=False, soft_wrap=True)
    out.print(f"written: {output / f'{record.name}.look.png'}", highlight=False, soft_wrap=True)
    state = "kept as it was" if kept else "written"
    out.print(f"{state}: {target}; next: smfe check {target}", highlight=False, soft_wrap=True)


@app.command()
def report(folder: Annotated[Path, typer.Argument(help="Folder of results.", show_default=False)]) -> None:
    """Write the report of a folder of results again."""
    with _bar() as progress:
        path = smfe.report(folder, progress)
    _done(path)


@contextmanager
def _bar() -> Iterator[Progress]:
    """Show a progress bar on stderr while the block runs; plain lines where the console is not a terminal."""
    if not console.is_terminal:
        yield _lines()
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with RichProgress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("starting", total=1)
        yield lambda what, done, of: progress.update(task, description=what, completed=done, total=max(of, 1))


def _lines() -> Progress:
    """Print each new job once."""
    seen: set[str] = set()

    def report(what: str, done: int, of: int) -> None:
        if what not in seen:
            seen.add(what)
            console.print(what, markup=False, highlight=False)

    return report


def _show(text: str) -> None:
    """Show the licence of a public data set that is about to be fetched."""
    console.print(text, markup=False, highlight=False)


def _finish(report_file: Path, as_json: bool = False) -> None:
    """Print the warnings and failures of a run, which the report has too, and where it is; 3 where a part failed."""
    kept = json.loads((report_file.parent / "provenance.json").read_text(encoding="utf-8"))
    if as_json:
        typer.echo(json.dumps({"report": str(report_file), **{k: kept[k] for k in ("warnings", "failures")}}, indent=2))
    else:
        for warning in kept["warnings"]:
            console.print(f"warning, {warning}", markup=False, highlight=False, soft_wrap=True)
        _done(report_file)
    _fail(unpack(kept))


def _fail(failures: Failures) -> None:
    """Print what failed and leave with exit code 3, if anything did."""
    for failure in failures:
        console.print(f"failed, {failure.sentence}", markup=False, highlight=False, soft_wrap=True)
    if failures:
        raise typer.Exit(3)


def _done(report_file: Path) -> None:
    out.print(f"report: {report_file}", highlight=False, soft_wrap=True)


def app_entry() -> None:
    """Run the command line.

    Wrong input ends with one message and exit code 1, wrong usage with 2; 3 where a part of what was asked for failed.
    """
    try:
        app()
    except InputError as error:
        console.print(f"smfe: {error}", markup=False, highlight=False, soft_wrap=True)
        sys.exit(1)
    except OSError as error:
        console.print(f"smfe: {error.strerror or error}: {error.filename or ''}", markup=False, highlight=False)
        sys.exit(1)
    except KeyboardInterrupt:
        console.print("smfe: interrupted; what was finished is kept", highlight=False)
        sys.exit(130)
