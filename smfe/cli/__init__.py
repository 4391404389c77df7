"""The command line: parses, calls, prints. Numerics are imported inside the commands, so that help answers at once."""

import sys
from typing import TYPE_CHECKING

from process._lazy import lazy

if TYPE_CHECKING:
    from smfe.cli.entry import app

__all__ = ["app", "app_entry"]


def app_entry() -> None:
    """Run the command line: the exit status says how it ended, see `smfe --help`."""
    try:
        # Inside, so that Ctrl-C while the verbs are imported is answered like any other.
        from smfe.cli.entry import app

        app()
    except KeyboardInterrupt:
        # Before a verb began or after it ended; a verb says itself what it keeps.
        print("smfe: interrupted", file=sys.stderr)
        sys.exit(130)


if not TYPE_CHECKING:
    __getattr__, __dir__ = lazy(__name__, {"smfe.cli.entry": "app"})
