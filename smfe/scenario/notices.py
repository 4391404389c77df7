"""What the user of simulated records must know and no number shows."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from process.friction.laws import Viscous
from process.machine.machine import Machine
from process.units import show as quantity
from smfe.records.formats.channels import listed
from smfe.scenario.scenario import Scenario


def to_stderr(text: str) -> None:
    """Show a notice where nothing else is given to show it."""
    print(f"notice: {text}", file=sys.stderr)


def standing_axes(scenario: Scenario) -> list[str]:
    """Return a sentence for each sweep or cut that pushes an axis which stands still on friction that is not viscous.

    Such a machine is not linear: the axis sticks or slides with the cutting force.
    """
    machine = scenario.machine
    if not isinstance(machine, Machine):
        return []
    found: dict[tuple[int, str], str] = {}
    for entry in scenario.entries:
        if entry.method not in ("sweep", "cut"):
            continue
        feeds = machine.feeds(entry.running.feed)
        rubbing = [a for a, axis in machine.axes.items() if not isinstance(axis.friction, Viscous)]
        standing = [a for a in rubbing if feeds[a] == 0.0]
        if standing:
            found.setdefault((entry.trial, "".join(standing)), f"trial[{entry.trial}]: {_standing(standing, feeds)}")
    return list(found.values())


def _standing(standing: list[str], feeds: dict[str, float]) -> str:
    moving = next((v for v in feeds.values() if v), 500e-3 / 60.0)
    feed = ", ".join(f'{axis} = "{quantity(v or moving, "mm/min", "speed")}"' for axis, v in feeds.items())
    return (
        f"axis {', '.join(standing)} stands still on its friction while the cut pushes it: the result depends on the "
        f"force; give feed = {{ {feed} }} to move it, or read it as such"
    )


def left_behind(folder: Path, written: Iterable[str]) -> list[str]:
    """Return a sentence about records in the folder of records that this scenario has not written."""
    new = set(written)
    old = sorted(path.name for path in folder.iterdir() if path.is_file() and path.name not in new)
    if not old:
        return []
    return [
        f"{folder} also holds {len(old)} file(s) of an earlier scenario, which the campaign does not read: "
        f"{listed(old, 8)}; delete them where nothing else does"
    ]
