"""From a trial of the scenario to its records: one entry of the campaign for each combination of its lists."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from process.cut.engagement import engagement
from process.drive.servo import Servo
from process.errors import InputError
from process.instruments.sensors import Sensors
from process.instruments.trials import (
    AT_REST,
    Running,
    actuator_trial,
    hammer_trial,
    milling_trial,
    moving_trial,
    shaker_trial,
    silent_trial,
)
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.machine.structure import Posture
from process.simulation.excitation import Chirp, Excitation, Multisine, PseudoRandom, all_harmonics
from process.simulation.milling import MillingCut, Spindle
from process.simulation.problem import SampledControl
from process.units import show
from smfe.records.formats.channels import did_you_mean, listed
from smfe.scenario import schema

Make = Callable[..., xr.Dataset]

BRAKES = "brakes"
"""What the campaign calls the controller where brakes hold all axes."""

DWELL = 1.5
"""Time a step of a sine in steps [s], where a trial gives none."""

MOST_STEPS = 10_000
"""Steps of a sine."""

TAPER = 0.01
"""Share of its time in which a sine that sweeps rises, and falls, as half a cosine."""

DECAY = 2.0
"""Time after a sine that sweeps in which the machine comes to rest [s]."""

SAMPLES_A_PULSE = 4
"""Fewest samples of a record in a hammer's pulse: with less its peak and its double hits are not seen."""


@dataclass(frozen=True)
class Stand:
    """Everything that a trial works with.

    Parameters
    ----------
    file : ScenarioFile
        The scenario.
    machine, loaded : Machine or ModalModel
        Bare, and with the mass of the accelerometer.
    sensors : Sensors
        Measuring chain of the method.
    trial : int
        Number of the trial in the file.
    held : tuple of str
        Axes that brakes hold.
    """

    file: schema.ScenarioFile
    machine: Machine | ModalModel
    loaded: Machine | ModalModel
    sensors: Sensors
    trial: int
    held: tuple[str, ...] = ()


@dataclass(frozen=True)
class Job:
    """One record: its file without suffix, how it comes about, and what the campaign says about it."""

    file: str
    make: Make
    says: Mapping[str, Any]


@dataclass(frozen=True)
class Entry:
    """One ``[[measurement]]`` or ``[[cutting_test]]`` of the campaign.

    Parameters
    ----------
    name : str
        Unique.
    method : str
        Of the trial; "open_loop" where a periodic force is added to a drive.
    trial : int
        Its number in the file.
    says : mapping
        Conditions as the campaign writes them.
    running : Running
        Conditions as the machine takes them.
    jobs : tuple of Job
        Its records.
    held : tuple of str
        Axes that brakes hold.
    """

    name: str
    method: str
    trial: int
    says: Mapping[str, Any]
    running: Running
    jobs: tuple[Job, ...]
    held: tuple[str, ...] = ()


@dataclass(frozen=True)
class Combination:
    """One choice of all that a trial gives as a list."""

    name: str
    running: Running
    says: dict[str, Any]
    level: float


def entries(stand: Stand) -> list[Entry]:
    """Return the entries of one trial.

    Raises
    ------
    InputError
        When the machine cannot run it, or the sample rate cannot follow it.
    """
    trial = stand.file.trial[stand.trial]
    makers: dict[str, Callable[[Stand, Any, Combination], Iterator[Entry]]] = {
        "hammer": _hammer,
        "actuator": _actuator,
        "sweep": _sweep,
        "cut": _cuts,
        "drive": _drive,
        "silent": _silent,
    }
    if trial.brakes:
        stand = _braked(stand, trial)
    _check_machine(stand.machine, trial)
    combined = list(_combinations(stand.machine, trial))
    return [entry for chosen in combined for entry in makers[trial.method](stand, trial, chosen)]


