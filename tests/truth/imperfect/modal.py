"""Campaigns of hammer hits on a ram in three directions, against its modes: a [[model]] or those of the idle hammer.

The ram is that of `truth.modal_machine`: matrices, not modes. Linear rams answer by their matrices line by line; one
with a loose joint is integrated in time (Runge-Kutta of fourth order, Jenkins elements, a cubic spring, a gap).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from truth.imperfect import bench
from truth.imperfect.bench import Answer, Hiding, Instruments, Real
from truth.modal_machine import Ram, modes, nominal

Complex = NDArray[np.complex128]
AXES = "xyz"

EFFECTS = {
    "posture": Hiding(0.05, "1/m", ("posture",), True),
    "drift": Hiding(0.03, "", ("drift",), True),
    "micro_slip": Hiding(0.05, "of the peak", ("joint_micro_slip",)),
    "cubic": Hiding(0.03, "of the peak's frequency", ("joint_hardening",)),
    "gain": Hiding(0.15, "", ("sensor_gain",), True),
    "force_gain": Hiding(-0.13, "", ("sensor_gain", "modal_scale")),
    "exchanged": Hiding(1.0, "", ("sensor_axis",), switch=True),
    "reversed": Hiding(1.0, "", ("sensor_gain", "sensor_axis"), switch=True),
    "turned": Hiding(math.radians(7.0), "rad", ("sensor_axis",), True),
    "skew": Hiding(100e-6, "s", ("time_skew",), True),
    "mass_loading": Hiding(0.02, "of the mass at the tool", ("accelerometer_mass", "modal_mass")),
    "missing_mode": Hiding(0.02, "of the largest compliance", ("missing_mode",)),
}
"""What the catalogue of a modal model knows.

