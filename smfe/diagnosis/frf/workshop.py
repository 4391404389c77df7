"""Ordinary imperfections of measured compliances: what all conditions share is fitted, what one has alone is an error.

Sensors are calibrated within a per cent and mounted within a degree, a channel shows a little of the others, force and
motion are not recorded at quite the same time, and whoever hits always leans the same way: nuisances with a prior, the
same in every condition (`sensor_nuisances`, `measured`). The hits of one set-up lean and miss their point as well, and
the clock of a recording is its own: errors that all lines of one condition share (`errors_of_condition`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import permutations
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

from process.types import Complex, Real
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.frf.causes import AXES, PLANES
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.inference.problem import Parameter, Values

_ACCELEROMETER = (
    *(f"{what}_{a}" for what in ("gain", "aside", "turned", "reversed") for a in AXES),
    *(f"{what}_{a}{b}" for what in ("talk", "exchanged", "quarter") for a, b in PLANES),
)
_LEANS = tuple(f"lean_{a}{b}" for a, b in permutations(AXES, 2))
_FORCE = ("gain_force", "reversed_force", *(f"reach_{a}" for a in AXES), *_LEANS)
SENSORS = (*_ACCELEROMETER, *_FORCE, "skew")
"""Parameters of the sensors and of the hits."""

_DEGREES = 180.0 / math.pi
_STEP = 1e-6  # half of the step of differences of small smooth matrices


def sensor_nuisances(tolerances: Tolerances) -> tuple[Parameter, ...]:
    """Return what sensors and hits have in common in all conditions of three axes, with a workshop's priors."""
    t, found = tolerances, []
    gains = {"force": "gain of the force sensor", **{a: f"gain of the accelerometer along {a}" for a in AXES}}
    for a, said in gains.items():
        found.append(gain_nuisance(f"gain_{a}", said, t.sensor_gain))
    # An accelerometer beside the point that is hit moves otherwise by what the machine turns there, for each channel
    # about the two axes across it: how that goes with what the point does along x, y and z nobody measured, so that
    # each channel may show so much of each of them.
    aside = math.sqrt(2.0) * t.sensor_position / RULES.arm
    for a in AXES:
        said = f"the accelerometer beside its place, as it shows along {a}"
        found.append(_small(f"aside_{a}", "%", aside, 0.5, "", said))
    # Of the cross-talk of each pair of channels one half is a rotation. Single sensors are turned one by one.
    across = math.hypot(t.cross_talk, aside) / math.sqrt(2.0)
    turned, talk = math.hypot(t.mounting_angle, across), math.hypot(t.mounting_angle / math.sqrt(2.0), across)
    for a in AXES:
        found.append(_small(f"turned_{a}", "deg", turned, 1.0, "sensor_axis", f"the accelerometer turned about {a}"))
    for a, b in PLANES:
        said = f"what the channels {a} and {b} of the accelerometer show of each other"
        found.append(_small(f"talk_{a}{b}", "%", talk, 0.5, "sensor_axis", said))
    for name in _LEANS:
        said = f"hits along {name[-2]} that lean towards {name[-1]}"
        found.append(_small(name, "deg", t.setup_direction, 1.0, "sensor_axis", said))
    for a in AXES:
        said = f"hits along {a} beside their point"
        found.append(_small(f"reach_{a}", "%", t.hit_position / RULES.arm, 0.5, "", said))
    return tuple(p for p in (*found, skew_nuisance(t.clock)) if p is not None)


def gain_nuisance(name: str, said: str, prior: float) -> Parameter | None:
    """Relative error of a gain; None where it is exact."""
    if prior <= 0.0:
        return None
    return Parameter(name, "%", 0.0, 0.01, -0.9, 12.0, prior, 100.0, "sensor_gain", said=said)


def skew_nuisance(prior: float) -> Parameter | None:
    """Time that the motion is recorded late; None where the clocks agree."""
    said = "time between force and motion"
    return None if prior <= 0.0 else Parameter("skew", "us", 0.0, 1e-5, -2e-3, 2e-3, prior, 1e6, "time_skew", said=said)


def _small(name: str, unit: str, prior: float, most: float, given: str, said: str) -> Parameter | None:
    if prior <= 0.0:
        return None
    shown = _DEGREES if unit == "deg" else 100.0
    return Parameter(name, unit, 0.0, 0.01, -most, most, prior, shown, given, said=said)