def _braked(stand: Stand, trial: schema.Trial) -> Stand:
    """Return the stand whose brakes hold the axes that a trial names, or all that there are."""
    machine, loaded = stand.machine, stand.loaded
    if not isinstance(machine, Machine) or not isinstance(loaded, Machine) or not machine.axes:
        raise InputError("its brakes need axes, and the machine has none; add [machine.axis.x]")
    held = brakes_of(machine, trial)
    if not held:
        unknown = listed(trial.brakes or ())
        raise InputError(f"brakes hold {unknown}, and the machine moves along {listed(machine.axes)}")
    left = [axis for axis in machine.axes if axis not in held]
    fed = {a for feed in trial.feed or () if len(set(feed.values())) > 1 for a, v in feed.items() if v and a in held}
    if fed or (not left and any(any(feed.values()) for feed in trial.feed or ())):
        raise InputError(f"feeds axis {listed(fed or held)}, which its brakes hold; leave out the feed or the brakes")
    if not left and (trial.controller is not None or trial.control is not None):
        raise InputError("brakes hold all axes, so that no controller acts; leave controller and control out")
    if isinstance(trial, schema.DriveTrial) and trial.axis in held:
        raise InputError(f"brakes hold axis {trial.axis}; a drive cannot move it")
    return replace(stand, machine=machine.braked(held), loaded=loaded.braked(held), held=held)


def brakes_of(machine: Machine, trial: schema.Trial) -> tuple[str, ...]:
    """Return the axes of a machine that the brakes hold in a trial."""
    wanted = trial.brakes or ()
    return tuple(axis for axis in machine.axes if axis in wanted)


# --- conditions ---------------------------------------------------------------------------------------------


def _check_machine(machine: Machine | ModalModel, trial: schema.Trial) -> None:
    if isinstance(machine, ModalModel):
        given = [key for key in ("controller", "position", "control") if getattr(trial, key) is not None]
        given += ["feed"] * bool(trial.feed is not None and any(any(feed.values()) for feed in trial.feed))
        if given or trial.method == "drive":
            what = f"its {listed(given)} need" if given else "a drive trial needs"
            raise InputError(f"{what} axes, and the machine has modes alone; add [machine.axis.x]")
        return
    servos = {name: axis.servo for name, axis in machine.axes.items() if isinstance(axis.servo, Mapping)}
    _check_controllers(servos, trial)
    late = any(servo.delay > 0.0 for named in servos.values() for servo in named.values())
    if trial.control is not None and late:
        raise InputError(
            "its control has a period and a lag, which make the dead time; leave the delay of the servos out"
        )
    if trial.position is not None and not isinstance(machine.structure, Posture):
        raise InputError("gives a position, and the machine is the same everywhere; add [machine.posture]")
    if not machine.axes and any(any(feed.values()) for feed in trial.feed or ()):
        raise InputError("gives a feed, and the machine has no axes; add [machine.axis.x]")
    if isinstance(trial, schema.DriveTrial) and trial.axis not in machine.axes:
        raise InputError(f"axis {trial.axis} does not move; the machine moves {listed(machine.axes)}")


def _check_controllers(servos: Mapping[str, Mapping[str, Servo]], trial: schema.Trial) -> None:
    """Refuse a trial that leaves the controller of an axis open; `servos` are those of each axis by name."""
    known = {name for named in servos.values() for name in named}
    for name in trial.controller or ():
        if name not in known:
            raise InputError(f"controller '{name}' is not known{did_you_mean(name, known)}; there are {listed(known)}")
    for axis, named in servos.items():
        if trial.controller is None and len(named) > 1:
            raise InputError(
                f'must name a controller: axis {axis} has {listed(named)}; add controller = "{next(iter(named))}"'
            )
        lacking = [name for name in trial.controller or () if name not in named]
        if lacking:
            raise InputError(
                f"axis {axis} has no controller '{lacking[0]}', it has {listed(named)}; give each axis one of that name"
            )


