"""A drive that moves: strokes under a sampled position loop, torque steps, runs at constant speed; drawn at random.

Independent of the packages. Friction acts as in Coulomb's law with exact sticking (a step that would turn the velocity
round ends at rest where the driving force is below the limit), the controller is sampled, its command is held and acts
late, the encoder has steps, the logged force has noise, a filter and a clock of its own; friction changes along the
stroke, the motor cogs, weight pulls, and the two ways differ in everything.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import signal


@dataclass(frozen=True)
class Rig:
    """Inertia [kg or kg m2], friction by direction (forward, backward), constant force, and how it is measured."""

    rotary: bool
    inertia: float
    coulomb: tuple[float, float]
    static: tuple[float, float]
    stribeck_speed: tuple[float, float]
    shape: float  # exponent of the Stribeck curve
    viscous: tuple[float, float]
    constant: float
    delay: int  # of the command, in integration steps
    resolution: float
    force_noise: float
    ripple: float  # of the Coulomb force along the stroke, relative
    wave: float
    cogging: float
    rate: float


@njit(cache=True)
def _moved(profile, stepped, parameters, gains, late, fine, per_sample, seed):
    """Position and commanded force at each sample; profile: reference, or force where it is stepped."""
    (inertia, up, down, static_up, static_down, slow_up, slow_down, shape, viscous_up, viscous_down) = parameters[:10]
    constant, ripple, wave, cogging, resolution = parameters[10:]
    np.random.seed(seed)  # noqa: NPY002
    kp, kv, ti = gains
    n = profile.size
    place, force = np.empty(n), np.empty(n)
    x, v, integral, last = 0.0, 0.0, 0.0, 0.0
    buffer = np.zeros(late + 1)
    k = 0
    for i in range(n):
        seen = resolution * math.floor(x / resolution + np.random.random()) if resolution > 0.0 else x  # noqa: NPY002
        place[i] = seen
        if stepped:
            command = profile[i]
        else:
            speed = (seen - last) * fine / per_sample if i > 0 else 0.0
            last = seen
            slope = (profile[min(i + 1, n - 1)] - profile[i]) * fine / per_sample
            error = kv * (profile[i] - seen) + slope - speed
            integral += error * per_sample / fine / ti
            command = kp * (error + integral)
        force[i] = command
        for _ in range(per_sample):
            buffer[k % (late + 1)] = command
            k += 1
            acting = buffer[k % (late + 1)] - constant - cogging * math.sin(2.7 * wave * x + 1.0)
            along = 1.0 + ripple * math.sin(wave * x)
            if v == 0.0:
                limit = (static_up if acting > 0.0 else static_down) * along
                if abs(acting) <= limit:
                    continue
                way = 1.0 if acting > 0.0 else -1.0
            else:
                way = 1.0 if v > 0.0 else -1.0
            if way > 0.0:
                kinetic, rest, viscous, slow = up, static_up, viscous_up, slow_up
            else:
                kinetic, rest, viscous, slow = down, static_down, viscous_down, slow_down
            curve = math.exp(-((abs(v) / slow) ** shape))
            friction = way * (kinetic + (rest - kinetic) * curve) * along + viscous * v
            new = v + (acting - friction) / inertia / fine
            if v != 0.0 and new * v < 0.0:
                new = 0.0
            x += 0.5 * (v + new) / fine
            v = new
    return place, force


def truths(rig: Rig) -> dict[tuple[str, str], float]:
    """Return the true value of each parameter by name and direction; a constant force is part of the Coulomb forces."""
    (up, down), c = rig.coulomb, rig.constant
    return {
        ("inertia", "both"): rig.inertia,
        ("coulomb", "forward"): up + c,
        ("coulomb", "backward"): down - c,
        ("coulomb", "both"): 0.5 * (up + down),
        ("viscous", "forward"): rig.viscous[0],
        ("viscous", "backward"): rig.viscous[1],
        ("static", "forward"): rig.static[0] + c,
        ("static", "backward"): rig.static[1] - c,
        ("stribeck_speed", "forward"): rig.stribeck_speed[0],
        ("stribeck_speed", "backward"): rig.stribeck_speed[1],
    }


def draw(seed: int, kind: str) -> tuple[Rig, dict[str, np.ndarray]]:
    """Draw a rig and its record: kind is "stroke" (one way), "strokes" (both), "step" (of the force) or "runs".

    Returns
    -------
    tuple
        The rig; time [s], position [m or rad] and force [N or N m] as recorded.
    """
    rng = np.random.default_rng([seed, len(kind), ord(kind[-1])])
    rotary = bool(rng.integers(2))
    inertia = 10.0 ** (rng.uniform(-5.0, 1.0) if rotary else rng.uniform(1.0, 3.5))
    fastest = rng.uniform(5.0, 200.0) if rotary else rng.uniform(0.05, 0.8)
    ramp = rng.uniform(0.08, 0.4)  # time to the fastest speed
    inertial = inertia * fastest / ramp
    friction = inertial * 10.0 ** rng.uniform(-1.2, 0.3)
    share = rng.uniform(0.1, 1.0)
    one_way = rng.uniform(0.8, 1.25, 2)
    coulomb = (friction * (1 - 0.5 * share) * one_way[0], friction * (1 - 0.5 * share) * one_way[1])
    boost = 1.0 + (rng.random() < 0.5) * rng.uniform(0.0, 0.6)
    viscous = friction * share / fastest
    rig = Rig(
        rotary,
        inertia,
        coulomb,
        (coulomb[0] * boost, coulomb[1] * boost),
        tuple(fastest * rng.uniform(0.01, 0.15) * rng.uniform(0.9, 1.1, 2)),
        rng.uniform(1.0, 2.0),
        (viscous * rng.uniform(0.8, 1.25), viscous * rng.uniform(0.8, 1.25)),
        0.0 if rng.random() < 0.5 else coulomb[0] * rng.uniform(-0.6, 0.6),
        int(rng.integers(0, 12)),
        fastest * 10.0 ** rng.uniform(-6.5, -4.5),
        inertial * 10.0 ** rng.uniform(-3.0, -1.3),
        0.0 if rng.random() < 0.5 else rng.uniform(0.0, 0.08),
        2.0 * math.pi / (fastest * rng.uniform(0.02, 0.5)),
        0.0 if rng.random() < 0.6 else coulomb[0] * rng.uniform(0.01, 0.08),
        float(rng.choice([500.0, 1000.0, 2000.0, 4000.0])),
    )
    per_sample = max(1, round(16000.0 / rig.rate))
    profile, stepped = _profile(rng, rig, kind, fastest, ramp)
    bandwidth = 2.0 * math.pi * rng.uniform(8.0, 20.0)
    gains = (inertia * bandwidth, bandwidth / 4.0, 5.0 / bandwidth)
    parameters = (
        rig.inertia, *rig.coulomb, *rig.static, *rig.stribeck_speed, rig.shape, *rig.viscous, rig.constant, rig.ripple,
        rig.wave, rig.cogging, rig.resolution,
    )  # fmt: skip
    place, force = _moved(profile, stepped, parameters, gains, rig.delay, rig.rate * per_sample, per_sample, seed)
    noisy = _logged(rng, force, rig.rate) + rig.force_noise * rng.standard_normal(force.size)
    return rig, {"time": np.arange(force.size) / rig.rate, "place": place, "force": noisy}


def _logged(rng: np.random.Generator, force: np.ndarray, rate: float) -> np.ndarray:
    """Pass the force through the filter of the current sensor, and read it by a clock that is off a little."""
    shift = rng.uniform(-0.5, 0.5)
    force = np.interp(np.arange(force.size) + shift, np.arange(force.size), force)
    pole = math.exp(-1.0 / (rate * rng.uniform(1e-4, 6e-4)))
    return signal.lfilter([1.0 - pole], [1.0, -pole], force, zi=[pole * force[0]])[0]


def _profile(rng: np.random.Generator, rig: Rig, kind: str, fastest: float, ramp: float) -> tuple[np.ndarray, bool]:
    """Reference position, or force of a step."""
    dt = 1.0 / rig.rate
    rest = np.zeros(round(0.25 * rig.rate))
    if kind == "step":
        speed = fastest * rng.uniform(0.4, 0.8)
        level = rig.coulomb[0] + rig.viscous[0] * speed + rig.constant
        hold = max(rig.static[0] + rig.constant, 0.0) * 1.2 + rig.inertia * speed / ramp
        parts = [rest]
        for _ in range(int(rng.integers(1, 4))):
            parts += [
                np.full(round(ramp * rig.rate), level + hold - rig.coulomb[0]),
                np.full(round(0.4 * rig.rate), level),
            ]
        return np.concatenate([*parts, rest + level]), True
    speeds = [fastest]
    if kind == "strokes":
        speeds = [s * fastest * rng.uniform(0.2, 1.0) for s in (1.0, -1.0) * int(rng.integers(1, 4))]
    if kind == "runs":
        speeds = [
            s * w * fastest
            for w in np.geomspace(rng.uniform(0.005, 0.06), 1.0, int(rng.integers(5, 10)))
            for s in (1.0, -1.0)
        ]
    velocity = [rest]
    for speed in speeds:
        up = np.linspace(0.0, speed, max(3, round(ramp * abs(speed) / fastest * rig.rate)))
        cruise = np.full(round((0.6 if kind == "runs" else rng.uniform(0.15, 0.5)) * rig.rate), speed)
        velocity += [up, cruise, up[::-1], rest]
    smooth = np.hanning(max(3, round(0.02 * rig.rate)) + 2)
    return np.cumsum(np.convolve(np.concatenate(velocity), smooth / smooth.sum(), mode="same")) * dt, False