Sizes are those that the tolerances of a workshop let anybody tell. Clocks agree within 20 us: 50 us are 2.5 standard
deviations, whatever is measured. Reciprocity and what is declared of the modes tell the gain of one channel, each
within 1 % and hits 1 % beside their point, within 1.2 to 2.5 % (Fisher information): 14 % are found 95 times of 100.
Mounting, cross-talk and the place of the accelerometer turn each axis by 1.2 degrees together; one of a thousand, of
the twelve angles that data could contradict, is 4.1 times that: of turns by 5 degrees half are beyond it, of 7 degrees
95 %.
"""

OUTSIDE = {
    "cable": Hiding(0.03, "of the mass at the tool", ()),
    "temperature_walk": Hiding(0.03, "", ()),
}
"""What it does not know."""

NEEDS_MODEL = ("missing_mode", "mass_loading", "force_gain", "gain", "exchanged", "reversed", "turned", "skew")
"""Effects that modes fitted to the idle hammer would take over."""

OF_A_SPRING = ("posture", "drift", "micro_slip", "cubic", "temperature_walk")
"""Effects that change one spring: that on which the limit depth hangs most, for of another no change would matter."""

OF_A_CHANNEL = ("gain", "turned")
"""Effects on channels: those on which the limit depth hangs most, of another no change would matter."""

KNOWN_FOR_FORCE = 0.03
"""Uncertainty of the stiffnesses where the force gain is wrong: beside 10 % of each mode 13 % are 1.9 sigma."""

TIMED = 0.5
"""Share of the campaigns that say when each measurement was made; of the others the list says it."""

LARGE, LARGE_MODE = 0.4, (0.2, 0.5)
"""Share of the modes that are missing because nobody looked, and their size over the largest compliance."""

PAIRS = (("posture", "drift"), ("posture", "gain"), ("micro_slip", "missing_mode"), ("skew", "posture"))


@dataclass(frozen=True)
class Machine:
    """The ram as it stands, and what hides in it.

    grow: relative change of the first spring's stiffness per metre; late: over the session; sag: its random walk.
    loose: share of the first spring made of Jenkins elements; `hard` [N/m3]. extra: compliance [m/N], frequency [Hz],
    damping and direction of a mode nobody modelled. hung: mass [kg] at the tool that swings at `swing` [Hz].
    """

    ram: Ram
    tilt: Real
    grow: float = 0.0
    late: float = 0.0
    sag: float = 0.0
    loose: float = 0.0
    travel: float = 1e-4
    hard: float = 0.0
    extra: tuple[float, float, float, tuple[float, float, float]] = (0.0, 70.0, 0.03, (1.0, 0.0, 0.0))
    hung: float = 0.0
    swing: float = 47.0
    sensor: float = 0.0


@dataclass(frozen=True)
class State:
    """One measurement: place [m], order 0 to 1, level over the usual, mass added [kg], factor on damping."""

    place: float = 0.0
    order: float = 0.0
    level: float = 1.0
    added: float = 0.0
    damping: float = 1.0
    walk: float = 0.0


@dataclass(frozen=True)
class Show:
    """What the sensors make of it."""

    accelerometer: Real
    force: float = 1.0
    skew: float = 0.0


def matrices(machine: Machine, state: State) -> tuple[Real, Real, Real]:
    """Mass, damping and stiffness in one state; a loose joint is still whole."""
    ram = machine.ram
    vector, k = ram.springs[0]
    change = machine.grow * state.place + machine.late * state.order + machine.sag * state.walk
    stiffness = ram.stiffness + change * k * np.outer(vector, vector)
    mass = ram.mass + np.diag([state.added + machine.sensor] * 3 + [0.0] * (ram.mass.shape[0] - 3))
    return mass, ram.damping * state.damping, stiffness


def dynamic(machine: Machine, state: State, frequency: Real, softer: complex = 0.0) -> Complex:
    """Inverse of the compliance of all coordinates; `softer`: what the first spring loses [N/m]."""
    mass, damping, stiffness = matrices(machine, state)
    w = 2.0 * np.pi * frequency[:, None, None]
    vector = machine.ram.springs[0][0]
    out = stiffness - softer * np.outer(vector, vector) + 1j * w * damping - w**2 * mass
    if machine.hung:
        own = (2.0 * np.pi * machine.swing) ** 2
        pull = own + 0.1j * w[:, 0, 0] * math.sqrt(own)
        for i in range(3):
            out[:, i, i] -= machine.hung * w[:, 0, 0] ** 2 * pull / (pull - w[:, 0, 0] ** 2)
    return out


def compliance(machine: Machine, state: State, frequency: Real, softer: complex = 0.0) -> Complex:
    """Compliance of all coordinates, shape (f, n, n)."""
    out = np.linalg.inv(dynamic(machine, state, frequency, softer))
    size, f, zeta, direction = machine.extra
    if size:
        d = np.zeros(out.shape[1])
        d[:3] = direction
        r = frequency / f
        out = out + (size / (1.0 - r**2 + 2j * zeta * r))[:, None, None] * np.outer(d, d)
    return out


# --- A loose joint, in time.


@njit(cache=True, nogil=True)
def _step_forces(v, x, held, anchor, stiff, limit, hard):
    """Force of the Jenkins elements and the cubic spring at a deformation x."""
    total = hard * x * x * x
    for i in range(held.size):
        g = held[i] + stiff * (x - anchor)
        total += min(max(g, -limit[i]), limit[i])
    return total


@njit(cache=True, nogil=True)
def _march(force, dt, inverse, damping, stiffness, vector, stiff, limit, hard, out):
    """Integrate ``M q'' + C q' + K q + vector f(vector.q) = force`` (rows at half steps); out: accelerations."""
    n = inverse.shape[0]
    q, u = np.zeros(n), np.zeros(n)
    held = np.zeros(limit.size)
    anchor = 0.0
    a = np.zeros((4, n))
    dq = np.zeros((4, n))
    for k in range(out.shape[0]):
        for stage in range(4):
            c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            qs, us = q.copy(), u.copy()
            if stage > 0:
                qs += c * dt * dq[stage - 1]
                us += c * dt * a[stage - 1]
            x = 0.0
            for i in range(n):
                x += vector[i] * qs[i]
            f = _step_forces(0.0, x, held, anchor, stiff, limit, hard)
            row = 2 * k + (0 if stage == 0 else (2 if stage == 3 else 1))
            rest = force[row] - damping @ us - stiffness @ qs - vector * f
            a[stage] = inverse @ rest
            dq[stage] = us
        out[k] = a[0]
        q = q + dt / 6.0 * (dq[0] + 2.0 * dq[1] + 2.0 * dq[2] + dq[3])
        u = u + dt / 6.0 * (a[0] + 2.0 * a[1] + 2.0 * a[2] + a[3])
        x = 0.0
        for i in range(n):
            x += vector[i] * q[i]
        for i in range(held.size):
            g = held[i] + stiff * (x - anchor)
            held[i] = min(max(g, -limit[i]), limit[i])
        anchor = x


