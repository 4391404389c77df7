"""A whole measuring campaign on a linear simulated machine, written to disk as a laboratory would find it.

Machine, tool, cut, work material and sensor noise are the published set-up of a simulated sweep milling test by the
group that introduced the method (public code, 2022): three modes at 33.37, 57.44 and 58.61 Hz, an 80 mm tool with two
inserts at 45 deg, sweeps from 600 rpm at 1.5 rad/s2. The hammer, the actuator and the cutting tests are ours.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.instruments.sensors import Sensors, Tone
from process.instruments.trials import actuator_trial, hammer_trial, milling_trial
from process.machine.modes import ModalModel
from process.simulation.milling import MillingCut, Spindle
from smfe.progress import Progress, silent
from smfe.records import write_record_csv, write_record_mat, write_record_netcdf
from smfe.results import write_atomically

MACHINE = ModalModel(
    frequency=np.array([33.37, 57.44, 58.61]),
    damping=np.array([0.061, 0.0822, 0.0287]),
    stiffness=np.array([45.5e6, 32.1e6, 36.7e6]),
    direction=np.array([[-0.055, 0.6245, 0.7724], [0.0199, 0.9968, -0.0161], [0.999, 4.0028e-4, 0.0096]]),
)
TOOL = Tool(diameter=0.080, teeth=2, approach_angle=math.radians(45.0))
MATERIAL = CuttingCoefficients(1889.2e6, 806.1e6, 291.0e6, 63.12e3, 113.7e3, -3.1e3)
SENSORS = Sensors(force_noise=(0.0, 0.0, 0.0), acceleration_noise=(0.01597, 0.01175, 0.00139))
DEMO_SEED = 20220712
SWEEP_START = 600.0 * math.pi / 30.0
SWEEP_RATE = 1.5
SWEEP_DURATION = 65.0
SWEEP_DEPTH = 0.002
SWEEP_WIDTH = 0.012
FEED_PER_TOOTH = 1e-4
TEST_WIDTH = 0.040
CUTTING_TESTS: tuple[tuple[int, float], ...] = (
    (700, 3.0),
    (700, 5.0),
    (950, 5.0),
    (950, 8.5),
    (1150, 3.0),
    (1150, 5.0),
)
"""Spindle speed [rpm] and depth of cut [mm] of the cutting tests: two depths a speed, one on each side of the limit."""


@dataclass(frozen=True)
class DemoSize:
    """How much is measured; the default is the demonstration."""

    sweep_rate: float = SWEEP_RATE
    """Acceleration of the spindle in the sweeps [rad/s2]."""

    sweep_duration: float = SWEEP_DURATION
    """Time in the cut of a sweep [s]: from 600 to 1531 rpm, so that a tooth passes at 20 to 51 Hz."""

    hits: int = 5
    """Hits a direction."""

    actuator_step: float = 1.0
    """Step of the actuator from 20 to 80 Hz [Hz]."""

    cutting_tests: tuple[tuple[int, float], ...] = CUTTING_TESTS
    """Spindle speed [rpm] and depth of cut [mm] of each cutting test."""

    lobe_step: int = 5
    """Step of the spindle speeds from 600 to 1500 rpm at which the lobes are computed [rpm]."""


DEMO = DemoSize()


@dataclass(frozen=True)
class _Job:
    """One record: what it is called and how it comes about."""

    file: str
    make: Callable[[np.random.Generator], xr.Dataset]


def sweep_passes(
    seed: int, width: float = SWEEP_WIDTH, sensors: Sensors = SENSORS, duration: float = SWEEP_DURATION
) -> dict[str, xr.Dataset]:
    """Return the records of down, up and central milling sweeps on the demonstration machine.

    Parameters
    ----------
    seed : int
        Seed of the sensor noise.
    width : float, optional
        Width of cut [m].
    sensors : Sensors, optional
        Sensor noise; default: that of the published set-up.
    duration : float, optional
        Time in the cut [s].
    """
    rng = np.random.default_rng(seed)
    return {cut: _sweep(cut, width, sensors, duration, SWEEP_RATE)(rng) for cut in ("down", "up", "central")}


def _sweep(
    cut: str, width: float, sensors: Sensors, duration: float, rate: float
) -> Callable[[np.random.Generator], xr.Dataset]:
    # The feed rate is held while the speed rises, so the feed per tooth falls during the sweep.
    feed = FEED_PER_TOOTH * TOOL.tooth_passing_frequency(SWEEP_START)
    milling = MillingCut(TOOL, engagement(cut, width, TOOL.diameter), MATERIAL, SWEEP_DEPTH, feed_rate=feed)
    spindle = Spindle(SWEEP_START, rate)
    return lambda rng: milling_trial(MACHINE, milling, spindle, duration, sensors, rng)


def _hammer(axis: str, hits: int) -> Callable[[np.random.Generator], xr.Dataset]:
    sensors = Sensors((1.0, 1.0, 1.0), SENSORS.acceleration_noise)
    return lambda rng: hammer_trial(MACHINE, axis, list(rng.uniform(3.0, 5.0, hits)), sensors, rng)


def _hammer_in_motion(axis: str, hits: int) -> Callable[[np.random.Generator], xr.Dataset]:
    """The same test while x moves at the feed of the sweeps: the ripple of its drive is in the record."""
    ripple = (Tone("acceleration_x", 0.05, 44.0), Tone("acceleration_x", 0.02, 88.0))
    sensors = Sensors((1.0, 1.0, 1.0), SENSORS.acceleration_noise, stages=ripple)
    return lambda rng: hammer_trial(MACHINE, axis, list(rng.uniform(3.0, 5.0, hits)), sensors, rng)


def _actuator(axis: str, step: float) -> Callable[[np.random.Generator], xr.Dataset]:
    sensors = Sensors((0.5, 0.5, 0.5), SENSORS.acceleration_noise)
    steps = np.arange(20.0, 80.5, step)
    return lambda rng: actuator_trial(MACHINE, axis, steps, 100.0, sensors, rng, sample_rate=1000.0)


def _cutting_test(speed: int, depth: float) -> Callable[[np.random.Generator], xr.Dataset]:
    arc = engagement("down", TEST_WIDTH, TOOL.diameter)
    milling = MillingCut(TOOL, arc, MATERIAL, depth * 1e-3, feed_per_tooth=FEED_PER_TOOTH)
    spindle = Spindle(speed * math.pi / 30.0)
    return lambda rng: milling_trial(MACHINE, milling, spindle, 8.0, SENSORS, rng, lead=0.25, tail=0.25)


def _test_file(speed: int, depth: float) -> str:
    return f"records/cut_{speed}rpm_{depth:g}mm.csv"


def _jobs(size: DemoSize) -> list[_Job]:
    jobs = [_Job(f"records/hammer_{a}.csv", _hammer(a, size.hits)) for a in "xyz"]
    jobs += [_Job(f"records/actuator_{a}.mat", _actuator(a, size.actuator_step)) for a in "xyz"]
    jobs += [
        _Job(f"records/sweep_{cut}.nc", _sweep(cut, SWEEP_WIDTH, SENSORS, size.sweep_duration, size.sweep_rate))
        for cut in ("down", "up", "central")
    ]
    # Seeds go by number: what is added comes last, so that the other records stay as they were.
    jobs += [_Job(_test_file(*test), _cutting_test(*test)) for test in size.cutting_tests]
    return jobs + [_Job(f"records/hammer_moving_{a}.csv", _hammer_in_motion(a, size.hits)) for a in "xyz"]


def write_demo(folder: Path, seed: int = DEMO_SEED, progress: Progress = silent, size: DemoSize = DEMO) -> Path:
    """Simulate the campaign and write its records and campaign file.

    Parameters
    ----------
    folder : Path
        Where ``campaign.toml`` and ``records/`` go.
    seed : int, optional
        Seed of all sensor noise; each record has its own stream.
    progress : callable, optional
        Called with (what, done, of).
    size : DemoSize, optional
        How much is measured.

    Returns
    -------
    Path
        The campaign file.
    """
    jobs = _jobs(size)
    streams = np.random.SeedSequence(seed).spawn(len(jobs))
    writers: Mapping[str, Callable[[xr.Dataset, Path], object]] = {
        ".csv": write_record_csv,
        ".mat": write_record_mat,
        ".nc": write_record_netcdf,
    }
    for done, (job, stream) in enumerate(zip(jobs, streams, strict=True)):
        progress(f"simulating {job.file}", done, len(jobs))
        path = folder / job.file
        path.parent.mkdir(parents=True, exist_ok=True)
        writers[path.suffix](job.make(np.random.default_rng(stream)), path)
    progress("records written", len(jobs), len(jobs))
    return write_atomically(folder / "campaign.toml", lambda p: p.write_text(campaign_text(size), encoding="utf-8"))


def campaign_text(size: DemoSize = DEMO) -> str:
    """Return the campaign file of the demonstration."""
    lobes = _LOBES.format(step=size.lobe_step)
    return _HEAD + _models() + _MEASUREMENTS + lobes + _cutting_tests(size.cutting_tests)


def _models() -> str:
    rows = [
        f'    {{ frequency = "{f:g} Hz", damping = {z:g}, stiffness = "{k / 1e6:g} N/um", '
        f"direction = [{d[0]:g}, {d[1]:g}, {d[2]:g}] }},\n"
        for f, z, k, d in zip(MACHINE.frequency, MACHINE.damping, MACHINE.stiffness, MACHINE.direction, strict=True)
    ]
    head = '[[model]]                 # what was simulated; of a real machine it is not known\nname = "known_machine"\n'
    return head + "modes = [\n" + "".join(rows) + "]\n"


def _cutting_tests(tests: tuple[tuple[int, float], ...]) -> str:
    return "".join(
        f'\n[[cutting_test]]\nfile = "{_test_file(speed, depth)}"\nspindle_speed = "{speed} rpm"\n'
        f'depth_of_cut = "{depth:g} mm"\ncut = "down"\nwidth_of_cut = "{TEST_WIDTH * 1e3:g} mm"\n'
        f'feed_per_tooth = "{FEED_PER_TOOTH * 1e3:g} mm"\n'
        for speed, depth in tests
    )


_HEAD = """\
# A measuring campaign on a simulated machine: three sweeps, hammer tests at rest and in motion, an actuator test, six
# cutting tests. Feed and method can be separated, because there is a hammer test at either feed; method and level
# (the depth of cut of a sweep, the force of an actuator) cannot, and explained.csv says so.
[campaign]
name = "Simulated milling machine"

