"""Verbs that predict: `lobes`, `pitch`, `tune`, `simulate`, `demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from smfe.cli.answer import run_outcome
from smfe.cli.terminal import Outcome, Terminal
from smfe.cli.verb import OUT, PREDICT, CampaignFile, any_files, campaign_files, verb

CutName = Annotated[
    str | None, typer.Option(help='Which [[lobes]] says the cut, "lobes_2"; default: the first.', show_default=False)
]
SourceName = Annotated[
    str | None,
    typer.Option(help="Which of its measurements or models; default: the first.", show_default=False),
]
KnownCompliances = Annotated[
    Path | None,
    typer.Option(help="Use these compliances instead of identifying.", show_default=False, autocompletion=any_files),
]


@verb(
    PREDICT,
    gives="lobes.nc and lobe_table.csv: the limit depth over the spindle speed with its quantiles, for each "
    "measurement that the campaign asks for; bands.csv and a picture of it where it asks for all bands of depth, "
    "maps.nc, maps.csv and a picture where it asks for maps; widths.nc, widths.csv and a picture of several widths.",
    examples=["smfe lobes campaign.toml", "smfe lobes campaign.toml --frf results/frf.nc"],
    keeps="nothing was written, and what was identified is kept beside the results",
    keys="output, table, bands, written, limits",
)
def lobes(
    terminal: Terminal,
    campaign: CampaignFile,
    frf: KnownCompliances = None,
    output: Annotated[Path, typer.Option(*OUT, help="NetCDF file of the lobes.")] = Path("lobes.nc"),
    table: Annotated[Path, typer.Option(help="CSV lobe table.")] = Path("lobe_table.csv"),
    bands: Annotated[
        Path, typer.Option(help="CSV table of all bands of depth, where bands_up_to asks for them.")
    ] = Path("bands.csv"),
    maps: Annotated[
        Path, typer.Option(help="NetCDF file of maps over speed and depth, where maps_up_to asks for them.")
    ] = Path("maps.nc"),
    widths: Annotated[
        Path, typer.Option(help="NetCDF file of limits over width of cut and speed, where there are several widths.")
    ] = Path("widths.nc"),
) -> Outcome:
    """Compute the stability lobes that a campaign asks for."""
    import smfe
    from smfe.limits.depth_bands import islands_said, unpacked
    from smfe.results import Failures, unpack_warnings

    failures: Failures = []
    written: list[Path] = []
    with terminal.bar() as progress:
        results = smfe.lobes(campaign, output, table, frf, progress, failures, bands, maps, widths, written)
    lines, content, warnings = [], [], []
    for r in results:
        depth, speed = r.lobes["limit_depth"].values, r.lobes["spindle_speed"].values
        low, high = int(depth.argmin()), int(depth.argmax())
        lines.append(
            f"{r.request}, {r.source}: limit {depth[low]:.3g} mm at {speed[low]:g} rpm (smallest) to "
            f"{depth[high]:.3g} mm at {speed[high]:g} rpm (largest)"
        )
        lower = r.lobes.get("lower_limit_depth")
        if lower is not None and bool((lower < r.lobes["limit_depth"]).any()):
            at = int((lower / r.lobes["limit_depth"]).values.argmin())
            lines.append(
                f"{r.request}, {r.source}: a kick of {float(r.lobes['kick'][at]):.2g} N s lowers it to "
                f"{float(lower[at]):.3g} mm at {speed[at]:g} rpm, where that takes most"
            )
        found = unpacked(r.lobes)
        if found is not None:
            lines.append(f"{r.request}, {r.source}: {islands_said(found)}")
        content.append(
            {
                "lobes": r.request,
                "source": r.source,
                "smallest_limit_mm": float(depth[low]),
                "smallest_at_rpm": float(speed[low]),
                "largest_limit_mm": float(depth[high]),
                "largest_at_rpm": float(speed[high]),
            }
        )
        warnings += [f"{r.request}, {r.source}: {warning}" for warning in unpack_warnings(r.lobes)]
    lines.append(f"written: {', '.join(map(str, written))}; next: smfe run {campaign} recommends a speed and a depth")
    said: dict[str, Any] = {
        "output": str(output),
        "table": str(table),
        "bands": str(bands) if bands in written else None,
    }
    said["written"] = [str(file) for file in written]
    return Outcome(lines, {**said, "limits": content}, warnings, failures)


@verb(
    PREDICT,
    gives="pitch.toml with the pitch angles to paste into [tool], pitch.csv with the limits of unequal and of equal "
    "pitch over the spindle speed, figures/pitch.png.",
    examples=[
        'smfe pitch campaign.toml --speed "4200 rpm"',
        'smfe pitch campaign.toml --speed "4200 rpm" --lobes lobes_2 --around 0.05',
    ],
    keeps="nothing was written, and what was identified is kept beside the results",
    keys="output, written, lobes, source, spindle_speed_rpm, pattern, pitch_angles_deg, line, gain, limit_mm, "
    "equal_limit_mm, largest_chip, verified",
)
def pitch(
    terminal: Terminal,
    campaign: CampaignFile,
    speed: Annotated[
        str, typer.Option(help='Spindle speed of interest with its unit, "4200 rpm".', show_default=False)
    ],
    output: Annotated[Path, typer.Option(*OUT, help="Folder of the pitch.")] = Path("pitch"),
    lobes: CutName = None,
    measurement: SourceName = None,
    frf: KnownCompliances = None,
    frequency: Annotated[
        str | None,
        typer.Option(
            help='Mode to silence, "920 Hz"; default: the chatter frequency with equal pitch.', show_default=False
        ),
    ] = None,
    around: Annotated[float, typer.Option(help="Share of the speed on both sides where the limit counts.")] = 0.03,
    largest_deviation: Annotated[
        float, typer.Option(help="Largest departure of a pitch from the mean, as a share of it.")
    ] = 0.2,
) -> Outcome:
    """Find the unequal pitch of the teeth that raises the limit most at a spindle speed."""
    import smfe
    from smfe.commands.cut.pitch import WRITTEN

    with terminal.bar() as progress:
        found = smfe.pitch(
            campaign,
            speed,
            output,
            progress,
            lobes=lobes,
            measurement=measurement,
            frf=frf,
            frequency=frequency,
            around=around,
            largest_deviation=largest_deviation,
        )
    cut = f"{found.asked.request.name}, {found.asked.source}"
    within = f"within {100 * found.around:g} % of {found.spindle_speed:g} rpm"
    if found.design.pattern == "equal":
        lines = [f"{cut}: equal pitch stays best {within}, limit {found.least_mm:.3g} mm"]
    else:
        lines = [
            f"{cut}: {found.design.pattern} pitch, limit {found.least_mm:.3g} mm {within}, {found.equal_least_mm:.3g} "
            f"mm with equal pitch: {found.design.gain:.3g} times",
            f"{found.line()}; the thickest chip is {found.largest_chip:.3g} times the mean",
        ]
    written = [output / name for name in (*WRITTEN, "figures/pitch.png")]
    lines.append(f"written: {', '.join(map(str, written))}; next: paste pitch.toml into [tool], smfe run {campaign}")
    content = {
        "output": str(output),
        "written": [str(file) for file in written],
        "lobes": found.asked.request.name,
        "source": found.asked.source,
        "spindle_speed_rpm": found.spindle_speed,
        "pattern": found.design.pattern,
        "pitch_angles_deg": list(found.design.pitch_angles_deg),
        "line": found.line(),
        "gain": found.design.gain,
        "limit_mm": found.least_mm,
        "equal_limit_mm": found.equal_least_mm,
        "largest_chip": found.largest_chip,
        "verified": found.design.check.to_dict("records"),
    }
    return Outcome(lines, content, found.notes)


@verb(
    PREDICT,
    gives="gains.toml with the controllers found, tuning.csv with the present ones beside them and the compromises "
    "with tracking, tuning.nc with lobes and loops, figures/tuning.png.",
    examples=["smfe tune campaign.toml", "smfe tune campaign.toml -o tuned --json"],
    keys="output, gains, goal, worst, nominal, unit, tracking_error_um, values, sets, summary",
)
def tune(
    terminal: Terminal,
    campaign: CampaignFile,
    output: Annotated[Path, typer.Option(*OUT, help="Folder of the gains.")] = Path("tuned"),
) -> Outcome:
    """Find the gains of the feed drives with which a cut is most stable, within limits of commissioning."""
    import smfe
    from smfe.tuning import words

    with terminal.bar() as progress:
        found = smfe.tune(campaign, output, progress, terminal.show)
    lines = [*words.summary(found), f"written: {output / 'gains.toml'}; next: set them, and cut a test"]
    rate = found.task.goal.kind == "removal_rate"
    factor = 6e7 if rate else 1e3
    content = {
        "output": str(output),
        "gains": {axis: dict(vars(v)) for axis, v in found.servos.items()},
        "goal": found.task.goal.words,
        "worst": factor * found.best.goal,
        "nominal": factor * found.best.nominal,
        "unit": "cm3/min" if rate else "mm",
        "tracking_error_um": 1e6 * found.best.tracking_error,
        "values": words.values(found.best),
        "sets": found.table().to_dict("records"),
        "summary": lines[:-1],
    }
    return Outcome(lines, content, found.warnings)


@verb(
    PREDICT,
    gives="records as instruments would have written them, the campaign file that reads them, and truth.nc.",
    examples=["smfe simulate scenario.toml -o simulated", "smfe run simulated/campaign.toml"],
    keys="campaign, left_out",
)
def simulate(
    terminal: Terminal,
    scenario: Annotated[
        Path, typer.Argument(help="Scenario file (TOML).", show_default=False, autocompletion=campaign_files)
    ],
    output: Annotated[Path, typer.Option(*OUT, help="Folder for records and campaign file.")] = Path("simulated"),
    workers: Annotated[
        int | None, typer.Option(min=1, help="Records at a time; default: one a core.", show_default=False)
    ] = None,
) -> Outcome:
    """Simulate the trials of a scenario; write their records and the campaign file that reads them."""
    import smfe
    from smfe.results import Failures
    from smfe.scenario.run import NothingLeft

    notes: list[str] = []
    failures: Failures = []
    try:
        with terminal.bar() as progress:
            campaign = smfe.simulate(scenario, output, workers, progress, notes.append, failures)
    except NothingLeft:
        return Outcome(["nothing written: no condition is left"], {"campaign": None}, notes, failures)
    content = {"campaign": str(campaign), "left_out": [{"name": f.name, "reason": f.reason} for f in failures]}
    return Outcome([f"written: {campaign}; next: smfe run {campaign}"], content, notes)


@verb(
    PREDICT,
    gives="a campaign with records under demo/, and its results: open demo/results/report.html.",
    examples=["smfe demo", "smfe demo --out try --seed 1"],
    keeps="records that are complete are kept",
    keys="recommendation, recommendations, report, finding",
)
def demo(
    terminal: Terminal,
    folder: Annotated[Path, typer.Option(*OUT, help="Folder for records, campaign file and results.")] = Path("demo"),
    seed: Annotated[
        int | None, typer.Option(help="Seed of the sensor noise; default: a fixed one.", show_default=False)
    ] = None,
) -> Outcome:
    """Simulate a whole measuring campaign and run it."""
    import smfe
    from smfe.commands.demo import DEMO_SEED

    with terminal.bar() as progress:
        report_file = smfe.demo(folder, DEMO_SEED if seed is None else seed, progress)
    return run_outcome(report_file)