def in_time(machine: Machine, state: State, force: Real, rate: float) -> Real:
    """Accelerations (n, samples) under forces on all coordinates, (n, samples), of a machine with a loose joint."""
    mass, damping, stiffness = matrices(machine, state)
    vector, k = machine.ram.springs[0]
    count = 16
    each = machine.loose * k / count
    limit = each * machine.travel * (np.arange(count) + 0.5) / count
    stiffness = stiffness - machine.loose * k * np.outer(vector, vector)
    # The force at half steps, by the spectrum.
    n = force.shape[1]
    spectrum = np.fft.rfft(force, axis=1)
    fine = np.fft.irfft(spectrum, 2 * n, axis=1) * 2.0
    rows = np.ascontiguousarray(np.column_stack([fine, fine[:, -1]]).T)
    out = np.zeros((n, mass.shape[0]))
    _march(
        rows,
        1.0 / rate,
        np.linalg.inv(mass),
        damping,
        stiffness,
        np.array(vector, float),
        each,
        limit,
        machine.hard,
        out,
    )
    return out.T


def softened(machine: Machine, amplitude: float) -> complex:
    """What the first spring loses at an amplitude of its deformation [m], by the first harmonic [N/m]."""
    _, k = machine.ram.springs[0]
    out = -0.75 * machine.hard * amplitude**2 + 0j
    if machine.loose:
        limits = machine.travel * (np.arange(16) + 0.5) / 16
        r = np.clip(limits / max(amplitude, 1e-300), 0.0, 1.0)
        angle = np.arccos(1.0 - 2.0 * r)
        kept = (angle - 0.5 * np.sin(2.0 * angle)) / math.pi + 4j / math.pi * r * (1.0 - r)
        out += machine.loose * k * (1.0 - complex(np.mean(kept)))
    return out


# --- Hits.


@dataclass(frozen=True)
class Setup:
    """How the hits along one axis were made in one measurement."""

    lean: Real
    place: Real
    recorder: float


def hit_forces(
    rng: np.random.Generator, n: int, rate: float, at: Real, peaks: Real, width: float, exponent: float
) -> Real:
    """Force of each hit (hits, n): steep up, slow down; each a little other."""
    t = np.arange(n) / rate
    out = np.zeros((at.size, n))
    for k in range(at.size):
        rise = 0.45 * width * rng.uniform(0.93, 1.07)
        s = (t - at[k]) / rise
        inside = (s > 0.0) & (s < 12.0)
        shape = np.zeros(n)
        shape[inside] = np.exp(exponent * (np.log(s[inside]) + 1.0 - s[inside]))
        out[k] = peaks[k] * shape
    return out


@dataclass(frozen=True)
class Shop:
    """All that a campaign has drawn."""

    machine: Machine
    tools: Instruments
    show: Show
    peak: float
    width: float
    seconds: float
    hits: int
    sensor_place: Real
    gravity: bool
    units: tuple[str, str]
    double: float


