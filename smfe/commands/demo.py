"""A whole measuring campaign on one virtual machine: friction that holds the x axis at rest and not in the cut.

The machine is the story of Franco et al. 2024 (JMMP 8/5/207) at the size of a small mill. At rest the guideway of x
sticks: a hammer finds the structure on a carriage that is held. In a cut the carriage slides, friction no longer
resists a small vibration, and what holds it is the servo, softer and less damped. Lobes of the machine at rest promise
a depth at which it chatters. y and z stand still and bend as one mode each.

Everything is integrated in time with bristle friction and seen through noisy sensors. The campaign file knows nothing
of that: its ``[baseline]`` is what the maker of such a machine states, two masses with viscous friction.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import xarray as xr

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.servo import Servo
from process.friction.laws import LuGre
from process.instruments.sensors import Sensors
from process.instruments.trials import Running, hammer_trial, milling_trial
from process.machine.machine import FeedAxis, Machine
from process.machine.structure import Structure
from process.simulation.milling import MillingCut, Spindle
from smfe.commands.run import run
from smfe.progress import Progress, part, silent
from smfe.records import write_record_csv, write_record_netcdf
from smfe.results import write_atomically

MM_MIN = 1e-3 / 60.0
RPM = math.pi / 30.0

SERVO = Servo(Kp=48e3, Ti=3e-3, Kv=25.0, delay=1.8e-3)
FRICTION = LuGre(4.5e8, 5e4, coulomb=15.0, static=20.0, stribeck_speed=6e-3, sigma=300.0)
TOOL = Tool(diameter=0.080, teeth=3, approach_angle=math.radians(45.0))
MATERIAL = CuttingCoefficients(1889.2e6, 806.1e6, 291.0e6, 63.12e3, 113.7e3, -3.1e3)
SENSORS = Sensors(force_noise=(1.0, 1.0, 1.0), acceleration_noise=(0.005, 0.005, 0.005))
HAMMER_SENSORS = Sensors(force_noise=(0.02, 0.02, 0.02), acceleration_noise=(3e-4, 3e-4, 3e-4))
DEMO_SEED = 20240807

HITS = 5
SWEEP_START, SWEEP_RATE, SWEEP_DURATION = 450.0 * RPM, 2.5, 44.0  # rad/s, rad/s2, s: to 1500 rpm
SWEEP_FEED = 450.0 * MM_MIN
SWEEP_DEPTH = 1e-3
SWEEP_PASSES = {"down": 0.056, "up": 0.024, "central": 0.064}
"""Width of cut [m] of each pass: the force along x is alike in all, so that the guideway slides alike in all."""

FEED_PER_TOOTH = 0.15e-3
CUT_WIDTH = 0.070
CUTTING_TESTS: tuple[tuple[int, float], ...] = (
    (720, 7.0),
    (900, 1.5),
    (900, 4.5),
    (950, 4.0),
    (1100, 1.5),
    (1100, 5.0),
)
"""Spindle speed [rpm] and depth of cut [mm] of the cutting tests."""


def _machine() -> Machine:
    """Return the machine: x of two masses with a slide, y and z one mode each; the head nods, so that x moves y too."""
    stiffness, damping = 16e6, 6270.0
    k, c, tool = np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((3, 4))
    spring = np.array([[1.0, -1.0], [-1.0, 1.0]])
    k[:2, :2], c[:2, :2] = stiffness * spring, damping * spring
    mass = [96.0, 200.0]
    for i, (f, zeta, modal) in enumerate(((110.0, 0.06, 200e6), (150.0, 0.05, 240e6)), 2):
        w = 2.0 * math.pi * f
        mass.append(modal / w**2)
        k[i, i], c[i, i] = modal, 2.0 * zeta * modal / w
    tool[:, 0], tool[:, 2], tool[:, 3] = [1.0, 0.1, 0.0], [0.0, 0.98, 0.2], [0.0, -0.2, 0.98]
    structure = Structure(np.diag(mass), c, k, tool, {"x": np.array([0.0, 1.0, 0.0, 0.0])})
    return Machine(structure, {"x": FeedAxis(SERVO, FRICTION)})


MACHINE = _machine()


Make = Callable[[np.random.Generator], xr.Dataset]
"""Makes a record; all that is random is drawn from the generator."""


def _sweep(cut: str) -> Make:
    # The feed rate is held while the speed rises, so that one state of the guideway is measured.
    arc = engagement(cut, SWEEP_PASSES[cut], TOOL.diameter)
    milling = MillingCut(TOOL, arc, MATERIAL, SWEEP_DEPTH, feed_rate=SWEEP_FEED)
    spindle = Spindle(SWEEP_START, SWEEP_RATE)
    running = Running({"x": SWEEP_FEED})
    return lambda rng: milling_trial(MACHINE, milling, spindle, SWEEP_DURATION, SENSORS, rng, running=running)


def _impulse(axis: str, feed: float) -> float:
    """Mean impulse of a hit [N s]: at rest so little that the guideway withstands it, which x feels most of all."""
    if feed > 0.0:
        return 0.2
    return 0.018 if axis == "x" else 0.1


def _hammer(axis: str, feed: float) -> Make:
    running = Running({"x": feed * MM_MIN})

    def make(rng: np.random.Generator) -> xr.Dataset:
        impulses = list(_impulse(axis, feed) * rng.uniform(0.85, 1.15, HITS))
        return hammer_trial(MACHINE, axis, impulses, HAMMER_SENSORS, rng, interval=2.5, running=running)

    return make


def _cutting_test(speed: int, depth: float) -> Make:
    arc = engagement("central", CUT_WIDTH, TOOL.diameter)
    milling = MillingCut(TOOL, arc, MATERIAL, depth * 1e-3, feed_per_tooth=FEED_PER_TOOTH)
    spindle = Spindle(speed * RPM)
    running = Running({"x": FEED_PER_TOOTH * TOOL.teeth * speed / 60.0})
    return lambda rng: milling_trial(
        MACHINE, milling, spindle, 8.0, SENSORS, rng, lead=0.25, tail=0.25, running=running
    )


def _test_file(speed: int, depth: float) -> str:
    return f"records/cut_{speed}rpm_{depth:g}mm.csv"


def records() -> list[tuple[str, Make]]:
    """Return the file of each record, in the folder of the campaign, and what makes it."""
    found = [(f"records/sweep_{cut}.nc", _sweep(cut)) for cut in SWEEP_PASSES]
    found += [(_test_file(*test), _cutting_test(*test)) for test in CUTTING_TESTS]
    found += [(f"records/hammer_{a}.csv", _hammer(a, 0.0)) for a in "xyz"]
    found += [(f"records/hammer_600_{a}.csv", _hammer(a, 600.0)) for a in "xyz"]
    return found + [(f"records/hammer_{f}_x.csv", _hammer("x", f)) for f in (200, 300)]


def write_demo(folder: Path, seed: int = DEMO_SEED, progress: Progress = silent) -> Path:
    """Simulate the campaign and write its records and campaign file.

    Parameters
    ----------
    folder : Path
        Where ``campaign.toml`` and ``records/`` go.
    seed : int, optional
        Seed of hits and sensor noise; each record has its own stream.
    progress : callable, optional
        Called with (what, done, of).

    Returns
    -------
    Path
        The campaign file.
    """
    made = records()
    streams = np.random.SeedSequence(seed).spawn(len(made))
    writers: Mapping[str, Callable[[xr.Dataset, Path], object]] = {
        ".csv": write_record_csv,
        ".nc": write_record_netcdf,
    }
    (folder / "records").mkdir(parents=True, exist_ok=True)

    def write(number: int) -> str:
        file, make = made[number]
        writers[Path(file).suffix](make(np.random.default_rng(streams[number])), folder / file)
        return file

    # The integration lets go of the interpreter: two records are made at once.
    with ThreadPoolExecutor(2) as pool:
        for done, file in enumerate(pool.map(write, range(len(made))), 1):
            progress(f"simulated {file}", done, len(made))
    return write_atomically(folder / "campaign.toml", lambda p: p.write_text(campaign_text(), encoding="utf-8"))


def campaign_text() -> str:
    """Return the campaign file of the demonstration."""
    tests = "".join(
        f'\n[[cutting_test]]\nfile = "{_test_file(speed, depth)}"\nspindle_speed = "{speed} rpm"\n'
        f'depth_of_cut = "{depth:g} mm"\ncut = "central"\nwidth_of_cut = "{CUT_WIDTH * 1e3:g} mm"\n'
        f'feed_per_tooth = "{FEED_PER_TOOTH * 1e3:g} mm"\n'
        for speed, depth in CUTTING_TESTS
    )
    return _CAMPAIGN + tests


def demo(out: Path | str, seed: int = DEMO_SEED, progress: Progress = silent) -> Path:
    """Simulate a whole measuring campaign, write it to ``out/`` and run it into ``out/results``.

    Records and campaign file are made anew each time; the same seed makes the same records.
    """
    folder = Path(out)
    campaign = write_demo(folder, seed, part(progress, 0.0, 0.3))
    return run(campaign, folder / "results", progress=part(progress, 0.3, 1.0))


_CAMPAIGN = """\
# A measuring campaign on a virtual milling machine, told as a shop would meet it.
#
# At rest the guideway of x sticks: the hammer finds a stiff machine and promises deep cuts. In the cut x moves,
# friction no longer holds it, and the machine chatters far below. The cutting tests say so, the sweeps predict it, and
# the diagnosis names what the maker's simulation ([baseline]) leaves out.
[campaign]
name = "Virtual milling machine with guideway friction"

