"""Files of frequency responses as programs of the workshop write them, drawn at random; shares no code with smfe.

A machine is drawn as mass, damping and stiffness matrices of points with directions x, y, z; its displacement over
force is solved line by line. Then the form of the file is drawn: kind of response and unit, complex or parts,
decibels, degrees or radians, wrapped or not; frequencies as a column in Hz, kHz or rad/s or by spacing; text, MATLAB
5 and 7.3, NumPy, universal file as text and binary; the sign of time; directions with a minus; the line at 0 Hz as
NaN; a coherence of n averages with the noise that belongs to it; a whole Fourier transform; lines from the top down.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy import io

POUND, GRAVITY, INCH = 4.4482216152605, 9.80665, 0.0254

UNITS: dict[str, dict[str, float]] = {
    "compliance": {"m/N": 1.0, "mm/N": 1e-3, "um/N": 1e-6, "nm/N": 1e-9, "mm/kN": 1e-6, "in/lbf": INCH / POUND},
    "mobility": {"m/s/N": 1.0, "mm/s/N": 1e-3, "(m/s)/N": 1.0, "in/s/lbf": INCH / POUND},
    "accelerance": {"m/s^2/N": 1.0, "g/N": GRAVITY, "(m/s^2)/N": 1.0, "1/kg": 1.0, "g/lbf": GRAVITY / POUND},
    "dynamic_stiffness": {"N/m": 1.0, "N/um": 1e6, "N/mm": 1e3, "lbf/in": POUND / INCH},
    "impedance": {"N s/m": 1.0, "N/(m/s)": 1.0, "kg/s": 1.0},
    "apparent_mass": {"kg": 1.0, "N/(m/s^2)": 1.0, "N/g": 1.0 / GRAVITY},
}
"""Kind -> unit -> factor to SI."""

ORDER = {"compliance": 0, "mobility": 1, "accelerance": 2, "dynamic_stiffness": 0, "impedance": 1, "apparent_mass": 2}
INVERSE = ("dynamic_stiffness", "impedance", "apparent_mass")
FORMATS = ("csv", "mat5", "mat73", "npy", "uff", "uffb")


@dataclass(frozen=True)
class FrfFile:
    """A file, the table of a campaign that reads it, and what is in it.

    `table` is the text of a ``[[measurement]]``; `response`, `excitation` name the ends as the result does. `truth` is
    the compliance [m/N] at `frequency` [Hz], noise included in `measured`. `says` is a word that a warning has to hold,
    empty where nothing is wrong; where it is not empty the numbers are not right. `std` is the stated error where it is
    known.
    """

    path: Path
    table: str
    response: str
    excitation: str
    frequency: np.ndarray
    truth: np.ndarray
    measured: np.ndarray
    digits: float
    says: str
    averages: int
    drawn: dict[str, Any] = field(default_factory=dict)


def machine(rng: np.random.Generator, points: int, f: np.ndarray) -> np.ndarray:
    """Return displacement over force of a chain of masses [m/N], shape (f, points, points)."""
    m = rng.uniform(2.0, 30.0, points)
    k = rng.uniform(0.5, 2.0, points) * 15.0 * (2 * np.pi * rng.uniform(0.15, 0.3) * f[-1]) ** 2
    stiffness = np.diag(k + np.append(k[1:], 0.0)) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
    size, shape = np.linalg.eigh(stiffness / np.sqrt(np.outer(m, m)))
    zeta = rng.uniform(0.01, 0.05, points)
    root = np.sqrt(m)[:, None] * shape
    damping = root @ np.diag(2.0 * zeta * np.sqrt(size)) @ root.T
    w = 2 * np.pi * f[:, None, None]
    return np.linalg.inv(stiffness - w**2 * np.diag(m) + 1j * w * damping)


def draw(seed: int, folder: Path, formats: tuple[str, ...] = FORMATS) -> FrfFile:
    """Draw a machine, one entry of its response, and a file that holds it."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(list(UNITS)))
    form = str(rng.choice(["complex", "real_imag", "magnitude", "decibel"]))
    style = str(rng.choice(list(formats)))
    if style in ("uff", "uffb"):
        form = "complex"
    elif style == "csv" and form == "complex":
        form = "real_imag"
    n = int(rng.integers(200, 900))
    spacing = float(rng.choice([0.25, 0.5, 1.0, 2.0, 1.25, 0.1953125]))
    first = int(rng.choice([0, 0, 1, 20]))
    f = spacing * (first + np.arange(n))
    points = 3
    nodes = [str(v) for v in rng.choice(np.arange(1, 400), points, replace=False)]
    there = int(rng.integers(points))
    here = there if rng.random() < 0.5 else int(rng.integers(points))
    direction = str(rng.choice(["x", "y", "z"]))
    named = there != here or rng.random() < 0.3
    phi = machine(rng, points, f)[:, there, here]
    truth = phi.copy()

    averages = int(rng.integers(2, 40)) if rng.random() < 0.4 else 0
    coherence = np.full(n, np.nan)
    if averages:
        noise = float(10 ** rng.uniform(-2.5, -0.5)) * np.median(np.abs(phi))
        phi, coherence = averaged(rng, phi, noise, averages)

    factor = float(UNITS[kind][unit := str(rng.choice(list(UNITS[kind])))])
    with np.errstate(divide="ignore", invalid="ignore"):
        numbers = phi * (2j * np.pi * f) ** ORDER[kind]
        numbers = (1.0 / numbers if kind in INVERSE else numbers) / factor
    if ORDER[kind] and f[0] == 0.0:
        numbers[0] = 0.0 if rng.random() < 0.3 and kind not in INVERSE else np.nan
    turned = bool(rng.random() < 0.15)
    numbers = numbers.conj() if turned else numbers
    declared = turned and bool(rng.random() < 0.6)
    minus = bool(rng.random() < 0.15)
    numbers = -numbers if minus else numbers
    lines = np.arange(n)
    whole = first == 0 and form in ("complex", "real_imag") and style not in ("uff", "uffb") and rng.random() < 0.1
    falling = not whole and style == "csv" and rng.random() < 0.1
    if whole:
        numbers = np.concatenate([numbers, [0.0], numbers[:0:-1].conj()])
        coherence = np.concatenate([coherence, [1.0], coherence[:0:-1]])
        lines = np.arange(2 * n)
    if falling:
        numbers, coherence, lines = numbers[::-1], coherence[::-1], lines[::-1]
    axis = spacing * (first + lines)
    by_spacing = style not in ("uff", "uffb") and not falling and rng.random() < 0.3
    scale, clock = {"Hz": (1.0, "Hz"), "kHz": (1e-3, "kHz"), "rad": (2 * np.pi, "rad/s")}[
        str(rng.choice(["Hz", "Hz", "kHz", "rad"]))
    ]

    columns: dict[str, np.ndarray] = {} if by_spacing else {"f": scale * axis}
    channels: dict[str, str] = {}
    if by_spacing:
        begin = f', start = "{float(axis[0])!r} Hz"' if first else ""
        channels["frequency"] = f'{{ spacing = "{spacing!r} Hz"{begin} }}'
    elif style not in ("uff", "uffb"):
        channels["frequency"] = f'{{ column = "f", unit = "{clock}" }}'
    stated, more, declared_as = _parts(rng, kind, unit, form, numbers)
    columns |= more
    channels |= declared_as
    if averages:
        percent = style not in ("uff", "uffb") and rng.random() < 0.3
        columns["coh"] = coherence * (100.0 if percent else 1.0)
        channels["coherence"] = f'{{ column = "coh"{", unit = " + chr(34) + "%" + chr(34) if percent else ""} }}'

    ends = [f"{nodes[there]}:{direction}", f"{nodes[here]}:{direction}"] if named else [direction, direction]
    path, digits = _write(
        rng, folder / f"frf_{seed}", style, columns, (nodes[there], nodes[here], direction, minus), axis
    )
    if style in ("uff", "uffb"):
        name = _degrees(nodes[there], nodes[here], direction, minus)
        channels[kind] = f'{{ column = "{name}", unit = "{unit}" }}'
        channels |= {"coherence": f'{{ column = "{name} coherence" }}'} if averages else {}
    elif style in ("mat5", "mat73") and in_structure(seed):
        channels = {k: v.replace('column = "', 'column = "rec.') for k, v in channels.items()}
    response = ends[0]
    if minus and style not in ("uff", "uffb"):
        response = ends[0].replace(direction, f"-{direction}") if ":" in ends[0] else f"-{direction}"
    says = "conjugate" if turned != declared else ""
    text = ["[[measurement]]", f'name = "m{seed}"', 'method = "frf"']
    text += [f"averages = {averages}"] if averages else []
    text += ["conjugate = true"] if declared else []
    text += [
        f'records = [{{ file = "{path.name}", response = "{response}", excitation = "{ends[1]}" }}]',
        "[measurement.channels]",
        *(f"{name} = {entry}" for name, entry in channels.items()),
    ]
    drawn = {
        "kind": kind,
        "form": form,
        "style": style,
        "unit": stated,
        "turned": turned,
        "minus": minus,
        "named": named,
    }
    drawn |= {"whole": bool(whole), "falling": bool(falling), "spacing": bool(by_spacing), "averages": averages}
    return FrfFile(path, "\n".join(text) + "\n", *ends, f, truth, phi, digits, says, averages, drawn)