def _combinations(machine: Machine | ModalModel, trial: schema.Trial) -> Iterator[Combination]:
    base = trial.name or trial.method
    lists: dict[str, tuple[Any, ...]] = {
        "feed": trial.feed or (None,),
        "controller": trial.controller or (None,),
        "position": trial.position or (None,),
        "level": _levels(trial),
        "repeat": tuple(range(1, trial.repeats + 1)),
    }
    for values in itertools.product(*lists.values()):
        chosen = dict(zip(lists, values, strict=True))
        varied = {key: chosen[key] for key, options in lists.items() if len(options) > 1}
        running = AT_REST
        says: dict[str, Any] = {}
        if isinstance(machine, Machine):
            control = None if trial.control is None else _control(trial.control)
            running = Running(_feed(machine, chosen["feed"]), chosen["controller"], chosen["position"], control)
            machine.feeds(running.feed)
            machine.structure_at(running.position)
        if chosen["feed"] is not None:
            says["feed"] = _said_feed(running.feed)
        if chosen["controller"] is not None:
            says["controller"] = chosen["controller"]
        elif trial.brakes and isinstance(machine, Machine) and not machine.axes:
            says["controller"] = BRAKES
        if chosen["position"] is not None:
            says["position"] = show(chosen["position"], "mm", "length")
        if trial.repeats > 1:
            says["repeat"] = chosen["repeat"]
        name = "_".join([base, *(_label(trial.method, key, value, _unit(trial)) for key, value in varied.items())])
        yield Combination(name, running, says, chosen["level"])


def _control(table: schema.ControlTable) -> SampledControl:
    return SampledControl(table.period, table.lag, table.encoder_resolution)


def _levels(trial: schema.Trial) -> tuple[float, ...]:
    """Return what a trial varies in strength: impulse [N s], force [N] or depth of cut [m]."""
    if isinstance(trial, schema.HammerTrial):
        peaks = tuple(2.0 / math.pi * peak * trial.duration for peak in trial.peak_force or ())
        return trial.impulse or peaks
    if isinstance(trial, schema.SweepTrial | schema.CutTrial):
        return trial.depth_of_cut
    if isinstance(trial, schema.ActuatorTrial):
        return trial.force or trial.current or ()
    return (trial.force or (0.0,)) if isinstance(trial, schema.DriveTrial) else (0.0,)


def _unit(trial: schema.Trial) -> str:
    """Return the unit of the strength of a trial in names."""
    if isinstance(trial, schema.ActuatorTrial) and trial.current is not None:
        return "A"
    return "Ns" if trial.method == "hammer" else "N"


def _label(method: str, key: str, value: Any, unit: str) -> str:
    if key == "feed":
        moving = [f"{axis}{v * 6e4:g}" for axis, v in value.items() if v]
        same = len(set(value.values())) == 1
        return "f" + (f"{value['x'] * 6e4:g}" if same else "".join(moving) or "0")
    if key == "position":
        return f"p{value * 1e3:g}"
    if key == "level":
        return f"{value * 1e3:g}mm" if method in ("sweep", "cut") else f"{value:g}{unit}"
    return f"r{value}" if key == "repeat" else str(value)


def _feed(machine: Machine, feed: Mapping[str, float] | None) -> dict[str, float]:
    """Return the feed of the machine's axes; one value for all axes means those that there are."""
    if feed is None:
        return {}
    same = len(set(feed.values())) == 1
    return {axis: v for axis, v in feed.items() if axis in machine.axes or (v != 0.0 and not same)}


def _said_feed(feed: float | Mapping[str, float]) -> Any:
    """Return a feed as the campaign writes it: the axes that the machine has, or nought where it has none."""
    if not isinstance(feed, Mapping) or not feed:
        return "0 mm/min"
    return {axis: show(v, "mm/min", "speed") for axis, v in feed.items()}


# --- methods ------------------------------------------------------------------------------------------------


