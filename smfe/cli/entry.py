"""The options that stand before a verb, and all verbs in the order of the help."""

from __future__ import annotations

from typing import Annotated

import typer

from smfe._version import __version__
from smfe.cli import decide, files, fleet, measure, predict  # noqa: F401  (each registers its verbs)
from smfe.cli.terminal import DONE, out
from smfe.cli.verb import GROUPS, STATUS, app

__all__ = ["app"]


def _version(asked: bool) -> None:
    if asked:
        out.print(f"smfe {__version__}", highlight=False)
        raise typer.Exit(DONE)


app.registered_commands.sort(key=lambda command: GROUPS.index(str(command.rich_help_panel)))


HELP = (
    "Machine-tool dynamics: measured records -> compliance -> stability lobes -> chatter verdicts.\n\n"
    "[bold]How deep may I cut, at which speed, and how sure are you?[/bold] Write what was measured into a campaign "
    "file, then: smfe run campaign.toml"
)


@app.callback(help=HELP, epilog=STATUS)
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Take the options that stand before a verb."""