def _parts(
    rng: np.random.Generator, kind: str, unit: str, form: str, numbers: np.ndarray
) -> tuple[str, dict[str, np.ndarray], dict[str, str]]:
    """Return the unit as it is declared, the columns of a response and their channels."""
    if form == "complex":
        return unit, {"H": numbers}, {kind: f'{{ column = "H", unit = "{unit}" }}'}
    if form == "real_imag":
        names = (("real", "re"), ("imag", "im"))
        channels = {f"{kind}_{p}": f'{{ column = "{c}", unit = "{unit}" }}' for p, c in names}
        return unit, {"re": numbers.real, "im": numbers.imag}, channels
    phase = np.angle(numbers)
    phase = np.unwrap(phase) if rng.random() < 0.3 and np.isfinite(phase).all() else phase
    turn, angle = (np.pi / 180.0, "deg") if rng.random() < 0.7 else (1.0, "rad")
    size, stated = np.abs(numbers), unit
    if form == "decibel":
        zero = float(rng.choice([1.0, 1e-6]))
        stated = f"dB re {zero:g} {unit}"
        with np.errstate(divide="ignore"):
            size = 20.0 * np.log10(size / zero)
    channels = {f"{kind}_magnitude": f'{{ column = "mag", unit = "{stated}" }}'}
    channels[f"{kind}_phase"] = f'{{ column = "ph", unit = "{angle}" }}'
    return stated, {"mag": size, "ph": phase / turn}, channels


