"""Time simulation of a whole machine: hammer hits, shakers and cuts, idle or in motion; error of the step.

Deviations from the ramp of each axis are integrated: the steady friction is held by the integrator, so there is no
start-up transient and no cancellation. The linear part moves exactly (matrix exponential); friction and joints are
inputs that are solved for, quadratic in time, and the step is halved where that does not follow them. Labelled in and
out; the loop is in `process.simulation._machine_kernels`. `RepeatedImpact` prepares a machine once for many impacts;
`require_bounded` and `count_unstable` refuse servos that are unstable and count the unstable poles of a record.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr
from scipy import signal

from process.drive.sampled_servo import sampled_transition
from process.errors import InputError
from process.friction.laws import MemoryLaw
from process.friction.linearised import FrictionImpedance
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.machine.operating_point import OperatingPoint
from process.simulation.excitation import Excitation, HalfSine
from process.simulation.milling import MillingCut, Spindle, simulate_milling
from process.simulation.packing import pack_forces, pack_impact
from process.simulation.problem import MachineRun, Problem, SampledControl, resolve
from process.simulation.record import (
    PreparedMachine,
    Run,
    as_record,
    displacement_of,
    integrate,
    prepare,
    prepare_again,
)
from process.simulation.rules import RULES
from process.simulation.step_maps import System, fastest_pole, system_of
from process.types import Real


def _default_step(p: Problem, fastest: float) -> float:
    """Return the default step [s], which `simulate_machine` states."""
    bounds = [*(e.shortest / RULES.steps_per_event for e in p.run.excitations), *p.delays]
    period = 2.0 * math.pi / fastest
    bounds.append(period / RULES.steps_per_pole)
    if p.run.cut is not None and p.run.spindle is not None:
        _, turning = p.run.spindle.extremes(0.0, p.run.total)
        bounds.append(1.0 / (RULES.steps_per_tooth * p.run.cut.tool.tooth_passing_frequency(turning)))
        bounds.append(period / RULES.steps_per_period)
    return min(bounds)


def _keep(p: Problem, sample_rate: float, largest: float) -> int:
    """Steps a sample: the step divides the sampling intervals of record and controller."""
    keep = max(1, math.ceil(1.0 / (sample_rate * largest) - 1e-9))
    if p.run.control is None:
        return keep
    for more in range(keep, 64 * keep + 64):
        ratio = p.run.control.period * sample_rate * more
        if abs(ratio - round(ratio)) < 1e-9 * ratio and round(ratio) >= 1:
            return more
    raise InputError(
        f"no step divides both the servo's period {p.run.control.period:g} s and the interval of {sample_rate:g} "
        "samples a second; give a sample rate that is a simple fraction of the servo's"
    )


def integrate_problem(
    p: Problem, sample_rate: float, step: float | None, accuracy: float | None = None
) -> tuple[System, Run]:
    """Integrate a problem; return its linear part and the run."""
    if not p.run.total * sample_rate >= 2.0:
        raise InputError(f"{p.run.total:g} s at {sample_rate:g} Hz; at least two samples are needed")
    require_bounded(p)
    system = system_of(p)
    fastest = fastest_pole(p, system)
    usual = _default_step(p, fastest)
    if step is not None:
        require_fine(p, fastest, step)
    half = usual if usual * sample_rate >= 4.0 else 0.5 / sample_rate
    keep = _keep(p, sample_rate, min(usual, half) if step is None else step)
    if accuracy is None:
        accuracy = min(RULES.largest_accuracy, RULES.accuracy / (sample_rate * keep * usual) ** 4)
    h = 1.0 / (sample_rate * keep)
    # The low-pass looks ahead: integrate beyond the end of the record.
    steps = (round(p.run.total * sample_rate) + (2 * RULES.margin if keep > 1 else 0)) * keep
    steps += max([math.ceil(p.lateness(axis) / h - 1e-6) for axis in p.machine.axes], default=0)
    given, forces = pack_forces(p, h, steps)
    # A mode rings after an impulse with a force of its frequency times that.
    given = given._replace(peak=max(given.peak, RULES.least_force, fastest * max(abs(v) for v in p.run.impulse)))
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
    commanded: bool = False,
    sample_rate: float = 2000.0,
    step: float | None = None,
) -> xr.Dataset:
    """Return the record of a machine at rest or in motion that is hit, shaken, or mills.

    Everything linear moves exactly. The default step is the smallest of 1/8 of the shortest event of the excitations,
    1/24 of the period of the fastest pole, the shortest dead time and, below 4 samples in such a step, half a sample;
    with a cut also of 1/60 of that period and 1/120 of the shortest tooth period, as in `simulation.milling`. Where
    friction or a joint does not follow a parabola to `SimulationRules.accuracy`, a step is halved, up to 8 times.

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
    commanded : bool, optional
        Drive forces are added to what the controllers command, before the dead time, and ``drive_force`` is that,
        as a controller logs it; the force that acts is the same, a dead time later.
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
    run = MachineRun(
        duration,
        feed,
        controller,
        position,
        forces or {},
        drive_forces or {},
        cut,
        spindle,
        lead,
        tail,
        impulse,
        control,
        commanded,
    )
    p = resolve(machine, run)
    system, states = integrate_problem(p, sample_rate, step)
    return as_record(p, system, states, sample_rate, count_unstable(operating_point(p), control))


