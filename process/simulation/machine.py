"""Time simulation of a whole machine: hammer hits, shakers and cuts, idle or in motion.

Deviations from the ramp of each axis are integrated: the steady friction is held by the integrator, so there is no
start-up transient and no cancellation. The linear part moves exactly (matrix exponential); friction and joints are
inputs that are solved for, quadratic in time, and the step is halved where that does not follow them. Labelled in and
out; the loop is in `process.simulation._machine_kernels`.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from scipy import linalg

from process.drive.axis import Drive
from process.errors import InputError
from process.friction.laws import FrictionLaw, MemoryLaw, Viscous
from process.friction.linearised import FrictionImpedance
from process.machine.machine import FeedAxis, Machine
from process.machine.operating_point import OperatingPoint
from process.machine.structure import two_mass_axes
from process.simulation.excitation import Excitation, HalfSine
from process.simulation.excitation import SteppedSine as SteppedSine
from process.simulation.milling import STEPS_PER_PERIOD, STEPS_PER_TOOTH, MillingCut, Spindle
from process.simulation.packing import pack_forces, pack_impact
from process.simulation.problem import Problem, problem
from process.simulation.problem import SampledControl as SampledControl
from process.simulation.record import (
    AT_REST,
    MARGIN,
    Motion,
    Run,
    as_motion,
    as_record,
    displacement_of,
    integrate,
    prepare,
)
from process.simulation.step_maps import System, fastest_pole, system_of
from process.types import Real

STEPS_PER_EVENT = 8
"""Steps in the shortest event of an excitation, at least."""

STEPS_PER_POLE = 24
"""Steps in the period of the fastest linear pole, at least."""

ACCURACY = 2e-3
"""Largest error of a friction or joint force, over the largest so far, in a step that only poles and events limit.