def _entry(stand: Stand, chosen: Combination, says: Mapping[str, Any], jobs: list[Job]) -> Entry:
    trial = stand.file.trial[stand.trial]
    mounted = stand.file.sensors.accelerometer.mass
    added = {"added_mass": show(mounted, "kg", "mass")} if mounted and trial.method != "cut" else {}
    said = {**chosen.says, **says, **added}
    return Entry(chosen.name, trial.method, stand.trial, said, chosen.running, tuple(jobs), stand.held)


def _common(stand: Stand, chosen: Combination) -> dict[str, Any]:
    return {"sample_rate": stand.file.scenario.sample_rate, "sensors": stand.sensors, "running": chosen.running}


def _band(trial: Any) -> dict[str, Any]:
    band = trial.frequency_range
    return {} if band is None else {"frequency_range": [show(f, "Hz", "frequency") for f in band]}


def _hammer(stand: Stand, trial: schema.HammerTrial, chosen: Combination) -> Iterator[Entry]:
    samples = trial.duration * stand.file.scenario.sample_rate
    if samples < SAMPLES_A_PULSE:
        raise InputError(
            f"a pulse of {trial.duration * 1e3:g} ms has {samples:.2g} samples at "
            f"{stand.file.scenario.sample_rate:g} Hz; at least {SAMPLES_A_PULSE} are needed: sample at "
            f"{SAMPLES_A_PULSE / trial.duration:g} Hz or more, or hit softer"
        )
    jobs = []
    for axis in trial.directions:
        hits = {"pulse_duration": trial.duration, "interval": trial.interval, **_common(stand, chosen)}
        make = partial(_scattered, stand.loaded, axis, chosen.level, trial.hits, trial.scatter, hits)
        jobs.append(Job(f"{chosen.name}_{axis}", make, {"excitation": axis}))
    peak = show(0.5 * math.pi * chosen.level / trial.duration, "N", "force")
    yield _entry(stand, chosen, {"force_level": peak, **_band(trial)}, jobs)


def _scattered(
    machine: Machine | ModalModel,
    axis: str,
    impulse: float,
    hits: int,
    scatter: float,
    options: Mapping[str, Any],
    rng: np.random.Generator,
) -> xr.Dataset:
    """Hit as an arm does: no two hits alike."""
    impulses = impulse * (1.0 + scatter * rng.uniform(-1.0, 1.0, hits))
    return hammer_trial(machine, axis, list(impulses), rng=rng, **options)


def _actuator(stand: Stand, trial: schema.ActuatorTrial, chosen: Combination) -> Iterator[Entry]:
    table = stand.file.actuator
    _check_rate(trial.frequencies[1], stand.file.scenario.sample_rate, "the highest frequency")
    coil, amplitude = None if table is None else table.build(), chosen.level
    if trial.current is not None:
        if table is None or table.force_constant is None:
            raise InputError('a current needs an [actuator] with its force_constant, e.g. "40 N/A"; or give a force')
        amplitude *= table.force_constant
    common = {**_common(stand, chosen), "coil": coil}
    jobs = [
        Job(f"{chosen.name}_{axis}", _shaken(stand, trial, axis, amplitude, common), {"excitation": axis})
        for axis in trial.directions
    ]
    yield _entry(stand, chosen, {"force_level": show(amplitude, "N", "force")}, jobs)


def _shaken(stand: Stand, trial: schema.ActuatorTrial, axis: str, amplitude: float, common: Mapping[str, Any]) -> Make:
    """Return the record of a sine in steps, or of one that sweeps."""
    low, high, *step = trial.frequencies
    if trial.sweep_time is None:
        count = int((high - low) / step[0] * (1.0 + 1e-9)) + 1
        if count > MOST_STEPS:
            raise InputError(
                f"{count} steps of {step[0]:g} Hz; give a wider step, of which at most {MOST_STEPS} fit in"
            )
        steps = low + step[0] * np.arange(count)
        return partial(actuator_trial, stand.loaded, axis, steps, amplitude, dwell=trial.dwell or DWELL, **common)
    sweep = Chirp(low, high, amplitude, trial.sweep_time, TAPER * trial.sweep_time, start=0.0)
    return partial(shaker_trial, stand.loaded, axis, sweep, trial.sweep_time + DECAY, **common)


