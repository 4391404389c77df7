"""``python -m smfe``."""

from smfe.cli import app_entry

app_entry()
