"""Stability of a machine that is to be moved in time: at its feed, and so fast that friction is past its curve."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from process.errors import InputError
from process.friction_impedance import FrictionImpedance
from process.machine_problem import Problem, SampledControl
from process.operating_point import OperatingPoint

Real = NDArray[np.float64]


def operating_point(p: Problem) -> OperatingPoint:
    """Return the machine linearised in uniform motion, with the local friction."""
    return p.machine.at(dict(zip(p.machine.axes, p.feeds, strict=True)), p.controller, p.position)


class _Asked:
    """What a verdict is about: two problems are alike where their keys are."""

    def __init__(self, p: Problem) -> None:
        self.problem = p._replace(forces={}, drive_forces={}, cut=None, spindle=None)
        first = p.structures[0]
        matrices = (first.mass, first.damping, first.stiffness, first.slide_rows())
        joints = tuple((m.joint, m.participation.tobytes()) for m in p.machine.joints)
        fast = tuple(r.fast for r in p.friction)
        self.key: Hashable = (tuple(m.tobytes() for m in matrices), joints, p.servos, p.control, fast)

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Asked) and self.key == other.key


def require_bounded(p: Problem) -> None:
    """Friction limits a motion only where its force rises with speed: the servo must be stable when sliding fast."""
    if not any(v is not None for v in p.servos):
        return
    count = _unbounded(_Asked(p))
    if count:
        gains = "; ".join(
            f"axis {name} has Kp {servo.Kp:g} N s/m, Ti {servo.Ti * 1e3:g} ms, Kv {servo.Kv:g} 1/s, delay "
            f"{servo.delay * 1e3:g} ms"
            for name, servo in zip(p.machine.axes, p.servos, strict=True)
            if servo is not None
        )
        raise InputError(
            f"the machine is unstable with its servos even when it slides fast: {count} pole(s); {gains}. Lower Kp "
            "or Kv, raise Ti, or shorten the dead time or the sampling period"
        )


@lru_cache(maxsize=256)
def _unbounded(asked: _Asked) -> int:
    """Count unstable poles when sliding fast, in the worse direction. Kept: the same machine is hit many times."""
    p = asked.problem
    point = operating_point(p)
    counts = [0]
    for slopes in dict.fromkeys(zip(*(r.fast for r in p.friction), strict=True)):
        slides = [replace(s, friction=FrictionImpedance(v)) for s, v in zip(point.slides, slopes, strict=True)]
        counts.append(count_unstable(OperatingPoint(point.structure, slides), p.control))
    return max(counts)


def count_unstable(point: OperatingPoint, control: SampledControl | None) -> int:
    """Count poles in the right half plane, or outside the unit circle; without dead time from the eigenvalues."""
    if control is not None:
        return int(np.sum(np.abs(np.linalg.eigvals(_sampled_transition(point, control))) > 1.0 + 1e-9))
    if any(s.servo is not None and s.servo.delay > 0.0 for s in point.slides):
        return point.unstable_poles()
    s = np.linalg.eigvals(point.delay_equation.a)
    # A free slide has its pole at the origin twice, which rounding spreads by the root of its size.
    return int(np.sum(s.real > 1e-6 * np.abs(s).max(initial=0.0)))


def _sampled_transition(point: OperatingPoint, control: SampledControl) -> Real:
    """Return the matrix that takes motion, integrals, waiting forces and last readings from one sample to the next.

    An encoder with a resolution gives the velocity as the difference of two readings.
    """
    free = replace(point, slides=tuple(replace(s, servo=None) for s in point.slides))
    a, n, period, lag = free.delay_equation.a, point.structure.size, control.period, control.lag
    rows, held = point.structure.slide_rows(), [(i, s.servo) for i, s in enumerate(point.slides) if s.servo is not None]
    m, count = a.shape[0], len(held)
    block = np.zeros((m + count, m + count))
    block[:m, :m] = a
    block[n : 2 * n, m:] = np.linalg.solve(point.structure.mass, rows[[i for i, _ in held]].T)
    exact = linalg.expm(block * period)[:m]
    differenced = control.encoder_resolution > 0.0
    readings = m + count * (1 + lag)
    size = readings + count * differenced
    z = np.zeros((size, size))
    z[:m, :m] = exact[:, :m]
    for k, (i, servo) in enumerate(held):
        error, integral = np.zeros(size), m + k
        error[:n] = -servo.Kv * rows[i]
        if differenced:
            error[:n] -= rows[i] / period
            error[readings + k] = 1.0 / period
            z[readings + k, :n] = rows[i]
        else:
            error[n : 2 * n] = -rows[i]
        z[integral] = period * error
        z[integral, integral] = 1.0
        force = servo.Kp * (error + z[integral] / servo.Ti)
        queue = m + count + k * lag
        if lag == 0:
            z[:m] += np.outer(exact[:, m + k], force)
        else:
            z[:m, queue + lag - 1] += exact[:, m + k]
            z[queue] = force
            z[queue + 1 : queue + lag, queue : queue + lag - 1] = np.eye(lag - 1)
    return z
