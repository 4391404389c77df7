"""An archive of small campaigns as an institute collects them: machines, tools, dates; modes that drift and differ.

Each campaign holds hammer hits in x and y on modes that are known, cutting tests, and asks for lobes. A hit is a half
sine; what answers is the exact response of each mode to it, sample by sample (a recursion whose poles are those of the
mode, driven by the force as it is between two samples, a straight line). Nothing here is taken from the packages.
"""

from __future__ import annotations

import datetime
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import signal

RATE = 2000.0

HEAD = """[campaign]
name = "{machine}, {date}"
[machine]
name = "{machine}"
[tool]
name = "{tool}"
diameter = "80 mm"
teeth = 4
[material]
name = "C45"
Ktc = "1900 N/mm^2"
Krc = "800 N/mm^2"
[channels]
time = {{ column = "t", unit = "s" }}
force_x = {{ column = "Fx", unit = "N" }}
force_y = {{ column = "Fy", unit = "N" }}
acceleration_x = {{ column = "ax", unit = "m/s^2" }}
acceleration_y = {{ column = "ay", unit = "m/s^2" }}
"""

MEASUREMENT = """[[measurement]]
name = "{name}"
method = "hammer"
started = {date}
frequency_range = ["20 Hz", "400 Hz"]
records = [ {{ file = "{name}_x.csv", excitation = "x" }}, {{ file = "{name}_y.csv", excitation = "y" }} ]
"""

LOBES = """[[lobes]]
measurements = [{names}]
method = "zero_order"
cut = "down"
width_of_cut = "40 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["600 rpm", "1500 rpm", "{step:g} rpm"]
"""

TEST = """[[cutting_test]]
file = "{name}.csv"
spindle_speed = "{speed:g} rpm"
depth_of_cut = "{depth:g} mm"
cut = "down"
width_of_cut = "40 mm"
feed_per_tooth = "0.1 mm"
"""


@dataclass(frozen=True)
class Mode:
    """One mode of one axis: natural frequency [Hz], damping ratio, stiffness [N/m]."""

    frequency: float
    damping: float
    stiffness: float


@dataclass(frozen=True)
class Visit:
    """What one campaign found: the machine, its tool, the day, and the modes of x and y as they were that day."""

    machine: str
    tool: str
    date: datetime.date
    modes: dict[str, Mode] = field(default_factory=dict)


def visits(count: int, machines: int = 10, seed: int = 0) -> list[Visit]:
    """Return visits to a fleet: frequencies scatter by 4 % over the machines, and sink by 3 % a year on the first."""
    rng = np.random.default_rng(seed)
    own = np.exp(rng.normal(0.0, [0.04, 0.10, 0.06], (machines, 2, 3)))
    out = []
    for i in range(count):
        which, turn = i % machines, i // machines
        date = datetime.date(2024, 1, 15) + datetime.timedelta(days=30 * turn + which)
        worn = 1.0 - 0.03 * 30.0 * turn / 365.0 if which == 0 else 1.0
        modes = {}
        for a, (axis, base) in enumerate((("x", Mode(61.0, 0.03, 45e6)), ("y", Mode(84.0, 0.04, 38e6)))):
            f, z, k = own[which, a]
            modes[axis] = Mode(base.frequency * f * worn, base.damping * z, base.stiffness * k)
        out.append(Visit(f"Mill {which + 1:02d}", f"T{1 + turn % 3}", date, modes))
    return out


def write_archive(
    folder: Path,
    count: int,
    machines: int = 10,
    seed: int = 0,
    hits: int = 3,
    tests: int = 2,
    seconds: float = 1.5,
    step: float = 10,
) -> list[Path]:
    """Write campaigns, one folder each, ``MACHINE/DATE/campaign.toml``, and return their files."""
    out = []
    for number, visit in enumerate(visits(count, machines, seed)):
        place = folder / visit.machine.replace(" ", "_").lower() / visit.date.isoformat()
        out.append(write_campaign(place, visit, (seed, number), ("hammer",), hits, tests, seconds, step))
    return out