def measured(shop: Shop, state: State, axis: int, setup: Setup, rng: np.random.Generator) -> dict[str, Real]:
    """One record: hits along an axis, one after the other."""
    tools, times = shop.tools, 4
    rate = tools.rate * times
    apart = shop.seconds
    n = round(apart * shop.hits * rate)
    at = apart * np.arange(shop.hits) + rng.uniform(0.04, 0.1, shop.hits) * apart
    peaks = shop.peak * state.level * rng.uniform(0.85, 1.15, shop.hits)
    exponent = rng.uniform(2.5, 3.5)
    each = hit_forces(rng, n, rate, at, peaks, shop.width, exponent)
    size = shop.machine.ram.mass.shape[0]
    push = np.zeros((size, n))
    for k in range(shop.hits):
        d = np.eye(3)[axis] + setup.lean + math.radians(1.0) * rng.standard_normal(3) * (np.arange(3) != axis)
        d /= np.linalg.norm(d)
        arm = setup.place + 1e-3 * rng.standard_normal(3)
        general = np.zeros(size)
        general[:3] = d
        general += shop.machine.tilt.T @ np.cross(arm, d)
        push += general[:, None] * each[k]
    seen = np.zeros((3, size))
    seen[:, :3] = np.eye(3)
    # The accelerometer sits a little beside the point that is hit: u + theta x r.
    r = shop.sensor_place
    across = np.array([[0.0, r[2], -r[1]], [-r[2], 0.0, r[0]], [r[1], -r[0], 0.0]])
    seen += across @ shop.machine.tilt
    if shop.machine.loose or shop.machine.hard:
        moved = seen @ in_time(shop.machine, state, push, rate)
        size_extra = shop.machine.extra[0]
        if size_extra:
            only = replace(shop.machine, extra=(0.0, *shop.machine.extra[1:]))
            moved = moved + seen @ (_linear(shop.machine, state, push, rate) - _linear(only, state, push, rate))
    else:
        moved = seen @ _linear(shop.machine, state, push, rate)
    late = shop.show.skew + setup.recorder
    f = np.fft.rfftfreq(2 * n, 1.0 / rate)
    moved = np.fft.irfft(np.fft.rfft(moved, 2 * n, axis=1) * np.exp(-2j * np.pi * f * late), 2 * n, axis=1)[:, :n]
    return _recorded(shop, state, axis, each.sum(axis=0), moved, rng)


def _linear(machine: Machine, state: State, push: Real, rate: float) -> Real:
    """Accelerations of all coordinates (n, samples) of a linear machine; lines above its band are let go softly."""
    n = push.shape[1]
    f = np.fft.rfftfreq(2 * n, 1.0 / rate)
    top = min(0.125 * rate, f[-1])
    some = f <= top
    spectrum = np.fft.rfft(push, 2 * n, axis=1)
    out = np.zeros_like(spectrum)
    phi = compliance(machine, state, f[some])
    out[:, some] = -((2.0 * np.pi * f[some]) ** 2) * np.einsum("fij,jf->if", phi, spectrum[:, some])
    return np.asarray(np.fft.irfft(out, 2 * n, axis=1)[:, :n])


def _recorded(
    shop: Shop, state: State, axis: int, force: Real, moved: Real, rng: np.random.Generator
) -> dict[str, Real]:
    """What recorder and sensors make of force and motion."""
    tools = shop.tools
    seen = np.vstack([shop.show.force * force[None], shop.show.accelerometer @ moved])
    rows = tools.filtered(seen, 4)
    rms = np.sqrt(np.mean(rows**2, axis=1))
    # Noise and hum belong to the instruments, not to the level of these hits.
    usual = rms / state.level
    main = max(usual[1:])
    sizes = np.array([usual[0], *np.maximum(usual[1:], 0.3 * main)])
    below = 10.0 ** (-tools.snr / 20.0)
    noise = tools.noise(rows.shape, rng) * (below * np.array([0.2 * usual[0], main, main, main]))[:, None]
    rows = tools.hummed(rows, sizes, rng) + noise
    full = np.array([2.5 * shop.peak * 2.0, *([1.5 * np.abs(rows[1:]).max()] * 3)])
    rows = tools.converted(rows, full)
    if shop.gravity:
        rows[3] += 0.3 * main  # what is left of gravity
    scale = {"N": 1.0, "kN": 1e-3, "m/s^2": 1.0, "g": 1.0 / 9.80665}
    out = {"t": np.arange(rows.shape[1]) / tools.rate, f"F{AXES[axis]}": rows[0] * scale[shop.units[0]]}
    return out | {f"a{a}": rows[1 + i] * scale[shop.units[1]] for i, a in enumerate(AXES)}


# --- The campaign.


