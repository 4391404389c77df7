"""The true axis of a drive record: moves to and fro under a sampled controller, with what may be hidden in it.

Shares no code with the packages: Runge-Kutta of fourth order with ten steps a sample, LuGre bristles that give way by
8 um, a controller that sees a quantised, noisy encoder, a force that is held for a sample and comes late by any
fraction of one. SI throughout.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy import signal

STEP = 1e-3


@dataclass(frozen=True)
class Axis:
    """What is true.

    friction: Coulomb and static force [N], speed [m/s] and exponent of the Stribeck curve; thinning: force [N] that
    builds up with speed over `thinning_speed`. asymmetry: `d |v|` [N s/m]. slope: force along the stroke [N/m].
    ripple: force [N], once per lead [m]. delay: of the force beyond its hold [s]. drift: relative change of the
    viscous friction over the record. command: height of pulses [N] that the drive gets besides its controller.
    push: a force on the axis [N] for 0.3 s; pushes: one for 0.2 s, 16 times at random. limit: the drive gives no
    more [N], whatever the command. hum: amplitude of a line in the logged force [N]. gain_error: relative, of the
    logged force. noise: rms of the disturbing force [N] and its pole a sample; wander: rms of another that is slow,
    with its corner [Hz]. one_way: first all moves forth.
    """

    mass: float = 95.0
    viscous: float = 240.0
    offset: float = -3.0
    coulomb: float = 0.0
    static: float = 0.0
    stribeck_speed: float = 0.02
    stribeck_exponent: float = 1.0
    thinning: float = 0.0
    thinning_speed: float = 0.015
    asymmetry: float = 0.0
    slope: float = 0.0
    ripple: float = 0.0
    lead: float = 2.5e-3
    delay: float = 0.0
    drift: float = 0.0
    command: float = 0.0
    push: float = 0.0
    push_at: float = 10.0
    pushes: float = 0.0
    limit: float = np.inf
    hum: float = 0.0
    hum_frequency: float = 21.3
    gain_error: float = 0.0
    noise: float = 0.8
    pole: float = 0.8
    wander: float = 0.0
    wander_frequency: float = 0.5
    encoder: float = 2e-8
    quantum: float = 5e-8
    position_gain: float = 160.0
    velocity_gain: float = 8500.0
    speeds: tuple[float, ...] = (0.04, 0.08, 0.12, 0.04)
    acceleration: float = 1.2
    seconds: float = 24.0
    rest: float = 0.0
    one_way: bool = False

    def with_nuisances(self, rng: np.random.Generator) -> Axis:
        """Another axis of the same kind: masses, friction, noise, gains, moves and screw drawn evenly."""
        mass = float(rng.uniform(60.0, 140.0))
        fast = float(rng.uniform(0.8, 1.25))
        return replace(
            self,
            mass=mass,
            viscous=float(rng.uniform(150.0, 350.0)),
            offset=float(rng.uniform(-5.0, 5.0)),
            noise=float(rng.uniform(0.4, 1.0)),
            pole=float(rng.uniform(0.7, 0.95)),
            wander=float(rng.uniform(0.0, 0.25)),
            wander_frequency=float(rng.uniform(0.2, 2.0)),
            encoder=float(rng.uniform(1e-8, 3e-8)),
            quantum=float(rng.choice([2e-8, 5e-8, 1e-7])),
            position_gain=float(rng.uniform(120.0, 180.0)),
            velocity_gain=float(mass * rng.uniform(75.0, 95.0)),
            lead=float(rng.choice([2.5e-3, 4e-3, 5e-3])),
            speeds=tuple(fast * float(s) for s in rng.permutation([0.04, 0.08, 0.12, 0.04])),
            acceleration=float(rng.uniform(1.0, 1.4)),
            push_at=float(rng.uniform(6.0, 18.0)),
            hum_frequency=float(rng.uniform(12.0, 25.0)),
        )


def reference(axis: Axis) -> np.ndarray:
    """Strokes of several moves, forth and back, each from rest to rest; one way: first all forth, then all back."""
    velocity: list[np.ndarray] = []
    way, total, wanted = 1.0, 0, round(axis.seconds / STEP)
    while total < wanted:
        for speed in axis.speeds:
            time = max(0.45, 0.4 + 1.2 * speed / axis.acceleration * 4.0)
            t = np.arange(round(time / STEP)) * STEP
            velocity.append(way * np.clip(axis.acceleration * np.minimum(t, time - t), 0.0, speed))
            velocity.append(np.zeros(round(axis.rest / STEP)))
            total += t.size + velocity[-1].size
        way = (1.0 if total < wanted / 2 else -1.0) if axis.one_way else -way
    smooth = np.convolve(np.concatenate(velocity), np.ones(12) / 12.0, mode="same")
    return np.cumsum(smooth)[:wanted] * STEP


def pulse_train(samples: int) -> np.ndarray:
    """Ones for 50 ms every 0.9 s."""
    k = np.arange(samples)
    return np.where((k % 900 >= 300) & (k % 900 < 350), 1.0, 0.0)


@njit(cache=True, nogil=True)
def _slope(x, v, z, force, warm, p):
    speed = abs(v)
    level = p[0] + (p[1] - p[0]) * np.exp(-((speed / p[2]) ** p[13])) + p[9] * (1.0 - np.exp(-speed / p[10]))
    if level > 0.0:
        stiff = p[12] / 8e-6
        rate = v - stiff * speed * z / level
        bristle = stiff * (z + 1.5e-4 * rate)
    else:
        rate, bristle = 0.0, 0.0
    friction = bristle + p[6] * (1.0 + warm) * v + p[3] * speed + p[7] + p[11] * x
    wave = p[4] * np.sin(2.0 * np.pi * x / p[5])
    return v, (force - friction - wave) / p[8], rate


@njit(cache=True, nogil=True)
def _run(target, added, noise, disturbance, delay, drift, limit, gains, quantum, p):
    n, fine = target.size, 10
    h = 1e-3 / fine
    q, u = np.zeros(n), np.zeros(n)
    x, v, z = target[0], 0.0, 0.0
    for k in range(n):
        q[k] = np.round((x + noise[k]) / quantum) * quantum
        before = q[k - 1] if k > 0 else q[k]
        u[k] = gains[1] * (gains[0] * (target[k] - q[k]) - (q[k] - before) / 1e-3) + added[k]
        warm = drift * (k / n - 0.5)
        for j in range(fine):
            at = k + j / fine - delay / 1e-3
            i = int(np.floor(at + 1e-9))
            # The next command may arrive within this step: then the mean force of the step counts.
            share = min(1.0, (i + 1.0 - at) * fine)
            old, new = u[i] if i >= 0 else 0.0, u[min(i + 1, k)] if i >= -1 else 0.0
            force = share * old + (1.0 - share) * new
            force = min(max(force, -limit), limit) + disturbance[k]
            a1, b1, c1 = _slope(x, v, z, force, warm, p)
            a2, b2, c2 = _slope(x + 0.5 * h * a1, v + 0.5 * h * b1, z + 0.5 * h * c1, force, warm, p)
            a3, b3, c3 = _slope(x + 0.5 * h * a2, v + 0.5 * h * b2, z + 0.5 * h * c2, force, warm, p)
            a4, b4, c4 = _slope(x + h * a3, v + h * b3, z + h * c3, force, warm, p)
            x += h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
            v += h * (b1 + 2.0 * b2 + 2.0 * b3 + b4) / 6.0
            z += h * (c1 + 2.0 * c2 + 2.0 * c3 + c4) / 6.0
    return q, u


def _coloured(rng: np.random.Generator, n: int, pole: float) -> np.ndarray:
    """First-order noise of unit variance."""
    white = rng.standard_normal(n)
    first = white[0]
    white *= np.sqrt(1.0 - pole**2)
    white[0] = first
    return signal.lfilter([1.0], [1.0, -pole], white)


def simulate(axis: Axis, seed: int) -> dict[str, np.ndarray]:
    """Return time, encoder position, drive force (command, without the lag of the hold), reference and pulses."""
    rng = np.random.default_rng(seed)
    target = reference(axis)
    n = target.size
    slowly = float(np.exp(-2.0 * np.pi * axis.wander_frequency * STEP))
    disturbance = axis.noise * _coloured(rng, n, axis.pole) + axis.wander * _coloured(rng, n, slowly)
    time = np.arange(n) * STEP
    disturbance = disturbance + np.where((time >= axis.push_at) & (time < axis.push_at + 0.3), axis.push, 0.0)
    for begin in np.sort(rng.uniform(1.0, axis.seconds - 1.0, 16)):
        disturbance = disturbance + np.where((time >= begin) & (time < begin + 0.2), axis.pushes, 0.0)
    p = np.array(
        [
            axis.coulomb,
            max(axis.static, axis.coulomb),
            axis.stribeck_speed,
            axis.asymmetry,
            axis.ripple,
            axis.lead,
            axis.viscous,
            axis.offset,
            axis.mass,
            axis.thinning,
            axis.thinning_speed,
            axis.slope,
            max(axis.coulomb, axis.thinning),
            axis.stribeck_exponent,
        ]
    )
    added = axis.command * pulse_train(n)
    gains = np.array([axis.position_gain, axis.velocity_gain])
    shaky = axis.encoder * rng.standard_normal(n)
    q, u = _run(target, added, shaky, disturbance, axis.delay, axis.drift, axis.limit, gains, axis.quantum, p)
    force = u * (1.0 + axis.gain_error) + axis.hum * np.sin(2.0 * np.pi * axis.hum_frequency * time)
    return {"time": time, "encoder": q, "force": force, "reference": target, "pulses": added}


@dataclass(frozen=True)
class DriveEffect:
    """What is hidden: how an axis is changed by a size, the size that must be found, whether both signs make sense."""

    plant: Callable[[Axis, float], Axis]
    size: float
    unit: str
    signed: bool = False


FRICTION = 20.0
"""Coulomb friction [N] that a tenth of is a friction level of 10 %."""

DRIVE_EFFECTS = {
    "friction": DriveEffect(lambda a, s: replace(a, coulomb=a.coulomb + FRICTION * s), 0.1, ""),
    "asymmetry": DriveEffect(lambda a, s: replace(a, asymmetry=a.viscous * s), 0.1, "", True),
    "delay": DriveEffect(lambda a, s: replace(a, delay=a.delay + s), 0.25e-3, "s"),
    "ripple": DriveEffect(lambda a, s: replace(a, ripple=s), 0.5, "N"),
    "drift": DriveEffect(lambda a, s: replace(a, drift=s), 0.03, "", True),
    "stribeck": DriveEffect(lambda a, s: replace(a, static=a.coulomb + s), 3.0, "N"),
    "thinning": DriveEffect(lambda a, s: replace(a, thinning=s), 3.0, "N"),
    "slope": DriveEffect(lambda a, s: replace(a, slope=s), 10.0, "N/m", True),
    "command": DriveEffect(lambda a, s: replace(a, command=s), 20.0, "N", True),
    "saturation": DriveEffect(lambda a, s: replace(a, limit=(1.0 - s) * strongest(a)), 0.1, ""),
    "hum": DriveEffect(lambda a, s: replace(a, hum=s), 0.5, "N"),
}
"""Effects in the catalogue of drive records. Asymmetry: |v| part over the viscous friction."""

DRIVE_OUTSIDE = {
    "pushes": DriveEffect(lambda a, s: replace(a, pushes=s), 10.0, "N", True),
}
"""Effects that it does not know: a force that comes and goes all the time."""


def strongest(axis: Axis) -> float:
    """Force [N] for the greatest acceleration at the greatest speed."""
    return axis.mass * axis.acceleration + axis.viscous * max(axis.speeds) + axis.coulomb + abs(axis.offset)