def in_structure(seed: int) -> bool:
    """Whether the variables of a MATLAB file stand in a structure."""
    return seed % 3 == 0


def averaged(rng: np.random.Generator, phi: np.ndarray, noise: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return response and coherence of n averages with circular noise on the motion, summed average by average."""
    shape = (phi.size, n)
    force = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    motion = phi[:, None] * force + noise * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    sxf, sff, sxx = (motion * force.conj()).sum(1), (np.abs(force) ** 2).sum(1), (np.abs(motion) ** 2).sum(1)
    return sxf / sff, np.abs(sxf) ** 2 / (sxx * sff)


def _write(
    rng: np.random.Generator,
    stem: Path,
    style: str,
    columns: dict[str, np.ndarray],
    ends: tuple[Any, ...],
    axis: np.ndarray,
) -> tuple[Path, float]:
    """Write the columns; return the file and the relative error of its digits."""
    if style == "csv":
        path, digits = stem.with_suffix(str(rng.choice([".csv", ".txt", ".dat"]))), int(rng.choice([6, 8, 12]))
        comma = ";" if rng.random() < 0.3 else ","
        rows = [comma.join(columns)]
        rows += [comma.join(f"{v:.{digits}e}" for v in row) for row in zip(*columns.values(), strict=True)]
        text = "\n".join(rows) + "\n"
        if comma == ";" and rng.random() < 0.6:
            text = text.replace(".", ",")
        path.write_text(text)
        return path, 10.0**-digits
    if style == "mat5":
        path = stem.with_suffix(".mat")
        held = {k: v[:, None] if rng.random() < 0.5 else v[None, :] for k, v in columns.items()}
        io.savemat(
            path, {"rec": held} if in_structure(int(stem.name[4:])) else held, do_compression=bool(rng.random() < 0.5)
        )
        return path, 1e-12
    if style == "mat73":
        path = stem.with_suffix(".mat")
        with h5py.File(path, "w", userblock_size=512) as file:
            place = file.create_group("rec") if in_structure(int(stem.name[4:])) else file
            for name, values in columns.items():
                if np.iscomplexobj(values):
                    pair = np.empty((1, values.size), np.dtype([("real", "f8"), ("imag", "f8")]))
                    pair["real"], pair["imag"] = values.real, values.imag
                    place[name] = pair
                else:
                    place[name] = values[None, :]
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file".ljust(124) + struct.pack("<H", 0x0200) + b"IM")
        return path, 1e-12
    if style == "npy":
        path = stem.with_suffix(".npz")
        np.savez(path, **columns)
        return path, 1e-12
    path = stem.with_suffix(".unv" if rng.random() < 0.5 else ".uff")
    blocks = [_uff(4, columns["H"], ends, axis, style == "uffb")]
    if "coh" in columns:
        blocks.append(_uff(6, columns["coh"], ends, axis, style == "uffb"))
    order = blocks[::-1] if rng.random() < 0.5 else blocks
    path.write_bytes(b"".join(order))
    return path, 1e-6 if style == "uffb" else 1e-5  # the step of the frequencies has six digits in both


def _degrees(there: str, here: str, direction: str, minus: bool) -> str:
    return f"{there}:{'-' if minus else '+'}{direction.upper()}/{here}:+{direction.upper()}"


def _uff(kind: int, values: np.ndarray, ends: tuple[Any, ...], axis: np.ndarray, binary: bool) -> bytes:
    """One dataset 58, by the columns of its standard; NaN is written as zero, as most programs do."""
    there, here, direction, minus = ends
    code = "xyz".index(direction) + 1
    values = np.nan_to_num(values)
    complex_values = np.iscomplexobj(values)
    ordinate = (6 if binary else 5) if complex_values else (4 if binary else 2)
    body = values.astype("<c16" if complex_values else "<f8").tobytes() if binary else b""
    first, step = float(axis[0]), float(axis[1] - axis[0])
    head = ["    -1"]
    head += [f"{58:6d}b{1:6d}{2:6d}{11:12d}{len(body):12d}{0:6d}{0:6d}{0:12d}{0:12d}" if binary else f"{58:6d}"]
    head += ["response", "made elsewhere", "22-Nov-26 12:00:00", "NONE", "NONE"]
    head += [
        f"{kind:5d}{0:10d}{1:5d}{0:10d} {'NONE':<10}{int(there):10d}{-code if minus else code:4d}"
        f" {'NONE':<10}{int(here):10d}{code:4d}"
    ]
    head += [f"{ordinate:10d}{values.size:10d}{1:10d}{first:13.5e}{step:13.5e}{0.0:13.5e}"]
    head += [f"{18:10d}{0:5d}{0:5d}{0:5d} {'Frequency':<20} {'Hz':<20}"]
    head += [f"{0:10d}{0:5d}{0:5d}{0:5d} {'NONE':<20} {'NONE':<20}"] * 3
    flat = np.column_stack([values.real, values.imag]).ravel() if complex_values else values
    if not binary:
        body = b"\n".join("".join(f"{v:13.5e}" for v in flat[k : k + 6]).encode() for k in range(0, flat.size, 6))
    return "\n".join(head).encode() + b"\n" + body + b"\n    -1\n"