def drawn_shop(rng: np.random.Generator) -> Shop:
    """Draw the machine, the instruments and how hits are made."""
    ram = nominal(int(rng.integers(3, 6)), rng)
    # From a portal to a small mill: heavier, lighter, and 0.6 to 4 times as fast.
    weight, fast = (
        math.exp(rng.uniform(math.log(0.1), math.log(3.0))),
        math.exp(rng.uniform(math.log(0.7), math.log(4.0))),
    )
    stiff = weight * fast**2
    loss = rng.uniform(0.5, 1.3)
    springs = tuple((v, k * stiff) for v, k in ram.springs)
    damping = loss * (9.0 * fast * ram.mass * weight + 1.2e-4 / fast * ram.stiffness * stiff)
    ram = Ram(ram.mass * weight, damping, ram.stiffness * stiff, springs)
    tilt = np.zeros((3, ram.mass.shape[0]))
    tilt[:, :3] = rng.standard_normal((3, 3)) / rng.uniform(0.25, 0.6)
    f, zeta, _, _ = modes(ram)
    top = float(f.max())
    rate = 2.0 ** math.ceil(math.log2(6.0 * top)) if rng.random() < 0.5 else 100.0 * math.ceil(0.065 * top)
    tools = bench.instruments(rng, float(max(rate, 1000.0)))
    slowest = float(np.min(2.0 * np.pi * f * zeta))
    seconds = min(max(rng.uniform(7.0, 10.0) / slowest, 0.5), 8.0)
    stiffness = float(ram.springs[0][1])
    peak = stiffness * rng.uniform(5e-6, 4e-5)
    return Shop(
        Machine(ram, tilt),
        tools,
        Show(bench.sensitivities(rng), 1.0 + 0.01 * rng.standard_normal()),
        float(peak),
        float(rng.uniform(0.25, 0.5) / top),
        seconds,
        int(rng.integers(3, 8)),
        3e-3 * rng.standard_normal(3),
        bool(rng.random() < 0.3),
        (str(rng.choice(["N", "kN"])), str(rng.choice(["m/s^2", "g"]))),
        0.0,
    )


def states(shop: Shop, rng: np.random.Generator, drift: bool) -> list[tuple[str, State]]:
    """What is measured: idle, two to four places, levels, an added mass, the first state again at the end."""
    far = rng.uniform(0.6, 1.2)
    places = [0.0, *(far * np.linspace(0.0, 1.0, int(rng.integers(3, 5)))[1:])]
    loss = {p: 1.0 if p == 0.0 else float(np.exp(0.02 * rng.standard_normal())) for p in places}
    mass = float(f"{rng.uniform(0.03, 0.08) * shop.machine.ram.mass[0, 0]:.2g}")
    plan = [("hammer_idle", State())]
    middle = [(f"place_{i}", State(place=float(p), damping=loss[p])) for i, p in enumerate(places) if i > 0]
    middle += [("light", State(level=0.5)), ("hard", State(level=2.0)), ("mass", State(added=mass))]
    plan += [middle[i] for i in rng.permutation(len(middle))]
    plan += [("again", State())]
    steps = rng.standard_normal(len(plan)) / math.sqrt(len(plan))
    walk = np.cumsum(steps) - steps[0]
    last = len(plan) - 1
    return [(name, replace(s, order=i / last, walk=float(walk[i]))) for i, (name, s) in enumerate(plan)]


def spring_amplitude(machine: Machine, level: float, peak: float, width: float) -> float:
    """Deformation of the first spring after a hit along the axis that deforms it most [m], linear."""
    vector, _ = machine.ram.springs[0]
    mass, damping, stiffness = matrices(machine, State())
    f = np.linspace(1.0, 1.2 * float(modes(machine.ram)[0].max()), 400)
    phi = np.linalg.inv(
        stiffness - (2 * np.pi * f[:, None, None]) ** 2 * mass + 2j * np.pi * f[:, None, None] * damping
    )
    impulse = 0.5 * peak * level * width
    through = np.abs(np.einsum("i,fij->fj", vector, phi)[:, :3])
    # Peak of the impulse response, from the spectrum of one mode: about the integral over the band.
    return float(2.0 * np.trapezoid(through, f, axis=0).max() * impulse)