def write_campaign(
    place: Path,
    visit: Visit,
    seed: tuple[int, ...],
    names: tuple[str, ...] = ("hammer",),
    hits: int = 3,
    tests: int = 2,
    seconds: float = 1.5,
    step: float = 10,
    lobes: int = 1,
) -> Path:
    """Write one campaign: measurements by name, cutting tests, lobes of the first `lobes` measurements."""
    rng = np.random.default_rng(seed)
    place.mkdir(parents=True, exist_ok=True)
    text = [HEAD.format(machine=visit.machine, tool=visit.tool, date=visit.date)]
    for name in names:
        text.append(MEASUREMENT.format(name=name, date=visit.date))
        for axis in "xy":
            _write(place / f"{name}_{axis}.csv", *tap(visit.modes[axis], axis, hits, seconds, rng))
    if lobes:
        text.append(LOBES.format(names=", ".join(f'"{n}"' for n in names[:lobes]), step=step))
    for i in range(tests):
        speed, chatters = 700.0 + 150.0 * (i % 5), i % 2 == 1
        name = f"cut_{i + 1}"
        _write(place / f"{name}.csv", *cut(visit.modes["x"], speed, 4, chatters, 2.0, rng))
        text.append(TEST.format(name=name, speed=speed, depth=1.0 + 2.0 * chatters))
    path = place / "campaign.toml"
    path.write_text("".join(text), encoding="utf-8")
    return path


def tap(
    mode: Mode, axis: str, hits: int, seconds: float, rng: np.random.Generator
) -> tuple[list[str], NDArray[np.float64]]:
    """Return names and columns of a record of hits, `seconds` apart, on one mode; the other axis does not move."""
    n = round(hits * seconds * RATE)
    t = np.arange(n) / RATE
    force = np.zeros(n)
    for hit in range(hits):
        u = t - (0.1 + hit * seconds)
        size = 900.0 + 200.0 * rng.random()
        force += np.where((u > 0.0) & (u < 4e-3), size * np.sin(np.pi * np.clip(u, 0.0, 4e-3) / 4e-3), 0.0)
    motion = accelerations(mode, force)
    own, other = (1, 2) if axis == "x" else (2, 1)
    columns = np.zeros((5, n))
    columns[0], columns[own], columns[own + 2] = t, force, motion
    columns[own] += 0.1 * rng.standard_normal(n)
    columns[own + 2] += 1e-3 * rng.standard_normal(n)
    columns[other + 2] = 1e-3 * rng.standard_normal(n)
    return ["t", "Fx", "Fy", "ax", "ay"], columns


def accelerations(mode: Mode, force: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the acceleration [m/s^2] of a mode at rest under a force that is straight between samples."""
    w, z = 2.0 * np.pi * mode.frequency, mode.damping
    system = signal.StateSpace(
        [[0.0, 1.0], [-(w**2), -2.0 * z * w]],
        [[0.0], [w**2 / mode.stiffness]],
        [[-(w**2), -2.0 * z * w]],
        [[w**2 / mode.stiffness]],
    )
    found = system.to_discrete(1.0 / RATE, method="foh")
    b, a = signal.ss2tf(found.A, found.B, found.C, found.D)
    return np.asarray(signal.lfilter(b[0], a, force))


def cut(
    mode: Mode, speed: float, teeth: int, chatters: bool, seconds: float, rng: np.random.Generator
) -> tuple[list[str], NDArray[np.float64]]:
    """Return names and columns of a cut: harmonics of the tooth passing, and where it chatters a line near the mode."""
    n = round(seconds * RATE)
    t = np.arange(n) / RATE
    passing = speed / 60.0 * teeth
    columns = np.zeros((5, n))
    columns[0] = t
    for k in range(1, 5):
        columns[3] += 4.0 / k * np.cos(2.0 * np.pi * k * passing * t + k)
        columns[4] += 3.0 / k * np.cos(2.0 * np.pi * k * passing * t + 2.0 * k)
    if chatters:
        columns[3] += 30.0 * np.cos(2.0 * np.pi * 1.07 * mode.frequency * t)
    columns[1:3] = 20.0 * columns[3:5] + 100.0
    columns[1:] += 0.05 * rng.standard_normal((4, n))
    return ["t", "Fx", "Fy", "ax", "ay"], columns


def _write(path: Path, names: list[str], columns: NDArray[np.float64]) -> None:
    lines = [",".join(names), *(",".join(f"{v:.7g}" for v in row) for row in columns.T.tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
