"""Verbs about files: `look`, `convert`, `export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from smfe.cli.terminal import Outcome, Terminal
from smfe.cli.verb import FILES, OUT, any_files, campaign_files, result_folders, verb


@verb(
    FILES,
    gives="channels with units and sizes, the kind of record it seems to be and why; NAME.look.png and a campaign file "
    "to start from, NAME.look.toml.",
    examples=["smfe look hit_x.csv", "smfe look cut.tdms -o first_look"],
    keys="kind, reason, sample_rate_Hz, samples, columns, notes, picture, campaign",
)
def look(
    terminal: Terminal,
    record: Annotated[
        Path, typer.Argument(help="Any file of measured data.", show_default=False, autocompletion=any_files)
    ],
    output: Annotated[Path, typer.Option(*OUT, help="Folder for the picture and the campaign file.")] = Path("."),
) -> Outcome:
    """Say what a file holds and what it seems to be; draw it; write a campaign file to start from."""
    import smfe
    from smfe.records.look import summary

    target, picture = output / f"{record.name}.look.toml", output / f"{record.name}.look.png"
    kept = target.exists()
    with terminal.bar() as progress:
        progress(f"looking at {record.name}", 0, 1)
        found = smfe.look(record, output)
    state = "kept as it was" if kept else "written"
    lines = [
        *summary(found).splitlines(),
        f"written: {picture}",
        f"{state}: {target}; next: smfe check {target}",
    ]
    content = {
        "kind": found.kind.name,
        "reason": found.kind.reason,
        "sample_rate_Hz": found.sample_rate,
        "samples": found.size,
        "columns": found.columns.to_dict("records"),
        "notes": list(found.notes),
        "picture": str(picture),
        "campaign": str(target),
    }
    return Outcome(lines, content)


@verb(
    FILES,
    gives="the record in SI units with the corrections of its channels; what the other format cannot hold is said.",
    examples=["smfe convert record.tdms record.csv", "smfe convert hit.csv hit.uff --campaign campaign.toml"],
    keys="written",
)
def convert(
    terminal: Terminal,
    source: Annotated[
        Path, typer.Argument(help="Record to read, in any format.", show_default=False, autocompletion=any_files)
    ],
    target: Annotated[
        Path,
        typer.Argument(
            help="File to write: .nc, .csv, .mat, .uff, .unv.", show_default=False, autocompletion=any_files
        ),
    ],
    campaign: Annotated[
        Path | None,
        typer.Option(
            help="Campaign file that declares the channels.", show_default=False, autocompletion=campaign_files
        ),
    ] = None,
) -> Outcome:
    """Write a record in another format, in SI units and with the corrections of its channels."""
    import smfe

    left: list[str] = []
    with terminal.bar() as progress:
        written = smfe.convert(source, target, campaign, progress, left.append)
    return Outcome([f"written: {path}" for path in written], {"written": [str(p) for p in written]}, left)


@verb(
    FILES,
    gives="presets with spindle speed, depth (stepdown), width (stepover), feed and cutting speed, in the units of the "
    "tool; a library that is there already keeps everything else. Or a table, or a page for the wall.",
    examples=[
        "smfe export results -o shop.tools --to fusion",
        'smfe export results -o shop.json --to fusion --tool "face mill 80"',
        "smfe export results -o mill80.fctb --to freecad",
        "smfe export results -o setup.pdf --to sheet",
    ],
    keys="written, presets",
)
def export(
    terminal: Terminal,
    results: Annotated[
        Path,
        typer.Argument(help="Folder of results of `smfe run`.", show_default=False, autocompletion=result_folders),
    ],
    output: Annotated[
        Path,
        typer.Option(
            *OUT,
            help="File: .json or .tools (Fusion), .fctb (FreeCAD), .csv, .pdf, .png or .svg (sheet).",
            show_default=False,
            autocompletion=any_files,
        ),
    ],
    to: Annotated[
        Literal["fusion", "freecad", "csv", "sheet"], typer.Option(help="What the file is for.", show_default=False)
    ],
    tool: Annotated[
        str | None,
        typer.Option(
            help="Tool in an existing Fusion library: guid, number, product-id or description.", show_default=False
        ),
    ] = None,
) -> Outcome:
    """Write the cuts that a run recommends for a CAM program, or as a page for the wall."""
    import smfe

    with terminal.bar() as progress:
        progress("writing", 0, 1)
        written = smfe.export(results, output, to, tool)
    return Outcome([*written, f"written: {output}"], {"written": str(output), "presets": written})