[tool]
diameter = "80 mm"
teeth = 3
approach_angle = "45 deg"
edge_length = "11 mm"     # of an insert: at 45 deg no cut deeper than 7.7 mm is recommended

[material]
name = "C45 steel"
Ktc = "1889.2 N/mm^2"
Krc = "806.1 N/mm^2"
Kac = "291.0 N/mm^2"
Kte = "63.12 N/mm"
Kre = "113.7 N/mm"
Kae = "-3.1 N/mm"
uncertainty = "5 %"        # another batch of the steel cuts with 5 % more or less force

[channels]                # columns of the records: name and unit
time = { column = "t", unit = "s" }
force_x = { column = "Fx", unit = "N" }
force_y = { column = "Fy", unit = "N" }
force_z = { column = "Fz", unit = "N" }
acceleration_x = { column = "ax", unit = "m/s^2" }
acceleration_y = { column = "ay", unit = "m/s^2" }
acceleration_z = { column = "az", unit = "m/s^2" }
spindle_speed = { column = "n", unit = "rpm" }

# --- What was measured

[[measurement]]           # at rest, in all three directions: what most shops do, and stop there
name = "hammer"
method = "hammer"
feed = "0 mm/min"
frequency_range = ["25 Hz", "150 Hz"]
records = [
    { file = "records/hammer_x.csv", excitation = "x" },
    { file = "records/hammer_y.csv", excitation = "y" },
    { file = "records/hammer_z.csv", excitation = "z" },
]

