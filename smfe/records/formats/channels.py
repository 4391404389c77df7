"""Channels: which column of a file is which physical quantity, in which unit and with which corrections."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from process import units
from process.errors import InputError
from process.labels import AXES, RECORD_SCALARS, RECORD_VECTORS
from process.types import Real

_DIMENSION_OF_VECTOR = {
    "force": "force",
    "acceleration": "acceleration",
    "displacement": "length",
    "encoder_position": "length",
    "drive_force": "force",
    "reference_position": "length",
    "encoder_speed": "speed",
    "reference_speed": "speed",
    "encoder_angle": "angle",
    "encoder_rotation": "rotation",
    "drive_torque": "torque",
}

RECORD_CHANNELS: dict[str, str] = {
    "time": "time",
    **{f"{name}_{axis}": _DIMENSION_OF_VECTOR[name] for name in RECORD_VECTORS for axis in AXES},
    "spindle_angle": "angle",
    "spindle_speed": "rotation",
    "tacho": "dimensionless",
    "sound": "pressure",
}
"""Channel of a record -> dimension of its values (a key of `process.units.UNITS`)."""

FRF_KINDS: dict[str, tuple[int, bool]] = {
    "compliance": (0, False),
    "mobility": (1, False),
    "accelerance": (2, False),
    "dynamic_stiffness": (0, True),
    "impedance": (1, True),
    "apparent_mass": (2, True),
}
"""Frequency response -> how often its motion is differentiated in time, and whether it is force over motion."""

FRF_PARTS = ("", "real", "imag", "magnitude", "phase")
"""How a frequency response is written: as complex numbers, or as two columns of real ones."""


def frf_channel(kind: str, part: str) -> str:
    """Return ("mobility", "real") as the channel "mobility_real"; without a part the complex "mobility"."""
    return f"{kind}_{part}" if part else kind


COMPLIANCE_CHANNELS: dict[str, str] = {
    "frequency": "frequency",
    **{frf_channel(kind, part): "angle" if part == "phase" else kind for kind in FRF_KINDS for part in FRF_PARTS},
    "coherence": "dimensionless",
}
"""Channel of a frequency response that another program has averaged -> dimension of its values."""

CHANNELS: dict[str, str] = {**RECORD_CHANNELS, **COMPLIANCE_CHANNELS}
"""Every channel a campaign may declare -> dimension of its values."""


@dataclass(frozen=True)
class Channel:
    """Where a channel stands in a file, and what has to be done to its numbers.

    ``value = sign * scale * number * (unit in SI)``, then shifted in time: the sample at t belongs to what happened at
    ``t - delay``.

    Parameters
    ----------
    column : str or int, optional
        Header name, or position counted from 1. Not needed for files in our own layout.
    unit : str, optional
        Unit of the numbers after `scale`.
    sign : float, optional
        +1 or -1.
    scale : float, optional
        Factor on the numbers, for a sensor recorded in volts.
    delay : float, optional
        Delay of the channel [s]; positive when it comes late.
    sample_rate : float, optional
        Only for "time": sample rate [Hz] instead of a column.
    pulses_per_revolution : float, optional
        Only for "tacho".
    spacing, start : float, optional
        Only for "frequency": distance of the lines [Hz] instead of a column, and the first of them [Hz] (else 0).
    """

    column: str | int | None = None
    unit: str | None = None
    sign: float = 1.0
    scale: float = 1.0
    delay: float = 0.0
    sample_rate: float | None = None
    pulses_per_revolution: float | None = None
    spacing: float | None = None
    start: float | None = None

    def to_si(self, name: str, numbers: Real) -> Real:
        """Return the numbers of channel `name` in the unit of its label (SI; a spindle speed in rpm)."""
        factor = self.sign * self.scale * unit_factor(name, self.unit)
        if is_decibel(self.unit):
            return np.asarray(factor * 10.0 ** (numbers / 20.0))
        return numbers if factor == 1.0 else numbers * factor


def unit_factor(name: str, unit: str | None) -> float:
    """Return the number that turns `unit` into the unit of channel `name`.

    Raises
    ------
    InputError
        For a channel or a unit that is not known, or no unit where one is needed.
    """
    check_channel_name(name)
    dimension = CHANNELS[name]
    if name == "coherence":
        return units.factor(unit or "1", dimension)
    if dimension == "dimensionless":
        # A tacho is a train of pulses: its level is of no interest, so volts do as well as ones.
        return 1.0
    if unit is None:
        raise InputError(f'{name} has no unit; add unit = "{next(iter(units.UNITS[dimension]))}" or the one it is in')
    if dimension in FRF_KINDS:
        return _frf_factor(name, dimension, unit)
    factor = units.factor(unit, dimension)
    # Labels show a spindle speed in rpm (process.labels.SHOP_UNITS).
    return units.from_si(factor, "rpm", "rotation") if name == "spindle_speed" else factor


def _frf_factor(name: str, kind: str, unit: str) -> float:
    """Return the factor of a frequency response; of one in decibels, that of what 0 dB is."""
    if is_decibel(unit) and not name.endswith("_magnitude"):
        raise InputError(f"{name} in decibels is not possible; only a magnitude is, call the channel {kind}_magnitude")
    match = _DECIBEL.match(unit)
    number, unit = (float(match["number"] or 1.0), match["unit"]) if match else (1.0, unit)
    if not unit:
        raise InputError(
            f'"dB" says nothing without what 0 dB is; write unit = "dB re 1 {next(iter(units.UNITS[kind]))}"'
        )
    if kind == "compliance":
        kind = _MOTIONS[motion_of(unit)]
    other = next((k for k in FRF_KINDS if units.known(unit, k)), None)
    if other is not None and not units.known(unit, kind):
        raise InputError(
            f"unit '{unit}' is that of {'an' if other[0] in 'ai' else 'a'} {other.replace('_', ' ')}; call the channel "
            f"{name.replace(kind, other, 1)}"
        )
    return number * units.factor(unit, kind)


_DECIBEL = re.compile(r"\s*dB(?:\s*re:?\s*(?P<number>[-+.\deE]*\d(?![\d/]))?\s*(?P<unit>\S.*?)?)?\s*$", re.I)
"""Decibels and what 0 dB is: "dB re 1e-6 m/N" has the number 1e-6 and the unit m/N, "dB re 1/kg" the unit 1/kg."""


def is_decibel(unit: str | None) -> bool:
    """Whether numbers are ``20 log10`` of a magnitude over what 0 dB is: "dB re 1 m/N"."""
    return unit is not None and _DECIBEL.match(unit) is not None


_MOTIONS = ("compliance", "mobility", "accelerance")
"""What averaged responses come as: displacement, velocity or acceleration over force."""


def motion_of(unit: str | None) -> int:
    """Return how often the motion of an averaged response is differentiated in time, by its unit: 0, 1 or 2."""
    match = _DECIBEL.match(unit) if unit is not None else None
    bare = match["unit"] if match else unit
    for order, dimension in enumerate(_MOTIONS):
        if bare is not None and units.known(bare, dimension):
            return order
    return 0


def check_channel_name(name: str) -> str:
    """Return the name of a channel when it is one, else raise `InputError` with the nearest that is."""
    if name not in CHANNELS:
        vectors = ", ".join(f"{vector}_x|y|z" for vector in RECORD_VECTORS)
        raise InputError(
            f"channel '{name}' is not known{did_you_mean(name, CHANNELS)}; channels are time, {vectors}, "
            f"{', '.join(RECORD_SCALARS)}; of a frequency response frequency, coherence and {', '.join(FRF_KINDS)} "
            "(each "
            f"complex, or as _real and _imag, or as _magnitude and _phase{_synonym(name)})"
        )
    return name


_SYNONYMS = {
    "receptance": "compliance",
    "flexibility": "compliance",
    "inertance": "accelerance",
    "dynamic_mass": "apparent_mass",
    "effective_mass": "apparent_mass",
    "admittance": "mobility",
}


def _synonym(name: str) -> str:
    return next((f"; a {word} is called {ours} here" for word, ours in _SYNONYMS.items() if name.startswith(word)), "")


def split_vector(name: str) -> tuple[str, str] | None:
    """Return ("force", "x") for "force_x", None for a channel without an axis."""
    vector, _, axis = name.rpartition("_")
    return (vector, axis) if vector in RECORD_VECTORS and axis in AXES else None


def record_channels(channels: Mapping[str, Channel]) -> dict[str, Channel]:
    """Return the channels that belong to a record; refuse names that are not known."""
    return {name: channel for name, channel in channels.items() if check_channel_name(name) in RECORD_CHANNELS}


# --- Half-sentences for messages about names.


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'column'?)"`` for a name near a known one, else nothing."""
    choices = list(known)
    near = difflib.get_close_matches(name, choices, n=1, cutoff=0.6)
    if not near:
        lower = {choice.lower(): choice for choice in choices}
        near = [lower[key] for key in difflib.get_close_matches(name.lower(), list(lower), n=1, cutoff=0.6)]
    return f" (did you mean '{_in_line(near[0])}'?)" if near else ""


def listed(names: Iterable[object], most: int = 30) -> str:
    """Return names in quotes with commas between, shortened when there are many."""
    quoted = [f"'{_in_line(str(name))}'" for name in names]
    more = f", and {len(quoted) - most} more" if len(quoted) > most else ""
    return (", ".join(quoted[:most]) + more) or "none"


def _in_line(name: str) -> str:
    """Return a name from a file as it stands in a sentence: a line break in it is no end of that."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in name)