def _check_rate(frequency: float, rate: float, what: str) -> None:
    if frequency > 0.4 * rate:
        raise InputError(
            f"{what} is {frequency:g} Hz, sampled at {rate:g} Hz; sample at {frequency / 0.4:g} Hz or more"
        )


def _milled(
    stand: Stand, trial: schema.SweepTrial | schema.CutTrial, chosen: Combination, rotation: float, highest: float
) -> Any:
    """Return tool, material, feed rate, and the running with the axis x that feeds, where nothing else is said."""
    file = stand.file
    missing = [f"[{name}]" for name in ("tool", "material") if getattr(file, name) is None]
    if file.tool is None or file.material is None:
        raise InputError(f"a {trial.method} needs {' and '.join(missing)}; add it")
    tool = file.tool.build()
    _check_rate(tool.tooth_passing_frequency(highest), file.scenario.sample_rate, "the tooth passing frequency")
    feed_rate = trial.feed_per_tooth * tool.tooth_passing_frequency(rotation)
    running = chosen.running
    if isinstance(stand.machine, Machine) and trial.feed is None and "x" in stand.machine.axes:
        running = replace(running, feed={"x": feed_rate})
    return tool, file.material.build(), feed_rate, running


def _sweep(stand: Stand, trial: schema.SweepTrial, chosen: Combination) -> Iterator[Entry]:
    start, end = trial.spindle_speed
    tool, material, feed_rate, running = _milled(stand, trial, chosen, start, end)
    if running != chosen.running:
        chosen.says["feed"] = _said_feed(running.feed)
    chosen = replace(chosen, running=running)
    # The spindle accelerates in the air already, so that the speeds that are asked for are those in the cut.
    first = start - trial.rate * trial.lead
    if not first > 0.0:
        raise InputError(
            f"a spindle that has {start * 30.0 / math.pi:.4g} rpm where the cut begins and gains "
            f"{trial.rate * 30.0 / math.pi:.4g} rpm/s would turn backwards {trial.lead:g} s (lead) before; shorten "
            "lead or lower rate"
        )
    jobs = []
    for number, one in enumerate(trial.passes, 1):
        arc = engagement(one.cut, one.width_of_cut, tool.diameter)
        make = partial(
            milling_trial,
            stand.loaded,
            MillingCut(tool, arc, material, chosen.level, feed_rate=feed_rate),
            Spindle(first, trial.rate),
            (end - start) / trial.rate,
            lead=trial.lead,
            tail=trial.tail,
            **_common(stand, chosen),
        )
        says = {"cut": one.cut, "width_of_cut": show(one.width_of_cut, "mm", "length")}
        jobs.append(Job(f"{chosen.name}_{one.cut}_{number}", make, says))
    says = {"depth_of_cut": show(chosen.level, "mm", "length"), **_band(trial)}
    yield _entry(stand, chosen, says, jobs)


