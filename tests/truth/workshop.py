"""Random measuring campaigns as workshops bring them back, healthy or with one planted fault.

Machine, tool, cut, sensors, clocks, lengths of records, names of columns, file formats and units are drawn. The machine
is linear: 1 to 4 modes of any direction; motion is computed in the frequency domain from the force. Cuts are steady and
stable, their forces those of teeth with run-out without regeneration. Nothing of the package is imported.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy import io

G = 9.80665
AXES = "xyz"

Columns = dict[str, np.ndarray]


@dataclass
class Record:
    """A record before it is written: SI samples by channel name, and how it is written."""

    name: str
    data: Columns
    suffix: str = ".csv"


@dataclass
class Part:
    """One ``[[measurement]]`` or ``[[cutting_test]]``: keys as TOML text, records with their keys."""

    table: str
    keys: dict[str, str]
    records: list[tuple[Record, dict[str, str]]]


@dataclass
class Workshop:
    """A campaign in the making."""

    rng: np.random.Generator
    modes: dict[str, np.ndarray] = field(default_factory=dict)
    fast: bool = False
    axes: str = "xyz"
    rate: float = 2000.0
    tool: dict[str, Any] = field(default_factory=dict)
    material: dict[str, str] = field(default_factory=dict)
    parts: list[Part] = field(default_factory=list)
    model: str = ""
    lobes: list[dict[str, str]] = field(default_factory=list)
    columns: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    said: list[str] = field(default_factory=list)


# --- machine ----------------------------------------------------------------------------------------------------------


def receptance(modes: dict[str, np.ndarray], frequency: np.ndarray) -> np.ndarray:
    """``Phi = sum d d^T / (k (1 - r^2 + 2 j zeta r))``, shape (f, 3, 3) [m/N]."""
    r = frequency[:, None] / modes["frequency"]
    single = 1.0 / (modes["stiffness"] * (1.0 - r**2 + 2j * modes["damping"] * r))
    return np.einsum("fm,mi,mj->fij", single, modes["direction"], modes["direction"])


def acceleration(shop: Workshop, force: np.ndarray) -> np.ndarray:
    """Acceleration (3, n) of the tool under a force (3, n), at rest before and long after."""
    n = force.shape[1]
    length = 2 * n
    f = np.fft.rfftfreq(length, 1.0 / shop.rate)
    spectrum = np.fft.rfft(force, length)
    moved = -((2.0 * np.pi * f) ** 2) * np.einsum("fij,jf->if", receptance(shop.modes, f), spectrum)
    # What a converter lets through: nothing near half the sample rate.
    return np.fft.irfft(moved / (1.0 + (f / (0.42 * shop.rate)) ** 16), length)[:, :n]


def drawn_machine(shop: Workshop) -> None:
    """Portal mills with modes below 100 Hz, and spindles with modes up to 1 kHz."""
    rng = shop.rng
    shop.fast = bool(rng.random() < 0.5)
    count = int(rng.integers(1, 4))
    low, high = (250.0, 900.0) if shop.fast else (25.0, 80.0)
    frequency = np.sort(np.exp(rng.uniform(math.log(low), math.log(high), count)))
    frequency *= np.cumprod(np.concatenate([[1.0], 1.0 + 0.15 * rng.random(max(count - 1, 0))]))[:count]
    direction = rng.standard_normal((count + 2, 3))
    # Every axis moves: one stiff mode far above the others for each that remains.
    frequency = np.concatenate([frequency, frequency[-1] * rng.uniform(1.3, 2.0, 2)])
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    stiffness = np.exp(rng.uniform(math.log(4e6 if shop.fast else 1e7), math.log(6e7), count + 2))
    damping = rng.uniform(0.02, 0.06, count + 2)
    shop.modes = {"frequency": frequency, "damping": damping, "stiffness": stiffness, "direction": direction}
    shop.axes = "xyz" if rng.random() < 0.6 else "xy"
    top = float(frequency.max())
    shop.rate = float(rng.choice([3.2, 4.096, 5.0])) * top
    shop.rate = (
        float(2 ** math.ceil(math.log2(shop.rate))) if rng.random() < 0.5 else 100.0 * math.ceil(shop.rate / 100)
    )
    teeth = int(rng.integers(2, 7))
    shop.tool = {"diameter": 12.0 if shop.fast else 80.0, "teeth": teeth, "runout": rng.uniform(0.0, 0.1)}
    shop.material = {"Ktc": rng.uniform(600, 2200), "Krc": rng.uniform(200, 900), "Kac": rng.uniform(150, 400)}


def noise(shop: Workshop, shape: tuple[int, ...], size: float) -> np.ndarray:
    """White noise through the same converter."""
    return size * shop.rng.standard_normal(shape)


# --- trials -----------------------------------------------------------------------------------------------------------


def hammer(shop: Workshop, axis: str, size: float = 1.0) -> Columns:
    """Three to five hits along an axis, each left to ring out."""
    rng = shop.rng
    slowest = float(np.min(2.0 * np.pi * shop.modes["frequency"] * shop.modes["damping"]))
    apart, count = max(7.0 / slowest, 0.25), int(rng.integers(3, 6))
    n = round((count * apart + 0.3 * apart + 0.05) * shop.rate)
    t = np.arange(n) / shop.rate
    width = max(rng.uniform(0.25, 0.5) / float(shop.modes["frequency"].max()), 4.0 / shop.rate)
    force = np.zeros((3, n))
    peak = size * (1000.0 if not shop.fast else 200.0)
    for k in range(count):
        u = t - (0.05 + 0.1 * apart + k * apart + 0.05 * apart * rng.random())
        inside = (u > 0.0) & (u < width)
        force[AXES.index(axis)] += rng.uniform(0.8, 1.2) * peak * np.where(inside, np.sin(np.pi * u / width) ** 2, 0.0)
    return _recorded(shop, t, force, peak * 3e-4)


def sines(shop: Workshop, axis: str) -> Columns:
    """A stepped sine over the first modes."""
    rng, f = shop.rng, shop.modes["frequency"]
    steps = np.linspace(0.7 * f[0], min(1.3 * f[len(f) - 3], 0.3 * shop.rate), int(rng.integers(12, 18)))
    hold = np.maximum(10.0 / (2.0 * np.pi * f[0] * shop.modes["damping"].min()), 30.0 / steps[0])
    n = round(hold * shop.rate)
    phase = 2.0 * np.pi * np.cumsum(np.repeat(steps, n)) / shop.rate
    force = np.zeros((3, phase.size))
    level = 20.0 if shop.fast else 100.0
    force[AXES.index(axis)] = level * np.sin(phase)
    return _recorded(shop, np.arange(phase.size) / shop.rate, force, level * 3e-3)


def chip_force(shop: Workshop, angle: np.ndarray, arc: tuple[float, float], depth: float, feed: float) -> np.ndarray:
    """Forces (3, n) of the teeth: tangential, radial, axial on the chip ``f_z sin(phi)``, with run-out."""
    force = np.zeros((3, angle.size))
    teeth = shop.tool["teeth"]
    kt, kr, ka = (1e6 * shop.material[k] for k in ("Ktc", "Krc", "Kac"))
    for k in range(teeth):
        phi = np.mod(angle + 2.0 * np.pi * k / teeth, 2.0 * np.pi)
        cutting = (phi >= arc[0]) & (phi < arc[1])
        share = 1.0 + shop.tool["runout"] * math.cos(2.0 * math.pi * k / teeth + 1.0)
        chip = np.where(cutting, feed * share * np.sin(phi), 0.0) * depth
        ft, fr, fa = kt * chip, kr * chip, ka * chip
        force += np.array([-ft * np.cos(phi) - fr * np.sin(phi), ft * np.sin(phi) - fr * np.cos(phi), -fa])
    return force


def arc_of(shop: Workshop, cut: str, width: float) -> tuple[float, float]:
    share = width / shop.tool["diameter"]
    if cut == "down":
        return math.pi - math.acos(1.0 - 2.0 * share), math.pi
    if cut == "up":
        return 0.0, math.acos(1.0 - 2.0 * share)
    half = math.asin(share)
    return 0.5 * math.pi - half, 0.5 * math.pi + half


def cut(shop: Workshop, rpm: float, kind: str, width: float, depth: float, feed: float, turns: float) -> Columns:
    """A steady cut with air at both ends, its spindle speed within 0.1 %, a tacho of one pulse a turn."""
    rng = shop.rng
    air = 6.0
    n = round((turns + 2.0 * air) * 60.0 / rpm * shop.rate)
    t = np.arange(n) / shop.rate
    speed = rpm * (1.0 + 1e-3 * rng.uniform(-1.0, 1.0))
    angle = 2.0 * np.pi * speed / 60.0 * t + rng.uniform(0.0, 2.0 * np.pi)
    inside = (t > air * 60.0 / rpm) & (t < (turns + air) * 60.0 / rpm)
    force = chip_force(shop, angle, arc_of(shop, kind, width), 1e-3 * depth, 1e-3 * feed) * inside
    out = _recorded(shop, t, force, 0.01 * float(np.abs(force).max()))
    if rng.random() < 0.5:
        out["spindle_speed"] = np.full(n, speed) + 0.02 * rng.standard_normal(n)
    elif speed / 60.0 < shop.rate / 20.0:
        out["tacho"] = 5.0 * (np.mod(angle, 2.0 * np.pi) < 0.5 * np.pi) + 0.02 * rng.standard_normal(n)
    return out


def sweep(shop: Workshop, kind: str, width: float, depth: float, seconds: float) -> Columns:
    """A pass whose tooth passing runs over the first modes, in the cut all the time but for the ends."""
    f = shop.modes["frequency"]
    start, stop = 0.55 * f[0], 1.05 * f[max(len(f) - 3, 0)]
    n = round(seconds * shop.rate)
    t = np.arange(n) / shop.rate
    passing = start + (stop - start) * t / seconds
    angle = 2.0 * np.pi * np.cumsum(passing) / shop.rate / shop.tool["teeth"] + shop.rng.uniform(0.0, 6.0)
    inside = (t > 0.04 * seconds) & (t < 0.96 * seconds)
    force = chip_force(shop, angle, arc_of(shop, kind, width), 1e-3 * depth, 1e-4) * inside
    out = _recorded(shop, t, force, 0.002 * float(np.abs(force).max()))
    return out | {"spindle_speed": 60.0 * passing / shop.tool["teeth"]}


def _recorded(shop: Workshop, t: np.ndarray, force: np.ndarray, force_noise: float) -> Columns:
    """What sensors make of it: noise of both, and offsets of the force amplifier."""
    moved = acceleration(shop, force)
    size = 2e-3 * max(float(np.abs(moved).max()), 1e-3) * shop.rng.uniform(0.2, 1.5)
    moved = moved + noise(shop, moved.shape, 0.25 * size)
    force = force + noise(shop, force.shape, force_noise)
    out = {"time": t}
    for k, axis in enumerate(AXES):
        if axis in shop.axes:
            out[f"force_{axis}"], out[f"acceleration_{axis}"] = force[k], moved[k]
    return out


# --- the campaign -----------------------------------------------------------------------------------------------------

HEADS = (
    {"time": "t", "force": "F{}", "acceleration": "a{}", "spindle_speed": "n", "tacho": "tacho"},
    {"time": "Time", "force": "Force {}", "acceleration": "Acc_{}", "spindle_speed": "Speed", "tacho": "Pulse"},
    {"time": "zeit", "force": "kraft_{}", "acceleration": "b_{}", "spindle_speed": "drehzahl", "tacho": "takt"},
)
UNITS = {"time": ("s", "ms"), "force": ("N", "N", "kN"), "acceleration": ("m/s^2", "g", "g")}
SCALE = {"s": 1.0, "ms": 1e-3, "N": 1.0, "kN": 1e3, "m/s^2": 1.0, "g": G, "rpm": 1.0, "1": 1.0}


def healthy(seed: int) -> Workshop:
    """Draw a campaign without a fault."""
    shop = Workshop(np.random.default_rng([seed, 4711]))
    rng = shop.rng
    drawn_machine(shop)
    head = HEADS[int(rng.integers(len(HEADS)))]
    for name in ("time", "force", "acceleration"):
        shop.units[name] = str(rng.choice(UNITS[name]))
    for name in ("time", *(f"{kind}_{a}" for kind in ("force", "acceleration") for a in shop.axes)):
        kind, _, axis = name.partition("_")
        shop.columns[name] = head[kind].format(axis)
    shop.columns |= {name: head[name] for name in ("spindle_speed", "tacho")}
    suffix = str(rng.choice([".csv", ".mat", ".h5"]))
    sources = _measured(shop, suffix)
    if rng.random() < 0.6:
        sources.append("known")
        error = np.exp(0.03 * rng.standard_normal(len(shop.modes["frequency"])))
        shop.model = model_text(shop, error)
    if rng.random() < 0.75:
        _tests(shop, suffix)
    _requests(shop, sources)
    return shop


def _measured(shop: Workshop, suffix: str) -> list[str]:
    rng, sources = shop.rng, []
    for number in range(int(rng.integers(1, 3))):
        name = f"hammer_{number + 1}" if rng.random() < 0.7 else f"tip {number + 1}"
        records = [
            (Record(f"{name.replace(' ', '_')}_{a}", hammer(shop, a), suffix), {"excitation": f'"{a}"'})
            for a in shop.axes
        ]
        keys = {"name": f'"{name}"', "method": '"hammer"'}
        if number == 1:
            keys["controller"] = '"K2"'
        shop.parts.append(Part("measurement", keys, records))
        sources.append(name)
    if rng.random() < 0.3:
        records = [(Record(f"shaker_{a}", sines(shop, a), suffix), {"excitation": f'"{a}"'}) for a in shop.axes]
        shop.parts.append(Part("measurement", {"name": '"shaker"', "method": '"actuator"'}, records))
        sources.append("shaker")
    if not shop.fast and shop.axes == "xyz" and rng.random() < 0.35:
        d = shop.tool["diameter"]
        passes = (("down", 0.3 * d), ("up", 0.5 * d), ("central", 0.85 * d))
        records = [
            (
                Record(f"sweep_{kind}", sweep(shop, kind, width, 0.5, 20.0), suffix),
                {"cut": f'"{kind}"', "width_of_cut": f'"{width:g} mm"'},
            )
            for kind, width in passes
        ]
        keys = {"name": '"sweep"', "method": '"sweep"', "depth_of_cut": '"0.5 mm"', "resolution": '"2 Hz"'}
        shop.parts.append(Part("measurement", keys, records))
        sources.append("sweep")
    return sources


def _tests(shop: Workshop, suffix: str) -> None:
    rng, d, teeth = shop.rng, shop.tool["diameter"], shop.tool["teeth"]
    highest = 0.1 * shop.rate / teeth * 60.0
    for number in range(int(rng.integers(1, 4))):
        rpm = float(round(rng.uniform(0.3, 0.9) * highest))
        width, depth, feed = round(rng.uniform(0.2, 0.6) * d, 1), round(rng.uniform(0.1, 0.6), 2), 0.08
        data = cut(shop, rpm, "down", width, depth, feed, rng.uniform(70.0, 120.0))
        keys = {
            "spindle_speed": f'"{rpm:g} rpm"',
            "depth_of_cut": f'"{depth:g} mm"',
            "cut": '"down"',
            "width_of_cut": f'"{width:g} mm"',
            "feed_per_tooth": f'"{feed:g} mm"',
        }
        shop.parts.append(Part("cutting_test", keys, [(Record(f"cut_{number + 1}", data, suffix), {})]))


def _requests(shop: Workshop, sources: list[str]) -> None:
    rng, f, teeth = shop.rng, shop.modes["frequency"], shop.tool["teeth"]
    measured = [s for s in sources if s != "known"]
    for _ in range(int(rng.integers(1, 3))):
        method = str(rng.choice(["zero_order", "zero_order", "multi_frequency", "semi_discretization"]))
        names = ["known"] if method == "semi_discretization" and "known" in sources else list(measured)
        if method in ("multi_frequency", "semi_discretization") and "known" not in names:
            method = "zero_order"
        base = 60.0 * f[0] / teeth
        shop.lobes.append(
            {
                "measurements": "[" + ", ".join(f'"{n}"' for n in names) + "]",
                "method": f'"{method}"',
                "cut": '"down"',
                "width_of_cut": f'"{0.4 * shop.tool["diameter"]:g} mm"',
                "feed_per_tooth": '"0.08 mm"',
                "spindle_speed": f'["{0.3 * base:.6g} rpm", "{1.2 * base:.6g} rpm", "{0.15 * base:.6g} rpm"]',
            }
        )


def model_text(shop: Workshop, error: np.ndarray) -> str:
    rows = [
        f'    {{ frequency = "{f:.6g} Hz", damping = {z:.5g}, stiffness = "{k * e / 1e6:.6g} N/um", '
        f"direction = [{d[0]:.5g}, {d[1]:.5g}, {d[2]:.5g}] }},\n"
        for f, z, k, d, e in zip(*shop.modes.values(), error, strict=True)
    ]
    return '[[model]]\nname = "known"\nmodes = [\n' + "".join(rows) + "]\n"


# --- to disk ----------------------------------------------------------------------------------------------------------


def write(shop: Workshop, folder: Path) -> Path:
    """Write records and ``campaign.toml``."""
    folder.mkdir(parents=True, exist_ok=True)
    for part in shop.parts:
        for record, _ in part.records:
            write_record(shop, record, folder)
    path = folder / "campaign.toml"
    path.write_text(text(shop), encoding="utf-8")
    return path


def write_record(shop: Workshop, record: Record, folder: Path) -> None:
    columns = {}
    for name, samples in record.data.items():
        unit = shop.units.get(name.partition("_")[0], "rpm" if name == "spindle_speed" else "1")
        columns[shop.columns[name]] = samples / SCALE[unit]
    path = folder / f"{record.name}{record.suffix}"
    if record.suffix == ".csv":
        table = np.column_stack(list(columns.values()))
        np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(columns), comments="")
    elif record.suffix == ".mat":
        io.savemat(path, {k.replace(" ", "_"): v for k, v in columns.items()})
    else:
        with h5py.File(path, "w") as file:
            for name, values in columns.items():
                file[name] = values


def text(shop: Workshop) -> str:
    """Return the campaign file."""
    tool, work = shop.tool, shop.material
    lines = ["[campaign]", 'name = "workshop"', "[tool]", f'diameter = "{tool["diameter"]:g} mm"']
    lines += [f"teeth = {tool.get('stated', tool['teeth'])}"]
    if work:
        lines += ["[material]", *(f'{k} = "{v:.5g} N/mm^2"' for k, v in work.items())]
    lines.append("[channels]")
    suffix = next((r.suffix for p in shop.parts for r, _ in p.records), ".csv")
    optional = {name for p in shop.parts for r, _ in p.records for name in r.data}
    for name, column in shop.columns.items():
        unit = shop.units.get(name.partition("_")[0], "rpm" if name == "spindle_speed" else "1")
        column = column.replace(" ", "_") if suffix == ".mat" else column
        if name in optional and name not in ("spindle_speed", "tacho"):
            lines.append(f'{name} = {{ column = "{column}", unit = "{unit}" }}')
    for part in shop.parts:
        lines += [f"[[{part.table}]]", *(f"{k} = {v}" for k, v in part.keys.items())]
        if part.table == "cutting_test":
            lines.append(f'file = "{part.records[0][0].name}{part.records[0][0].suffix}"')
        else:
            rows = (
                "    { " + ", ".join([f'file = "{r.name}{r.suffix}"', *(f"{k} = {v}" for k, v in keys.items())]) + " },"
                for r, keys in part.records
            )
            lines += ["records = [", *rows, "]"]
        own = {name for r, _ in part.records for name in r.data} & {"spindle_speed", "tacho"}
        for name in sorted(own):
            unit = "rpm" if name == "spindle_speed" else "1"
            pulses = ", pulses_per_revolution = 1" if name == "tacho" else ""
            column = shop.columns[name]
            lines.append(f"[{part.table}.channels]" if name == min(own) else "")
            lines.append(f'{name} = {{ column = "{column}", unit = "{unit}"{pulses} }}')
    if shop.model:
        lines.append(shop.model)
    for request in shop.lobes:
        lines += ["[[lobes]]", *(f"{k} = {v}" for k, v in request.items())]
    return "\n".join(lines) + "\n"


# --- faults -----------------------------------------------------------------------------------------------------------

Fault = Callable[[Workshop, Path], bool]
"""Plants itself in a campaign and its folder, which has been written; False where the campaign offers no place."""


def _pick(shop: Workshop, *tables: str, method: str | None = None) -> Part | None:
    wanted = [
        p for p in shop.parts if p.table in tables and (method is None or p.keys.get("method", "") == f'"{method}"')
    ]
    return wanted[int(shop.rng.integers(len(wanted)))] if wanted else None


def _any_record(shop: Workshop, *tables: str, method: str | None = None) -> tuple[Part, Record] | None:
    part = _pick(shop, *(tables or ("measurement", "cutting_test")), method=method)
    return None if part is None else (part, part.records[int(shop.rng.integers(len(part.records)))][0])


def _changed(change: Callable[[Workshop, Columns], None], *tables: str, method: str | None = None) -> Fault:
    """A fault in the samples of one record."""

    def plant(shop: Workshop, folder: Path) -> bool:
        found = _any_record(shop, *tables, method=method)
        if found is None:
            return False
        change(shop, found[1].data)
        write_record(shop, found[1], folder)
        return True

    return plant


def _of_part(change: Callable[[Workshop, Part], bool | None], *tables: str, method: str | None = None) -> Fault:
    """A fault of a whole measurement or test; its records are written again."""

    def plant(shop: Workshop, folder: Path) -> bool:
        part = _pick(shop, *tables, method=method)
        if part is None or change(shop, part) is False:
            return False
        write(shop, folder)
        return True

    return plant


def _scaled(prefix: str, factor: float, method: str | None = None, table: str = "measurement") -> Fault:
    def change(shop: Workshop, part: Part) -> None:
        for record, _ in part.records:
            for name in record.data:
                if name.startswith(prefix):
                    record.data[name] = factor * record.data[name]

    return _of_part(change, table, method=method)


def _broken_file(how: str) -> Fault:
    def plant(shop: Workshop, folder: Path) -> bool:
        found = _any_record(shop)
        if found is None:
            return False
        path = folder / f"{found[1].name}{found[1].suffix}"
        content = path.read_bytes()
        path.write_bytes({"empty": b"", "cut": content[: len(content) // 2], "garbage": b"\x00\x01hello" * 400}[how])
        if how == "cut" and found[1].suffix == ".csv":
            path.write_bytes(content[:40])
        return True

    return plant


def _nan_block(shop: Workshop, data: Columns) -> None:
    name = str(shop.rng.choice([n for n in data if n != "time"]))
    at = int(shop.rng.integers(data[name].size // 2))
    data[name] = data[name].copy()
    data[name][at : at + 40] = np.nan


def _clipped(shop: Workshop, data: Columns) -> None:
    name = str(shop.rng.choice([n for n in data if n.startswith("acceleration")]))
    data[name] = np.clip(data[name], -np.inf, 0.4 * data[name].max())


def _lost(shop: Workshop, data: Columns) -> None:
    del data[str(shop.rng.choice([n for n in data if n.partition("_")[0] in ("force", "acceleration")]))]


def _no_rows(shop: Workshop, data: Columns) -> None:
    for name in data:
        data[name] = data[name][:0]


def _few_rows(shop: Workshop, data: Columns) -> None:
    for name in data:
        data[name] = data[name][:7]


def _backwards(shop: Workshop, data: Columns) -> None:
    t = data["time"].copy()
    t[t.size // 2 :] -= 0.4 * t[-1]
    data["time"] = t


def _slow_rate(shop: Workshop, data: Columns) -> None:
    for name in data:
        data[name] = data[name][::40]


def _same_file(shop: Workshop, part: Part) -> bool | None:
    if len(part.records) < 2:
        return False
    part.records[1][0].data = {k: v.copy() for k, v in part.records[0][0].data.items()}
    return None


def _swapped(shop: Workshop, part: Part) -> bool | None:
    if len(part.records) < 2:
        return False
    (a, _), (b, _) = part.records[:2]
    a.data, b.data = b.data, a.data
    return None


def _pulses(shop: Workshop, part: Part) -> bool | None:
    data = part.records[0][0].data
    if "tacho" not in data:
        return False
    rpm = float(part.keys["spindle_speed"].strip('"').split()[0])
    data["tacho"] = 5.0 * (np.mod(data["time"] * rpm / 60.0 * 4.0, 1.0) < 0.3) + 0.0
    return None


def _stated_speed(shop: Workshop, part: Part) -> bool | None:
    data = part.records[0][0].data
    if "tacho" not in data and "spindle_speed" not in data:
        return False
    rpm = float(part.keys["spindle_speed"].strip('"').split()[0])
    part.keys["spindle_speed"] = f'"{round(rpm * shop.rng.choice([0.6, 0.8, 1.3])):g} rpm"'
    return None


def _above_band(shop: Workshop, part: Part) -> None:
    """The record was downsampled: the tooth passing is above what is left."""
    data = part.records[0][0].data
    for name in data:
        data[name] = data[name][::11]


def _teeth(shop: Workshop, part: Part) -> bool | None:
    shop.tool["stated"] = shop.tool["teeth"] + 1
    return None


def _range(shop: Workshop, part: Part) -> None:
    part.keys["frequency_range"] = f'["{2 * shop.rate:g} Hz", "{3 * shop.rate:g} Hz"]'


def _method(shop: Workshop, part: Part) -> None:
    part.keys["method"] = '"actuator"'


def _one_axis(shop: Workshop, part: Part) -> bool | None:
    """A lobe request of modes from one short band: nothing can be fitted."""
    shop.lobes.append(shop.lobes[0] | {"method": '"semi_discretization"', "measurements": f"[{part.keys['name']}]"})
    part.keys["frequency_range"] = (
        f'["{0.05 * shop.modes["frequency"][0]:.4g} Hz", "{0.1 * shop.modes["frequency"][0]:.4g} Hz"]'
    )
    return None


def _operating(shop: Workshop, part: Part) -> bool | None:
    if not shop.model:
        return False
    shop.lobes.append(
        shop.lobes[0] | {"method": '"operating_point"', "measurements": f'[{part.keys["name"]}, "known"]'}
    )
    return None


def _file_text(change: Callable[[Workshop, str], str]) -> Fault:
    def plant(shop: Workshop, folder: Path) -> bool:
        path = folder / "campaign.toml"
        before = path.read_text(encoding="utf-8")
        after = change(shop, before)
        path.write_text(after, encoding="utf-8")
        return after != before

    return plant


def _cross(shop: Workshop, part: Part) -> None:
    """Nine tap tests of ten: each tap is seen by its own axis alone."""
    for record, keys in part.records:
        axis = keys["excitation"].strip('"')
        for other in AXES:
            if other != axis:
                record.data.pop(f"force_{other}", None)
                record.data.pop(f"acceleration_{other}", None)


def _no_material(shop: Workshop, text_: str) -> str:
    start = text_.index("[material]")
    return text_[:start] + text_[text_.index("[channels]") :]


FAULTS: dict[str, Fault] = {
    "acceleration 9.8 times too large": _scaled("acceleration", G),
    "acceleration 9.8 times too small": _scaled("acceleration", 1.0 / G),
    "one accelerometer 9.8 times too large": _scaled("acceleration_y", G, "hammer"),
    "force 1000 times too large (hammer)": _scaled("force", 1e3, "hammer"),
    "force 1000 times too small (cut)": _scaled("force", 1e-3, None, "cutting_test"),
    "force of the wrong sign": _scaled("force", -1.0, "hammer"),
    "acceleration of the wrong sign": _scaled("acceleration", -1.0, "hammer"),
    "records of two axes exchanged": _of_part(_swapped, "measurement", method="hammer"),
    "one record under two names": _of_part(_same_file, "measurement"),
    "block of NaN": _changed(_nan_block),
    "acceleration cut off": _changed(_clipped),
    "missing column": _changed(_lost),
    "wrong pulses of the tacho": _of_part(_pulses, "cutting_test"),
    "wrong stated speed": _of_part(_stated_speed, "cutting_test"),
    "tooth passing above the band": _of_part(_above_band, "cutting_test"),
    "sample rate too low": _changed(_slow_rate),
    "wrong number of teeth": _of_part(_teeth, "cutting_test"),
    "frequency range beyond the rate": _of_part(_range, "measurement"),
    "hammer declared as actuator": _of_part(_method, "measurement", method="hammer"),
    "no modes for the method asked": _of_part(_one_axis, "measurement", method="hammer"),
    "operating point with a model": _of_part(_operating, "measurement", method="hammer"),
    "no cross terms": _of_part(_cross, "measurement", method="hammer"),
    "empty file": _broken_file("empty"),
    "truncated file": _broken_file("cut"),
    "no recording at all": _broken_file("garbage"),
    "record without a sample": _changed(_no_rows),
    "record of seven samples": _changed(_few_rows),
    "time that runs backwards": _changed(_backwards),
    "lobes of an unknown name": _file_text(
        lambda s, t: t.replace('measurements = ["', 'measurements = ["no such name", "', 1)
    ),
    "no work material": _file_text(_no_material),
    "wider than the tool": _file_text(lambda s, t: t.replace('width_of_cut = "', 'width_of_cut = "9', 1)),
    "file that is not there": _file_text(lambda s, t: t.replace('file = "', 'file = "x', 1)),
    "unit that is none": _file_text(lambda s, t: t.replace('unit = "N"', 'unit = "Nm/s"', 1).replace("kN", "kp", 1)),
}
"""What is planted."""


def planted(seed: int, folder: Path) -> str:
    """Write a campaign with one fault, which is drawn; return its name."""
    rng = np.random.default_rng([seed, 99])
    names = list(FAULTS)
    shop = healthy(seed)
    write(shop, folder)
    for name in rng.permutation(names):
        if FAULTS[str(name)](shop, folder):
            return str(name)
    raise AssertionError("no fault found a place")