It goes with the fourth power of the step: 1.25e-4 at half of it.
"""

_COARSEST = 20


def _default_step(p: Problem, fastest: float) -> float:
    """Return the default step [s], which `simulate_machine` states."""
    bounds = [*(e.shortest / STEPS_PER_EVENT for e in p.excitations), *p.delays]
    period = 2.0 * math.pi / fastest
    bounds.append(period / STEPS_PER_POLE)
    if p.cut is not None and p.spindle is not None:
        _, turning = p.spindle.extremes(0.0, p.total)
        bounds.append(1.0 / (STEPS_PER_TOOTH * p.cut.tool.tooth_passing_frequency(turning)))
        bounds.append(period / STEPS_PER_PERIOD)
    return min(bounds)


def _keep(p: Problem, sample_rate: float, largest: float) -> int:
    """Steps a sample: the step divides the sampling intervals of record and controller."""
    keep = max(1, math.ceil(1.0 / (sample_rate * largest) - 1e-9))
    if p.control is None:
        return keep
    for more in range(keep, 64 * keep + 64):
        ratio = p.control.period * sample_rate * more
        if abs(ratio - round(ratio)) < 1e-9 * ratio and round(ratio) >= 1:
            return more
    raise InputError(
        f"no step divides both the servo's period {p.control.period:g} s and the interval of {sample_rate:g} samples a "
        "second; give a sample rate that is a simple fraction of the servo's"
    )


def _prepared(p: Problem, sample_rate: float, step: float | None, accuracy: float | None = None) -> tuple[System, Run]:
    """Integrate a problem; return its linear part and the run."""
    if not p.total * sample_rate >= 2.0:
        raise InputError(f"{p.total:g} s at {sample_rate:g} Hz; at least two samples are needed")
    require_bounded(p)
    system = system_of(p)
    fastest = fastest_pole(p, system)
    usual = _default_step(p, fastest)
    if step is not None:
        require_fine(p, fastest, step)
    half = usual if usual * sample_rate >= 4.0 else 0.5 / sample_rate
    keep = _keep(p, sample_rate, min(usual, half) if step is None else step)
    if accuracy is None:
        accuracy = min(1e-2, ACCURACY / (sample_rate * keep * usual) ** 4)
    h = 1.0 / (sample_rate * keep)
    # The low-pass looks ahead: integrate beyond the end of the record.
    steps = (round(p.total * sample_rate) + (2 * MARGIN if keep > 1 else 0)) * keep
    given, forces = pack_forces(p, h, steps)
    # A mode rings after an impulse with a force of its frequency times that.
    given = given._replace(peak=max(given.peak, fastest * max(abs(v) for v in p.impulse)))
    return system, integrate(prepare(p, system, h, steps), given, forces, keep=keep, accuracy=accuracy)


def simulate_machine(
    machine: Machine,
    *,
    duration: float,
    feed: float | Mapping[str, float] = 0.0,
    controller: str | None = None,
    position: float | None = None,
    forces: Mapping[str, Excitation] | None = None,
    drive_forces: Mapping[str, Excitation] | None = None,
    cut: MillingCut | None = None,
    spindle: Spindle | None = None,
    lead: float = 0.0,
    tail: float = 0.0,
    impulse: tuple[float, float, float] = (0.0, 0.0, 0.0),
    control: SampledControl | None = None,
    sample_rate: float = 2000.0,
    step: float | None = None,
) -> xr.Dataset:
    """Return the record of a machine at rest or in motion that is hit, shaken, or mills.

    Everything linear moves exactly. The default step is the smallest of 1/8 of the shortest event of the excitations,
    1/24 of the period of the fastest pole, the shortest dead time and, below 4 samples in such a step, half a sample;
    with a cut also of 1/60 of that period and 1/120 of the shortest tooth period, as in `simulation.milling`. Where
    friction or a joint does not follow a parabola to `ACCURACY`, a step is halved, up to 8 times.

    The step is of order 4, with a cut 2. Laws with memory are less regular: hits on the bench of Franco et al. 2024
    converge with order 1.8 to 4.9 (LuGre, two halvings from 0.5 ms, also where the bristles settle within a step) and
    2.1 to 3.7 (Maxwell slip, three halvings, where one may gain nothing and the next make up for it). Once all is at
    rest to 1e-12 and nothing excites it any more, it stays there. `step_error` measures what a step costs: on that
    bench at 2 kHz below 2e-6 for a hit of 25 N, 4 ms, below 1e-4 where up to 1000 N break it away.

    Parameters
    ----------
    machine : Machine
        Structure, servos, friction, joints; it follows its ramps steadily before t = 0.
    duration : float
        Length of the record, with a cut the time in the cut [s].
    feed : float or mapping, optional
        Feed of all axes, or axis name -> feed [m/s], of either sign; zero is idle.
    controller : str, optional
        Name of the controllers, where axes have several.
    position : float, optional
        Position [m], at t = 0, of the axis that a posture depends on; the structure follows its feed.
    forces : mapping, optional
        Axis name -> force on the tool.
    drive_forces : mapping, optional
        Axis name -> force added to that of the drive.
    cut : MillingCut, optional
        The cut; its feed is its own.
    spindle : Spindle, optional
        Speed of the spindle, needed with a cut.
    lead, tail : float, optional
        Time before and after the cut [s]; without one they add to the duration.
    impulse : (float, float, float), optional
        Impulse on the tool at entry [N s], to disturb a cut on purpose.
    control : SampledControl, optional
        The servos work on samples; they must have no delay of their own.
    sample_rate : float, optional
        Samples a second [Hz]; above it every channel is low-passed alike.
    step : float, optional
        Largest integration step [s]. The step used divides the sampling interval; with one step a sample nothing is
        low-passed. The tolerance of friction and joints goes with its fourth power.

    Returns
    -------
    xarray.Dataset
        ``force``, ``displacement`` and ``acceleration`` of the tool (deviations from the ramp) along the axes in which
        it can move; ``encoder_position`` and ``reference_position`` (with the ramp) and ``drive_force`` (with the
        steady friction) of each slide. A force that is held between jumps (`PseudoRandom`, a sampled servo where the
        record is low-passed) has samples around each jump that weigh it as integrals do, so that the spectrum of the
        record is that of the force that acted, without dead time. With a cut ``spindle_angle`` and ``spindle_speed``.
        Attributes: ``feed_mm_min`` (one value, or one a slide); ``step_s``; ``energy_error`` (largest error of the
        energy balance over the largest energy; NaN where the structure changes on the way); ``unstable_poles`` of
        uniform motion with the local friction; of the last quarter second, ``residual_m`` (half the swing of the tool)
        and ``standstill_share`` (slide slower than a tenth of its feed, or going back; the largest); ``motion``:
        "settled", "excited to the end", "still decaying", or a sentence that begins with "self-excited": not at rest
        without excitation; with a cut ``lost_contact`` and ``largest_chip_thickness_m`` as in
        `process.simulation.milling.simulate_milling`.

    Raises
    ------
    InputError
        When the servos are unstable when sliding fast, the step is too large, a law jumps at rest, the spindle does
        not turn forward, or the tool leaves the range of 1 m.
    """
    p = problem(
        machine,
        duration=duration,
        feed=feed,
        controller=controller,
        position=position,
        forces=forces,
        drive_forces=drive_forces,
        cut=cut,
        spindle=spindle,
        lead=lead,
        tail=tail,
        impulse=impulse,
        control=control,
    )
    system, run = _prepared(p, sample_rate, step)
    return as_record(p, system, run, sample_rate, count_unstable(operating_point(p), control))


def machine_motion(
    machine: Machine,
    *,
    sample_rate: float = 2000.0,
    step: float | None = None,
    accuracy: float | None = None,
    **arguments: Any,
) -> Motion:
    """Return the motion of the tool of `simulate_machine` as plain arrays, for those who ask for it many times.

    The same numbers, without labels, slides and verdict; parameters and errors are those of `simulate_machine`.
    accuracy: largest error of a friction or joint force in a step, over the largest force so far; default `ACCURACY`
    times the fourth power of the step over the default one.

    Returns
    -------
    Motion
        ``time`` [s], shape (n,), ``force`` [N], ``displacement`` [m], ``acceleration`` [m/s^2], shape (3, n).
    """
    p = problem(machine, **arguments)
    system, run = _prepared(p, sample_rate, step, accuracy)
    return as_motion(p, system, run, sample_rate)


def step_error(machine: Machine, *, step: float | None = None, **arguments: Any) -> float:
    """Return what the step costs: largest change of the tool's displacement when it is halved, over the largest [1].

    Parameters
    ----------
    machine : Machine
        The machine.
    step : float, optional
        Step to judge [s]; default that of `simulate_machine`.
    **arguments
        As of `simulate_machine`; a sample is a step here.
    """
    arguments.pop("sample_rate", None)
    if step is None:
        step = simulate_machine(machine, **arguments).attrs["step_s"]
    coarse, fine = (
        simulate_machine(machine, sample_rate=1.0 / h, step=h, **arguments)["displacement"].values
        for h in (step, 0.5 * step)
    )
    n = min(coarse.shape[1], (fine.shape[1] + 1) // 2)
    return float(np.abs(coarse[:, :n] - fine[:, ::2][:, :n]).max() / np.abs(fine).max())


def require_fine(p: Problem, fastest: float, step: float) -> None:
    """Refuse a step that does not follow the fastest pole [rad/s] and the dead times."""
    largest = min([2.0 * math.pi / fastest / _COARSEST, *p.delays])
    if not 0.0 < step <= largest * (1.0 + 1e-12):
        raise InputError(
            f"the step is {step * 1e6:g} us; at most {largest * 1e6:.4g} us follow the fastest pole and the dead time "
            "of this machine; leave the step out to have it chosen"
        )


# --- Repeated impacts on a machine in uniform motion: all but the force is prepared once.


_ANY = HalfSine(1.0)


class RepeatedImpact:
    """A machine that is hit along one axis many times; its samples are its steps, and nothing is low-passed.

    Parameters
    ----------
    machine : Machine
        At rest or in uniform motion.
    axis : str
        Axis of the impact.
    duration : float
        Time that is followed [s].
    feed, controller, position
        As of `process.simulation.machine.simulate_machine`.
    sample_rate : float, optional
        Samples and steps a second [Hz].
    accuracy : float
        Largest error of a friction or joint force in a step, over the largest force so far.

    Raises
    ------
    InputError
        When the servos are unstable when sliding fast, or the step is too large.
    """

    def __init__(
        self,
        machine: Machine,
        axis: str,
        *,
        duration: float,
        accuracy: float,
        feed: float | Mapping[str, float] = 0.0,
        controller: str | None = None,
        position: float | None = None,
        sample_rate: float = 2000.0,
    ) -> None:
        p = problem(
            machine, duration=duration, feed=feed, controller=controller, position=position, forces={axis: _ANY}
        )
        require_bounded(p)
        system, step = system_of(p), 1.0 / sample_rate
        require_fine(p, fastest_pole(p, system), step)
        self._prepared = prepare(p, system, step, round(p.total * sample_rate))
        self._accuracy = accuracy

    def displacement(self, impact: Excitation, rest: float = AT_REST) -> Real:
        """Return the displacement of the tool [m] from the ramp at each sample, shape (3, m), until it is at rest.

        Parameters
        ----------
        impact : Excitation
            Force on the tool; hashable: how it is sampled is kept.
        rest : float, optional
            Share of their largest below which states and forces are at rest once the impact is over. Then the record
            ends: the tool stays where it was before the impact.

        Raises
        ------
        InputError
            When friction and joints cannot be solved for, or the tool leaves the range of 1 m.
        """
        r = self._prepared
        run = integrate(r, pack_impact(impact, r.step, r.steps), [], keep=1, accuracy=self._accuracy, rest=rest)
        return displacement_of(r.problem, run)


# --- Stability of a machine that is to be moved in time: at its feed, and so fast that friction is past its curve.


def operating_point(p: Problem) -> OperatingPoint:
    """Return the machine linearised in uniform motion, with the local friction."""
    return p.machine.at(dict(zip(p.machine.axes, p.feeds, strict=True)), p.controller, p.position)


class _StabilityCase:
    """What a verdict is about: two problems are alike where their keys are."""

    def __init__(self, p: Problem) -> None:
        self.problem = p._replace(forces={}, drive_forces={}, cut=None, spindle=None)
        first = p.structures[0]
        matrices = (first.mass, first.damping, first.stiffness, first.slide_rows())
        joints = tuple((m.joint, m.participation.tobytes()) for m in p.machine.joints)
        fast = tuple(r.fast for r in p.friction)
        self.key: Hashable = (tuple(m.tobytes() for m in matrices), joints, p.servos, p.control, fast)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _StabilityCase) and self.key == other.key


def require_bounded(p: Problem) -> None:
    """Friction limits a motion only where its force rises with speed: the servo must be stable when sliding fast."""
    if not any(v is not None for v in p.servos):
        return
    count = _unbounded(_StabilityCase(p))
    if count:
        gains = "; ".join(
            f"axis {name} has Kp {servo.Kp:g} N s/m, Ti {servo.Ti * 1e3:g} ms, Kv {servo.Kv:g} 1/s, delay "
            f"{servo.delay * 1e3:g} ms"
            for name, servo in zip(p.machine.axes, p.servos, strict=True)
            if servo is not None
        )
        raise InputError(
            f"the machine is unstable with its servos even when it slides fast: {count} pole(s); {gains}. Lower Kp "
            "or Kv, raise Ti, or shorten the dead time or the sampling period"
        )


@lru_cache(maxsize=256)
def _unbounded(case: _StabilityCase) -> int:
    """Count unstable poles when sliding fast, in the worse direction. Kept: the same machine is hit many times."""
    p = case.problem
    point = operating_point(p)
    counts = [0]
    for slopes in dict.fromkeys(zip(*(r.fast for r in p.friction), strict=True)):
        slides = [replace(s, friction=FrictionImpedance(v)) for s, v in zip(point.slides, slopes, strict=True)]
        counts.append(count_unstable(OperatingPoint(point.structure, slides), p.control))
    return max(counts)


def count_unstable(point: OperatingPoint, control: SampledControl | None) -> int:
    """Count poles in the right half plane, or outside the unit circle; without dead time from the eigenvalues."""
    if control is not None:
        return int(np.sum(np.abs(np.linalg.eigvals(_sampled_transition(point, control))) > 1.0 + 1e-9))
    if any(s.servo is not None and s.servo.delay > 0.0 for s in point.slides):
        return point.unstable_poles()
    s = np.linalg.eigvals(point.delay_equation.a)
    # A free slide has its pole at the origin twice, which rounding spreads by the root of its size.
    return int(np.sum(s.real > 1e-6 * np.abs(s).max(initial=0.0)))


def _sampled_transition(point: OperatingPoint, control: SampledControl) -> Real:
    """Return the matrix that takes motion, integrals, waiting forces and last readings from one sample to the next.

    An encoder with a resolution gives the velocity as the difference of two readings.
    """
    free = replace(point, slides=tuple(replace(s, servo=None) for s in point.slides))
    a, n, period, lag = free.delay_equation.a, point.structure.size, control.period, control.lag
    rows, held = point.structure.slide_rows(), [(i, s.servo) for i, s in enumerate(point.slides) if s.servo is not None]
    m, count = a.shape[0], len(held)
    block = np.zeros((m + count, m + count))
    block[:m, :m] = a
    block[n : 2 * n, m:] = np.linalg.solve(point.structure.mass, rows[[i for i, _ in held]].T)
    exact = linalg.expm(block * period)[:m]
    differenced = control.encoder_resolution > 0.0
    readings = m + count * (1 + lag)
    size = readings + count * differenced
    z = np.zeros((size, size))
    z[:m, :m] = exact[:, :m]
    for k, (i, servo) in enumerate(held):
        error, integral = np.zeros(size), m + k
        error[:n] = -servo.Kv * rows[i]
        if differenced:
            error[:n] -= rows[i] / period
            error[readings + k] = 1.0 / period
            z[readings + k, :n] = rows[i]
        else:
            error[n : 2 * n] = -rows[i]
        z[integral] = period * error
        z[integral, integral] = 1.0
        force = servo.Kp * (error + z[integral] / servo.Ti)
        queue = m + count + k * lag
        if lag == 0:
            z[:m] += np.outer(exact[:, m + k], force)
        else:
            z[:m, queue + lag - 1] += exact[:, m + k]
            z[queue] = force
            z[queue + 1 : queue + lag, queue : queue + lag - 1] = np.eye(lag - 1)
    return z


# --- Time simulation of one feed axis: `process.simulation.machine` for a `Drive`, a friction law, a force on the tip.


def as_machine(drive: Drive, friction: FrictionLaw | MemoryLaw | None = None, axis: str = "x") -> Machine:
    """Return the machine of one axis that a drive is; its own sigma is the friction where no law is given.

    Raises
    ------
    InputError
        When the drive has a sigma and a law is given too.
    """
    if friction is None:
        friction = Viscous(drive.sigma)
    elif drive.sigma != 0.0:
        raise InputError(
            f"the drive has sigma {drive.sigma:g} N s/m and a friction law is given: friction would count twice; "
            "put the viscous part into the law and leave sigma 0"
        )
    return Machine(two_mass_axes({axis: replace(drive, sigma=0.0)}), {axis: FeedAxis(drive.servo, friction)})


def simulate_axis(
    drive: Drive,
    friction: FrictionLaw | MemoryLaw | None,
    excitation: Excitation,
    feed: float,
    duration: float,
    sample_rate: float = 2000.0,
    step: float | None = None,
    axis: str = "x",
) -> xr.Dataset:
    """Return the record of an axis that moves at a constant feed while its tip is hit or shaken.

    Parameters
    ----------
    drive : Drive
        Masses, joint and servo; the axis follows its ramp steadily before the excitation.
    friction : FrictionLaw, MemoryLaw or None
        Friction of the carriage; None means the drive's own sigma. With a law, the drive's sigma must be zero.
    excitation : Excitation
        Force on the tip.
    feed : float
        Feed v0 [m/s], of either sign; zero is idle.
    duration : float
        Length of the record [s].
    sample_rate : float, optional
        Samples a second [Hz]; above it every channel is low-passed alike.
    step : float, optional
        Largest integration step [s]; default that of `simulate_machine`.
    axis : {"x", "y", "z"}, optional
        Name of the axis.

    Returns
    -------
    xarray.Dataset
        That of `process.simulation.machine.simulate_machine`, of this axis alone.
    """
    machine = as_machine(drive, friction, axis)
    return simulate_machine(
        machine, duration=duration, feed=feed, forces={axis: excitation}, sample_rate=sample_rate, step=step
    )


def axis_step_error(
    drive: Drive,
    friction: FrictionLaw | MemoryLaw | None,
    excitation: Excitation,
    feed: float,
    duration: float,
    step: float | None = None,
) -> float:
    """Return `process.simulation.machine.step_error` of an axis; parameters are those of `simulate_axis`."""
    machine = as_machine(drive, friction)
    return step_error(machine, duration=duration, feed=feed, forces={"x": excitation}, step=step)
