"""Time simulation of a whole machine: hammer hits, shakers and cuts, idle or in motion.

Deviations from the ramp of each axis are integrated: the steady friction is held by the integrator, so there is no
start-up transient and no cancellation. The linear part moves exactly (matrix exponential); friction and joints are
inputs that are solved for, quadratic in time, and the step is halved where that does not follow them. Labelled in and
out; the loop is in `process._machine_kernels`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from process.errors import InputError
from process.excitation import Excitation
from process.machine import Machine
from process.machine_linear import System, fastest_pole, system_of
from process.machine_march import made_ready, march
from process.machine_packing import pack_forces
from process.machine_problem import Problem, problem
from process.machine_problem import SampledControl as SampledControl
from process.machine_records import MARGIN, Motion, Run, as_motion, as_record
from process.machine_stability import count_unstable, operating_point, require_bounded
from process.simulate import STEPS_PER_PERIOD, STEPS_PER_TOOTH, MillingCut, Spindle

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
    """March a problem; also return its linear part."""
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
    # The low-pass looks ahead: march beyond the end of the record.
    steps = (round(p.total * sample_rate) + (2 * MARGIN if keep > 1 else 0)) * keep
    given, forces = pack_forces(p, h, steps)
    # A mode rings after an impulse with a force of its frequency times that.
    given = given._replace(peak=max(given.peak, fastest * max(abs(v) for v in p.impulse)))
    return system, march(made_ready(p, system, h, steps), given, forces, keep=keep, accuracy=accuracy)


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
    with a cut also of 1/60 of that period and 1/120 of the shortest tooth period, as in `process.simulate`. Where
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
        `process.simulate.simulate_milling`.

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
