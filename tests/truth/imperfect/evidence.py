"""Campaigns of one feed axis with all evidence: hits at rest and in motion, a drive record, twelve cutting tests.

The axis is that of `truth.axis`; its hits come from there. Moves and cuts are integrated here, in steps of 25 us: two
masses, bristles of LuGre, a sampled P-PI servo with a late force, and four teeth in a slot that meet the surface which
the tooth before them left. With four teeth in a slot forces along the feed do not change over a turn, so that a limit
depth is the same by any theory; it is found here by force, from whether a push grows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numba import njit
from scipy import signal

from truth.axis import MM_MIN, RATE, Control, Friction, Joint, Servo, Setting, Truth, simulate
from truth.imperfect import bench
from truth.imperfect.axis import Visit
from truth.imperfect.bench import Real

STEP = 25e-6
"""Step of the integration [s]; tooth periods are whole numbers of it."""

TEETH, DIAMETER, FEED = 4, 80e-3, 0.15e-3
KT, KR = 2.0e9, 0.7e9
"""Cutter, feed per tooth [m] and coefficients [N/m2]."""

SPEEDS = (470.0, 560.0, 660.0, 790.0, 960.0, 1150.0)
"""About these spindle speeds [rpm] limits are looked for."""

PLAN = (
    Visit("idle", 0.0, 50.0, "K2"),
    Visit("hard_500", 500.0, 200.0, "K2"),
    Visit("at_500", 500.0, 100.0, "K2"),
    Visit("back_500", -500.0, 100.0, "K2"),
    Visit("at_1000", 1000.0, 100.0, "K2"),
    Visit("at_250", 250.0, 100.0, "K2"),
)
HIDDEN = ("", "friction", "velocity_gain")


@dataclass(frozen=True)
class Test:
    """A cutting test: spindle speed [rpm], depth [m], whether a push grew in it."""

    speed: float
    depth: float
    chatter: bool


@dataclass(frozen=True)
class Written:
    """A campaign that was written: its file, the axis and what it was declared as, the limits [m] by speed [rpm]."""

    file: Path
    truth: Truth
    declared: Truth
    limits: dict[float, float]
    tests: tuple[Test, ...]


def campaign(path: Path, seed: int, hidden: str) -> Written:
    """Write a campaign in which one of `HIDDEN` is hidden; friction is as nominal, the velocity gain 25 % lower."""
    rng = np.random.default_rng([seed, 909])
    joint = Joint(1.68e6 * float(rng.uniform(0.9, 1.2)), 104.0 * float(rng.uniform(0.9, 1.2)))
    masses = 23.1 * float(rng.uniform(0.9, 1.1)), 11.3 * float(rng.uniform(0.9, 1.1))
    control = Control(0.25e-3, 1, 0.25e-3, 2e-8)
    oil = Friction("none", viscous=(float(rng.uniform(150.0, 200.0)),) * 2)
    declared = Truth(*masses, joint, oil, {"K2": Servo(6268.0, 10.9e-3, 45.5)}, control)
    truth = declared
    if hidden == "friction":
        dry = Friction("lugre", (42.0,) * 2, (84.0,) * 2, (400.0 * MM_MIN,) * 2, oil.viscous)
        truth = replace(truth, friction=dry)
    if hidden == "velocity_gain":
        truth = replace(truth, servos={"K2": Servo(0.75 * 6268.0, 10.9e-3, 45.5)})
    limits = {speed: limit(truth, speed) for speed in map(possible, SPEEDS)}
    tests = tuple(
        Test(speed, share * found * float(rng.uniform(0.98, 1.02)), share > 1.0)
        for speed, found in limits.items()
        for share in (0.92, 1.08)
    )
    out = bench.folder(path, rng, f"all evidence{', ' if hidden else ''}{hidden}", (".h5",))
    _declare(out, declared, rng)
    _hit(out, truth, rng)
    _move(out, truth, rng)
    _cut(out, truth, tests, rng)
    return Written(out.close(), truth, declared, limits, tests)


def _declare(out: bench.Folder, t: Truth, rng: np.random.Generator) -> None:
    near = lambda value, sigma: value * (1.0 + bench.clipped_normal(rng, sigma))  # noqa: E731
    servo, late = t.servos["K2"], (t.control.lag + 1.0) * t.control.period + t.control.extra
    out.say("[channels]", 'time = { column = "t", unit = "s" }')
    out.say("[baseline]", 'axis = "x"', 'evidence = ["drive", "limits"]')
    out.say(f'moving_mass = "{near(t.moving_mass, 0.03):.5g} kg"', f'tip_mass = "{near(t.tip_mass, 0.03):.5g} kg"')
    out.say(f'stiffness = "{near(t.joint.stiffness, 0.03) * 1e-6:.5g} N/um"')
    out.say(f'damping = "{near(t.joint.damping, 0.1):.5g} N s/m"')
    gains = f'Kp = "{servo.kp:.6g} N s/m", Ti = "{1e3 * servo.ti:.5g} ms", Kv = "{servo.kv:.5g} 1/s"'
    out.say(f'controllers = {{ K2 = {{ {gains}, delay = "{1e3 * late:.4g} ms" }} }}')
    out.say(f'friction = {{ law = "viscous", sigma = "{near(t.friction.viscous[0], 0.1):.5g} N s/m" }}')
    out.say(bench.table("tool", diameter=f"{1e3 * DIAMETER:g} mm", teeth=TEETH, approach_angle="90 deg"))
    known = {n: f"{near(k, 0.01) * 1e-6:.5g} N/mm^2" for n, k in (("Ktc", KT), ("Krc", KR))}
    out.say(bench.table("material", **known, Kac="0 N/mm^2"))
    width = f"{1e3 * DIAMETER:g} mm"
    speeds = [f"{SPEEDS[0] - 20.0:g} rpm", f"{SPEEDS[-1] + 50.0:g} rpm", "10 rpm"]
    asked = {"measurements": ["at_500"], "method": "zero_order", "cut": "central", "width_of_cut": width}
    out.say(bench.table("[lobes]", **asked, feed_per_tooth=f"{1e3 * FEED:g} mm", spindle_speed=speeds))


def _hit(out: bench.Folder, truth: Truth, rng: np.random.Generator) -> None:
    """Write four hits a measurement; force and acceleration are calibrated within 1 %, with noise 40 dB below them."""
    gains = 1.0 + 0.01 * rng.standard_normal(2)
    every = 2
    for visit in PLAN:
        setting = Setting(visit.feed * MM_MIN, "K2", phase=float(rng.uniform()))
        starts = 0.1 + 2.0 * np.arange(4) + rng.uniform(0.0, 0.05, 4)
        peaks = visit.level * rng.uniform(0.9, 1.1, 4)
        pulses = np.column_stack([starts, peaks, np.full(4, 1.7e-3), np.full(4, 3.0)])
        raw = simulate(truth, setting, pulses, np.zeros((0, 5)), 8.2)
        rows = signal.sosfilt(signal.butter(6, 0.4, output="sos"), raw[[3, 0]], axis=1)[:, ::every] * gains[:, None]
        size = 0.01 * np.sqrt(np.mean(rows**2, axis=1)) * [0.2, 1.0]
        rows = rows + size[:, None] * rng.standard_normal(rows.shape)
        file = out.record(visit.name, {"t": np.arange(rows.shape[1]) * every / RATE, "F": rows[0], "a": rows[1]})
        out.say("[[measurement]]", f'name = "{visit.name}"', 'method = "hammer"', 'controller = "K2"')
        out.say(f'feed = {{ x = "{visit.feed:g} mm/min" }}', f'records = [{{ file = "{file}", excitation = "x" }}]')
        out.say("[measurement.channels]", 'force_x = { column = "F", unit = "N" }')
        out.say('acceleration_x = { column = "a", unit = "m/s^2" }')


def _move(out: bench.Folder, truth: Truth, rng: np.random.Generator) -> None:
    """Write a record of 30 s of moves to and fro at 3 to 9 m/min, encoder and acting drive force."""
    per = round(truth.control.period / STEP)
    place, pieces = 0.0, [np.zeros(2000)]
    for k in range(24):
        speed, ramp = rng.choice([0.05, 0.1, 0.15]), rng.choice([0.8, 1.5])
        way = (-1.0) ** k * float(rng.uniform(0.06, 0.12))
        ramped = speed / ramp
        t = np.arange(0.0, abs(way) / speed + ramped, truth.control.period)
        v = np.clip(np.minimum(ramp * t, ramp * (t[-1] - t)), 0.0, speed)
        x = np.cumsum(v) * truth.control.period
        pieces += [place + way * x / x[-1], np.full(1000, place + way)]
        place += way
    path = np.concatenate(pieces)
    out_ = travel(truth, path, path.size * per, 0.0)
    every = 20
    n = out_[:, ::every].shape[1]
    gain = 1.0 + 0.01 * rng.standard_normal()
    force = gain * out_[2, ::every] + 0.5 * rng.standard_normal(n)
    file = out.record("moves", {"t": np.arange(n) * STEP * every, "x": out_[1, ::every], "f": force})
    out.say(
        "[[measurement]]",
        'name = "moves"',
        'method = "drive"',
        'controller = "K2"',
        f'records = [{{ file = "{file}" }}]',
    )
    out.say("[measurement.channels]")
    out.say('encoder_position_x = { column = "x", unit = "m" }', 'drive_force_x = { column = "f", unit = "N" }')


def _cut(out: bench.Folder, truth: Truth, tests: tuple[Test, ...], rng: np.random.Generator) -> None:
    for number, test in enumerate(tests, 1):
        raw = cut(truth, test.speed, test.depth, 4.0, 0.0)
        every = 20
        seen = raw[0, ::every] * (1.0 + 0.01 * rng.standard_normal())
        seen = seen + 0.02 * rng.standard_normal(seen.size)
        file = out.record(f"cut_{number}", {"t": np.arange(seen.size) * STEP * every, "a": seen})
        out.say("[[cutting_test]]", f'file = "{file}"', 'cut = "central"', f'width_of_cut = "{1e3 * DIAMETER:g} mm"')
        out.say(f'spindle_speed = "{test.speed:.8g} rpm"', f'depth_of_cut = "{1e3 * test.depth:.6g} mm"')
        out.say(f'feed_per_tooth = "{1e3 * FEED:g} mm"', 'controller = "K2"')
        out.say(f'observed = "{"chatter" if test.chatter else "stable"}"')
        out.say("[cutting_test.channels]")
        out.say('acceleration_x = { column = "a", unit = "m/s^2" }')


# --- The machine in time.


def possible(speed: float) -> float:
    """Return the nearest spindle speed [rpm] whose tooth period is a whole number of steps."""
    return 60.0 / TEETH / (STEP * round(60.0 / TEETH / speed / STEP))


def cut(truth: Truth, speed: float, depth: float, duration: float, push: float) -> Real:
    """Return tip acceleration, encoder, drive force and tip position of a cut; `push` [m/s] kicks the tip at 1.5 s."""
    feed = FEED * TEETH * speed / 60.0
    count = round(duration / STEP)
    path = feed * truth.control.period * np.arange(math.ceil(duration / truth.control.period) + 2)
    return travel(truth, path, count, feed, speed, depth, push)


def limit(truth: Truth, speed: float) -> float:
    """Return the depth [m] from which on a small push grows, within 0.5 %."""
    low, high = 2e-5, 2e-5
    while not grows(truth, speed, high):
        low, high = high, 1.4 * high
        if high > 0.05:
            return math.inf
    while high / low > 1.005:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if grows(truth, speed, middle) else (middle, high)
    return math.sqrt(low * high)


def grows(truth: Truth, speed: float, depth: float) -> bool:
    """Return whether steady cutting vibrates by 1 um, or a push of 0.05 mm/s grows in it.

    The encoder is exact, for its steps push too; a push that has died away to the last digits does not grow.
    """
    fine = replace(truth, control=replace(truth.control, resolution=1e-13))
    still, pushed = (cut(fine, speed, depth, 4.0, push)[3] for push in (0.0, 5e-5))
    half = round(0.5 / STEP)
    if float(np.std(signal.detrend(still[-half:]))) > 1e-6:
        return True
    first, last = (float(np.std((pushed - still)[k * half : (k + 1) * half])) for k in (4, 7))
    return last > max(first, 1e-11)


def travel(
    truth: Truth, path: Real, count: int, feed: float, speed: float = 0.0, depth: float = 0.0, push: float = 0.0
) -> Real:
    """Return tip acceleration, encoder, acting drive force and tip position, (4, count), along a path of readings."""
    servo, control, f = truth.servos["K2"], truth.control, truth.friction
    curve = f.curve()
    if f.kind == "none":
        curve[:, :2] = 0.0
    late = round((control.lag * control.period + control.extra) / STEP)
    tooth = round(60.0 / TEETH / speed / STEP) if speed else 0
    plant = np.array([truth.tip_mass, truth.moving_mass, truth.joint.stiffness, truth.joint.damping])
    loop = np.array([servo.kp, servo.ti, servo.kv, control.resolution, f.steady(feed)])
    bristle = np.array([f.bristle_stiffness, f.bristle_damping])
    per = round(control.period / STEP)
    out = np.zeros((4, count))
    _integrate(plant, curve, bristle, loop, per, late, path, feed, tooth, depth * KR * TEETH / 4.0, push, out)
    return out


@njit(cache=True, error_model="numpy")
def _integrate(plant, curve, bristle, loop, per, late, path, feed, tooth, hard, push, out):
    """Semi-implicit Euler; the bristles by their exact solution over a step of constant speed."""
    tip, carriage, k, c = plant
    kp, ti, kv, resolution, steady = loop
    xt, vt, xc, vc, z = 0.0, feed, 0.0, feed, 0.0
    dry = curve[0, 1] > 0.0
    if dry and feed > 0.0:
        z = (steady - curve[0, 3] * feed) / bristle[0]
    queue = np.full(late + 1, steady)
    integral, last, command = steady * ti / kp, math.nan, steady
    left = np.zeros(max(tooth, 1))
    for i in range(left.size):
        left[i] = feed * (i - left.size) * STEP
    for n in range(out.shape[1]):
        if n % per == 0:
            i = n // per
            seen = math.floor(xc / resolution + 0.5) * resolution
            way = (path[min(i + 1, path.size - 1)] - path[max(i - 1, 0)]) / (2.0 * per * STEP)
            if i == 0:
                way = feed
            v = vc if math.isnan(last) else (seen - last) / (per * STEP)
            last = seen
            error = way + kv * (path[min(i, path.size - 1)] - seen) - v
            integral += per * STEP * error
            command = kp * (error + integral / ti)
        queue[n % (late + 1)] = command
        acting = queue[(n + 1) % (late + 1)]
        force = 0.0
        if tooth > 0:
            at = n % tooth
            chip = xt - left[at]
            if chip > 0.0:
                force = -hard * min(n * STEP / 0.5, 1.0) * chip
                left[at] = xt
        if n == round(1.5 / STEP):
            vt += push
        joint = k * (xt - xc) + c * (vt - vc)
        side = 0 if vc >= 0.0 else 1
        rub = curve[side, 3] * vc
        if dry:
            top = curve[side, 0] + (curve[side, 1] - curve[side, 0]) * math.exp(-abs(vc) / curve[side, 2])
            new = z + vc * STEP
            if vc != 0.0:
                end = math.copysign(top / bristle[0], vc)
                new = end + (z - end) * math.exp(-bristle[0] * abs(vc) / top * STEP)
            rub += bristle[0] * 0.5 * (z + new) + bristle[1] * (new - z) / STEP
            z = new
        at_tip = (force - joint) / tip
        vt += STEP * at_tip
        vc += STEP * (acting + joint - rub) / carriage
        xt += STEP * vt
        xc += STEP * vc
        out[0, n], out[1, n], out[2, n], out[3, n] = at_tip, math.floor(xc / resolution + 0.5) * resolution, acting, xt
