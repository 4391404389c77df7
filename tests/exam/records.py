"""From the records of the independent generator to conditions that can be diagnosed, and the baselines of the exam."""

import math
from dataclasses import replace

import numpy as np
from truth.axis import MM_MIN, Truth
from truth.campaign import PRETRIGGER, SAMPLE_RATE, reduce

from process.drive.axis import Drive
from process.drive.sampled_servo import SampledServo
from process.drive.servo import Servo
from smfe.diagnosis.frf.axis import MachineFrfs, as_hit
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.frf.noise import Excited, Hits, chosen_lines, degrees_of_freedom_of, scatter_of, smooth_errors
from smfe.diagnosis.inference.problem import Condition

BAND = (8.0, 128.0)
DISCREPANCY = 0.004
"""Smooth relative error that two simulations of the same machine may differ by."""

FLOOR = 0.002
"""The same of what is not smooth, line by line."""

CONTACT = 0.025
"""Time [s] of a hit."""

HALF_SINE_WIDTH = math.sqrt(0.25 - 2.0 / math.pi**2)
WINDOW = 1.9


def pulses(force):
    """Impulse [N s], width [s] and share of a second hit of each hit, shape (r,)."""
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
    """The hits one by one: force and compliance (r, f, 1)."""
    n = record["time"].size
    f = np.fft.rfftfreq(n, 1.0 / SAMPLE_RATE)
    lines = np.searchsorted(f, frequency - 1e-9)
    quiet = round(0.9 * PRETRIGGER * SAMPLE_RATE)
    centred = {k: record[k] - record[k][:, :quiet].mean(axis=1, keepdims=True) for k in ("force", "acceleration")}
    force, response = (np.fft.rfft(x)[:, lines] for x in centred.values())
    start = round(PRETRIGGER * SAMPLE_RATE)
    pulse = centred["force"][:, start : start + round(CONTACT * SAMPLE_RATE)]
    return Hits(pulse, SAMPLE_RATE, (response / force / -((2.0 * np.pi * frequency) ** 2))[:, :, None])


def excited_by(record):
    """How a record was excited, with its noise."""
    plan = record["condition"]
    record = without_bounces(record)
    found = reduce(record)
    common = {"feed": {"x": plan.feed * MM_MIN}, "controller": plan.controller}
    pick = chosen_lines(found["frequency"], BAND)
    f, h = found["frequency"][pick], found["compliance"][pick, None]
    smooth = smooth_errors(f, h, DISCREPANCY)
    if plan.method == "actuator":
        std = np.hypot(found["std"][pick, None], FLOOR * np.abs(h))
        return Excited(f, (("x", "x"),), std, "actuator", plan.level, shared=smooth, **common), h
    hits = hits_of(record, found["frequency"])
    std, shared = scatter_of(hits.compliance[:, :, 0], hits.impulse)
    shared = np.concatenate([shared[:, pick, None], smooth])
    std = np.hypot(std[pick, None], FLOOR * np.abs(h))
    impulse, width, _ = pulses(record["force"])
    level, duration = (float(np.sum(impulse**2 * x) / np.sum(impulse**2)) for x in (impulse, width))
    hits = replace(hits, compliance=hits.compliance[:, pick])
    more = {"shared": shared, "window": WINDOW, "hits": hits, **common}
    more["degrees_of_freedom"] = degrees_of_freedom_of(len(hits.force), f.size)
    return Excited(f, (("x", "x"),), std, "hammer", level, duration, **more), h


def condition_of(record, name=None):
    """A measured condition of the exam."""
    plan = record["condition"]
    excited, h = excited_by(record)
    # The direction is in the sign of the feed; twice the same contrast would be held out twice.
    settings = {key: value for key, value in plan.settings().items() if key not in ("direction", "method")}
    return Condition(name or plan.name, settings, excited.whitened(h), "", excited)


def conditions_of(records):
    """Every record with an excitation, under names of their own."""
    used = [r for r in records if r["condition"].method != "silent"]
    names = [r["condition"].name for r in used]
    return tuple(
        condition_of(r, f"{n}, at {r['condition'].order:.2f}" if names.count(n) > 1 else n)
        for r, n in zip(used, names, strict=True)
    )


def sampled(servo: Servo, period: float, lag: int = 1, latency: float = 0.0) -> Servo:
    """Return the continuous servo that equals a sampled one whose velocity is the difference of two readings.

    To the second order of the period T: hold, lag and latency are a dead time, the rectangular integral is worth
    ``Kp (1 + T/(2 Ti))`` and ``Ti + T/2``, and the velocity, T/2 later than the position, makes ``Kp (1 + Kv T/2)`` and
    ``Kv/(1 + Kv T/2)`` with half a period more of dead time.

    Parameters
    ----------
    servo : Servo
        Gains, without a delay.
    period : float
        Sampling period [s].
    lag : int, optional
        Whole periods from reading to force.
    latency : float, optional
        Further dead time [s].
    """
    plain, later = SampledServo(servo, period, lag).continuous(), 1.0 + 0.5 * servo.Kv * period
    return replace(plain, Kp=plain.Kp * later, Kv=plain.Kv / later, delay=plain.delay + latency + 0.5 * period)


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
    return AxisBaseline(drive, servos, "x", known, spread, period=0.0)


def family(records, friction="stribeck", proposals=(), without=()):
    """What is diagnosed."""
    found = MachineFrfs(baseline(friction), conditions_of(records), tuple(proposals), without)
    return as_hit(found, DISCREPANCY)