[[measurement]]           # the same hits while x moves
name = "hammer_moving"
method = "hammer"
feed = { x = "600 mm/min" }
frequency_range = ["25 Hz", "150 Hz"]
records = [
    { file = "records/hammer_600_x.csv", excitation = "x" },
    { file = "records/hammer_600_y.csv", excitation = "y" },
    { file = "records/hammer_600_z.csv", excitation = "z" },
]

[[measurement]]           # x alone at a slow feed: does friction depend on the feed?
name = "hammer_slow"
method = "hammer"
feed = { x = "200 mm/min" }
frequency_range = ["25 Hz", "150 Hz"]
records = [{ file = "records/hammer_200_x.csv", excitation = "x" }]

[[measurement]]           # a feed that no fit sees: the diagnosis is examined on it
name = "hammer_300"
method = "hammer"
feed = { x = "300 mm/min" }
frequency_range = ["25 Hz", "150 Hz"]
held_out = true
records = [{ file = "records/hammer_300_x.csv", excitation = "x" }]

[[measurement]]           # milling itself excites: three passes while the spindle speeds up
name = "sweep"
method = "sweep"
feed = { x = "450 mm/min" }
depth_of_cut = "1 mm"
frequency_range = ["22 Hz", "150 Hz"]
records = [
    { file = "records/sweep_down.nc", cut = "down", width_of_cut = "56 mm" },
    { file = "records/sweep_up.nc", cut = "up", width_of_cut = "24 mm" },
    { file = "records/sweep_central.nc", cut = "central", width_of_cut = "64 mm" },
]

# --- What the maker's simulation says: a carriage and a head, a drive, and friction as a damper

[baseline]
axis = "x"
moving_mass = "208 kg"    # carriage, from the drawing
tip_mass = "92 kg"        # head, spindle and tool
stiffness = "16.5 N/um"    # between the two
damping = "6000 N s/m"
Kp = "48000 N s/m"        # read from the control
Ti = "3 ms"
Kv = "25 1/s"
delay = "1.8 ms"
friction = { law = "viscous", sigma = "10000 N s/m" }   # 17 N of drive force at 100 mm/min, taken as viscous

# --- The cut that is wanted, and the cutting tests

[[lobes]]
measurements = ["hammer", "hammer_moving", "sweep"]
method = "zero_order"
cut = "central"
width_of_cut = "70 mm"
feed_per_tooth = "0.15 mm"
spindle_speed = ["600 rpm", "1500 rpm", "5 rpm"]
"""
