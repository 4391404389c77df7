"""The part of docs/commands.md that is written from the command line itself: ``python tests/commands_page.py``."""

import sys
from itertools import groupby
from typing import Any

import typer
from places import CHECKOUT

from smfe.cli import app
from smfe.cli.verb import COMMON_KEYS, GROUPS, SHARED, VERBS

PAGE = CHECKOUT / "docs" / "commands.md"
BEGIN, END = "<!-- written by tests/commands_page.py -->\n", "<!-- end of what is written -->\n"


def options(name: str) -> list[str]:
    """Return a row for each argument and option of a verb that is its own."""
    command: Any = typer.main.get_command(app).commands[name]  # type: ignore[attr-defined]
    rows = []
    for parameter in command.params:
        if parameter.name in SHARED or parameter.name == "help":
            continue
        is_option = parameter.opts[0].startswith("-")
        word = ", ".join(f"`{o}`" for o in parameter.opts) if is_option else f"`{parameter.name.upper()}`"
        default = parameter.default
        known = default is not None and default != "" and default is not False and not parameter.required
        rows.append(f"| {word} | {parameter.help or ''}{f' Default: `{default}`.' if known else ''} |")
    return rows


def written() -> str:
    """Return the part of the page."""
    parts = []
    in_order = sorted(VERBS.items(), key=lambda item: GROUPS.index(item[1].group))
    for group, verbs in groupby(in_order, key=lambda item: item[1].group):
        parts.append(f"## {group}\n")
        for name, about in verbs:
            own = [key for key in about.keys if key not in COMMON_KEYS]
            parts.append(f"### smfe {name}\n\n{about.summary}\n\nYou get {about.gives}\n")
            parts.append("```sh\n" + "\n".join(about.examples) + "\n```\n")
            parts.append("| argument or option | what |\n| --- | --- |\n" + "\n".join(options(name)) + "\n")
            parts.append(f"With `--json`: {', '.join(f'`{key}`' for key in own)}.\n")
    return BEGIN + "\n".join(parts) + END


def page() -> str:
    """Return the page with that part as it is now."""
    text = PAGE.read_text(encoding="utf-8")
    return text[: text.index(BEGIN)] + written() + text[text.index(END) + len(END) :]


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"written: {PAGE}\n")
