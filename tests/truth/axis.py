"""The true feed axis: what it is made of, and what it does when it is hit or shaken. Shares no code with the packages.

Two masses with a joint, LuGre, GMS or stick-slip friction with a side for each direction, a sampled P-PI servo with a
quantised encoder. Nominal values: Tables 1 and 2 of Franco et al. 2024 (JMMP 8/5/207). SI throughout.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from truth import kernels

MM_MIN = 1.0 / 6e4
RATE = 8192.0
"""Rate of the raw signals [Hz]."""

KINDS = {"none": kernels.NONE, "lugre": kernels.LUGRE, "gms": kernels.SLIP, "stick": kernels.STICK}
SHARE = (0.1, 0.2, 0.3, 0.4)
"""Part of each GMS element in the friction level."""

STIFF = (0.4, 0.3, 0.2, 0.1)
"""Part of each GMS element in the bristle stiffness."""

ELEMENTS = 12


@dataclass(frozen=True)
class Friction:
    """Guideway friction; pairs are (forth, back).

    kind "lugre", "gms", "stick" (events: sticks until the pull exceeds `static`) or "none" (viscous part only).
    """

    kind: str = "lugre"
    coulomb: tuple[float, float] = (44.2, 38.7)
    static: tuple[float, float] = (84.0, 88.0)
    stribeck: tuple[float, float] = (387.4 * MM_MIN, 421.0 * MM_MIN)
    viscous: tuple[float, float] = (168.0, 150.0)
    delta: float = 1.0
    bristle_stiffness: float = 5e8
    bristle_damping: float = 6e4
    attraction: float = 2e5

    def curve(self) -> np.ndarray:
        return np.ascontiguousarray(np.array([self.coulomb, self.static, self.stribeck, self.viscous]).T)

    def steady(self, feed: float) -> float:
        """Force at a steady feed [N]; zero at rest."""
        if feed == 0.0:
            return 0.0
        coulomb, static, stribeck, viscous = self.curve()[0 if feed > 0.0 else 1]
        dry = coulomb + (static - coulomb) * math.exp(-((abs(feed) / stribeck) ** self.delta))
        return math.copysign(0.0 if self.kind == "none" else dry, feed) + viscous * feed


@dataclass(frozen=True)
class Joint:
    """Joint between carriage and tip. The shares are parts of `stiffness`; at zero the joint is linear.

    micro-slip: Jenkins elements that slip at deformations spread evenly up to `slip_travel` [m]. gap: that share acts
    beyond `play` (half of the play) only. cubic [N/m3]. per_metre: relative change of all of it with position.
    """

    stiffness: float = 1.68e6
    damping: float = 104.0
    slip_share: float = 0.0
    slip_travel: float = 100e-6
    cubic: float = 0.0
    gap_share: float = 0.0
    play: float = 0.0
    per_metre: float = 0.0

    def jenkins(self) -> np.ndarray:
        """Stiffness [N/m] and slip force [N] of each element."""
        if self.slip_share == 0.0:
            return np.zeros((0, 2))
        each = self.slip_share * self.stiffness / ELEMENTS
        travel = self.slip_travel * (np.arange(ELEMENTS) + 0.5) / ELEMENTS
        return np.column_stack([np.full(ELEMENTS, each), each * travel])


@dataclass(frozen=True)
class Servo:
    """Gains of a P-PI cascade: K_p [N s/m], T_i [s], K_v [1/s]."""

    kp: float
    ti: float
    kv: float


SERVOS = {
    "K1": Servo(3242.0, 21.2e-3, 23.5),
    "K2": Servo(6268.0, 10.9e-3, 45.5),
    "K3": Servo(10590.0, 6.5e-3, 76.9),
    "K4": Servo(18804.0, 3.6e-3, 136.6),
}


@dataclass(frozen=True)
class Control:
    """How the servo runs: period (0: continuous, no delay), whole periods of lag, further latency [s], encoder step.

    Nominal dead time of the force (lag + 1/2) period + extra = 0.625 ms; the velocity, a difference of readings, is
    another half period late: the 0.75 ms of the bench.
    """

    period: float = 0.25e-3
    lag: int = 1
    extra: float = 0.25e-3
    resolution: float = 20e-9
    exact_velocity: bool = False
    limit: float = math.inf


@dataclass(frozen=True)
class Appendage:
    """An oscillator outside every catalogue: mass [kg] (0: none), frequency [Hz], damping ratio."""

    mass: float = 0.0
    frequency: float = 48.0
    ratio: float = 0.03

    def constants(self) -> tuple[float, float, float]:
        w = 2.0 * math.pi * self.frequency
        return self.mass, self.mass * w * w, 2.0 * self.ratio * self.mass * w


@dataclass(frozen=True)
class Truth:
    """The machine. `drift`: relative change of the joint stiffness from the first to the last measurement.

    walk: standard deviation of a random walk of the stiffness at the end of the session. Host: what the guideway is
    bolted to. Cable: hangs on the tip. ripple [N], pitch [m]: force of the screw.
    """

    moving_mass: float = 23.1
    tip_mass: float = 11.3
    joint: Joint = field(default_factory=Joint)
    friction: Friction = field(default_factory=Friction)
    servos: Mapping[str, Servo] = field(default_factory=lambda: dict(SERVOS))
    control: Control = field(default_factory=Control)
    sensor_mass: float = 0.0
    drift: float = 0.0
    walk: float = 0.0
    host: Appendage = field(default_factory=Appendage)
    cable: Appendage = field(default_factory=Appendage)
    ripple: float = 0.0
    pitch: float = 5e-3

    def with_nuisances(self, rng: np.random.Generator) -> Truth:
        """Masses and stiffness within 5 %, damping and viscous friction within 20 %, evenly spread."""
        masses, k, slow = 1.0 + 0.05 * rng.uniform(-1, 1, 2), 1.0 + 0.05 * rng.uniform(-1, 1), rng.uniform(-0.2, 0.2, 2)
        joint = replace(
            self.joint, stiffness=self.joint.stiffness * k, damping=self.joint.damping * (1.0 + float(slow[0]))
        )
        forth, back = (float(v * (1.0 + slow[1])) for v in self.friction.viscous)
        return replace(
            self,
            moving_mass=self.moving_mass * float(masses[0]),
            tip_mass=self.tip_mass * float(masses[1]),
            joint=joint,
            friction=replace(self.friction, viscous=(forth, back)),
        )


@dataclass(frozen=True)
class Setting:
    """State of the machine in one measurement: feed [m/s], controller, position [m], mass on the tip [kg], stiffness.

    stiffness: factor on the joint; arrival: bristle deflection at rest, part of the static one; phase: first reading
    of the servo, part of its period.
    """

    feed: float = 0.0
    controller: str = "K2"
    position: float = 0.0
    tip_mass: float = 0.0
    stiffness: float = 1.0
    arrival: float = 0.0
    phase: float = 0.5


def simulate(
    truth: Truth,
    setting: Setting,
    pulses: np.ndarray,
    tones: np.ndarray,
    duration: float,
    waves: np.ndarray | None = None,
) -> np.ndarray:
    """Return the raw signals (kernels.CHANNELS, n) at `RATE`; the axis is in steady motion at time 0.

    pulses: rows (start [s], peak [N], rise time [s], exponent); tones: rows (start, stop [s], N, Hz, rad), one after
    the other; waves: rows (N, Hz, rad) of cosines, all at once.
    """
    servo, control, feed = truth.servos[setting.controller], truth.control, setting.feed
    steady = truth.friction.steady(feed)
    y = np.zeros(kernels.STATES)
    y[[0, 2, 6]] = setting.position
    y[[1, 3, 7]] = feed
    mode = np.zeros(4, np.int64)
    _preload(truth.friction, setting, y, mode)
    y[12] = steady * servo.ti / servo.kp if servo.kp > 0.0 else 0.0
    loop = kernels.Loop(
        servo.kp,
        servo.ti,
        servo.kv,
        control.period,
        setting.phase * control.period,
        control.lag * control.period + control.extra,
        control.resolution,
        control.exact_velocity,
        control.limit,
    )
    out = np.zeros((kernels.CHANNELS, round(duration * RATE)))
    excitation = kernels.Push(
        np.ascontiguousarray(pulses, dtype=float).reshape(-1, 4),
        np.ascontiguousarray(tones, dtype=float).reshape(-1, 5),
        np.ascontiguousarray(np.zeros((0, 3)) if waves is None else waves, dtype=float).reshape(-1, 3),
    )
    plant, jenkins = _plant(truth, setting)
    kernels.integrate(
        y,
        plant,
        _packed_friction(truth.friction),
        loop,
        excitation,
        jenkins,
        steady,
        setting.position,
        feed,
        RATE,
        mode,
        out,
    )
    return out


def _plant(truth: Truth, setting: Setting) -> tuple[kernels.Plant, np.ndarray]:
    j = replace(truth.joint, stiffness=truth.joint.stiffness * setting.stiffness)
    linear = j.stiffness * (1.0 - j.slip_share - j.gap_share)
    plant = kernels.Plant(
        truth.tip_mass + setting.tip_mass,
        truth.moving_mass,
        j.damping,
        linear,
        j.cubic,
        j.gap_share * j.stiffness,
        j.play,
        j.per_metre,
        0.0,
        *truth.host.constants(),
        *truth.cable.constants(),
        truth.ripple,
        truth.pitch,
    )
    return plant, j.jenkins()


def _packed_friction(f: Friction) -> kernels.Friction:
    spring = f.bristle_stiffness * np.array(STIFF)
    return kernels.Friction(
        KINDS[f.kind],
        f.curve(),
        f.delta,
        f.bristle_stiffness,
        f.bristle_damping,
        np.array(SHARE),
        spring,
        f.attraction,
    )


def _preload(f: Friction, setting: Setting, y: np.ndarray, mode: np.ndarray) -> None:
    """Put the friction into steady sliding, or leave the deflection of an arrival."""
    dry = f.steady(setting.feed) - f.curve()[0 if setting.feed >= 0.0 else 1, 3] * setting.feed
    way = int(np.sign(setting.feed))
    if f.kind == "lugre":
        y[8] = (dry if way else setting.arrival * min(f.coulomb)) / f.bristle_stiffness
    elif f.kind == "gms":
        y[8:12] = dry * np.array(SHARE)
        mode[:] = way
    elif f.kind == "stick":
        mode[0] = way


def response_at_rest(truth: Truth, setting: Setting) -> tuple[bool, float]:
    """Return whether uniform motion settles after a small kick (0.02 N s), and the vibration that stays over the feed.

    At rest: the tip's speed varies by less than 2 % of the feed (rms, last quarter of 2 s).
    """
    if setting.feed == 0.0:
        return True, 0.0
    raw = simulate(truth, setting, np.array([0.1, 8.0, 1.7e-3, 3.0]), np.zeros((0, 5)), 2.0)
    tail = raw[4, -int(RATE / 4) :]
    speed = np.diff(tail) * RATE - setting.feed
    share = float(speed.std() / abs(setting.feed))
    return share < 0.02, share