def step_error(machine: Machine | ModalModel, *, step: float | None = None, **arguments: Any) -> float:
    """Return the error of a step: largest change of the record when the step is halved, over the largest value [1].

    The displacement of the tool is compared, and with a cut its force too, as means over a tooth period weighted by a
    Hann window: where a tooth enters, a sample is the share of its step. The order of a cut is two, so that the
    remaining error of the halved step is about a third of this. Above the stability limit two runs part exponentially,
    whatever the step.

    Parameters
    ----------
    machine : Machine or ModalModel
        The machine.
    step : float, optional
        Step to judge [s], shortened to divide the record; default that of the simulation.
    **arguments
        As of `simulate_machine`, or of `process.simulation.milling.simulate_milling`; a sample is a step here.

    Raises
    ------
    InputError
        When the cut lasts less than two tooth periods, or the simulation refuses its arguments.
    """
    simulate: Callable[..., xr.Dataset] = simulate_machine
    if isinstance(machine, ModalModel):
        simulate = simulate_milling
    total = sum(arguments.get(name, 0.0) for name in ("lead", "duration", "tail"))
    if step is None:
        step = float(simulate(machine, sample_rate=2.0 / total, **arguments).attrs["step_s"])
    count = math.ceil(total / step * (1.0 - 1e-9))
    runs = [simulate(machine, sample_rate=n / total, step=total / n, **arguments) for n in (count, 2 * count)]
    pairs = [[run["displacement"].values for run in runs]]
    cut, spindle = arguments.get("cut"), arguments.get("spindle")
    if cut is not None and spindle is not None:
        tooth = cut.tool.tooth_passing_frequency(spindle.extremes(0.0, total)[1])
        half_width = max(1, round(0.5 * count / (total * tooth)))
        if count < 4 * half_width:
            raise InputError(f"the cut lasts {total:g} s; the step can be judged by two tooth periods or more")
        pairs.append([_smoothed(run["force"].values, n * half_width) for n, run in enumerate(runs, 1)])
    errors = []
    for coarse, fine in pairs:
        n = min(coarse.shape[1], (fine.shape[1] + 1) // 2)
        errors.append(float(np.abs(coarse[:, :n] - fine[:, ::2][:, :n]).max() / np.abs(fine).max()))
    return max(errors)


def _smoothed(samples: Real, half_width: int) -> Real:
    """Mean over 2 half_width samples, weighted by a Hann window; the half widths at both ends are left out."""
    window = 0.5 + 0.5 * np.cos(np.pi * np.arange(-half_width, half_width + 1) / half_width)
    return np.asarray(signal.oaconvolve(samples, window[None, :] / half_width, mode="valid", axes=-1))


def _per_pole(fastest: float) -> float:
    return 2.0 * math.pi / fastest / RULES.coarsest_per_pole


def require_fine(p: Problem, fastest: float, step: float) -> None:
    """Refuse a step that does not follow the fastest pole [rad/s] and the dead times."""
    largest = min([_per_pole(fastest), *p.delays])
    if not 0.0 < step <= largest * (1.0 + 1e-12):
        raise InputError(
            f"the step is {step * 1e6:g} us; at most {largest * 1e6:.4g} us follow the fastest pole and the dead time "
            "of this machine; leave the step out to have it chosen"
        )


class RepeatedImpact:
    """A machine that is hit along one axis many times; its samples are its steps, and nothing is low-passed.

    Parameters
    ----------
    machine : Machine
        At rest or in uniform motion.
    axis : str
        Axis of the impact.
    run : MachineRun
        Duration, feed, controller and position; without forces.
    accuracy : float
        Largest error of a friction or joint force in a step, over the largest force so far.
    sample_rate : float, optional
        Least samples and steps a second [Hz]; the smallest multiple of it that follows the fastest pole is `rate`.
    like : RepeatedImpact, optional
        The same machine prepared for another run: what does not depend on the run is taken from it.

    Attributes
    ----------
    rate : float
        Samples and steps a second [Hz].

    Raises
    ------
    InputError
        When the servos are unstable when sliding fast, or a dead time is shorter than the step.
    """

    def __init__(
        self,
        machine: Machine,
        axis: str,
        run: MachineRun,
        *,
        accuracy: float,
        sample_rate: float = 2000.0,
        like: RepeatedImpact | None = None,
    ) -> None:
        self.rate: float
        self._prepared: PreparedMachine
        p = resolve(machine, replace(run, forces={axis: HalfSine(1.0)}))
        if like is not None and _same_linear_part(p, like._prepared.problem):
            self.rate = like.rate
            self._prepared = prepare_again(like._prepared, p, round(run.total * self.rate))
        else:
            require_bounded(p)
            system = system_of(p)
            fastest = fastest_pole(p, system)
            self.rate = sample_rate * max(math.ceil(1.0 / (sample_rate * _per_pole(fastest)) - 1e-9), 1)
            require_fine(p, fastest, 1.0 / self.rate)
            self._prepared = prepare(p, system, 1.0 / self.rate, round(run.total * self.rate))
        self._accuracy, self._axis = accuracy, axis

    def displacement(
        self,
        impact: Excitation,
        rest: float = RULES.at_rest,
        pull: float = 0.0,
        held: tuple[float, float] = (0.0, 0.0),
    ) -> Real:
        """Return the displacement of the tool [m] from the ramp at each sample, shape (3, m), until it is at rest.

        Parameters
        ----------
        impact : Excitation
            Force on the tool; hashable: how it is sampled is kept.
        rest : float, optional
            Share of their largest below which states and forces are at rest once the impact is over. Then the record
            ends: the tool stays where it was before the impact.
        pull : float, optional
            Force [N] of the drive on the axis of the impact as it comes to rest, which its guideway holds: the
            integrator of a servo at rest has any, up to the static friction.
        held : (float, float), optional
            A slide that its guideway holds does not come back. Its record ends as well once all velocities are below
            the first share of the largest, and the servos, winding up as they do then, would change their forces by
            less than the second share of the largest force until the end of the run: the tool stays where it is.

        Raises
        ------
        InputError
            When friction and joints cannot be solved for, the tool leaves the range of 1 m, or no guideway whose
            friction has a memory holds the pull.
        """
        r = self._prepared if pull == 0.0 else _pulled(self._prepared, self._axis, pull)
        given = pack_impact(impact, r.step, r.steps)
        # What a servo without dead time winds up by is not watched.
        stays = (0.0, 0.0) if r.system.prompt else held
        run = integrate(r, given, [], keep=1, accuracy=self._accuracy, rest=rest, held=stays)
        return displacement_of(r.problem, run)


def _pulled(r: PreparedMachine, axis: str, pull: float) -> PreparedMachine:
    """Return a machine at rest whose drive pulls along an axis with a force [N], which its guideway holds."""
    slide = list(r.problem.machine.axes).index(axis) if axis in r.problem.machine.axes else -1
    held = r.problem.friction[slide] if slide >= 0 else None
    law = None if held is None else held.law
    if held is None or not isinstance(law, MemoryLaw) or held.feed != 0.0 or abs(pull) > law.towards(pull).static:
        raise InputError(
            f"no guideway holds a pull of {pull:g} N along {axis} at rest; give less, or friction with memory"
        )
    element = list(r.system.nonlinear).index(slide)
    steady, state = r.elements.steady.copy(), r.state.copy()
    steady[element] += pull
    begin = r.elements.first[element]
    state[begin : begin + law.states] = law.holding(pull)
    return r._replace(elements=r.elements._replace(steady=steady), state=state)


def _same_linear_part(p: Problem, q: Problem) -> bool:
    """Whether two runs of one machine differ in nothing that its linear part knows: in time and feed only."""
    same = p.machine is q.machine and p.servos == q.servos and list(p.run.forces) == list(q.run.forces)
    fixed = len(p.structures) == len(q.structures) == 1 and p.structures[0] is q.structures[0]
    free = p.run.control is None and q.run.control is None
    slopes = ([(r.slope, r.fast) for r in of.friction] for of in (p, q))
    return same and fixed and free and next(slopes) == next(slopes)


# --- Stability: at the feed, and so fast that friction is past its curve.


def operating_point(p: Problem) -> OperatingPoint:
    """Return the machine linearised in uniform motion, with the local friction."""
    return p.machine.at(dict(zip(p.machine.axes, p.feeds, strict=True)), p.run.controller, p.run.position)


class _StabilityCase:
    """Key of a stability count: two problems are equal where structure, joints, servos and friction slopes are."""

    def __init__(self, p: Problem) -> None:
        # Neither forces nor the cut change the poles.
        self.problem = p._replace(
            run=replace(p.run, forces={}, drive_forces={}, cut=None, spindle=None, impulse=(0, 0, 0))
        )
        first = p.structures[0]
        matrices = (first.mass, first.damping, first.stiffness, first.slide_rows())
        joints = tuple((m.joint, m.participation.tobytes()) for m in p.machine.joints)
        fast = tuple(r.fast for r in p.friction)
        self.key: Hashable = (tuple(m.tobytes() for m in matrices), joints, p.servos, p.run.control, fast)

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
        counts.append(count_unstable(OperatingPoint(point.structure, slides), p.run.control))
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
    """Return the matrix of `sampled_transition`; an encoder with a resolution gives the velocity as a difference."""
    free = replace(point, slides=tuple(replace(s, servo=None) for s in point.slides))
    a, n, rows = free.delay_equation.a, point.structure.size, point.structure.slide_rows()
    held = [(i, s.servo) for i, s in enumerate(point.slides) if s.servo is not None]
    rows = rows[[i for i, _ in held]]
    inlets = np.zeros((a.shape[0], len(held)))
    inlets[n : 2 * n] = np.linalg.solve(point.structure.mass, rows.T)
    places, speeds = np.zeros((2, len(held), a.shape[0]))
    places[:, :n], speeds[:, n : 2 * n] = rows, rows
    gains = [(servo.Kp, servo.Ti, servo.Kv) for _, servo in held]
    differenced = control.encoder_resolution > 0.0
    return sampled_transition(a, inlets, places, speeds, gains, control.period, control.lag, differenced)
