"""Frequency responses that another program has averaged, in whatever form -> one entry of a compliance.

A response comes as displacement, velocity or acceleration over force (compliance, mobility, accelerance), or as force
over one of these (dynamic stiffness, impedance, apparent mass); as complex numbers, as real and imaginary part, or as
magnitude and phase, the magnitude perhaps in decibels:

    Phi = H / (j w)^n,      Phi = 1 / (Z (j w)^n)

with n = 0, 1, 2 derivatives of the motion. An entry of a measured force over motion is inverted by itself: one force
acts at a time. The matrix of a simulation, where all other motions are held, has to be inverted as a matrix before.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process import units
from process.errors import InputError
from process.labels import make_compliance, place_text
from process.types import Complex, Real
from smfe.records.formats import uff
from smfe.records.formats.channels import FRF_KINDS, Channel, frf_channel, motion_of
from smfe.records.formats.table import Table
from smfe.records.read import columns_of, format_of, named, values_of

MIRRORED = 1e-6
"""Two halves of a spectrum that differ by less than this share of its size are one and its mirror."""

ROUNDED = 1e-3
"""By how much a coherence may lie outside 0 to 1 and count as 0 or 1."""

STRAY = 0.1
"""Share of lines with an impossible coherence above which it is no coherence; fewer are left out."""

_FORMS = (("",), ("real", "imag"), ("magnitude", "phase"))
_MOTION_TYPES = {8: 0, 11: 1, 12: 2}
_MOTION_NAMES = ("displacement", "velocity", "acceleration")
_FORCE_TYPES = (9, 13)


@dataclass(frozen=True)
class _Form:
    """How a response is declared: its kind, its parts, and how it becomes a displacement over force."""

    kind: str
    parts: tuple[str, ...]
    order: int
    inverse: bool

    @property
    def channels(self) -> list[str]:
        """Names of its channels."""
        return [frf_channel(self.kind, part) for part in self.parts]


def read_frf(
    path: str | Path, channels: Mapping[str, Channel], response: str, excitation: str, *, conjugate: bool = False
) -> xr.Dataset:
    """Read one entry of a compliance that another program has averaged.

    Parameters
    ----------
    path : str or Path
        A file with one of the suffixes in `smfe.records.FORMATS`.
    channels : mapping of str to Channel
        "frequency" (a column, or `spacing` and `start`; a universal file knows its own) and one response: "mobility"
        for a complex array, "mobility_real" and "mobility_imag", or "mobility_magnitude" and "mobility_phase"; for
        mobility any of `FRF_KINDS`. Optionally "coherence". Others are left alone. A "compliance" whose unit is that of
        a mobility or accelerance is taken for one.
    response, excitation : str
        Axes at the tool tip ("x"), or places ("21:x"); "-x" turns the direction round.
    conjugate : bool, optional
        The response was written with ``exp(-j w t)``.

    Returns
    -------
    xarray.Dataset
        ``compliance(frequency, response, excitation)`` [m/N] with one response and one excitation, and ``coherence``
        where declared. Lines that say nothing of the displacement (0 Hz of a mobility or accelerance, numbers that are
        not finite) are left out; ``attrs["notes"]`` is a tuple of sentences on what was done.

    Raises
    ------
    InputError
        For anything that is wrong with the file or its channels.
    """
    path = Path(path)
    file_format = format_of(path)
    if "frequency" not in channels and file_format is uff.FORMAT:
        channels = {**channels, "frequency": Channel("frequency", "Hz")}
    form = _form(path.name, channels)
    used = {name: channels[name] for name in ("frequency", *form.channels, "coherence") if name in channels}
    columns = _split(path.name, form, used)
    tables = file_format.read_tables(path, columns_of(path.name, columns)) if columns else []
    if len(tables) > 1:
        raise InputError(f"{path.name}: has {len(tables)} segments; a compliance needs one")
    notes: list[str] = []
    turned = 1.0
    if file_format is uff.FORMAT:
        turned, said = _degrees_of_freedom(path, form, used, response, excitation)
        notes += said
    values = _values(path.name, columns, tables[0])
    h = _complex(path.name, form, values)
    frequency = values["frequency"] if "frequency" in values else _even(used["frequency"], h.size)
    keep, said = _lines(frequency, h, path.name)
    notes += said
    frequency, h = frequency[keep], h[keep].conj() if conjugate else h[keep]
    with np.errstate(divide="ignore", invalid="ignore"):
        phi = (1.0 / h if form.inverse else h) / (2j * np.pi * frequency) ** form.order
    there = np.isfinite(phi) & ((frequency > 0.0) | (form.order == 0))
    if (lost := int(np.sum(~there & (frequency > 0.0)))) > 0:
        notes.append(f"{lost} of {frequency.size} lines are empty, NaN, infinite or zero and are left out")
    if not there.any():
        raise InputError(f"{path.name}: no line of '{form.kind}' is a number; export it again")
    (to, sign), (at, other) = _end(response), _end(excitation)
    extra = {}
    if "coherence" in values:
        every, said = _coherence(path.name, values["coherence"])
        notes += said
        coherence = every[keep]
        there &= ~(np.isnan(coherence) & np.isfinite(values["coherence"][keep]))
        coherence = coherence[there]
        extra["coherence"] = (("frequency", "response", "excitation"), coherence[:, None, None])
    compliance: Complex = np.asarray(phi[there] * (turned * sign * other), dtype=complex)[:, None, None]
    with named(path.name):
        attrs: dict[str, object] = {"source": path.name, "notes": tuple(notes)}
        return make_compliance(frequency[there], compliance, [to], [at], extra, attrs)


def _end(place: str) -> tuple[str, float]:
    """Return a place without the sign of its direction, and that sign."""
    node, colon, axis = place_text(place).rpartition(":")
    return node + colon + axis.removeprefix("-"), -1.0 if axis.startswith("-") else 1.0


def _form(source: str, channels: Mapping[str, Channel]) -> _Form:
    """Return how the response is declared; refuse none, several, and halves of one."""
    declared = [kind for kind in FRF_KINDS if any(frf_channel(kind, p) in channels for form in _FORMS for p in form)]
    if "frequency" not in channels:
        raise InputError(
            f"{source}: channel frequency is not declared; a compliance needs frequency and a response, e.g. "
            'compliance_real and compliance_imag. Without a column give frequency = { spacing = "1 Hz" }'
        )
    if len(declared) != 1:
        found = " and ".join(declared) if declared else "no response"
        raise InputError(
            f"{source}: declares {found}; declare one of {', '.join(FRF_KINDS)}: complex, or as _real and _imag, or as "
            "_magnitude and _phase"
        )
    (kind,) = declared
    whole = [parts for parts in _FORMS if all(frf_channel(kind, p) in channels for p in parts)]
    if len(whole) != 1:
        there = [frf_channel(kind, p) for form in _FORMS for p in form if frf_channel(kind, p) in channels]
        begun = [form for form in _FORMS if any(frf_channel(kind, p) in there for p in form)]
        missing = next((frf_channel(kind, p) for form in begun for p in form if frf_channel(kind, p) not in there), "")
        why = "which says the same thing twice" if whole else f"but not {missing}; both parts are needed"
        raise InputError(f"{source}: declares {', '.join(there)}, {why}")
    order, inverse = FRF_KINDS[kind]
    if kind == "compliance":
        orders = {motion_of(channels[frf_channel(kind, p)].unit) for p in whole[0] if p != "phase"}
        if len(orders) > 1:
            raise InputError(
                f"{source}: real and imaginary part are of different motions; give both a unit of one kind"
            )
        order = orders.pop()
    return _Form(kind, whole[0], order, inverse)


def _split(source: str, form: _Form, used: Mapping[str, Channel]) -> dict[str, Channel]:
    """Return the columns to read: of a complex array its two parts; none for an even axis of frequencies."""
    out = {}
    for name, channel in used.items():
        if name == "frequency" and channel.spacing is not None:
            continue
        if name != form.kind:
            out[name] = channel
            continue
        if not isinstance(channel.column, str):
            raise InputError(
                f'{source}: {name} is complex and needs the name of its array, column = "H"; where real and imaginary '
                f"part stand in columns of their own, declare {name}_real and {name}_imag"
            )
        for part in ("real", "imag"):
            out[f"{name}_{part}"] = replace(channel, column=f"{channel.column} {part}")
    return out


def _values(source: str, columns: Mapping[str, Channel], table: Table) -> dict[str, Real]:
    """Return the channels in SI; lines that are no numbers stay NaN, the frequencies have to be finite."""
    out = {}
    for name, channel in columns.items():
        if name == "frequency":
            out[name] = values_of(source, name, channel, table)
            continue
        assert channel.column is not None
        with named(source):
            out[name] = channel.to_si(name, table.columns[channel.column])
    return out


def _complex(source: str, form: _Form, values: Mapping[str, Real]) -> Complex:
    if form.parts == ("magnitude", "phase"):
        magnitude, phase = (values[name] for name in form.channels)
        if np.any(magnitude < 0.0):
            raise InputError(
                f"{source}: {form.channels[0]} is negative; a magnitude in decibels needs a unit that says so, e.g. "
                'unit = "dB re 1 m/N", and a real part the channel '
                f"{form.kind}_real"
            )
        if np.nanmax(np.abs(phase)) < 1e-9:
            raise InputError(f"{source}: {form.channels[1]} is zero at every line; declare the column of the phase")
        return np.asarray(magnitude * np.exp(1j * phase))
    return np.asarray(values[f"{form.kind}_real"] + 1j * values[f"{form.kind}_imag"])


def _even(channel: Channel, size: int) -> Real:
    assert channel.spacing is not None
    return np.asarray((channel.start or 0.0) + channel.spacing * np.arange(size))


def _lines(frequency: Real, h: Complex, source: str) -> tuple[NDArray[np.int64], list[str]]:
    """Return the lines of positive frequency in rising order: one half of a spectrum that has both."""
    order = np.argsort(frequency, kind="stable")
    if frequency.size > 1 and (np.diff(frequency) < 0.0).all():
        return np.asarray(order), ["the frequencies fall; the lines were turned round"]
    if frequency.size and frequency[0] < 0.0 and (np.diff(frequency) > 0.0).all():
        return np.flatnonzero(frequency >= 0.0), ["the lines of negative frequency are left out"]
    n = h.size
    if n >= 16 and frequency[0] == 0.0:
        # The whole of a discrete Fourier transform: line n - k repeats line k, conjugate.
        half = h[1 : (n + 1) // 2]
        mirror = h[-1 : n // 2 : -1].conj()
        known = np.isfinite(half) & np.isfinite(mirror)
        size = np.abs(half[known]).max(initial=0.0)
        if size > 0.0 and np.abs(half - mirror)[known].max() < MIRRORED * size and np.abs(half.imag[known]).max() > 0.0:
            return np.arange((n + 1) // 2), [
                f"the lines from {frequency[(n + 1) // 2]:.6g} Hz on mirror those below (a whole Fourier transform) "
                "and are "
                "left "
                "out"
            ]
    return np.arange(n), []


def _coherence(source: str, values: Real) -> tuple[Real, list[str]]:
    """Return a coherence from 0 to 1, NaN at the few lines where it is neither that nor rounded to it."""
    known = values[np.isfinite(values)]
    wrong = np.isfinite(values) & ((values < -ROUNDED) | (values > 1.0 + ROUNDED))
    if np.mean(wrong) > STRAY:
        raise InputError(
            f"{source}: coherence lies between {known.min():.4g} and {known.max():.4g}; it is a number from 0 to 1 "
            '(its root is not one: square it), or per cent with unit = "%"'
        )
    said = []
    if wrong.any():
        many = f"{wrong.sum()} lines with" if wrong.sum() > 1 else "one line with"
        said = [f"{many} a coherence outside 0 to 1 ({known.min():.4g} to {known.max():.4g}) left out"]
    return np.where(wrong, np.nan, np.clip(values, 0.0, 1.0)), said


def _degrees_of_freedom(
    path: Path, form: _Form, used: Mapping[str, Channel], response: str, excitation: str
) -> tuple[float, list[str]]:
    """Hold what a universal file says of a function against what is declared; return its sign and what to say."""
    column = used[form.channels[0]].column
    name = str(column).removesuffix(" real")
    found = next((f for f in uff.read_functions(path) if f.name == name), None)
    if found is None:
        return 1.0, []
    notes = []
    ends = [(found.response, _end(response)[0]), (found.reference, _end(excitation)[0])]
    (there, here), (from_node, from_direction) = found.response, found.reference
    same_declared, same_found = ends[0][1] == ends[1][1], there == from_node and here[1:] == from_direction[1:]
    known = here[1:] in "XYZ" and from_direction[1:] in "XYZ" and here and from_direction
    if known and same_declared and not same_found:
        raise InputError(
            f"{path.name}: '{name}' is the motion of node {there} along {here} under a force at node {from_node} along "
            f"{from_direction}, and it is declared as the direct compliance {ends[0][1]}{ends[1][1]}. Name both ends: "
            f'response = "{there}:{here[1:].lower()}", excitation = "{from_node}:{from_direction[1:].lower()}"'
        )
    if known and same_found and not same_declared:
        raise InputError(
            f"{path.name}: '{name}' has its motion and its force at node {there} along {here[1:]}, and it is declared "
            "as "
            f"the response {ends[0][1]} to {ends[1][1]}; these must be the same"
        )
    if (turned := _stated_sign(found)) < 0.0:
        if any(used[channel].sign < 0.0 for channel in form.channels):
            turned = 1.0
        else:
            notes.append(f"'{name}' is between {here} and {from_direction}: its sign was turned to that of + and +")
    above, below = (found.denominator, found.numerator) if form.inverse else (found.numerator, found.denominator)
    if above[0] in _MOTION_TYPES and below[0] in _FORCE_TYPES and _MOTION_TYPES[above[0]] != form.order:
        notes.append(
            f"the file says that '{name}' is of {_MOTION_NAMES[_MOTION_TYPES[above[0]]]} [{above[1]}], and it is "
            "declared "
            f"as one of {_MOTION_NAMES[form.order]}; where the file is right the compliance is wrong by a factor that "
            "depends on frequency"
        )
    return turned, notes


def read_universal_frfs(path: str | Path) -> xr.Dataset:
    """Read every frequency response of a universal file that says itself what it is, as one matrix of named places.

    Parameters
    ----------
    path : str or Path
        A ``.uff`` or ``.unv`` file with datasets 58 of type 4: displacement, velocity or acceleration over force.

    Returns
    -------
    xarray.Dataset
        ``compliance(frequency, response, excitation)`` [m/N], its places ``NODE:axis``, NaN where no response is; of
        several axes of frequency the one that most functions have. ``attrs["notes"]`` is a tuple of sentences.

    Raises
    ------
    InputError
        When the file has no such response, or does not say of which motion and in which unit it is.
    """
    path = Path(path)
    every = [f for f in uff.read_functions(path) if f.kind == uff.FRF and np.iscomplexobj(f.y)]
    kept = [f for f in every if f.abscissa == "frequency" and all("R" not in d for _, d in (f.response, f.reference))]
    if not kept:
        raise InputError(f"{path.name}: no frequency response of a motion to a force is in this file; export FRFs")
    axes = [(f.first, f.step, f.y.size) for f in kept]
    axis = max(axes, key=axes.count)
    chosen = [f for f, other in zip(kept, axes, strict=True) if other == axis]
    notes = [f"{len(every) - len(chosen)} of {len(every)} responses have other axes or are of rotations: left out"]
    entries: dict[tuple[str, str], Complex] = {}
    frequency = chosen[0].axis()
    with np.errstate(divide="ignore", invalid="ignore"):
        for f in chosen:
            pair = (_node(f.response), _node(f.reference))
            if pair in entries:
                raise InputError(
                    f"{path.name}: the response {'/'.join(pair)} occurs twice; write a campaign that names one"
                )
            entries[pair] = _stated_sign(f) * f.y * _stated_factor(path.name, f, frequency)
    rows, columns = (list(dict.fromkeys(pair[k] for pair in entries)) for k in (0, 1))
    values = np.full((frequency.size, len(rows), len(columns)), np.nan, dtype=complex)
    for (r, e), y in entries.items():
        values[:, rows.index(r), columns.index(e)] = y
    there = np.isfinite(values).any(axis=(1, 2)) & (frequency > 0.0)
    attrs = {"source": path.name, "method": "frf", "notes": tuple(notes if len(every) > len(chosen) else ())}
    with named(path.name):
        values = np.where(np.isfinite(values), values, np.nan)[there]
        return make_compliance(frequency[there], values, rows, columns, attrs=attrs)


def _node(end: tuple[str, str]) -> str:
    """Return a place of a universal file; a scalar, which has no direction, is taken for x."""
    return f"{end[0]}:{end[1][1:].lower() or 'x'}"


def _stated_factor(source: str, function: uff.Function, frequency: Real) -> Complex:
    """Return what turns the numbers of a function into displacement over force [m/N], by what the file says of it."""
    (motion, unit), (force, other) = function.numerator, function.denominator
    if motion not in _MOTION_TYPES or force not in _FORCE_TYPES:
        raise InputError(
            f"{source}: does not say that '{function.name}' is a motion over a force (types {motion} and {force}); "
            "write a "
            "campaign with method = 'frf' that declares it"
        )
    order = _MOTION_TYPES[motion]
    dimension = ("length", "speed", "acceleration")[order]
    stated = [_unit(unit), _unit(other)]
    factors = [
        units.factor(text, kind) if text and units.known(text, kind) else 1.0
        for text, kind in zip(stated, (dimension, "force"), strict=True)
    ]
    return np.asarray(factors[0] / factors[1] / (2j * np.pi * frequency) ** order)


def _unit(label: str) -> str:
    """Return a unit without the brackets that some programs put around it."""
    return label.strip("[]() ").replace("NONE", "")


def _stated_sign(function: uff.Function) -> float:
    signs = [-1.0 if direction.startswith("-") else 1.0 for _, direction in (function.response, function.reference)]
    return signs[0] * signs[1]
