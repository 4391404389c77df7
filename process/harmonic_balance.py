"""A quasi-FRF by harmonic balance, without time simulation: one harmonic where it is right, many where it is not.

`balanced` answers for any `Network`; `SlidingAxis` is a machine with one friction point, `process.machine_balance`
makes the network of a whole machine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from process import units
from process.errors import InputError
from process.friction import FrictionLaw
from process.labels import make_compliance
from process.multi_harmonic import as_many_as_needed
from process.nonlinear_points import Balance, Complex, Compliance, FrictionPoint, Network, Real, checked
from process.single_harmonic import single_harmonic

METHODS = ("single harmonic", "many harmonics", "not converged", "not periodic")
TOLERANCE = 1e-3
"""Estimated relative error of a compliance above which more harmonics are used."""


class SlidingAxis(Network):
    """A linear machine with friction at one point, fed at a constant rate.

    Parameters
    ----------
    compliance : callable
        Frequency [Hz], shape (n,) -> compliance of the machine without friction [m/N], shape (n, 2, 2); index 0 is
        the tool, index 1 the friction point; response before excitation. That machine must be stable.
    law : FrictionLaw
        Friction without memory, with finite steepness at rest.
    feed : float
        Feed v0 [m/s]; zero is idle, negative the other direction.
    """

    def __init__(self, compliance: Compliance, law: FrictionLaw, feed: float) -> None:
        super().__init__(compliance, (FrictionPoint(law, feed),))

    @property
    def feed(self) -> float:
        """Feed v0 [m/s]."""
        (point,) = self.points
        assert isinstance(point, FrictionPoint)
        return point.feed


def two_mass_compliance(
    moving_mass: float, tip_mass: float, stiffness: float, damping: float, servo: Callable[[Real], Complex]
) -> Compliance:
    """Return the compliance of a flexible tip on a servo-held carriage, for `SlidingAxis`.

    ``[[m_t s^2 + q, -q], [-q, m_m s^2 + q + G]]^-1`` with ``q = c s + k``: tool first, then the carriage.

    Parameters
    ----------
    moving_mass, tip_mass : float
        Carriage m_m and tip m_t [kg].
    stiffness, damping : float
        Between the two: k [N/m] and c [N s/m].
    servo : callable
        Frequency [Hz], shape (n,) -> dynamic stiffness G of the servo at the carriage [N/m], shape (n,); of a
        `process.servo.Servo` it is ``lambda f: servo.feedback(2j * np.pi * f)``.
    """

    def compliance(frequency: Real) -> Complex:
        s = 2j * np.pi * frequency
        q = damping * s + stiffness
        tip, carriage = tip_mass * s**2 + q, moving_mass * s**2 + q + servo(frequency)
        out = np.empty((s.size, 2, 2), dtype=complex)
        out[:, 0, 0], out[:, 1, 1], out[:, 0, 1], out[:, 1, 0] = carriage, tip, q, q
        return np.asarray(out / (tip * carriage - q**2)[:, None, None])

    return compliance


def unstable_poles(axis: SlidingAxis, frequency: ArrayLike | None = None) -> int:
    """Count the unstable poles of the uniform motion by the turns of ``1 + f'(v0) Y(j w)`` about zero (Nyquist).

    The machine without friction must be stable. A falling friction curve (Stribeck) makes the count positive where
    the axis stick-slips without any outer force.

    Parameters
    ----------
    axis : SlidingAxis
        Machine, friction law and feed.
    frequency : array_like, optional
        Rising frequencies [Hz] that span the whole dynamics; by default 0.001 Hz to 100 kHz in 40 000 steps.

    Raises
    ------
    InputError
        When the frequencies are too coarse to follow the phase, or end where the loop still acts.
    """
    f = np.geomspace(1e-3, 1e5, 40_000) if frequency is None else np.asarray(frequency, dtype=float)
    (point,) = axis.points
    slope = float(np.real(point.coefficient(0.0)))
    loop = 1.0 + slope * axis.admittance(f, axis.matrix(f)[:, 1:, 1:])[:, 0, 0]
    turns = np.angle(loop[1:] / loop[:-1])
    if np.max(np.abs(turns)) > 0.5 * np.pi:
        where = f[int(np.argmax(np.abs(turns)))]
        raise InputError(f"the phase of the loop leaps near {where:.4g} Hz; give denser frequencies")
    # Close the curve at both ends, where the mobility tends to zero.
    half = float(np.sum(turns) + np.angle(loop[0]) - np.angle(loop[-1]))
    return round(-half / np.pi)


@dataclass(frozen=True)
class Answer:
    """What `balanced` finds at n frequencies.

    Attributes
    ----------
    balance : Balance
        Compliance (NaN where there is no stable periodic response), fundamental of the motion, coefficient, and
        estimated error of the compliance.
    method : ndarray of int, shape (n,)
        Index into `METHODS`.
    harmonics : ndarray of int, shape (n,)
        Highest harmonic.
    distortion : ndarray, shape (n,)
        Estimated error of one harmonic alone.
    """

    balance: Balance
    method: NDArray[np.int64]
    harmonics: NDArray[np.int64]
    distortion: Real


def balanced(
    network: Network, force: float, frequency: ArrayLike, excitation: int = 0, tolerance: float = TOLERANCE
) -> Answer:
    """Solve with one harmonic, and with as many as needed where its error exceeds the tolerance.

    The uniform motion must be stable: that is for the caller to see to.

    Parameters
    ----------
    network : Network
        Linear machine and its non-linear points.
    force : float
        Amplitude of the sine force on the tool [N].
    frequency : array_like, shape (n,)
        Frequencies [Hz], rising.
    excitation : int, optional
        Direction of the force among those of the tool.
    tolerance : float, optional
        Estimated relative error above which more harmonics are used.
    """
    f = checked(force, frequency)
    moved = network.reached(f, excitation)
    whole, network = network, network.part(moved)
    one = single_harmonic(network, force, f, excitation)
    n = one.frequency.size
    method, harmonics, distortion = np.zeros(n, dtype=np.int64), np.ones(n, dtype=np.int64), one.error
    doubt = np.flatnonzero((one.error > tolerance) | (one.solutions != 1))
    if doubt.size:
        many, harmonics[doubt], unstable = as_many_as_needed(network, force, one.part(doubt), tolerance, excitation)
        method[doubt] = np.select([~many.converged, unstable > 0], [2, 3], 1)
        one = one.replaced(doubt, many)
    one.compliance[method > 1] = np.nan
    return Answer(one.spread(whole, moved), method, harmonics, distortion)


def quasi_frf(
    axis: SlidingAxis, force: float, frequency: ArrayLike, *, direction: str = "x", tolerance: float = TOLERANCE
) -> xr.Dataset:
    """Return the compliance that a stepped sine of constant force would measure.

    Single-harmonic balance everywhere; many harmonics where its error exceeds the tolerance, and there
    `unstable_multipliers` tells whether the response is one that the axis stays on.

    Parameters
    ----------
    axis : SlidingAxis
        Machine, friction law and feed.
    force : float
        Amplitude of the sine force on the tool [N].
    frequency : array_like, shape (n,)
        Frequencies [Hz], rising.
    direction : str, optional
        Axis name of the tool's motion.
    tolerance : float, optional
        Estimated relative error above which more harmonics are used.

    Returns
    -------
    xarray.Dataset
        ``compliance(frequency, response, excitation)`` [m/N], ``velocity_amplitude`` [m/s] and ``equivalent_damping``
        [N s/m] at the friction point, ``error_estimate``, ``harmonics``, ``method`` (index into `METHODS`); attributes
        ``feed`` [mm/min], ``force_level`` [N] and ``status``. Where there is no stable periodic response the compliance
        is not a number; where the uniform motion is unstable (stick-slip) it is so throughout. ``status`` says it.
    """
    f = checked(force, frequency)
    steady = unstable_poles(axis) == 0
    answer = balanced(axis, force, f, 0, tolerance if steady else np.inf)
    x = answer.balance.compliance if steady else np.full_like(answer.balance.compliance, np.nan)
    extra: dict[str, Any] = {
        "velocity_amplitude": ("frequency", np.abs(answer.balance.fundamental[:, 0]), {"units": "m/s"}),
        "equivalent_damping": ("frequency", answer.balance.coefficient[:, 0].real, {"units": "N s/m"}),
        "error_estimate": ("frequency", answer.balance.error, {"units": "1"}),
        "harmonics": ("frequency", answer.harmonics, {"units": "1"}),
        "method": ("frequency", answer.method, {"units": "1"}),
    }
    attrs = {
        "feed": units.from_si(axis.feed, "mm/min", "speed"),
        "force_level": force,
        "status": status(steady, answer.method, answer.balance.solutions),
    }
    return make_compliance(f, x[:, :, None], [direction], [direction], extra, attrs)


def status(steady: bool, method: NDArray[np.int64], solutions: NDArray[np.int64]) -> str:
    """Say whether the uniform motion is stable, and where there is no stable periodic response or more than one."""
    if not steady:
        return (
            "self-excited: the uniform motion at this feed is unstable (stick-slip), so that no response to a force "
            "alone exists; feed faster, damp the loop, or simulate in time"
        )
    lost = int(np.sum(method > 1))
    if lost:
        return f"{lost} of {method.size} frequencies have no stable periodic response; simulate them in time"
    several = int(np.sum(solutions > 1))
    if several:
        return (
            f"{several} of {solutions.size} frequencies have several responses to this force; which of them a sweep "
            "finds depends on where it comes from, and the smallest is given: simulate them in time"
        )
    return "ok"
