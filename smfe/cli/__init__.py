"""The command line: parses, calls, prints. Numerics are imported inside the commands, so that help answers at once."""

from smfe.cli.entry import app_entry
from smfe.cli.verb import app

__all__ = ["app", "app_entry"]
