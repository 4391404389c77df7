"""Which compliance belongs to which cut: measured under its controller, at its position, seen along its feed.

A compliance with the axes x and y of the machine becomes that of a cut fed along the direction theta, whose own x is
the feed (`docs/conventions.md`), by a rotation about the tool axis: ``Phi' = R Phi R^T`` with ``x' = x cos theta + y
sin theta``, ``y' = -x sin theta + y cos theta``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from process.labels import AXES, at_tool, full_matrix, make_compliance, not_measured
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.types import Real
from smfe.campaign import Campaign, CuttingTest, LobeRequest, Measurement
from smfe.campaign.machine import MACHINE
from stability.bands.error_model import carries_errors, entry_covariance
from stability.problem import partial_warning

SEVERAL = " + "
"""Between the names of measurements that make one source."""

MODEL = "model"
"""Kind of a source that was declared instead of measured."""

ALIKE = math.radians(5.0)
"""Angle below which two directions of a feed are one [rad]."""

FIXED = ("controller", "position")
"""Conditions that a limit is not had across: there is nothing between two controllers."""


@dataclass(frozen=True)
class Source:
    """What gives one limit: a measurement or model, or several measurements of an operating point.

    Parameters
    ----------
    names : tuple of str
        Measurements or models.
    label : str
        What it is called in every output.
    controller, position : str, optional
        Under and at which it was measured; None: not stated, or a model.
    """

    names: tuple[str, ...]
    label: str
    controller: str | None = None
    position: str | None = None

    def differs(self, test: CuttingTest) -> str:
        """Return in which condition a cutting test is stated to differ from this source; empty: in none."""
        for key in FIXED:
            own, other = getattr(self, key), getattr(test, key)
            if own is not None and other is not None and own != other:
                return f"{key} {own}, the cut {other}"
        return ""


def sources_of(campaign: Campaign, request: LobeRequest) -> list[Source]:
    """Return what each result of a request is had from.

    Each measurement or model for itself; an operating point from all measurements under one controller and at one
    position together, so that a request over two controllers has two results, each labelled.
    """
    at = {m.name: m for m in campaign.measurements}
    conditions = {name: tuple(stated(at[name], key) for key in FIXED) for name in request.measurements if name in at}
    own = _machine_sources(campaign, request)
    if request.method != "operating_point":
        others = [n for n in request.measurements if not own or n != MACHINE]
        return [*own, *(Source((n,), n, *conditions.get(n, ())) for n in others)]
    names = [n for n in request.measurements if not own or n != MACHINE]
    asked = (request.controller, request.position)
    conditions = {
        n: kind for n, kind in conditions.items() if all(a is None or a == k for a, k in zip(asked, kind, strict=True))
    }
    models = tuple(name for name in names if name not in at)
    if not conditions and not models:
        return own or [Source(tuple(names), SEVERAL.join(names), *asked)]
    kinds = list(dict.fromkeys(conditions.values())) or [(None, None)]
    out = own
    for kind in kinds:
        members = tuple(n for n in names if conditions.get(n) == kind) + models
        said = [f"{key} {value or 'not stated'}" for key, value in zip(FIXED, kind, strict=True) if _varies(key, kinds)]
        label = ", ".join([SEVERAL.join(n for n in names if n in members), *said])
        out.append(Source(members, label.replace("/", " per "), *kind))
    return out


def _machine_sources(campaign: Campaign, request: LobeRequest) -> list[Source]:
    """Return an operating point of the machine of ``[machine]`` for each of its controllers, where one is asked for."""
    machine = campaign.machine_model
    if MACHINE not in request.measurements or not isinstance(machine, Machine):
        return []
    named = [axis.servo for axis in machine.axes.values() if isinstance(axis.servo, Mapping)]
    every = list(dict.fromkeys(name for servos in named for name in servos))
    if request.controller is not None:
        every = [request.controller]
    if len(every) < 2:
        return [Source((MACHINE,), MACHINE, every[0] if every else None, request.position)]
    return [Source((MACHINE,), f"{MACHINE}, controller {c}".replace("/", " per "), c, request.position) for c in every]


def kind_of(campaign: Campaign, source: Source) -> str:
    """Return how a source was measured, several methods joined by " + "; "model" where it was not."""
    methods = {m.name: m.method for m in campaign.measurements}
    return SEVERAL.join(dict.fromkeys(methods.get(name, MODEL) for name in source.names))


def in_motion(campaign: Campaign, source: Source) -> bool:
    """Return whether an axis moved while a source was measured: it states a feed, or was measured by cutting."""
    if MACHINE in source.names and isinstance(campaign.machine_model, Machine):
        return True
    for m in campaign.measurements:
        if m.name in source.names:
            feeds = [m.feed, *(entry.feed for entry in m.records)]
            if m.method == "sweep" or any(any((feed or {}).values()) for feed in feeds):
                return True
    return False


def _varies(key: str, kinds: Sequence[tuple[str | None, ...]]) -> bool:
    return len({kind[FIXED.index(key)] for kind in kinds}) > 1


def stated(measurement: Measurement, key: str) -> str | None:
    """Return a condition of a measurement; of records that state several, all: it belongs to none alone."""
    own = {getattr(entry, key) for entry in measurement.records} or {getattr(measurement, key)}
    values = sorted(str(v) for v in own if v is not None)
    return " and ".join(values) or None


# --- feed ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Feed:
    """The feed of a measurement or cut.

    Parameters
    ----------
    speed : float
        [m/s].
    direction : float or None
        From +x towards +y [rad]; None: at rest, or all axes move alike.
    reverse : bool
        All axes move alike, in their negative sense.
    """

    speed: float
    direction: float | None = None
    reverse: bool = False


def feed_of(vector: Mapping[str, float] | None) -> Feed | None:
    """Return the feed of a table of axes [m/s]; None where it leaves the plane of x and y.

    One speed for all axes, as a campaign writes ``feed = "500 mm/min"``, has no direction of its own.
    """
    x, y, z = (float((vector or {}).get(axis, 0.0)) for axis in AXES)
    if x == y == z:
        return Feed(abs(x), None, x < 0.0)
    if z != 0.0:
        return None
    return Feed(math.hypot(x, y), math.atan2(y, x))


def apart(a: float, b: float) -> float:
    """Return the angle between two directions [rad], 0 to pi."""
    return abs(math.remainder(a - b, 2.0 * math.pi))


def direction_text(angle: float) -> str:
    """Return a direction in words: x, -y, or e.g. "30 deg from x towards y"."""
    for name, at in (("x", 0.0), ("y", 0.5 * math.pi), ("-x", math.pi), ("-y", -0.5 * math.pi)):
        if apart(angle, at) < 1e-6:
            return name
    return f"{math.degrees(angle):.4g} deg from x towards y"


# --- the frame of the cut --------------------------------------------------------------------------------------------


def rotation(angle: float) -> Real:
    """Return the matrix R whose rows are the axes of a cut fed along a direction [rad]; quarter turns are exact."""
    c, s = (0.0 if abs(v) < 1e-12 else v for v in (math.cos(angle), math.sin(angle)))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def turned(compliance: xr.Dataset, angle: float) -> tuple[xr.Dataset, list[str]]:
    """Return a compliance in the axes of a cut that is fed along a direction, and what is to be said about it.

    Parameters
    ----------
    compliance : xarray.Dataset
        ``compliance(frequency, response, excitation)`` [m/N] in the axes of the machine.
    angle : float
        Direction of the feed, from +x towards +y [rad].

    Returns
    -------
    compliance : xarray.Dataset
        With its errors, where they are known: a rotation is linear, ``C' = (R x R) C (R x R)^T`` over all entries.
    warnings : list of str
        Entries that the rotation mixes and that were not measured count as rigid.
    """
    here = at_tool(compliance)
    phi, r = full_matrix(here), rotation(angle)
    missing = not_measured(here)
    known = np.zeros((3, 3), dtype=bool)
    rows, columns = ([AXES.index(str(a)) for a in here[d].values] for d in ("response", "excitation"))
    known[np.ix_(rows, columns)] = ~missing.transpose("response", "excitation").values
    mixes = r != 0.0
    needed = mixes.astype(int) @ (~known).astype(int) @ mixes.T.astype(int)
    reached = (mixes.astype(int) @ known.astype(int) @ mixes.T.astype(int)) > 0
    out = np.einsum("ij,fjk,lk->fil", r, phi, r)
    out[:, ~reached] = np.nan
    rows, columns = (np.flatnonzero(reached.any(axis=k)).tolist() for k in (1, 0))
    response, excitation = ([AXES[i] for i in at] for at in (rows, columns))
    values = out[:, rows][:, :, columns]
    errors = _turned_errors(here, r, rows, columns) if carries_errors(here) else {}
    f = here["frequency"].values
    turned_compliance = make_compliance(f, values, response, excitation, errors, attrs=here.attrs)
    if not (needed[reached] > 0).any():
        return turned_compliance, []
    return turned_compliance, partial_warning(here["response"].values, here["excitation"].values, missing)


def _turned_errors(
    here: xr.Dataset, r: Real, rows: Sequence[int], columns: Sequence[int]
) -> dict[str, tuple[tuple[str, ...], Any]]:
    """Return standard deviations, covariances and widths of some entries of a compliance seen in other axes."""
    of, on = ([AXES.index(str(a)) for a in here[d].values] for d in ("response", "excitation"))
    frequencies = here.sizes["frequency"]
    whole = np.zeros((frequencies, 3, 3, 3, 3), dtype=complex)
    whole[np.ix_(range(frequencies), of, on, of, on)] = entry_covariance(here)
    whole = np.einsum("ia,jb,fabcd,kc,ld->fijkl", r, r, whole, r, r, optimize=True)
    whole = whole[np.ix_(range(frequencies), rows, columns, rows, columns)]
    three = ("frequency", "response", "excitation")
    out: dict[str, tuple[tuple[str, ...], Any]] = {
        "entry_covariance": ((*three, "other_response", "other_excitation"), whole),
        "compliance_std": (three, np.sqrt(np.maximum(np.einsum("fijij->fij", whole).real, 0.0))),
    }
    if "half_width" in here:
        width = np.zeros((frequencies, 3))
        width[:, of] = here["half_width"].transpose("frequency", "response").values
        out["half_width"] = (three[:2], (width @ (r.T**2))[:, rows])
    return out


def turned_modes(modal: ModalModel, angle: float) -> ModalModel:
    """Return modes in the axes of a cut that is fed along a direction [rad]."""
    return replace(modal, direction=modal.direction @ rotation(angle).T)
