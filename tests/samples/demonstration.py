"""The demonstration, run once for all tests that read it."""

from __future__ import annotations

from pathlib import Path

import smfe


def full_demo(folder: Path, seed: int) -> None:
    """Run it into a folder, for `kept`."""
    smfe.demo(folder, seed)
