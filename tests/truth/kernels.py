"""One feed axis in time, from its differential equations: Dormand-Prince 5(4) with its own step control, in absolute
coordinates, between the events of a sampled servo. All arrays are made in `integrate`; the rest counts no references.

State: tip x, v; carriage x, v; host x, v; cable x, v; four friction states; integral of a continuous servo.

Compiled at the first call and cached: `integrate` and what it calls, for the tuples below of float64 arrays and
scalars, in 8 s of CPU.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

STATES = 13
CHANNELS = 6
"""Rows of the output: tip acceleration, encoder (carriage against host), drive force, tip force, tip x, carriage v."""

FASTEST = 4e4
"""Bristles relax no faster than this [1/s]; it leaves the friction curve as it is, and 25 us are nothing at 200 Hz."""

_SHORTEST, _EVENT, _QUEUE = 1e-9, 1e-7, 64

NONE, LUGRE, SLIP, STICK = 0, 1, 2, 3
_XT, _VT, _XM, _VM, _XH, _VH, _XC, _VC, _Z, _I = 0, 1, 2, 3, 4, 5, 6, 7, 8, 12
_ELEMENTS = 4


class Plant(NamedTuple):
    """Masses [kg], springs [N/m], dampers [N s/m]; a host or cable of zero mass is not there."""

    tip: float
    carriage: float
    damping: float
    stiffness: float
    cubic: float
    stop: float
    play: float
    posture: float
    origin: float
    host: float
    host_k: float
    host_c: float
    cable: float
    cable_k: float
    cable_c: float
    ripple: float
    pitch: float


class Friction(NamedTuple):
    """Friction: kind; rows (forth, back) of Coulomb, static [N], Stribeck speed [m/s], viscous [N s/m]; bristles."""

    kind: int
    curve: Any
    delta: float
    s0: float
    s1: float
    share: Any
    spring: Any
    attraction: float


class Loop(NamedTuple):
    """P-PI servo. A period of zero: continuous, without delay."""

    kp: float
    ti: float
    kv: float
    period: float
    first: float
    latency: float
    resolution: float
    exact: bool
    limit: float


class Push(NamedTuple):
    """Force on the tip: rows of pulses (start, peak, rise time, exponent) and of tones (start, stop, N, Hz, rad).

    The tones follow each other and last equally long. Rows of waves (N, Hz, rad) sound all at once, all the time.
    """

    pulses: Any
    tones: Any
    waves: Any


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def push(excitation, t):
    """Force on the tip [N] at time t [s]."""
    f = 0.0
    for i in range(excitation.pulses.shape[0]):
        s = (t - excitation.pulses[i, 0]) / excitation.pulses[i, 2]
        if 0.0 < s < 14.0:
            n = excitation.pulses[i, 3]
            f += excitation.pulses[i, 1] * math.exp(n * (math.log(s) + 1.0 - s))
    if excitation.tones.shape[0] > 0 and t >= excitation.tones[0, 0]:
        i = int((t - excitation.tones[0, 0]) / (excitation.tones[0, 1] - excitation.tones[0, 0]))
        if i < excitation.tones.shape[0]:
            phase = 2.0 * math.pi * excitation.tones[i, 3] * (t - excitation.tones[i, 0]) + excitation.tones[i, 4]
            f += excitation.tones[i, 2] * math.sin(phase)
    for i in range(excitation.waves.shape[0]):
        f += excitation.waves[i, 0] * math.cos(2.0 * math.pi * excitation.waves[i, 1] * t + excitation.waves[i, 2])
    return f


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def level(friction, v):
    """Stribeck curve without its viscous part [N], never negative; the side follows the sign of v."""
    side = 0 if v >= 0.0 else 1
    ratio = abs(v) / friction.curve[side, 2]
    if friction.delta != 1.0:
        ratio = ratio**friction.delta
    return friction.curve[side, 0] + (friction.curve[side, 1] - friction.curve[side, 0]) * math.exp(-ratio)


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def viscous(friction, v):
    """Viscous part of the friction [N]."""
    return friction.curve[0 if v >= 0.0 else 1, 3] * v


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _friction_force(friction, mode, y, dy, pull):
    """Friction on the carriage [N]; fills the rates of the friction states. `pull` is all else that acts on it."""
    v = y[_VM] - y[_VH]
    if friction.kind == NONE:
        return viscous(friction, v)
    if friction.kind == LUGRE:
        top = level(friction, v)
        dy[_Z] = v - friction.s0 * abs(v) / top * y[_Z]
        if friction.s0 * abs(v) > FASTEST * top:
            dy[_Z] *= FASTEST * top / (friction.s0 * abs(v))
        return friction.s0 * y[_Z] + friction.s1 * dy[_Z] + viscous(friction, v)
    if friction.kind == SLIP:
        top = level(friction, v)
        total = viscous(friction, v)
        for i in range(_ELEMENTS):
            if mode[i] == 0:
                dy[_Z + i] = friction.spring[i] * v
            else:
                dy[_Z + i] = friction.attraction * (mode[i] * friction.share[i] - y[_Z + i] / top)
            total += y[_Z + i]
        return total
    if mode[0] == 0:
        return pull
    return mode[0] * level(friction, mode[0] * abs(v)) + viscous(friction, v)


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _joint(plant, jenkins, anchor, held, d):
    """Elastic force of the joint [N] at deformation d [m]; Jenkins elements start from their last accepted point."""
    f = plant.stiffness * d + plant.cubic * d * d * d
    if plant.stop > 0.0:
        f += plant.stop * (max(d - plant.play, 0.0) + min(d + plant.play, 0.0))
    for i in range(held.size):
        g = held[i] + jenkins[i, 0] * (d - anchor)
        f += min(max(g, -jenkins[i, 1]), jenkins[i, 1])
    return f


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _rates(t, y, dy, plant, friction, loop, excitation, jenkins, anchor, held, mode, drive, start, feed):
    """Fill the time derivative of the state; return the drive force [N]."""
    dy[:] = 0.0
    x, v = y[_XM] - y[_XH], y[_VM] - y[_VH]
    if loop.period == 0.0:
        error = feed + loop.kv * (start + feed * t - x) - v
        dy[_I] = error
        drive = loop.kp * (error + y[_I] / loop.ti)
    elastic = _joint(plant, jenkins, anchor, held, y[_XT] - y[_XM])
    joint = elastic * (1.0 + plant.posture * (y[_XM] - plant.origin)) + plant.damping * (y[_VT] - y[_VM])
    cable = 0.0
    if plant.cable > 0.0:
        cable = plant.cable_k * (y[_XT] - y[_XC]) + plant.cable_c * (y[_VT] - y[_VC])
        dy[_VC] = cable / plant.cable
        dy[_XC] = y[_VC]
    pull = drive + joint
    if plant.ripple > 0.0:
        pull += plant.ripple * math.sin(2.0 * math.pi * x / plant.pitch)
    resisting = _friction_force(friction, mode, y, dy, pull)
    dy[_XT] = y[_VT]
    dy[_VT] = (push(excitation, t) - joint - cable) / plant.tip
    dy[_XM] = y[_VM]
    dy[_VM] = (pull - resisting) / plant.carriage
    if plant.host > 0.0:
        dy[_XH] = y[_VH]
        dy[_VH] = (resisting - pull + joint - plant.host_k * y[_XH] - plant.host_c * y[_VH]) / plant.host
        if friction.kind == STICK and mode[0] == 0:
            both = plant.carriage + plant.host
            dy[_VM] = (joint - plant.host_k * y[_XH] - plant.host_c * y[_VH]) / both
            dy[_VH] = dy[_VM]
    return drive


_NODES = np.array([0.0, 0.2, 0.3, 0.8, 8.0 / 9.0, 1.0, 1.0])
_WEIGHTS = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1.0 / 5.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3.0 / 40.0, 9.0 / 40.0, 0.0, 0.0, 0.0, 0.0],
        [44.0 / 45.0, -56.0 / 15.0, 32.0 / 9.0, 0.0, 0.0, 0.0],
        [19372.0 / 6561.0, -25360.0 / 2187.0, 64448.0 / 6561.0, -212.0 / 729.0, 0.0, 0.0],
        [9017.0 / 3168.0, -355.0 / 33.0, 46732.0 / 5247.0, 49.0 / 176.0, -5103.0 / 18656.0, 0.0],
        [35.0 / 384.0, 0.0, 500.0 / 1113.0, 125.0 / 192.0, -2187.0 / 6784.0, 11.0 / 84.0],
    ]
)
_ERROR = np.array([71.0 / 57600.0, 0.0, -71.0 / 16695.0, 71.0 / 1920.0, -17253.0 / 339200.0, 22.0 / 525.0, -1.0 / 40.0])


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _trial(t, y, h, k, new, live, plant, friction, loop, excitation, jenkins, anchor, held, mode, drive, start, feed):
    """Dormand-Prince step from y to new; return the scaled error.

    k[0] holds the first rates, k[6] gets the last; live: states that move.
    """
    for stage in range(1, 7):
        for j in live:
            total = 0.0
            for r in range(stage):
                total += _WEIGHTS[stage, r] * k[r, j]
            new[j] = y[j] + h * total
        at = t + _NODES[stage] * h
        _rates(at, new, k[stage], plant, friction, loop, excitation, jenkins, anchor, held, mode, drive, start, feed)
    worst = 0.0
    for j in live:
        total = 0.0
        for r in range(7):
            total += _ERROR[r] * k[r, j]
        worst = max(worst, abs(h * total) / _tolerance(j, friction.kind, new[j]))
    return worst


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _tolerance(j, kind, value):
    """Error allowed in one step: 0.01 nm, 10 nm/s, 1e-12 m of bristle or 0.1 mN of an element."""
    if j >= _Z and j < _I:
        return 1e-4 if kind == SLIP else 1e-12
    if j % 2 == 0:
        return 1e-11
    return 1e-8 + 1e-6 * abs(value)


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _passed(friction, mode, y, pull):
    """Return True when a friction event lies behind state y."""
    v = y[_VM] - y[_VH]
    if friction.kind == STICK:
        if mode[0] == 0:
            return abs(pull) > friction.curve[0 if pull > 0.0 else 1, 1]
        return v * mode[0] < 0.0
    if friction.kind == SLIP:
        for i in range(_ELEMENTS):
            if mode[i] == 0:
                if abs(y[_Z + i]) > friction.share[i] * level(friction, v) and y[_Z + i] * v > 0.0:
                    return True
            elif v * mode[i] < 0.0:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _switch(friction, mode, y, pull):
    """Carry out the friction events that lie behind state y."""
    v = y[_VM] - y[_VH]
    if friction.kind == STICK:
        if mode[0] == 0:
            mode[0] = 1 if pull > 0.0 else -1
        else:
            y[_VM] = y[_VH]
            mode[0] = 0
            if abs(pull) > friction.curve[0 if pull > 0.0 else 1, 1]:
                mode[0] = 1 if pull > 0.0 else -1
        return
    for i in range(_ELEMENTS):
        if mode[i] == 0:
            if abs(y[_Z + i]) > friction.share[i] * level(friction, v) and y[_Z + i] * v > 0.0:
                mode[i] = 1 if v > 0.0 else -1
        elif v * mode[i] < 0.0:
            mode[i] = 0


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _pull(y, plant, jenkins, anchor, held, drive):
    """All that acts on the carriage but friction and host [N]."""
    elastic = _joint(plant, jenkins, anchor, held, y[_XT] - y[_XM])
    factor = 1.0 + plant.posture * (y[_XM] - plant.origin)
    ripple = plant.ripple * math.sin(2.0 * math.pi * (y[_XM] - y[_XH]) / plant.pitch)
    return drive + elastic * factor + plant.damping * (y[_VT] - y[_VM]) + ripple


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _advance(clock, until, y, k, new, live, plant, friction, loop, excitation, jenkins, held, mode, drive, start, feed):
    """Integrate to time `until`; clock: time [s], step that the error allows [s], joint deformation last accepted."""
    fresh = True
    while clock[0] < until - 1e-13:
        t, step, anchor = clock[0], min(clock[1], until - clock[0]), clock[2]
        if fresh:
            _rates(t, y, k[0], plant, friction, loop, excitation, jenkins, anchor, held, mode, drive, start, feed)
        error = _trial(
            t, y, step, k, new, live, plant, friction, loop, excitation, jenkins, anchor, held, mode, drive, start, feed
        )
        fresh = False
        if error > 1.0 and step > _SHORTEST:
            clock[1] = step * max(0.2, 0.9 * error**-0.2)
            continue
        event = friction.kind >= SLIP and _passed(friction, mode, new, _pull(new, plant, jenkins, anchor, held, drive))
        if event and step > _EVENT:
            clock[1] = 0.5 * step
            continue
        for j in live:
            y[j] = new[j]
            k[0, j] = k[6, j]
        clock[2] = y[_XT] - y[_XM]
        for i in range(held.size):
            pulled = held[i] + jenkins[i, 0] * (clock[2] - anchor)
            held[i] = min(max(pulled, -jenkins[i, 1]), jenkins[i, 1])
        if event:
            _switch(friction, mode, y, _pull(y, plant, jenkins, clock[2], held, drive))
            fresh = True
        if step == clock[1] or error > 0.3:
            clock[1] = step * min(5.0, 0.9 * max(error, 1e-6) ** -0.2)
        clock[0] = t + step
    clock[0] = until


@njit(cache=True, nogil=True, error_model="numpy", _nrt=False)
def _read(t, y, memory, loop, start, feed):
    """Take a reading and return the force [N] that the servo wants; memory: integral of the error, last reading."""
    x = y[_XM] - y[_XH]
    if loop.resolution > 0.0:
        x = math.floor(x / loop.resolution + 0.5) * loop.resolution
    v = (x - memory[1]) / loop.period
    if loop.exact or math.isnan(memory[1]):
        v = y[_VM] - y[_VH]
    error = feed + loop.kv * (start + feed * t - x) - v
    memory[0] += loop.period * error
    memory[1] = x
    wanted = loop.kp * (error + memory[0] / loop.ti)
    return min(max(wanted, -loop.limit), loop.limit)


@njit(cache=True, nogil=True, error_model="numpy")
def _live(plant, friction, loop):
    """States that can move."""
    moves = np.zeros(STATES, np.bool_)
    moves[:_XH] = True
    moves[_XH:_XC] = plant.host > 0.0
    moves[_XC:_Z] = plant.cable > 0.0
    moves[_Z] = friction.kind == LUGRE or friction.kind == SLIP
    moves[_Z + 1 : _I] = friction.kind == SLIP
    moves[_I] = loop.period == 0.0
    return np.flatnonzero(moves)


@njit(cache=True, nogil=True, error_model="numpy")
def integrate(y, plant, friction, loop, excitation, jenkins, steady, start, feed, rate, mode, out):
    """Integrate from state y (t = 0, changed in place) and fill out (CHANNELS, n) at `rate` [Hz].

    steady [N]: drive force before the first reading. mode (4,): friction events, 0 sticks, else the direction of slip.
    """
    k, new, held, live = np.zeros((7, y.size)), y.copy(), np.zeros(jenkins.shape[0]), _live(plant, friction, loop)
    rates = np.zeros(y.size)
    clock = np.array([0.0, 1e-6, y[_XT] - y[_XM]])
    memory = np.array([steady * loop.ti / loop.kp if loop.kp > 0.0 else 0.0, math.nan])
    queue, put, get = np.zeros((_QUEUE, 2)), 0, 0
    drive = steady
    reading = loop.first if loop.period > 0.0 else math.inf
    for sample in range(out.shape[1]):
        goal = sample / rate
        change = queue[get % _QUEUE, 0] if get < put else math.inf
        while min(reading, change) <= goal:
            at = min(reading, change)
            _advance(
                clock, at, y, k, new, live, plant, friction, loop, excitation, jenkins, held, mode, drive, start, feed
            )
            if change <= reading:
                drive = queue[get % _QUEUE, 1]
                get += 1
            else:
                queue[put % _QUEUE, 0] = reading + loop.latency
                queue[put % _QUEUE, 1] = _read(reading, y, memory, loop, start, feed)
                put += 1
                reading += loop.period
            change = queue[get % _QUEUE, 0] if get < put else math.inf
        _advance(
            clock, goal, y, k, new, live, plant, friction, loop, excitation, jenkins, held, mode, drive, start, feed
        )
        now = _rates(
            goal, y, rates, plant, friction, loop, excitation, jenkins, clock[2], held, mode, drive, start, feed
        )
        out[0, sample], out[1, sample], out[2, sample] = rates[_VT], y[_XM] - y[_XH], now
        out[3, sample], out[4, sample], out[5, sample] = push(excitation, goal), y[_XT], y[_VM]
