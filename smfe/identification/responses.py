"""Method "frf": frequency responses that another program has averaged -> one compliance matrix with its uncertainty.

The coherence g2 that n independent averages gave says how far the response may be wrong. With a response that the
force explains but for noise, ``H = S_XF/S_FF`` has the complex error

    E |d|^2 = |H|^2 (1 - g2)/(g2 (n - 1)),

half of it in each part; Bendat and Piersol (Random Data, 4th ed., 9.2) have n for the true coherence; the measured
one is too high, the more so the fewer averages there are, and needs n - 1: what is left of n transforms after one
number was fitted has n - 1 complex degrees of freedom. An inverse has the same relative error.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import AXES, make_compliance
from process.types import Complex, Real
from smfe.campaign import Measurement
from smfe.identification.errors.result import Identification
from smfe.records import read_frf
from smfe.records.formats.channels import FRF_KINDS, frf_channel

SAME_LINE = 1e-3
"""Lines of two files that are closer than this share of their spacing are one."""

RISING = 0.5
"""Share by which the phase rises rather than falls from line to line before it is said."""


def identify_averaged(measurement: Measurement) -> Identification:
    """Put the averaged responses of a measurement together into one matrix.

    Parameters
    ----------
    measurement : Measurement
        With method "frf"; each entry of its records is one entry of the matrix.

    Returns
    -------
    Identification
        Compliance [m/N], NaN where an entry has no line; with ``averages`` and a coherence ``compliance_std``,
        ``degrees_of_freedom`` and ``coherence(frequency, response, excitation)``.

    Raises
    ------
    InputError
        When a file cannot be read, an entry occurs twice, or the files have no lines in common.
    """
    entries: dict[tuple[str, str], xr.Dataset] = {}
    notes: list[str] = []
    inverse: set[str] = set()
    for entry in measurement.records:
        assert entry.response is not None
        assert entry.excitation is not None
        if len(entry.files) > 1:
            raise InputError(
                f"several files for the entry {entry.response}{entry.excitation}; an averaged compliance has one: name "
                "it"
            )
        conjugate = bool(measurement.conjugate)
        found = read_frf(entry.files[0], entry.channels, entry.response, entry.excitation, conjugate=conjugate)
        pair = str(found["response"].values[0]), str(found["excitation"].values[0])
        if pair in entries:
            raise InputError(f"the entry {named_pair(pair)} occurs twice; an averaged compliance has one file for each")
        notes += [f"{entry.files[0].name}: {text}" for text in found.attrs["notes"]]
        inverse |= {
            k for k, (_, i) in FRF_KINDS.items() if i and any(frf_channel(k, p) in entry.channels for p in _ANY)
        }
        entries[pair] = found
    dataset = _matrix(measurement, entries)
    if inverse and any(r != e for r, e in entries):
        notes.append(
            f"each entry of the {' and '.join(sorted(inverse)).replace('_', ' ')} was inverted by itself, as measured "
            "with "
            "one force at a time; a matrix from a simulation has to be inverted as a matrix first"
        )
    notes += _turned(dataset)
    notes += _uncertainty_notes(measurement, dataset)
    return Identification(measurement.name, "frf", dataset, {}, tuple(notes))


_ANY = ("", "real", "magnitude")


def named_pair(pair: tuple[str, str]) -> str:
    """Return how an entry is called: "xy", and "21:x/1:x" where a place has a node."""
    return "".join(pair) if set(pair) <= set(AXES) else "/".join(pair)


def _matrix(measurement: Measurement, entries: dict[tuple[str, str], xr.Dataset]) -> xr.Dataset:
    frequency, places = _common_lines({named_pair(p): d["frequency"].values for p, d in entries.items()})
    rows, columns = (_ordered([pair[k] for pair in entries]) for k in (0, 1))
    shape = (frequency.size, len(rows), len(columns))
    values, coherence = np.full(shape, np.nan, dtype=complex), np.full(shape, np.nan)
    for (pair, dataset), place in zip(entries.items(), places, strict=True):
        r, e = rows.index(pair[0]), columns.index(pair[1])
        values[place, r, e] = dataset["compliance"].values[:, 0, 0]
        if "coherence" in dataset:
            coherence[place, r, e] = dataset["coherence"].values[:, 0, 0]
    low, high = measurement.frequency_range or (0.0, np.inf)
    keep = (frequency >= low) & (frequency <= high)
    if not keep.any():
        raise InputError(
            f"no line lies between {low:g} and {high:g} Hz; the files hold {frequency[0]:.6g} to {frequency[-1]:.6g} Hz"
        )
    three = ("frequency", "response", "excitation")
    extra: dict[str, tuple[tuple[str, ...], Real]] = {}
    if np.isfinite(coherence).any():
        extra["coherence"] = (three, coherence[keep])
        if measurement.averages is not None and measurement.averages > 1:
            std = response_std(values, coherence, measurement.averages)
            if np.isfinite(std).any():
                extra["compliance_std"] = (three, std[keep])
                degrees_of_freedom = np.where(np.isfinite(std), 2.0 * (measurement.averages - 1), np.nan)
                extra["degrees_of_freedom"] = (three, degrees_of_freedom[keep])
    return make_compliance(frequency[keep], values[keep], rows, columns, extra, {"method": "frf"})


def response_std(response: Complex, coherence: Real, averages: int) -> Real:
    """Return the root mean square of the complex error of responses from their coherence.

    ``std = |H| sqrt((1 - g2)/(g2 (n - 1)))``. A coherence that was rounded to 1 counts as half the smallest distance
    from 1 that occurs. NaN where the coherence is zero or unknown, and where it is 1 at every line.

    Parameters
    ----------
    response : ndarray of complex, shape (f, ...)
        H.
    coherence : ndarray, shape (f, ...)
        g2, from 0 to 1.
    averages : int
        n, independent averages; two at least.
    """
    if averages < 2:
        raise InputError(f"{averages} average has a coherence of 1 whatever the noise; two are the least")
    left = 1.0 - coherence
    there = left[np.isfinite(left) & (left > 0.0)]
    floor = 0.5 * float(there.min()) if there.size else np.nan
    left = np.where(left > 0.0, left, floor)
    with np.errstate(divide="ignore", invalid="ignore"):
        std = np.abs(response) * np.sqrt(left / (np.where(coherence > 0.0, coherence, np.nan) * (averages - 1)))
    return np.asarray(std)


def rising_phase(frequency: Real, response: Complex) -> bool:
    """Whether a response is that of ``exp(-j w t)``: its phase rises with frequency where it is large.

    The mean delay ``-sum |H|^2 dphi/dw / sum |H|^2`` is that of the energy of the impulse response (Parseval), which
    with ``exp(+j w t)`` comes after the impulse, whatever the sign of force or motion and whichever entry it is.
    """
    there = np.isfinite(response)
    step = np.diff(frequency[there])
    if step.size < 8:
        return False
    turn = (response[there][1:] * response[there][:-1].conj()).imag[step < 1.5 * np.median(step)]
    return bool(turn.sum() > RISING * np.abs(turn).sum() > 0.0)


def _turned(dataset: xr.Dataset) -> list[str]:
    """Say which entries are written with the other sign of time; `sign_warnings` says it of those of the tool tip."""
    frequency, out = dataset["frequency"].values, []
    for r in map(str, dataset["response"].values):
        for e in map(str, dataset["excitation"].values):
            if (r != e or r not in AXES) and rising_phase(
                frequency, dataset["compliance"].sel(response=r, excitation=e).values
            ):
                out.append(named_pair((r, e)))
    return [turned_text(out)] if out else []


def turned_text(entries: list[str]) -> str:
    """Return what to say of entries that are written with the other sign of time."""
    return (
        f"the phase of {', '.join(entries)} rises with frequency: written with exp(-j w t), while exp(+j w t) is used "
        "here; "
        "give the measurement conjugate = true (or take it out)"
    )


def _uncertainty_notes(measurement: Measurement, dataset: xr.Dataset) -> list[str]:
    """Say what is known of the error, and what it needs."""
    if "coherence" not in dataset:
        lost = "" if measurement.averages is None else f" (averages = {measurement.averages} needs one)"
        return [
            "averaged by another program: no uncertainty and no coherence are known; declare its coherence and "
            f"averages, the number of independent averages, where the file has it{lost}"
        ]
    if measurement.averages is None:
        return [
            "a coherence without the number of averages gives no uncertainty; give the measurement averages = 10, the "
            "number of hits or of blocks that do not overlap"
        ]
    if measurement.averages == 1:
        return ["one average has a coherence of 1 whatever the noise: no uncertainty is known; average several"]
    if "compliance_std" not in dataset:
        return ["the coherence is 1 at every line, as that of a single average: no uncertainty is known"]
    return []


def _ordered(names: list[str]) -> list[str]:
    """Return names once each, the axes first."""
    every = list(dict.fromkeys(names))
    return [a for a in AXES if a in every] + [name for name in every if name not in AXES]


def _common_lines(axes: dict[str, Real]) -> tuple[Real, list[NDArray[np.int64]]]:
    """Return the lines of all files together, and where those of each stand among them.

    Raises
    ------
    InputError
        When the lines of two files fall between each other.
    """
    every = np.sort(np.concatenate(list(axes.values())))
    spacing = min((float(np.median(np.diff(f))) for f in axes.values() if f.size > 1), default=1.0)
    first = np.concatenate([[True], np.diff(every) > SAME_LINE * spacing])
    line = np.cumsum(first) - 1
    frequency = np.bincount(line, every) / np.bincount(line)
    if len(axes) == 1:
        frequency = every
    longest = max(f.size for f in axes.values())
    span = (every[-1] - every[0]) / spacing + 1.5
    if frequency.size > longest and frequency.size > span:
        listed = ", ".join(f"{name}: {f.size} lines, {f[0]:.6g} to {f[-1]:.6g} Hz" for name, f in axes.items())
        raise InputError(f"its files have different frequency axes ({listed}); average them on one axis first")
    edges = 0.5 * (frequency[1:] + frequency[:-1])
    return frequency, [np.searchsorted(edges, f) for f in axes.values()]
