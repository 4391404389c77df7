"""What every family shares: the answer, instruments with their imperfections, and the folder that is written."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy import io, signal

Real = NDArray[np.float64]
Columns = Mapping[str, Real]

MATERIAL = 0.05
"""Relative change of the limit depth, or of the force, from which an effect matters."""

CLEARLY = 1.4
"""Times that which an effect costs at least: one that costs just as much is found too small in half of all cases."""

LARGEST = 30.0
"""An effect is raised up to this many times the size that must be found until it is material."""


@dataclass(frozen=True)
class Answer:
    """What was hidden in a campaign.

    hidden: effect -> its size with its sign. causes: effect -> ids of which any is right. cost: the relative change of
    limit depth or force by all of it. truths: name of a parameter -> true value in the unit that is shown. alike: ids
    that do the same to what is measured.
    """

    family: str
    seed: int
    hidden: Mapping[str, float]
    causes: Mapping[str, tuple[str, ...]]
    cost: float
    truths: Mapping[str, float] = field(default_factory=dict)
    drawn: Mapping[str, float | str] = field(default_factory=dict)
    alike: tuple[str, ...] = ()


@dataclass(frozen=True)
class Hiding:
    """An effect: the size that must be found, its unit, whether both signs make sense, and what may be said of it."""

    size: float
    unit: str
    causes: tuple[str, ...]
    signed: bool = False
    switch: bool = False
    """There or not: it has no size that could be raised."""
    alike: tuple[str, ...] = ()
    """Ids by which the same could be measured: none of them is right, but without them nothing is left to be named."""


def raised(
    size: float,
    cost: Callable[[float], float],
    switch: bool = False,
    largest: float = LARGEST,
    clearly: float = CLEARLY,
) -> tuple[float, float]:
    """Return a size, made larger by 12 % at a time until it clearly costs what is material, and what it then costs."""
    most = largest * abs(size)
    now = cost(size)
    while not switch and now < clearly * MATERIAL and abs(size) * 1.12 < most:
        size *= 1.12
        now = cost(size)
    return size, now


# --- Instruments.


@dataclass(frozen=True)
class Instruments:
    """One set of instruments.

    rate [Hz] of the records; `corner` of the anti-alias filter over it, of `order`; bits of the converter; noise below
    the signal at the usual level [dB]; hum relative to the rms of a channel at `mains` [Hz]; its harmonics.
    """

    rate: float
    corner: float
    order: int
    bits: int
    snr: float
    mains: float
    hum: float
    harmonics: tuple[float, float]

    def filtered(self, raw: Real, times: int) -> Real:
        """Return rows at `rate` from rows at `times` that rate, behind the anti-alias filter."""
        sections = signal.butter(self.order, 2.0 * self.corner / times, output="sos")
        return np.asarray(signal.sosfilt(sections, raw, axis=-1)[..., ::times])

    def hummed(self, rows: Real, size: Real, rng: np.random.Generator) -> Real:
        """Add the mains at a share of the rms `size` of each row."""
        t = np.arange(rows.shape[-1]) / self.rate
        line = self.mains * (1.0 + 4e-4 * rng.standard_normal())
        out = rows.copy()
        for i in range(rows.shape[0]):
            for times, part in ((1, 1.0), (3, self.harmonics[0]), (5, self.harmonics[1])):
                level = math.sqrt(2.0) * self.hum * part * float(size[i]) * rng.uniform(0.5, 1.0)
                if times * line < 0.45 * self.rate:
                    out[i] += level * np.sin(2.0 * np.pi * times * line * t + rng.uniform(0.0, 2.0 * np.pi))
        return out

    def noise(self, shape: tuple[int, int], rng: np.random.Generator) -> Real:
        """Noise of unit variance, somewhat more of it at low frequency."""
        white = rng.standard_normal((shape[0], shape[1] + 300))
        out = signal.lfilter([1.0], [1.0, -0.5], white, axis=1)[:, 300:]
        return np.asarray(math.sqrt(0.75) * out)

    def converted(self, rows: Real, full: Real) -> Real:
        """Round to the steps of a converter with a full scale for each row."""
        step = np.asarray(full)[:, None] / 2.0 ** (self.bits - 1)
        return np.asarray(np.round(rows / step) * step)


def instruments(rng: np.random.Generator, rate: float, hum: float = 0.01) -> Instruments:
    """Draw a set of instruments."""
    return Instruments(
        rate,
        float(rng.uniform(0.36, 0.42)),
        int(rng.choice([6, 8])),
        int(rng.choice([16, 24])),
        float(rng.uniform(20.0, 40.0)),
        float(rng.choice([50.0, 60.0])),
        hum,
        (float(rng.uniform(0.0, 0.5)), float(rng.uniform(0.0, 0.3))),
    )


def sensitivities(
    rng: np.random.Generator, gain: float = 0.01, angle: float = math.radians(1.0), talk: float = 0.01
) -> Real:
    """Matrix (3, 3) of a sensor of three axes: calibrated within `gain`, turned by `angle`, with cross-talk.

    None is further off than three standard deviations: one that is turned by five degrees is no healthy one.
    """
    a, b, c = angle * np.clip(rng.standard_normal(3), -3.0, 3.0)
    turn = np.array([[1.0, -c, b], [c, 1.0, -a], [-b, a, 1.0]])
    cross = talk * np.clip(rng.standard_normal((3, 3)), -3.0, 3.0)
    np.fill_diagonal(cross, 0.0)
    return np.diag(1.0 + gain * np.clip(rng.standard_normal(3), -3.0, 3.0)) @ (np.eye(3) + cross) @ turn


def clipped_normal(rng: np.random.Generator, sigma: float, most: float = 2.0) -> float:
    """Draw a normal number, none beyond `most` standard deviations."""
    while True:
        x = float(rng.standard_normal())
        if abs(x) <= most:
            return sigma * x


# --- The folder.


@dataclass
class Folder:
    """A campaign in the making: text of the file, and records that were written."""

    path: Path
    suffix: str
    lines: list[str] = field(default_factory=list)

    def say(self, *lines: str) -> None:
        """Add lines to the campaign file."""
        self.lines += lines

    def record(self, name: str, columns: Columns) -> str:
        """Write a record and return its file name."""
        file = self.path / f"{name}{self.suffix}"
        if self.suffix == ".csv":
            table = np.column_stack(list(columns.values()))
            np.savetxt(file, table, fmt="%.8g", delimiter=",", header=",".join(columns), comments="")
        elif self.suffix == ".mat":
            io.savemat(file, dict(columns))
        else:
            with h5py.File(file, "w") as out:
                for key, values in columns.items():
                    out[key] = values
        return file.name

    def close(self) -> Path:
        """Write the campaign file."""
        file = self.path / "campaign.toml"
        file.write_text("\n".join(self.lines) + "\n", encoding="utf-8")
        return file


def folder(
    path: Path, rng: np.random.Generator, name: str, suffixes: Sequence[str] = (".mat", ".h5", ".csv")
) -> Folder:
    """Begin a campaign."""
    path.mkdir(parents=True, exist_ok=True)
    out = Folder(path, str(rng.choice(list(suffixes))))
    out.say("[campaign]", f'name = "{name}"')
    return out


def table(name: str, **values: object) -> str:
    """Return a TOML table in one block; text is quoted, everything else is written as it is."""
    rows = [f"[{name}]"]
    for key, value in values.items():
        if value is None:
            continue
        rows.append(f"{key} = {_toml(value)}")
    return "\n".join(rows)


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    if isinstance(value, float):
        return f"{value:.7g}"
    return str(value)


# --- What a limit depth is.


def limit_depth(
    compliance: NDArray[np.complex128], kt: float, kr: float, teeth: int, entry: float, leave: float
) -> float:
    """Smallest stable depth [m] over all speeds, by the eigenvalues of the mean cut; compliance (f, 2, 2), x and y.

    ``1 = b lambda (1 - exp(-j w T))`` with lambda the eigenvalues of A Phi: ``b = 1 / (2 Re lambda)`` at some speed.
    A is the force over the motion since the tooth before, per depth, as its mean over a turn.
    """
    phi = np.linspace(entry, leave, 721)
    s, c = np.sin(phi), np.cos(phi)
    force = np.array([-kt * c - kr * s, kt * s - kr * c])
    a = teeth / (2.0 * math.pi) * np.trapezoid(force[:, None, :] * np.array([s, c])[None], phi, axis=2)
    value = np.linalg.eigvals(a[None] @ compliance)
    most = float(value.real.max())
    return math.inf if most <= 0.0 else 1.0 / (2.0 * most)