[tool]
diameter = "80 mm"
teeth = 2
approach_angle = "45 deg"

[material]
name = "C45 steel"
Ktc = "1889.2 N/mm^2"
Krc = "806.1 N/mm^2"
Kac = "291.0 N/mm^2"
Kte = "63.12 N/mm"
Kre = "113.7 N/mm"
Kae = "-3.1 N/mm"

[channels]
time = { column = "t", unit = "s" }
force_x = { column = "Fx", unit = "N" }
force_y = { column = "Fy", unit = "N" }
force_z = { column = "Fz", unit = "N" }
acceleration_x = { column = "ax", unit = "m/s^2" }
acceleration_y = { column = "ay", unit = "m/s^2" }
acceleration_z = { column = "az", unit = "m/s^2" }
spindle_speed = { column = "n", unit = "rpm" }

"""

_MEASUREMENTS = """
[[measurement]]
name = "hammer"
method = "hammer"
feed = "0 mm/min"
frequency_range = ["15 Hz", "90 Hz"]
records = [
    { file = "records/hammer_x.csv", excitation = "x" },
    { file = "records/hammer_y.csv", excitation = "y" },
    { file = "records/hammer_z.csv", excitation = "z" },
]

[[measurement]]           # the same test at the feed of the sweeps: what differs from the first is the feed alone
name = "hammer_moving"
method = "hammer"
feed = { x = "120 mm/min" }
frequency_range = ["15 Hz", "90 Hz"]
records = [
    { file = "records/hammer_moving_x.csv", excitation = "x" },
    { file = "records/hammer_moving_y.csv", excitation = "y" },
    { file = "records/hammer_moving_z.csv", excitation = "z" },
]