def measured(phi: Complex, frequency: Real, values: Values, accelerometer: bool = True) -> Complex:
    """Return a compliance at the tool [m/N] as the sensors measure it, shape (f, 3, 3).

    Values are ``gain_force``, ``gain_x`` ..., ``aside_x`` ..., ``reversed_x`` ..., ``exchanged_xy`` ...,
    ``quarter_xy`` (1: x shows y and y shows -x; -1: the other way round) ..., ``turned_x`` ... [rad], ``talk_xy`` ...,
    ``lean_xy`` (of hits along x towards y) ..., ``reach_x`` ..., ``skew`` [s]. A laser in place of the accelerometer
    has none of its faults.
    """
    found = _matrices(tuple([values.get(n, 0.0) for n in SENSORS]))
    out = phi if found.force is None else phi @ found.force
    if accelerometer and found.mounting is not None:
        out = found.mounting @ out
    skew = values.get("skew", 0.0)
    return out * np.exp(-2j * np.pi * frequency * skew)[:, None, None] if skew else out


class SensorSlopes(NamedTuple):
    """How what sensors and hits do changes with some parameters: matrices before and behind the machine, a delay."""

    values: Values
    force: Real  # (p, 3, 3)
    mounting: Real  # (p, 3, 3)
    late: NDArray[np.bool_]  # which is the delay, (p,)

    def of(self, phi: Complex, frequency: Real, accelerometer: bool) -> Complex:
        """Return the changes of what is measured of a compliance (f, 3, 3), shape (p, f, 3, 3)."""
        out = np.zeros((len(self.late), *phi.shape), dtype=complex)
        found = _matrices(tuple([self.values.get(n, 0.0) for n in SENSORS]))
        before = np.eye(3) if found.force is None else found.force
        behind = np.eye(3) if found.mounting is None or not accelerometer else found.mounting
        hit = np.any(self.force, axis=(1, 2))
        out[hit] = behind @ phi @ self.force[hit][:, None]
        if accelerometer:
            seen = np.any(self.mounting, axis=(1, 2))
            out[seen] += self.mounting[seen][:, None] @ (phi @ before)
        out[self.late] += -2j * np.pi * frequency[:, None, None] * (behind @ phi @ before)
        skew = self.values.get("skew", 0.0)
        return np.asarray(out * np.exp(-2j * np.pi * frequency * skew)[:, None, None] if skew else out)


def sensor_slopes(values: Values, names: Sequence[str]) -> SensorSlopes:
    """Return how sensors and hits change with some parameters; what has no slope (a sign) does not."""
    before, behind = np.zeros((2, len(names), 3, 3))
    for n, name in enumerate(names):
        for own, make, out in ((_FORCE, force, before), (_ACCELEROMETER, mounting, behind)):
            if name in own:
                less, more = (make({**values, name: values.get(name, 0.0) + side * _STEP}) for side in (-1.0, 1.0))
                out[n] = (more - less) / (2.0 * _STEP)
    return SensorSlopes(values, before, behind, np.array([name == "skew" for name in names], dtype=bool))


class _Matrices(NamedTuple):
    """Before and behind the machine; None where they change nothing."""

    force: Real | None
    mounting: Real | None


@lru_cache(maxsize=64)
def _matrices(sensors: tuple[float, ...]) -> _Matrices:
    values = dict(zip(SENSORS, sensors, strict=True))
    before, behind = (any(values[n] for n in names) for names in (_FORCE, _ACCELEROMETER))
    return _Matrices(force(values) if before else None, mounting(values) if behind else None)


def force(values: Values) -> Real:
    """Matrix from the force that the sensor shows to the force along x, y, z: leaning, beside its point, scaled."""
    out = np.diag([1.0 + values.get(f"reach_{a}", 0.0) for a in AXES])
    for name in _LEANS:
        out[AXES.index(name[-1]), AXES.index(name[-2])] = values.get(name, 0.0)
    sign = -1.0 if values.get("reversed_force", 0.0) > 0.5 else 1.0
    return np.asarray(sign * out / (1.0 + values.get("gain_force", 0.0)))


def mounting(values: Values) -> Real:
    """Matrix from the motion to the accelerometer's channels x, y, z: aside, turned, exchanged, talking, scaled."""
    out = np.eye(3)
    for k, a in enumerate(AXES):
        angle = values.get(f"turned_{a}", 0.0)
        if angle:
            i, j = (k + 1) % 3, (k + 2) % 3
            turn = np.eye(3)
            turn[i, i] = turn[j, j] = math.cos(angle)
            turn[i, j], turn[j, i] = -math.sin(angle), math.sin(angle)
            out = out @ turn
    out = out * [1.0 + values.get(f"aside_{a}", 0.0) for a in AXES]
    talk = np.eye(3)
    for a, b in PLANES:
        rows = [AXES.index(a), AXES.index(b)]
        talk[rows, rows[::-1]] = values.get(f"talk_{a}{b}", 0.0)
        if values.get(f"exchanged_{a}{b}", 0.0) > 0.5:
            out[rows] = out[rows[::-1]]
        if abs(quarter := values.get(f"quarter_{a}{b}", 0.0)) > 0.5:
            out[rows] = math.copysign(1.0, quarter) * np.array([[1.0], [-1.0]]) * out[rows[::-1]]
    gains: Real = 1.0 + np.array([values.get(f"gain_{a}", 0.0) for a in AXES])
    gains *= [-1.0 if values.get(f"reversed_{a}", 0.0) > 0.5 else 1.0 for a in AXES]
    return np.asarray((talk @ out) * gains[:, None])


