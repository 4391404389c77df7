"""From the records of the independent generator to conditions that can be diagnosed, and the baselines of the exam."""

import math
from dataclasses import replace

import numpy as np
from truth.axis import MM_MIN, Truth
from truth.campaign import PRETRIGGER, SAMPLE_RATE, reduce

from process.drive import Drive
from process.servo import Servo
from smfe.diagnosis.axis_baseline import AxisBaseline, sampled
from smfe.diagnosis.frf_noise import Excited, chosen_lines, scatter_of
from smfe.diagnosis.machine_frf import MachineFrfs, compliance_under
from smfe.diagnosis.problem import Condition

BAND = (8.0, 128.0)
FLOOR = 0.01
"""Share of a line that two simulations of the same machine are allowed to differ by."""

FLOOR_AT_REST = 0.03
"""The same where a blow breaks the guideway away from rest: 2 to 3 % were measured at 400 N, 1 % or less elsewhere."""

BREAKS_AWAY = 200.0
"""Level [N] above which a blow does."""

BETWEEN_SIDES = 0.07
"""Half the difference between the sides of Table 1: at rest the production law has one side only, their mean."""

HALF_SINE_WIDTH = math.sqrt(0.25 - 2.0 / math.pi**2)
WINDOW = 1.9


def pulses(force):
    """Impulse [N s], width [s] and share of a second blow of each hit, shape (r,)."""
    start = round(PRETRIGGER * SAMPLE_RATE) - 4
    x = force[:, start : start + round(0.03 * SAMPLE_RATE)]
    t = np.arange(x.shape[1]) / SAMPLE_RATE
    once = np.where(t < 9e-3, x, 0.0)
    total = once.sum(axis=1)
    mean = once @ t / total
    width = np.sqrt(np.maximum(once @ t**2 / total - mean**2, 0.0)) / HALF_SINE_WIDTH
    again = x[:, t > 11e-3].max(axis=1) / x.max(axis=1)
    return total / SAMPLE_RATE, width, again


def without_bounces(record):
    """The record without double hits, as the audit has it, where three or more are left."""
    good = pulses(record["force"])[2] < 0.05
    if record["condition"].method != "hammer" or good.all() or good.sum() < 3:
        return record
    return {**record, "force": record["force"][good], "acceleration": record["acceleration"][good]}


def hits_of(record, frequency):
    """Compliance from each hit, shape (r, f)."""
    n = record["time"].size
    f = np.fft.rfftfreq(n, 1.0 / SAMPLE_RATE)
    lines = np.searchsorted(f, frequency - 1e-9)
    quiet = round(0.9 * PRETRIGGER * SAMPLE_RATE)
    force, response = (
        np.fft.rfft(record[k] - record[k][:, :quiet].mean(axis=1, keepdims=True))[:, lines]
        for k in ("force", "acceleration")
    )
    return response / force / -((2.0 * np.pi * frequency) ** 2)


def excited_by(record):
    """How a record was excited, with its noise."""
    plan = record["condition"]
    floor = FLOOR_AT_REST if plan.feed == 0.0 and plan.level > BREAKS_AWAY else FLOOR
    record = without_bounces(record)
    found = reduce(record)
    common = {"feed": {"x": plan.feed * MM_MIN}, "controller": plan.controller}
    pick = chosen_lines(found["frequency"], BAND)
    f, h = found["frequency"][pick], found["compliance"][pick]
    if plan.method == "actuator":
        std = np.hypot(found["std"][pick], floor * np.abs(h))
        return Excited(f, (("x", "x"),), std[:, None], "actuator", plan.level, **common), h
    std, shared = scatter_of(hits_of(record, found["frequency"]), pulses(record["force"])[0])
    std = np.hypot(std[pick], floor * np.abs(h))
    impulse, width, _ = pulses(record["force"])
    level = float(np.sum(impulse**3) / np.sum(impulse**2))
    return Excited(
        f,
        (("x", "x"),),
        std[:, None],
        "hammer",
        level,
        float(width.mean()),
        shared=shared[:, pick, None],
        window=WINDOW,
        **common,
    ), h


def side_at_rest(excited):
    """What it makes of a blow at rest that one law stands for the two sides of the guideway, (1, f, 1)."""
    plain = baseline()
    values = {p.name: p.start for p in plain.nuisances()}
    one, other = (
        compliance_under(plain.machine(plain.effective(values | {"friction_level": level}, {}, 0.0)), excited)
        for level in (-BETWEEN_SIDES, BETWEEN_SIDES)
    )
    return 0.5 * (other - one)[None]


def condition_of(record, name=None):
    """A measured condition of the exam."""
    plan = record["condition"]
    excited, h = excited_by(record)
    if plan.feed == 0.0 and plan.method == "hammer":
        excited = replace(excited, shared=np.concatenate([excited.shared, side_at_rest(excited)]))
    # The direction is in the sign of the feed; twice the same contrast would be held out twice.
    settings = {key: value for key, value in plan.settings().items() if key not in ("direction", "method")}
    return Condition(name or plan.name, settings, excited.whitened(h[:, None]), "", excited)


def conditions_of(records):
    """Every record with an excitation, under names of their own."""
    used = [r for r in records if r["condition"].method != "silent"]
    names = [r["condition"].name for r in used]
    return tuple(
        condition_of(r, f"{n}, at {r['condition'].order:.2f}" if names.count(n) > 1 else n)
        for r, n in zip(used, names, strict=True)
    )


def baseline(friction="stribeck", truth=None):
    """Nominal axis that knows no friction but viscous, Coulomb friction, or all of Table 1 ("stribeck")."""
    t = truth or Truth()
    f, c = t.friction, t.control
    known = {"viscous": f.viscous}
    if friction != "viscous":
        known["coulomb"] = f.coulomb
    if friction == "stribeck":
        known |= {"static": f.static, "stribeck_speed": f.stribeck}
    servos = {n: sampled(Servo(s.kp, s.ti, s.kv), c.period, c.lag, c.extra) for n, s in t.servos.items()}
    drive = Drive(t.moving_mass, t.tip_mass, t.joint.stiffness, t.joint.damping, sigma=sum(f.viscous) / 2.0)
    spread = {"moving_mass": 0.05, "tip_mass": 0.05, "stiffness": 0.05, "damping": 0.2, "viscous": 0.2}
    return AxisBaseline(drive, servos, "x", known, spread)


def family(records, friction="stribeck", proposals=(), without=()):
    """What is diagnosed."""
    return MachineFrfs(baseline(friction), conditions_of(records), tuple(proposals), without)