[[measurement]]
name = "actuator"
method = "actuator"
feed = "0 mm/min"
force_level = "100 N"
records = [
    { file = "records/actuator_x.mat", excitation = "x" },
    { file = "records/actuator_y.mat", excitation = "y" },
    { file = "records/actuator_z.mat", excitation = "z" },
]

[[measurement]]
name = "sweep"
method = "sweep"
feed = { x = "120 mm/min" }
feed_per_tooth = "0.1 mm"
depth_of_cut = "2 mm"
frequency_range = ["20 Hz", "80 Hz"]
records = [
    { file = "records/sweep_down.nc", cut = "down", width_of_cut = "12 mm" },
    { file = "records/sweep_up.nc", cut = "up", width_of_cut = "12 mm" },
    { file = "records/sweep_central.nc", cut = "central", width_of_cut = "12 mm" },
]

[[measurement]]           # the same records with force x as the only reference, to compare with
name = "sweep_force_x_only"
method = "sweep"
feed = { x = "120 mm/min" }
feed_per_tooth = "0.1 mm"
depth_of_cut = "2 mm"
frequency_range = ["20 Hz", "80 Hz"]
references = "x"
records = [
    { file = "records/sweep_down.nc", cut = "down", width_of_cut = "12 mm" },
    { file = "records/sweep_up.nc", cut = "up", width_of_cut = "12 mm" },
    { file = "records/sweep_central.nc", cut = "central", width_of_cut = "12 mm" },
]
"""

_LOBES = """
[[lobes]]
measurements = ["hammer", "actuator", "sweep", "known_machine"]
method = "zero_order"
cut = "down"
width_of_cut = "40 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["600 rpm", "1500 rpm", "{step} rpm"]
"""
