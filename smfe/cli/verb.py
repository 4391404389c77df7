"""What all verbs share: options, help, JSON, exit status, and one line where somebody interrupts."""

from __future__ import annotations

import inspect
import traceback
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer
from rich.markup import escape

from process.errors import InputError
from smfe.cli.interrupt import listening
from smfe.cli.terminal import INTERRUPTED, WRONG, Outcome, Terminal
from smfe.progress import SmfeWarning
from smfe.staged import FULL

GROUPS = MEASURE, PREDICT, DECIDE, FILES = "Measure", "Predict", "Decide", "Files"
"""Groups of verbs in the help, in this order."""

STATUS = (
    "[bold]Exit status[/bold]: 0 done (also where a diagnosis names a cause); 1 the input is wrong and nothing was "
    "written; 2 wrong usage; 3 done, but a fault in the data remains: what was left out is said; 130 interrupted: the "
    "same command goes on."
)

AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object, nothing else, on stdout.", rich_help_panel="Output")
]
Verbose = Annotated[
    bool, typer.Option("-v", "--verbose", help="Say every step and every warning.", rich_help_panel="Output")
]
Quiet = Annotated[
    bool, typer.Option("-q", "--quiet", help="Say nothing on the way: the result alone.", rich_help_panel="Output")
]
SHARED = {"as_json": AsJson, "verbose": Verbose, "quiet": Quiet}
"""Options that every verb has."""

app = typer.Typer(
    no_args_is_help=True,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@dataclass(frozen=True)
class About:
    """What the help and the documentation say of a verb beside its options; see `verb`."""

    group: str
    summary: str
    gives: str
    examples: Sequence[str]
    keys: Sequence[str]


VERBS: dict[str, About] = {}
"""Name of a verb -> what is said of it."""

COMMON_KEYS = ("warnings", "failures")
"""Keys that every JSON object has which says what was found."""


def verb(
    group: str, gives: str, examples: Sequence[str], keys: str, keeps: str = "nothing was written"
) -> Callable[[Callable[..., Outcome]], Callable[..., Outcome]]:
    """Make a function a verb of the command line.

    Its first argument is the `Terminal` that it talks to; the options of `SHARED` are added to its own.

    Parameters
    ----------
    group : str
        Where the help lists it.
    gives : str
        What its user gets.
    examples : sequence of str
        Command lines.
    keys : str
        What ``--json`` prints beside the `COMMON_KEYS`: "one, two".
    keeps : str, optional
        What is kept when somebody interrupts it.
    """

    def registered(function: Callable[..., Outcome]) -> Callable[..., Outcome]:
        def called(as_json: bool, verbose: bool, quiet: bool, **arguments: Any) -> None:
            terminal = Terminal(as_json, verbose, quiet)
            try:
                with listening(), warnings.catch_warnings():
                    # What must be known of the result stands in the outcome, and is said there.
                    warnings.simplefilter("ignore", SmfeWarning)
                    # What was kept and is damaged is not part of any result.
                    warnings.filterwarnings("always", ".*is not as it was written", SmfeWarning)
                    plainly = warnings.showwarning

                    def shown(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
                        if isinstance(message, SmfeWarning):
                            terminal.note(f"warning, {message}")
                        else:
                            plainly(message, category, *where, **more)

                    warnings.showwarning = shown
                    outcome = function(terminal, **arguments)
                terminal.end(outcome)
            except KeyboardInterrupt:
                terminal.refuse(f"interrupted; {keeps}; the same command goes on")
                raise typer.Exit(INTERRUPTED) from None
            except InputError as error:
                terminal.refuse(str(error))
                raise typer.Exit(WRONG) from None
            except BrokenPipeError:
                raise
            except OSError as error:
                advice = "; make room or name another folder: the same command goes on" if error.errno in FULL else ""
                terminal.refuse(f"{error.strerror or error}: {error.filename or ''}{advice}")
                raise typer.Exit(WRONG) from None
            except typer.Exit:
                raise
            except Exception as error:
                from smfe.results import reason_of

                if verbose:  # for whoever mends it
                    traceback.print_exc()
                terminal.refuse(reason_of(error))
                raise typer.Exit(WRONG) from None

        hints = get_type_hints(function, include_extras=True)
        own = [p.replace(annotation=hints[p.name]) for p in inspect.signature(function).parameters.values()][1:]
        shared = [
            inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=annotation)
            for name, annotation in SHARED.items()
        ]
        # What typer reads: the function's own arguments, then those of every verb.
        called.__signature__ = inspect.Signature([*own, *shared])  # type: ignore[attr-defined]
        called.__annotations__ = {p.name: p.annotation for p in (*own, *shared)}
        summary = inspect.cleandoc(function.__doc__ or "")
        text = f"{summary}\n\n[bold]What you get:[/bold] {escape(gives)}"
        shown = "\n".join(["[bold]Examples[/bold]", *(f"  {escape(line)}" for line in examples)])
        VERBS[function.__name__] = About(group, summary, gives, examples, (*keys.split(", "), *COMMON_KEYS))
        app.command(function.__name__, help=text, epilog=shown, rich_help_panel=group)(called)
        return function

    return registered


def campaign_files(incomplete: str) -> list[str]:
    """Complete a campaign file: files that end in .toml, and folders on the way to them."""
    return _paths(incomplete, (".toml",))


def any_files(incomplete: str) -> list[str]:
    """Complete the name of any file."""
    return _paths(incomplete, ())


def result_folders(incomplete: str) -> list[str]:
    """Complete a folder."""
    return [p for p in _paths(incomplete, ()) if p.endswith("/")]


def _paths(incomplete: str, endings: tuple[str, ...]) -> list[str]:
    typed = Path(incomplete)
    folder = typed if incomplete.endswith("/") else typed.parent
    start = "" if incomplete.endswith("/") else typed.name
    prefix = incomplete[: len(incomplete) - len(start)]
    try:
        found = sorted(p for p in (folder if str(folder) else Path()).iterdir() if p.name.startswith(start))
    except OSError:
        return []
    shown = [p for p in found if start.startswith(".") or not p.name.startswith(".")]
    return [
        f"{prefix}{p.name}/" if p.is_dir() else f"{prefix}{p.name}"
        for p in shown
        if p.is_dir() or not endings or p.suffix in endings
    ]


OUT = ("-o", "--output", "--out")  # names of the option that says where to write
Campaigns = Annotated[
    list[str],
    typer.Argument(
        help="Campaign file (TOML); of many campaigns files, folders that hold some, or patterns.",
        show_default=False,
        autocompletion=campaign_files,
    ),
]
CampaignFile = Annotated[
    Path, typer.Argument(help="Campaign file (TOML).", show_default=False, autocompletion=campaign_files)
]
