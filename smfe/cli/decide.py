"""Verbs that decide: `run`, `chatter`, `diagnose`, `report`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from smfe.cli.answer import run_outcome
from smfe.cli.terminal import Outcome, Terminal
from smfe.cli.verb import DECIDE, OUT, CampaignFile, Campaigns, any_files, campaign_files, result_folders, verb


@verb(
    DECIDE,
    gives="a folder with report.html (lobes, cutting tests, compliances, diagnosis), the recommended speed and depth "
    "also in presets.json and pockets.csv, lobe_table.csv, frf.nc, lobes.nc, provenance.json. A second run goes on "
    "where the first stopped. Of many campaigns: such a folder each, with the report where --reports asks for it, and "
    "catalogue.parquet, one table of all, for `smfe catalogue`.",
    examples=[
        "smfe run campaign.toml",
        "smfe run campaign.toml --out results --json",
        "smfe run archive --out results --jobs 8",
        'smfe run "archive/*/2025-*/campaign.toml" --out results',
    ],
    keeps="what is finished is kept in the folder of results, and no file is half written",
    keys="recommendation, recommendations, report, finding",
)
def run(
    terminal: Terminal,
    campaign: Campaigns,
    folder: Annotated[Path, typer.Option(*OUT, help="Folder of the results.", autocompletion=result_folders)] = Path(
        "results"
    ),
    fresh: Annotated[bool, typer.Option("--fresh", help="Read nothing back from an earlier run.")] = False,
    jobs: Annotated[
        int | None,
        typer.Option(
            "-j", "--jobs", min=1, help="Processes; default: one a core, of one campaign one.", show_default=False
        ),
    ] = None,
    reports: Annotated[
        bool, typer.Option("--reports", help="Of many campaigns: write the report of each, too.")
    ] = False,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Scheduler of a dask cluster that does the work, tcp://host:8786.", show_default=False),
    ] = None,
) -> Outcome:
    """Do all that a campaign asks for: data audit, compliances, lobes, verdicts, diagnosis, report."""
    from smfe.commands.many.folders import is_one
    from smfe.kept import is_unchanged

    if len(campaign) > 1 or not is_one(campaign[0]):
        return _many(terminal, campaign, folder, fresh, jobs, reports, scheduler)
    # Said before the numerics are imported, which takes longer than all the rest.
    if not fresh and is_unchanged(Path(campaign[0]), folder) and (folder / "report.html").is_file():
        terminal.note("nothing has changed since these results were written; --fresh computes them again")
        return run_outcome(folder / "report.html")
    import smfe

    with terminal.bar() as progress:
        report_file = smfe.run(campaign[0], folder, fresh, progress, terminal.show, None, jobs, scheduler)
    return run_outcome(report_file)


def _many(
    terminal: Terminal,
    campaigns: list[str],
    folder: Path,
    fresh: bool,
    jobs: int | None,
    reports: bool,
    scheduler: str | None,
) -> Outcome:
    """Run many campaigns and say what they came to, what failed at the end."""
    import smfe

    with terminal.bar() as progress:
        batch = smfe.run(campaigns, folder, fresh, progress, None, reports, jobs, scheduler)
    states = list(batch.states.values())
    counts = {what: states.count(what) for what in ("done", "faults", "refused", "outside")}
    words = {"faults": "with parts that failed", "refused": "refused", "outside": "failed for reasons outside"}
    said = ", ".join([f"{counts['done']} done", *(f"{counts[k]} {w}" for k, w in words.items() if counts[k])])
    kept = f" ({batch.unchanged} unchanged since an earlier run)" if batch.unchanged else ""
    lines = [
        f"{len(states)} campaigns: {said}{kept}",
        f"catalogue: {batch.catalogue}; next: smfe catalogue {folder}",
    ]
    content = {"catalogue": str(batch.catalogue), "campaigns": batch.states, "unchanged": batch.unchanged}
    return Outcome(lines, content, failures=batch.failures, wrong=batch.wrong)


@verb(
    DECIDE,
    gives="stable, chatter or undecided with the reason, the part of the record that was judged, and speeds to try.",
    examples=[
        'smfe chatter cut.wav --teeth 6 --speed "1656 rpm"',
        "smfe chatter cut.csv --teeth 2 --campaign campaign.toml",
    ],
    keys="verdict, reason, ratio, chatter_frequency_Hz, tooth_passing_harmonic_Hz, spindle_speed_rpm, "
    "quantity, axes, cut_s, interval_s, half_order_ratio, try_rpm, notes",
)
def chatter(
    terminal: Terminal,
    record: Annotated[Path, typer.Argument(help="Record of a cut.", show_default=False, autocompletion=any_files)],
    teeth: Annotated[int, typer.Option(help="Number of teeth.", show_default=False)],
    speed: Annotated[
        str | None,
        typer.Option(help='Spindle speed with its unit, "500 rpm"; default: from the record.', show_default=False),
    ] = None,
    campaign: Annotated[
        Path | None,
        typer.Option(
            help="Campaign file that declares the channels.", show_default=False, autocompletion=campaign_files
        ),
    ] = None,
    interval: Annotated[
        tuple[str, str] | None,
        typer.Option(help='Part to judge, "2 s" "6 s"; default: the cut that is found.', show_default=False),
    ] = None,
    axes: Annotated[str | None, typer.Option(help='Axes to judge, "x,y"; default: all.', show_default=False)] = None,
    frequency_range: Annotated[
        tuple[str, str] | None, typer.Option(help='Band, "20 Hz" "400 Hz".', show_default=False)
    ] = None,
    quantity: Annotated[
        str | None, typer.Option(help="acceleration, displacement, force or sound.", show_default=False)
    ] = None,
    floor: Annotated[
        float | None, typer.Option(help="Least amplitude that counts (m/s^2, m, N, Pa).", show_default=False)
    ] = None,
    half_order_reference: Annotated[
        float | None, typer.Option(help="half_order_ratio of a stable cut with the same tool.", show_default=False)
    ] = None,
) -> Outcome:
    """Judge one cut by the spectral chatter criterion: WAV, CSV, TDMS, whatever smfe reads."""
    import smfe
    from process.units import parse

    with terminal.bar() as progress:
        progress(f"judging {record.name}", 0, 1)
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
    begin, entered, left, end = verdict.cut_s
    lines = [
        f"{verdict.verdict}: {verdict.reason}",
        f"cut from {begin:.3g} to {end:.3g} s (entered by {entered:.3g}, left from {left:.3g} s), judged from "
        f"{verdict.interval_s[0]:.3g} to {verdict.interval_s[1]:.3g} s",
        f"ratio {verdict.ratio:.3g}, spindle speed {verdict.spindle_speed_rpm:.5g} rpm, judged on {verdict.quantity}, "
        f"half_order_ratio {verdict.half_order_ratio:.3g}",
    ]
    if verdict.try_rpm:
        lines.append(f"speeds to try: {', '.join(f'{s:.0f}' for s in verdict.try_rpm)} rpm")
    lines += [f"note: {note}" for note in verdict.notes]
    content = {
        "verdict": verdict.verdict,
        "reason": verdict.reason,
        "ratio": verdict.ratio,
        "chatter_frequency_Hz": verdict.chatter_frequency_Hz,
        "tooth_passing_harmonic_Hz": verdict.tooth_passing_harmonic_Hz,
        "spindle_speed_rpm": verdict.spindle_speed_rpm,
        "quantity": verdict.quantity,
        "axes": {a.axis: a.verdict for a in verdict.by_axis},
        "cut_s": [begin, end],
        "interval_s": verdict.interval_s,
        "half_order_ratio": verdict.half_order_ratio,
        "try_rpm": verdict.try_rpm,
        "notes": verdict.notes,
    }
    return Outcome(lines, content)


@verb(
    DECIDE,
    gives="a verdict (consistent, named, ambiguous, unknown, insufficient data), what the extended model gains on "
    "conditions it was not fitted to, and the next experiment; finding.json, which `smfe report` shows.",
    examples=["smfe diagnose campaign.toml -o results/finding.json", "smfe diagnose campaign.toml --held-out pass_3"],
    keeps="nothing was written, and what was identified is kept beside the finding",
    keys="output, finding",
)
def diagnose(
    terminal: Terminal,
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option(*OUT, help="JSON file of the finding.")] = Path("finding.json"),
    seed: Annotated[int, typer.Option(help="Seed of all draws.")] = 0,
    held_out: Annotated[
        list[str] | None,
        typer.Option(
            "--held-out", help="Measurement to hold out and compare once, at the very end.", show_default=False
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Processes; default: one a core, at most 8, on Linux; else one.", show_default=False),
    ] = None,
) -> Outcome:
    """Say what the baseline of a campaign gets wrong, why, and what the repaired model gains."""
    import smfe
    from smfe.diagnosis.story.sentences import explain

    with terminal.bar() as progress:
        finding = smfe.diagnose(campaign, output, seed, tuple(held_out or ()), progress, terminal.show, workers)
    # `smfe report` looks for this name.
    then = f"; next: smfe report {output.parent}" if output.name == "finding.json" else ""
    content = json.loads(output.read_text(encoding="utf-8"))
    if name := (content.get("extended") or {}).get("file"):
        then = f"; the extended model as a campaign: {output.with_name(name)}{then}"
    faults = [row for row in content.get("data_audit", []) if row.get("level") == "fault"]
    block = finding.next_experiment.block if finding.next_experiment is not None else ""
    more = ["to add to the campaign file when it is measured:", *block.splitlines()] if block else []
    verdict = f"Verdict: {finding.verdict.replace('_', ' ')}."
    lines = [verdict, *explain(finding).splitlines(), *more, f"written: {output}{then}"]
    return Outcome(lines, {"output": str(output), "finding": content}, fault=bool(faults))


@verb(
    DECIDE,
    gives="report.html and figures/*.png, from the files of the folder alone: no record is read.",
    examples=["smfe report results"],
    keys="report",
)
def report(
    terminal: Terminal,
    folder: Annotated[
        Path, typer.Argument(help="Folder of results.", show_default=False, autocompletion=result_folders)
    ],
) -> Outcome:
    """Write the report of a folder of results again."""
    import smfe

    with terminal.bar() as progress:
        path = smfe.report(folder, progress)
    return Outcome([f"report: {path}"], {"report": str(path)})