def _cuts(stand: Stand, trial: schema.CutTrial, chosen: Combination) -> Iterator[Entry]:
    for rotation in trial.spindle_speed:
        rpm = rotation * 30.0 / math.pi
        tool, material, _, running = _milled(stand, trial, chosen, rotation, rotation)
        name = chosen.name + (f"_{rpm:.6g}rpm" if len(trial.spindle_speed) > 1 else "")
        one = replace(chosen, name=name, running=running)
        arc = engagement(trial.cut, trial.width_of_cut, tool.diameter)
        make = partial(
            milling_trial,
            stand.loaded,
            MillingCut(tool, arc, material, chosen.level, feed_per_tooth=trial.feed_per_tooth),
            Spindle(rotation),
            trial.duration,
            lead=trial.lead,
            tail=trial.tail,
            **_common(stand, one),
        )
        says: dict[str, Any] = {
            "spindle_speed": f"{rpm:.9g} rpm",
            "depth_of_cut": show(chosen.level, "mm", "length"),
            "cut": trial.cut,
            "width_of_cut": show(trial.width_of_cut, "mm", "length"),
            "feed_per_tooth": show(trial.feed_per_tooth, "mm", "length"),
            **{key: chosen.says[key] for key in ("controller", "position", "feed") if key in chosen.says},
        }
        if running != chosen.running:
            says["feed"] = _said_feed(running.feed)
        yield Entry(name, "cut", stand.trial, says, running, (Job(name, make, {}),), stand.held)


def _drive(stand: Stand, trial: schema.DriveTrial, chosen: Combination) -> Iterator[Entry]:
    force, duration = _drive_force(stand, trial, chosen.level)
    forces = None if force is None else {trial.axis: force}
    make = partial(_without_force, moving_trial, stand.loaded, duration, drive_forces=forces, commanded=True)
    says = {} if forces is None else {"force_level": show(chosen.level, "N", "force")}
    job = Job(chosen.name, partial(make, **_common(stand, chosen)), {})
    entry = _entry(stand, chosen, says, [job])
    yield replace(entry, method="open_loop") if force is not None and trial.signal != "chirp" else entry


def _drive_force(stand: Stand, trial: schema.DriveTrial, level: float) -> tuple[Excitation | None, float]:
    """Return the force that is added to the command, and the duration of the record [s]."""
    rate = stand.file.scenario.sample_rate
    if trial.force is None:
        return None, trial.duration or 0.0
    highest = trial.clock if trial.frequency_range is None else trial.frequency_range[1]
    assert highest is not None
    if trial.signal == "chirp":
        assert trial.frequency_range is not None
        assert trial.duration is not None
        _check_rate(highest, rate, "the highest frequency")
        chirp = Chirp(*trial.frequency_range, level, 0.9 * trial.duration, 0.05 * trial.duration)
        return chirp, trial.duration
    period, periods = trial.period or 0.0, trial.periods or 1
    samples = period * rate
    if abs(samples - round(samples)) > 1e-6 * samples:
        raise InputError(
            f"its period of {period:.6g} s holds {samples:.6g} samples at {rate:g} Hz; to average periods, "
            f"give a sample_rate that is a multiple of {'the clock' if trial.signal == 'prbs' else 'the resolution'}"
        )
    if trial.signal == "prbs":
        if highest > rate:
            raise InputError(f"a clock of {highest:g} Hz, sampled at {rate:g} Hz; sample at the clock or faster")
        return PseudoRandom(level, highest, trial.bits or 10, periods, start=0.0), periods * period
    _check_rate(highest, rate, "the highest frequency")
    assert trial.frequency_range is not None
    lines = [round(f * period + off) for f, off in zip(trial.frequency_range, (0.4999, -0.4999), strict=True)]
    tones = all_harmonics(max(lines[0], 1), max(lines[1], 0))
    return Multisine(1.0 / period, tones, level, periods, stand.file.scenario.seed, start=0.0), periods * period


def _silent(stand: Stand, trial: schema.SilentTrial, chosen: Combination) -> Iterator[Entry]:
    make = partial(_without_force, silent_trial, stand.loaded, trial.duration, **_common(stand, chosen))
    yield _entry(stand, chosen, {}, [Job(chosen.name, make, {})])


def _without_force(trial: Make, *arguments: Any, **options: Any) -> xr.Dataset:
    """Nothing measures a force where nothing touches the tool."""
    return trial(*arguments, **options).drop_vars("force")
