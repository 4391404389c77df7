"""Stability of a machine that is to be moved in time: at its feed, and so fast that friction is past its curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from process.argument_principle import right_half_plane_zeros
from process.delay_equation import DelayEquation
from process.errors import InputError
from process.friction_impedance import FrictionImpedance
from process.machine_problem import Problem, SampledControl
from process.operating_point import OperatingPoint

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_INDEPENDENT = 1e8


def operating_point(p: Problem) -> OperatingPoint:
    """Return the machine linearised in uniform motion, with the local friction."""
    return p.machine.at(dict(zip(p.machine.axes, p.feeds, strict=True)), p.controller, p.position)


def require_bounded(p: Problem, point: OperatingPoint) -> None:
    """Friction limits a motion only where its force rises with speed: the servo must be stable when sliding fast."""
    if not any(v is not None for v in p.servos):
        return
    for slopes in dict.fromkeys(zip(*(r.fast for r in p.friction), strict=True)):
        slides = [replace(s, friction=FrictionImpedance(v)) for s, v in zip(point.slides, slopes, strict=True)]
        count = count_unstable(OperatingPoint(point.structure, slides), p.control)
        if count:
            gains = "; ".join(
                f"axis {s.name} has Kp {s.servo.Kp:g} N s/m, Ti {s.servo.Ti * 1e3:g} ms, Kv {s.servo.Kv:g} 1/s, delay "
                f"{s.servo.delay * 1e3:g} ms"
                for s in slides
                if s.servo is not None
            )
            raise InputError(
                f"the machine is unstable with its servos even when it slides fast: {count} pole(s); {gains}. Lower Kp "
                "or Kv, raise Ti, or shorten the dead time or the sampling period"
            )


def count_unstable(point: OperatingPoint, control: SampledControl | None) -> int:
    """Count poles in the right half plane, or outside the unit circle; without dead time from the eigenvalues."""
    if control is not None:
        return int(np.sum(np.abs(np.linalg.eigvals(_sampled_transition(point, control))) > 1.0 + 1e-9))
    if any(s.servo is not None and s.servo.delay > 0.0 for s in point.slides):
        return _count_late(point)
    s = np.linalg.eigvals(point.delay_equation.a)
    # A free slide has its pole at the origin twice, which rounding spreads by the root of its size.
    return int(np.sum(s.real > 1e-6 * np.abs(s).max(initial=0.0)))


def _count_late(point: OperatingPoint) -> int:
    """Count by the argument principle; the determinant through the poles without dead time, where these allow it."""
    equation = point.delay_equation
    poles, vectors = np.linalg.eig(equation.prompt())
    apart = np.linalg.cond(vectors) < _INDEPENDENT and np.abs(poles.real).min() > 1e-9 * np.abs(poles).max()
    if not apart or any(s.servo is None for s in point.slides):
        return point.unstable_poles()
    scales = equation.scales()
    return right_half_plane_zeros(_characteristic(equation, poles, vectors, scales), scales, equation.longest)


def _characteristic(
    equation: DelayEquation, poles: Complex, vectors: Complex, scales: Real
) -> Callable[[Complex], Complex]:
    """Return s -> ``det(delta(s))/(s + w0)^n`` [1]: as large a determinant as there are dead times.

    With ``A_0 = A + sum E K``, ``det(delta) = det(s I - A_0) det(I + (1 - exp(-s tau)) K (s I - A_0)^-1 E)``.
    """
    taus, inlets, rows = (np.array(part) for part in zip(*equation.delayed, strict=True))
    residues = (rows @ vectors).T[:, :, None] * np.linalg.solve(vectors, inlets.T)[:, None, :]
    far, count = float(scales.max()), taus.size

    def characteristic(s: Complex) -> Complex:
        away = s[:, None] - poles
        loop = ((1.0 / away) @ residues.reshape(poles.size, -1)).reshape(s.size, count, count)
        loop *= -np.expm1(-s[:, None] * taus)[:, :, None]
        whole = 1.0 + loop[:, 0, 0] if count == 1 else np.linalg.det(np.eye(count) + loop)
        return np.asarray(np.prod(away / (s + far)[:, None], axis=1) * whole)

    return characteristic


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