def planted(shop: Shop, name: str, size: float, rng: np.random.Generator) -> Shop:
    """Hide an effect of a size."""
    machine, show = shop.machine, shop.show
    k = machine.ram.springs[0][1]
    typical = spring_amplitude(machine, 1.0, shop.peak, shop.width)
    f = modes(machine.ram)[0]
    grid = np.linspace(0.5 * f.min(), 1.3 * f.max(), 600)
    largest = float(np.abs(compliance(machine, State(), grid)[:, :3, :3]).max())
    axis = int(rng.integers(3))
    pair = tuple(int(i) for i in rng.permutation(3)[:2])
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    between = float(rng.uniform(1.1 * f.min(), 0.95 * f.max()))
    own = float(rng.uniform(0.02, 0.05))
    seen = show.accelerometer.copy()
    if name == "posture":
        machine = replace(machine, grow=size)
    elif name == "drift":
        machine = replace(machine, late=size)
    elif name == "temperature_walk":
        machine = replace(machine, sag=size)
    elif name == "micro_slip":
        machine = replace(machine, loose=min(6.0 * size, 0.9), travel=0.8 * typical)
    elif name == "cubic":
        machine = replace(machine, hard=2.0 * size * k / typical**2)
    elif name == "missing_mode":
        machine = replace(machine, extra=(size * largest, between, own, tuple(direction.tolist())))
    elif name == "mass_loading":
        machine = replace(machine, sensor=size * float(machine.ram.mass[0, 0]))
    elif name == "cable":
        machine = replace(machine, hung=size * float(machine.ram.mass[0, 0]), swing=between)
    elif name == "gain":
        seen[axis] *= 1.0 + size
        show = replace(show, accelerometer=seen)
    elif name == "force_gain":
        show = replace(show, force=show.force * (1.0 + size))
    elif name == "reversed":
        seen[axis] *= -1.0
        show = replace(show, accelerometer=seen)
    elif name == "exchanged":
        seen[list(pair)] = seen[list(pair[::-1])]
        show = replace(show, accelerometer=seen)
    elif name == "turned":
        i, j = pair
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = math.cos(size)
        turn[i, j], turn[j, i] = -math.sin(size), math.sin(size)
        show = replace(show, accelerometer=turn @ seen)
    elif name == "skew":
        show = replace(show, skew=size)
    else:
        raise ValueError(f"no effect '{name}' of a modal campaign")
    return replace(shop, machine=machine, show=show)


def cost_of(shop: Shop, before: Shop, plan: list[tuple[str, State]], cut: tuple[float, float, int]) -> float:
    """Largest relative change of the smallest limit depth, over the states, as the sensors show it."""
    f0 = modes(before.machine.ram)[0]
    f = np.linspace(0.5 * f0.min(), 1.3 * f0.max(), 700)
    kt, kr, teeth = cut
    worst = 0.0
    amplitude = spring_amplitude(before.machine, 1.0, before.peak, before.width)
    for _, state in plan:
        depth = []
        for each in (before, shop):
            soft = softened(each.machine, amplitude * state.level)
            phi = compliance(each.machine, state, f, soft)[:, :3, :3]
            phi = (
                each.show.accelerometer
                @ phi
                / each.show.force
                * np.exp(-2j * np.pi * f * each.show.skew)[:, None, None]
            )
            depth.append(bench.limit_depth(phi[:, :2, :2], kt, kr, teeth, 0.5 * math.pi, math.pi))
        if math.isfinite(depth[0]):
            ratio = depth[1] / depth[0]
            worst = max(worst, abs(min(ratio, 10.0) - 1.0))
    return worst


def leading(shop: Shop, plan: list[tuple[str, State]], cut: tuple[float, float, int]) -> Shop:
    """Return the shop with that spring first whose stiffness counts most for the limit depth.

    A spring that hardly counts would have to lose all its stiffness over the stroke before anybody lost depth by it.
    """

    def counts(first: int) -> float:
        before = replace(shop, machine=replace(shop.machine, ram=_first(shop.machine.ram, first)))
        end = max(state.place for _, state in plan)
        softer, stiffer = (replace(before, machine=replace(before.machine, grow=x / end)) for x in (-0.3, 0.3))
        return min(cost_of(softer, before, plan, cut), cost_of(stiffer, before, plan, cut))

    first = max(range(len(shop.machine.ram.springs)), key=counts)
    return replace(shop, machine=replace(shop.machine, ram=_first(shop.machine.ram, first)))