# --- Errors of one condition.


def errors_of_condition(excited: Excited, full: Complex, tolerances: Tolerances) -> Complex:
    """Return the errors that all lines of a condition share, shape (m, f, entries), as of `Excited.shared`.

    `full` is the compliance along x, y, z, (f, 3, 3): as measured, and where it was not, as it is expected [m/N]. Hits
    that lean towards another direction show what the machine does under a force there: of a set-up all alike, besides
    what remains of the mean of single ones. Hits beside their point turn the machine as well; how far it turns nobody
    measured, so that a column may be off by the distance over the arm `RULES.arm`, slowly over frequency. The clock of
    a recording turns the phase in proportion to frequency; hits along each axis are recordings of their own.
    """
    rows, columns = ([AXES.index(e[k]) for e in excited.entries] for k in (0, 1))
    lean = math.hypot(tolerances.setup_direction, tolerances.hit_direction / math.sqrt(excited.repeats))
    seen = full[:, rows, columns]
    found = []
    for e in dict.fromkeys(columns):
        here = np.array(columns) == e
        found.append(late(excited.frequency, seen * here, tolerances.clock))
        found += [lean * full[:, rows, a] * here for a in range(3) if a != e]
        found += list(beside_the_point(excited.frequency, seen * here, tolerances.hit_position))
    used = [x for x in found if np.any(x)]
    return np.array(used).reshape(-1, *seen.shape)


def without_own_noise(seen: Complex, std: Real, expected: Complex) -> Complex:
    """Return measured values, (f, ...), without what of them may be the noise of their own line.

    An error that all lines share goes with the true compliance. Taken in proportion to the measured one it goes with
    its noise as well, which costs less then if the error is there and the compliance larger than the model's: each of
    n lines pulls the model down by the square of the error, of 1 % and 1000 lines by a tenth (D'Agostini, Nucl.
    Instrum. Methods A 346, 1994). A line is therefore taken as what is expected there and what its neighbours are
    beside it; what it differs from that counts by how far it exceeds its noise, ``1 - (RULES.own_noise / d)^2`` of
    ``d`` standard deviations `std`: lines further apart than a resonance is wide say nothing of each other.
    """
    away = np.pad(seen - expected, [(1, 1), *[(0, 0)] * (seen.ndim - 1)], mode="reflect")
    smooth = expected + 0.5 * (away[:-2] + away[2:])
    beyond = np.abs(seen - smooth) ** 2
    real = 1.0 - (RULES.own_noise * std) ** 2 / np.maximum(beyond, 1e-300)
    return np.asarray(smooth + np.maximum(real, 0.0) * (seen - smooth))


def errors_along_axis(excited: Excited, seen: Complex, tolerances: Tolerances) -> Complex:
    """Return the errors of a condition that knows one axis alone, (m, f, entries): missed hits and the clock.

    What a hit that leans by an angle does along the axis is less by its square only.
    """
    clock = late(excited.frequency, seen, tolerances.clock)[None]
    return np.concatenate([clock, beside_the_point(excited.frequency, seen, tolerances.hit_position)])


def late(frequency: Real, compliance: Complex, clock: float) -> Complex:
    """Change of a compliance (f, entries) by a clock that is late by so much."""
    return np.asarray(-2j * np.pi * frequency[:, None] * clock * compliance)


def beside_the_point(frequency: Real, compliance: Complex, distance: float) -> Complex:
    """Changes of a column of the compliance (f, entries) by hits beside their point, (m, f, entries)."""
    u = np.log(frequency / frequency[0]) / np.log(frequency[-1] / frequency[0])
    order = np.arange(RULES.smooth_shapes)
    shapes = np.cos(np.pi * order[:, None] * u) * np.where(order == 0, 1.0, np.sqrt(2.0))[:, None]
    share = distance / RULES.arm / math.sqrt(RULES.smooth_shapes)
    return np.asarray(share * shapes[:, :, None] * compliance)


