"""Compliance of a machine at a level of force by harmonic balance: one harmonic where it is right, else many.

It is what stepped sines would measure, without time simulation. `network` makes a `Network` of a machine, `balanced`
solves it for one direction, `quasi_compliance` labels the solution, `compliance_map` does so for many conditions.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from process import units
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import FrictionLaw, Viscous
from process.friction.linearised import FrictionImpedance
from process.harmonic_balance.many_harmonics import as_many_as_needed
from process.harmonic_balance.network import RULES, Balance, FrictionElement, JointElement, Network, checked
from process.harmonic_balance.one_harmonic import single_harmonic
from process.labels import AXES, axis_index, make_compliance
from process.machine.machine import FEW_MICROSLIP, FeedAxis, Machine
from process.machine.operating_point import OperatingPoint, SlideImpedance
from process.machine.structure import Structure
from process.types import Complex, Real

METHODS = ("single harmonic", "many harmonics", "not converged", "not periodic")


@dataclass(frozen=True)
class Solution:
    """Solution by `balanced` at n frequencies.

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
    network: Network, force: float, frequency: ArrayLike, excitation: int = 0, tolerance: float = RULES.tolerance
) -> Solution:
    """Solve with one harmonic, and with as many as needed where its error exceeds the tolerance.

    The uniform motion must be stable: that is for the caller to see to.

    Parameters
    ----------
    network : Network
        Linear machine and its nonlinear elements.
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
    left = np.flatnonzero((one.error > tolerance) | (one.solutions != 1))
    if left.size:
        many, harmonics[left], unstable = as_many_as_needed(network, force, one.part(left), tolerance, excitation)
        method[left] = np.select([~many.converged, unstable > 0], [2, 3], 1)
        one = one.replaced(left, many)
    one.compliance[method > 1] = np.nan
    return Solution(one.spread(whole, moved), method, harmonics, distortion)


def status(steady: bool, method: NDArray[np.int64], solutions: NDArray[np.int64]) -> str:
    """Return a sentence: uniform motion unstable, responses missing or ambiguous; "ok" where neither."""
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


def network(
    machine: Machine,
    feed: float | Mapping[str, float] = 0.0,
    controller: str | None = None,
    position: float | None = None,
) -> Network:
    """Return the linear machine between tool (x, y, z), guideways with friction (in the order of the axes) and joints.

    Parameters
    ----------
    machine : Machine
        Structure, feed axes and joints.
    feed : float or mapping, optional
        Feed of all axes, or axis name -> feed [m/s].
    controller : str, optional
        Name of the controllers.
    position : float, optional
        Position [m] of the axis that a posture depends on.

    Raises
    ------
    InputError
        For friction with memory or with a jump at rest, and for a slide without servo that is fed.
    """
    structure = machine.structure_at(position)
    joints = [JointElement(m.joint, _reference(m.joint)) for m in machine.joints]
    rows = [m.participation for m in machine.joints]
    stiffness = structure.stiffness + sum(
        (p.reference * np.outer(r, r) for p, r in zip(joints, rows, strict=True)), np.zeros_like(structure.stiffness)
    )
    linear = Structure(structure.mass, structure.damping, stiffness, structure.tool, structure.slides)
    slides, guideways = [], []
    feeds, servos = machine.feeds(feed), machine.servos(controller)
    for (name, axis), servo in zip(machine.axes.items(), servos, strict=True):
        point = _guideway(name, axis, servo, feeds[name])
        if point is not None:
            guideways.append((structure.slides[name], point))
        slides.append(SlideImpedance(name, servo, FrictionImpedance(_damping(axis, point))))
    operating = OperatingPoint(linear, tuple(slides))
    elements = [*(p for _, p in guideways), *joints]
    shown = np.vstack([structure.tool, *(r for r, _ in guideways), *rows])

    def compliance(frequency: Real) -> Complex:
        return operating.receptance(frequency, shown)

    static = _static(linear, shown[3:], np.array([p.uses_displacement for p in elements], dtype=bool))
    unstable = operating.unstable_poles() if elements else 0
    return Network(compliance, tuple(elements), 3, static, unstable)


def _reference(joint: Any) -> float:
    """Stiffness of a joint that belongs to the linear machine: that for small motion, or of the stop beyond a play."""
    small = float(joint.equivalent_stiffness(FEW_MICROSLIP))
    return small if small > 0.0 else float(joint.stiffness)


def _guideway(name: str, axis: FeedAxis, servo: Servo | None, feed: float) -> FrictionElement | None:
    """Friction of an axis, unless it is viscous."""
    law = axis.friction
    if isinstance(law, Viscous):
        return None
    if not isinstance(law, FrictionLaw):
        raise InputError(
            f"the friction of axis {name} is {type(law).__name__}, which has memory; harmonic balance takes Andersson, "
            "Coulomb, CoulombViscous and Viscous friction: give one of them, leave force_level out (small vibration), "
            "or simulate in time"
        )
    if servo is None and feed != 0.0:
        raise InputError(f"axis {name} is fed but has no servo that would hold its speed; give it one, or feed 0")
    return FrictionElement(
        law, feed, 0.0 if servo is not None else float(law.force(RULES.free_speed)) / RULES.free_speed
    )


def _damping(axis: FeedAxis, point: FrictionElement | None) -> float:
    if point is not None:
        return point.reference
    return float(axis.friction.sigma) if isinstance(axis.friction, Viscous) else 0.0


def _static(structure: Structure, rows: Real, displaced: NDArray[np.bool_]) -> Real | None:
    """Compliance between the joints at 0 Hz, slides held; None where it is not finite: then no mean moves."""
    if not displaced.any():
        return None
    held = tuple(SlideImpedance(name, Servo(1.0, 1.0, 1.0), FrictionImpedance(0.0)) for name in structure.slides)
    g = OperatingPoint(structure, held).receptance([0.0], rows)[0].real
    return np.where(np.outer(displaced, displaced), g, 0.0) if np.all(np.isfinite(g)) else None


def quasi_compliance(
    machine: Machine,
    frequency: ArrayLike,
    force_level: float | None,
    feed: float | Mapping[str, float] = 0.0,
    controller: str | None = None,
    position: float | None = None,
    excitation: Sequence[str] = AXES,
    response: Sequence[str] = AXES,
    tolerance: float = RULES.tolerance,
) -> xr.Dataset:
    """Return the compliance that stepped sines of constant force would measure, one direction after the other.

    Parameters
    ----------
    machine : Machine
        Structure, feed axes and joints.
    frequency : array_like, shape (n,)
        Frequencies [Hz], rising.
    force_level : float or None
        Amplitude of the sine force [N]; None or zero: small vibration, `Machine.at`.
    feed : float or mapping, optional
        Feed of all axes, or axis name -> feed [m/s].
    controller : str, optional
        Name of the controllers.
    position : float, optional
        Position [m] of the axis that a posture depends on.
    excitation, response : sequence of str, optional
        Axis names.
    tolerance : float, optional
        Estimated relative error above which more harmonics are used.

    Returns
    -------
    xarray.Dataset
        ``compliance(frequency, response, excitation)`` [m/N]; at each guideway with friction (`slide`)
        ``equivalent_damping`` [N s/m] and ``velocity_amplitude`` [m/s]; at each joint (`joint`) ``joint_stiffness``
        (K + j H) [N/m] and ``joint_amplitude`` [m]; ``method`` (index into `quasi_frf.METHODS`),
        ``harmonics`` and ``error_estimate``. Coordinates ``feed`` [mm/min] (of each axis where they differ),
        ``force_level`` [N], and where given ``controller`` and ``position`` [m]. Attribute ``status``: "ok", or what is
        missing. Where there is no stable periodic response the compliance is not a number; where the uniform motion is
        self-excited it is so throughout.
    """
    f = np.atleast_1d(np.asarray(frequency, dtype=float))
    level = 0.0 if force_level is None else float(force_level)
    steady = machine.at(feed, controller, position).unstable_poles() == 0
    columns, rows = axis_index(list(excitation)), axis_index(list(response))
    extra: dict[str, Any] = {}
    sentence = status(steady, *np.zeros((2, 0), dtype=np.int64))
    shape = (f.size, len(rows), len(columns))
    if not steady:
        values = np.full(shape, np.nan + 0j)
    elif level == 0.0:
        values = machine.at(feed, controller, position).matrix(f)[:, rows][:, :, columns]
    else:
        f = checked(level, f)
        linear = network(machine, feed, controller, position)
        solutions = [balanced(linear, level, f, e, tolerance) for e in columns]
        values = np.stack([a.balance.compliance[:, rows] for a in solutions], axis=-1)
        extra = _element_variables(machine, linear, solutions)
        counts = np.stack([a.balance.solutions for a in solutions])
        sentence = status(steady, np.stack([a.method for a in solutions]), counts)
    out = make_compliance(f, values, response, excitation, extra, {"status": sentence})
    return _conditions(out, machine, feed, level, controller, position)


def _element_variables(machine: Machine, linear: Network, solutions: list[Solution]) -> dict[str, Any]:
    """Variables of the elements, of dimensions (frequency, slide or joint, excitation)."""
    coefficient = np.stack([a.balance.coefficient for a in solutions], axis=-1)
    amplitude = np.abs(np.stack([a.balance.fundamental for a in solutions], axis=-1))
    axes = ("frequency", "excitation")

    def each(values: list[Any]) -> NDArray[Any]:
        return np.stack(values, axis=-1)

    extra: dict[str, Any] = {
        "method": (axes, each([a.method for a in solutions]), {"units": "1"}),
        "harmonics": (axes, each([a.harmonics for a in solutions]), {"units": "1"}),
        "error_estimate": (axes, each([a.balance.error for a in solutions]), {"units": "1"}),
    }
    joint = linear.displaced
    names = [a for a, axis in machine.axes.items() if not isinstance(axis.friction, Viscous)]
    if names:
        dims = ("frequency", "slide", "excitation")
        extra["slide"] = ("slide", names)
        extra["equivalent_damping"] = (dims, coefficient[:, ~joint].real, {"units": "N s/m"})
        extra["velocity_amplitude"] = (dims, amplitude[:, ~joint], {"units": "m/s"})
    if machine.joints:
        dims = ("frequency", "joint", "excitation")
        extra["joint_stiffness"] = (dims, coefficient[:, joint], {"units": "N/m"})
        extra["joint_amplitude"] = (dims, amplitude[:, joint], {"units": "m"})
    return extra


def _conditions(
    out: xr.Dataset,
    machine: Machine,
    feed: float | Mapping[str, float],
    level: float,
    controller: str | None,
    position: float | None,
) -> xr.Dataset:
    """Add the operating condition as scalar coordinates."""
    feeds = machine.feeds(feed)
    same = not isinstance(feed, Mapping)
    shop = {"feed": feed} if same else {f"feed_{axis}": v for axis, v in feeds.items()}
    coords: dict[str, Any] = {
        name: ((), round(units.from_si(float(v), "mm/min", "speed"), 9), {"units": "mm/min"})  # type: ignore[arg-type]
        for name, v in shop.items()
    }
    coords["force_level"] = ((), level, {"units": "N"})
    if controller is not None:
        coords["controller"] = ((), controller, {"units": "1"})
    if position is not None:
        coords["position"] = ((), position, {"units": "m"})
    return out.assign_coords(coords)


def compliance_map(
    machine: Machine,
    frequency: ArrayLike,
    feeds: Sequence[float] = (0.0,),
    controllers: Sequence[str | None] = (None,),
    positions: Sequence[float | None] = (None,),
    force_levels: Sequence[float | None] = (None,),
    excitation: Sequence[str] = AXES,
    response: Sequence[str] = AXES,
) -> xr.Dataset:
    """Return the compliance of a machine over feeds, controllers, positions and levels of force.

    Parameters
    ----------
    machine : Machine
        Structure, feed axes and joints.
    frequency : array_like, shape (n,)
        Frequencies [Hz], rising.
    feeds : sequence of float, optional
        Feeds of all axes [m/s]; the label is in mm/min.
    controllers : sequence of str, optional
        Names of controllers.
    positions : sequence of float, optional
        Positions [m] of the axis that a posture depends on.
    force_levels : sequence of float or None, optional
        Amplitudes of the sine force [N]; None or zero: small vibration, shown as 0.
    excitation, response : sequence of str, optional
        Axis names.

    Returns
    -------
    xarray.Dataset
        ``compliance`` [m/N] and ``status`` over those of ``feed`` [mm/min], ``controller``, ``position`` [m] and
        ``force_level`` [N] that were given more than one value; the others are scalar coordinates. Not a number where
        the machine is not at rest without excitation; ``status`` states it.
    """
    lists: dict[str, Sequence[Any]] = {
        "feed": feeds, "controller": controllers, "position": positions, "force_level": force_levels,
    }  # fmt: skip
    empty = [name for name, values in lists.items() if len(values) == 0]
    if empty:
        raise InputError(f"no {empty[0].replace('_', ' ')} is given; give at least one, or leave the argument out")
    dims = [name for name, values in lists.items() if len(values) > 1]
    sizes = tuple(len(lists[name]) for name in dims)
    runs = [
        quasi_compliance(machine, frequency, level, feed, controller, position, excitation, response)
        for feed, controller, position, level in itertools.product(feeds, controllers, positions, force_levels)
    ]
    one = runs[0]
    values = np.stack([r["compliance"].values for r in runs]).reshape(*sizes, *one["compliance"].shape)
    coords = {name: one[name] for name in one.coords if name not in (*dims, "slide")}
    for name in dims:
        labels = dict.fromkeys(r[name].item() for r in runs)
        if len(labels) != len(lists[name]):
            raise InputError(f"a {name.replace('_', ' ')} is given twice; give each once")
        coords[name] = xr.DataArray(list(labels), dims=name, attrs=one[name].attrs)
    return xr.Dataset(
        {
            "compliance": ((*dims, *one["compliance"].dims), values, {"units": "m/N"}),
            "status": (tuple(dims), np.array([r.attrs["status"] for r in runs]).reshape(sizes), {"units": "1"}),
        },
        coords=coords,
    )