def _first(ram: Ram, first: int) -> Ram:
    """Return the same ram with another spring named first."""
    springs = ram.springs
    return replace(ram, springs=(springs[first], *springs[:first], *springs[first + 1 :]))


def campaign(path: Path, seed: int, hidden: tuple[str, ...], scale: float = 1.0) -> Answer:
    """Write a campaign and return what is hidden in it."""
    rng = np.random.default_rng([seed, 101])
    more = np.random.default_rng([seed, 104])
    timed, large = bool(more.random() < TIMED), bool(more.random() < LARGE)
    shop = drawn_shop(rng)
    plan = states(shop, rng, "drift" in hidden)
    cut = (float(rng.uniform(700e6, 2300e6)), 0.0, int(rng.integers(2, 7)))
    cut = (cut[0], cut[0] * float(rng.uniform(0.2, 0.5)), cut[2])
    by_model = bool(rng.random() < 0.5) or any(h in NEEDS_MODEL for h in hidden)
    signs = {name: float(rng.choice([-1.0, 1.0])) for name in sorted(EFFECTS | OUTSIDE)}
    errors = rng.standard_normal((3, 8))
    uncertain = {
        "frequency": float(rng.choice([0.005, 0.01])),
        "damping": 0.2,
        "stiffness": float(rng.choice([0.05, 0.1])),
    }
    if "force_gain" in hidden or (not hidden and rng.random() < 0.25):
        uncertain["stiffness"] = KNOWN_FOR_FORCE
    if any(name in OF_A_SPRING for name in hidden):
        shop = leading(shop, plan, cut)
    healthy, sizes, cost = shop, {}, 0.0
    for number, name in enumerate(hidden):
        what = (EFFECTS | OUTSIDE)[name]
        size = what.size * scale * (signs[name] if what.signed else 1.0)
        now = shop
        draw = [seed, 103, number]

        def price(s: float, now: Shop = now, name: str = name, draw: list[int] = draw) -> float:
            return cost_of(planted(now, name, s, np.random.default_rng(draw)), now, plan, cut)

        if name in OF_A_CHANNEL:
            draw[:] = max(([*draw, k] for k in range(8)), key=lambda d, size=size, price=price: price(size, draw=d))
        if name == "missing_mode":
            # Along z, or far from the modes that chatter, no mode that a machine has costs anything.
            tried = [[*draw, k] for k in range(8)]
            able = (d for d in tried if price(LARGE_MODE[1], draw=d) >= bench.CLEARLY * bench.MATERIAL)
            draw[:] = next(able, tried[0])
        if scale == 1.0:
            size, cost = bench.raised(size, price, what.switch)
        else:
            size, cost = bench.raised(what.size * (signs[name] if what.signed else 1.0), price, what.switch)
            size, cost = size * scale, price(size * scale)
        if name == "missing_mode" and large and scale == 1.0:
            size, cost = bench.raised(max(size, float(more.uniform(*LARGE_MODE))), price)
        sizes[name] = size
        shop = planted(now, name, size, np.random.default_rng(draw))
    _write(path, shop, healthy, plan, cut, by_model, uncertain, errors, timed, rng)
    ids = {name: (EFFECTS | OUTSIDE)[name].causes for name in hidden}
    drawn = {"baseline": "model" if by_model else "hammer_idle", "snr": shop.tools.snr, "rate": shop.tools.rate}
    return Answer("modal", seed, sizes, ids, cost, {}, drawn)