def runs(chosen: NDArray[np.bool_]) -> list[slice]:
    """Return the runs of lines next to each other that are chosen."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


# --- What single hits differ in.


def apart(each: Complex, frequency: Real, full: Complex, axis: int) -> tuple[Complex, Complex]:
    """Part what hits along one axis differ in into what all lines share and noise, both of shape (r, f, k).

    `each` is the compliance from r >= 2 hits with k responses, `full` that of the set-up along x, y, z, (f, k, 3). What
    hits do that lean, that miss their point, that are late is fitted to the deviation of each from their mean. What it
    explains is returned as errors of the mean, as of `Excited.shared`; the rest scatters like the noise of a hit.
    """
    count, own = each.shape[0], full[:, :, axis]
    shapes = [full[:, :, a] for a in range(3) if a != axis]
    shapes += [*beside_the_point(frequency, own, RULES.arm), late(frequency, own, 1.0)]
    away = each - each.mean(axis=0)
    size = np.sqrt(np.mean(np.abs(away) ** 2, axis=(0, 1)))  # a quiet response counts as much as a noisy one
    size[size == 0.0] = 1.0
    basis, left = (np.stack([_flat(x / size) for x in many], axis=1) for many in (shapes, away))
    basis, _ = np.linalg.qr(basis[:, np.any(basis != 0.0, axis=0)])
    explained = _unflat((basis @ (basis.T @ left)).T, away.shape) * size
    lost = basis.shape[1] / basis.shape[0]
    return explained * math.sqrt(RULES.shared / (max(count - 1, 1) * count)), (away - explained) / math.sqrt(1.0 - lost)


def with_single_hits(
    excited: Excited, compliance: xr.Dataset, hits: Mapping[str, xr.Dataset], expected: Complex
) -> Excited:
    """Return how a compliance was excited, with what its single hits differ in parted into shared errors and noise.

    `compliance` is the whole mean of `hits` (`Identification.hits`), `expected` about what it is, along x, y, z, (f, 3,
    3) [m/N]; axes whose hits do not show all the responses, or are too few, stay as they are.
    """
    axes = compliance["excitation"].values.tolist()
    found, std = [], excited.std.copy()
    for axis in dict.fromkeys(e for _, e in excited.entries):
        rows = [n for n, (_, e) in enumerate(excited.entries) if e == axis]
        responses = [excited.entries[n][0] for n in rows]
        own = hits.get(axis)
        if own is None or not set(responses) <= set(own["response"].values.tolist()):
            continue
        each = own["compliance"].sel(response=responses).sel(frequency=excited.frequency, method="nearest").values
        each = each[np.isfinite(each).all(axis=(1, 2))]
        if len(each) < RULES.fewest_hits:
            continue
        mean = compliance.sel(response=responses, frequency=excited.frequency, method=None)
        like = expected[:, [AXES.index(r) for r in responses]]
        full, error = like.copy(), np.zeros(like.shape)
        for a in set(AXES) & set(axes):
            full[:, :, AXES.index(a)] = mean["compliance"].sel(excitation=a).values
            error[:, :, AXES.index(a)] = mean["compliance_std"].sel(excitation=a).values
        full = np.where(np.isfinite(full), full, like)
        full = without_own_noise(full, np.where(np.isfinite(error), error, np.inf), like)
        shared, noise = apart(each, excited.frequency, full, AXES.index(axis))
        before, after = (_smooth(np.sum(np.abs(x) ** 2, axis=0)) for x in (each - each.mean(axis=0), noise))
        std[:, rows] *= np.sqrt(np.minimum(after / np.maximum(before, 1e-300), 1.0))
        whole = np.zeros((len(shared), *std.shape), dtype=complex)
        whole[:, :, rows] = shared
        found.append(whole)
    if not found:
        return excited
    known = [] if excited.shared is None else [excited.shared]
    floor = np.stack([RULES.floor * np.abs(_entry(compliance, excited, e)) for e in excited.entries], axis=1)
    return replace(excited, std=np.maximum(std, floor), shared=np.concatenate([*known, *found]))


def _entry(compliance: xr.Dataset, excited: Excited, entry: tuple[str, str]) -> Complex:
    one = compliance["compliance"].sel(response=entry[0], excitation=entry[1])
    return np.asarray(one.sel(frequency=excited.frequency).values)


def _smooth(squares: Real) -> Real:
    return np.asarray(convolve1d(squares, np.ones(RULES.smooth_lines), axis=0, mode="nearest"))


def _flat(values: Complex) -> Real:
    return np.concatenate([values.real.ravel(), values.imag.ravel()])


def _unflat(rows: Real, shape: tuple[int, ...]) -> Complex:
    half = rows.shape[1] // 2
    return np.asarray(rows[:, :half] + 1j * rows[:, half:]).reshape(shape)
