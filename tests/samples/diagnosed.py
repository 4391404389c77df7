"""Small campaigns of each kind of baseline, and the families that are diagnosed of them, without data that matter."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.labels import make_record
from process.machine.modes import ModalModel
from smfe.campaign import Campaign, load_campaign
from smfe.diagnosis.cases.experiments import proposed_experiments, proposed_modal_experiments
from smfe.diagnosis.cutting.forces import cutting_family
from smfe.diagnosis.cutting.limits import Limit, limit_family
from smfe.diagnosis.cutting.orders import SteadyCut
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.inference.problem import Condition, Family

F = np.linspace(10.0, 150.0, 20)
TOOL = (
    '[tool]\ndiameter = "25 mm"\nteeth = 4\n[material]\nKtc = "2000 N/mm^2"\nKrc = "600 N/mm^2"\nKac = "300 N/mm^2"\n'
)
CHANNELS = '[channels]\ntime = { column = "t", unit = "s" }\n'
AXIS = """[baseline]
axis = "x"
moving_mass = "23.1 kg"
tip_mass = "11.3 kg"
stiffness = "1.68 N/um"
damping = "104 N s/m"
controllers = { K2 = { Kp = "6268 N s/m", Ti = "10.9 ms", Kv = "45.5 1/s" } }
friction = { law = "viscous", sigma = "168 N s/m" }
"""
MODES = """[[model]]
name = "maker"
modes = [{ frequency = "60 Hz", damping = "4 %", stiffness = "20 N/um", direction = [1, 0.2, 0] }]
[baseline]
from = "maker"
"""
HIT = """[[measurement]]
name = "hammer_500"
method = "hammer"
feed = { x = "500 mm/min" }
controller = "K2"
accelerometer_mass = "30 g"
started = 2026-01-05
held_out = false
records = [{ file = "hit.csv", excitation = "x" }]
"""
CUT = """[[cutting_test]]
file = "cut.csv"
spindle_speed = "3000 rpm"
depth_of_cut = "2 mm"
cut = "down"
width_of_cut = "12.5 mm"
feed_per_tooth = "0.1 mm"
observed = "stable"
"""
MOVED = """[[measurement]]
name = "moved"
method = "drive"
records = [{ file = "moved.csv" }]
"""


def campaign(folder: Path, *tables: str) -> Campaign:
    for name in ("hit.csv", "cut.csv", "moved.csv"):
        (folder / name).write_text("t,a\n0,0\n", encoding="utf-8")
    (folder / "campaign.toml").write_text("\n".join(['[campaign]\nname = "shop"', *tables]), encoding="utf-8")
    return load_campaign(folder / "campaign.toml")


def appended(given: Campaign, block: str) -> Campaign:
    """The campaign with a block appended as it stands, its records made."""
    for line in block.splitlines():
        for name in line.split('"'):
            if name.startswith("record_"):
                (given.path.parent / name).write_text("t,a\n0,0\n", encoding="utf-8")
    longer = given.path.with_name("longer.toml")
    longer.write_text(given.path.read_text(encoding="utf-8") + "\n" + block, encoding="utf-8")
    return load_campaign(longer)


def condition(name: str, feed: float = 500.0) -> Condition:
    excited = Excited(F, (("x", "x"),), np.full((F.size, 1), 3e-8), "hammer", 1.0, 4e-3, {"x": feed / 6e4}, "K2")
    settings = {"method": "hammer", "feed": feed / 6e4, "level": 1.0, "controller": "K2", "order": 0.0}
    return Condition(name, {**settings, "position": 0.1}, None, name, excited)


def axis() -> MachineFrfs:
    baseline = AxisBaseline(Drive(23.1, 11.3, 1.68e6, 104.0, sigma=168.0), {"K2": Servo(6268.0, 10.9e-3, 45.5)})
    family = MachineFrfs(baseline, (condition("hammer_500"),))
    return replace(family, proposals=proposed_experiments(family))


def modal() -> ModalFrfs:
    modes = ModalModel(np.array([60.0]), np.array([0.04]), np.array([2e7]), np.array([[1.0, 0.2, 0.0]]))
    return ModalFrfs(modes, (condition("hammer_500"),), proposed_modal_experiments([condition("hammer_500")]))


def forces() -> Family:
    rng, arc = np.random.default_rng(1), engagement("down", 0.0125, 0.025)
    record = make_record(np.arange(40000) * 1e-4, {"force": {a: rng.standard_normal(40000) for a in "xyz"}})
    cut = SteadyCut(100.0 * math.pi, 1e-4, 2e-3, arc)
    more = {"twice": replace(cut, feed_per_tooth=2e-4), "air": replace(cut, depth=0.0)}
    return cutting_family({"cut": (record, cut)}, Tool(0.025, 4), (2e9, 6e8, 3e8), more)


def limits() -> Family:
    modes = ModalModel(np.array([60.0]), np.array([0.04]), np.array([2e7]), np.array([[1.0, 0.2, 0.0]]))
    arc = engagement("down", 0.0125, 0.025)
    return limit_family([Limit(3000.0, 2e-3)], modes, Tool(0.025, 4), arc, CuttingCoefficients(2e9, 6e8, 3e8))


def moved(seconds: float = 24.0) -> DriveRecordFamily:
    """An axis of 95 kg that goes to and fro over 0.1 m, quickly, with viscous friction and white noise."""
    step = 4e-3
    t = np.arange(0.0, seconds, step)
    a = 3.0 * np.sign(np.sin(2.0 * np.pi * t / 1.2)) * (np.abs(np.sin(2.0 * np.pi * t / 1.2)) > 0.4)
    v = np.cumsum(a) * step
    v -= v.mean()
    x = np.cumsum(v) * step
    force = 95.0 * np.gradient(np.gradient(x, step), step) + 200.0 * v
    force += 2.0 * np.random.default_rng(3).standard_normal(t.size)
    record = make_record(t, {"encoder_position": {"x": x}, "drive_force": {"x": force}})
    return DriveRecordFamily.from_record(record, lead=0.02)