def _write(
    path: Path,
    shop: Shop,
    healthy: Shop,
    plan: list[tuple[str, State]],
    cut: tuple[float, float, int],
    by_model: bool,
    uncertain: dict[str, float],
    errors: Real,
    timed: bool,
    rng: np.random.Generator,
) -> None:
    out = bench.folder(path, rng, "ram", (".mat", ".h5"))
    sec = bench.table
    diameter = float(rng.choice([20.0, 50.0, 80.0, 125.0]))
    out.say(sec("tool", diameter=f"{diameter} mm", teeth=cut[2], approach_angle="90 deg"))
    out.say(sec("material", Ktc=f"{cut[0] / 1e6:.5g} N/mm^2", Krc=f"{cut[1] / 1e6:.5g} N/mm^2", uncertainty="10 %"))
    names = {"time": ("t", "s")} | {f"acceleration_{a}": (f"a{a}", shop.units[1]) for a in AXES}
    rows = [f'{k} = {{ column = "{c}", unit = "{u}" }}' for k, (c, u) in names.items()]
    rows += [f'force_{a} = {{ column = "F{a}", unit = "{shop.units[0]}" }}' for a in AXES]
    out.say("[channels]", *rows)
    if by_model:
        f, zeta, k, d = modes(healthy.machine.ram)
        # Nobody knows which way a mode moves to better than a degree or two; drawn apart, the rest stays as it is.
        d = d + math.tan(math.radians(1.5)) * np.clip(rng.spawn(1)[0].standard_normal(d.shape), -2.0, 2.0)
        d = d / np.linalg.norm(d, axis=1)[:, None]
        wrong = 1.0 + np.clip(errors[:, : f.size], -2.0, 2.0) * np.array([list(uncertain.values())]).T
        each = [
            f'    {{ frequency = "{a:.6g} Hz", damping = {z:.5g}, stiffness = "{s / 1e6:.6g} N/um", '
            f"direction = [{v[0]:.6g}, {v[1]:.6g}, {v[2]:.6g}] }},"
            for a, z, s, v in zip(f * wrong[0], zeta * wrong[1], k * wrong[2], d, strict=True)
        ]
        spread = ", ".join(f'{n} = "{100 * s:g} %"' for n, s in uncertain.items())
        out.say("[[model]]", 'name = "finite_elements"', "modes = [", *each, "]", f"uncertainty = {{ {spread} }}")
    out.say("[baseline]", f'from = "{"finite_elements" if by_model else "hammer_idle"}"')
    base = 60.0 * float(modes(healthy.machine.ram)[0][0]) / cut[2]
    speeds = f'["{0.3 * base:.5g} rpm", "{1.2 * base:.5g} rpm", "{0.1 * base:.5g} rpm"]'
    out.say(
        "[[lobes]]",
        f'measurements = ["{"finite_elements" if by_model else "hammer_idle"}"]',
        'method = "zero_order"',
        'cut = "down"',
        f'width_of_cut = "{0.5 * diameter:g} mm"',
        'feed_per_tooth = "0.1 mm"',
        f"spindle_speed = {speeds}",
    )
    setups = {axis: _setup(rng) for axis in range(3)}
    held = plan[int(rng.integers(1, len(plan) - 1))][0] if rng.random() < 0.5 else ""
    for number, (name, state) in enumerate(plan):
        files = []
        for axis in range(3):
            # A set-up lasts while the machine stands in one place.
            setups[axis] = _setup(rng) if state.place or name in ("mass", "again") else setups[axis]
            columns = measured(shop, state, axis, setups[axis], rng)
            file = out.record(f"{name}_{AXES[axis]}", columns)
            files.append(f'    {{ file = "{file}", excitation = "{AXES[axis]}" }},')
        out.say("[[measurement]]", f'name = "{name}"', 'method = "hammer"')
        out.say(f'position = "{1e3 * state.place:.4g} mm"')
        if timed:
            out.say(f"started = 2024-05-14T{8 + number // 2:02d}:{30 * (number % 2):02d}:00")
        if state.added:
            out.say(f'added_mass = "{state.added:g} kg"')
        if name == held:
            out.say("held_out = true")
        out.say("records = [", *files, "]")
    out.close()


def _setup(rng: np.random.Generator) -> Setup:
    lean = math.radians(1.5) * rng.standard_normal(3)
    return Setup(lean, 3e-3 * rng.standard_normal(3), float(rng.uniform(-20e-6, 20e-6)))


healthy = partial(campaign, hidden=())
