"""A machine linearised at one operating point: compliance with exact dead times, poles, stability, state space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.drive.delay_equation import DelayEquation, oscillations
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.linearised import FrictionImpedance
from process.labels import AXES, make_compliance
from process.machine.structure import Structure
from process.types import Complex, Real

_ORIGIN = 1e-6
"""Poles below this share of the largest rest at the origin."""


@dataclass(frozen=True)
class SlideImpedance:
    """Servo and linearised friction of one slide.

    Parameters
    ----------
    name : str
        Axis.
    servo : Servo or None
        None: no servo.
    friction : FrictionImpedance
        Local friction.
    """

    name: str
    servo: Servo | None
    friction: FrictionImpedance

    def stiffness(self, s: Complex) -> Complex:
        """Return the dynamic stiffness [N/m] at complex s [rad/s], shape (n,), s not zero."""
        held = self.friction(s)
        return held if self.servo is None else np.asarray(held + self.servo.feedback(s))


@dataclass(frozen=True)
class OperatingPoint:
    """Linear machine: ``Phi = T Z^-1 T^T``, ``Z = M s^2 + C s + K + sum_a S_a^T (G_a(s) + s F_a(s)) S_a``.

    Parameters
    ----------
    structure : Structure
        With joints linearised.
    slides : sequence of SlideImpedance
        In the order of the structure's slides.
    """

    structure: Structure
    slides: Sequence[SlideImpedance]

    def dynamic_stiffness(self, s: ArrayLike) -> Complex:
        """Return Z [N/m], shape (f, n, n), at complex s [rad/s], shape (f,), not zero."""
        s = np.atleast_1d(np.asarray(s, dtype=np.complex128))
        m = self.structure
        z = m.mass * (s**2)[:, None, None] + m.damping * s[:, None, None] + m.stiffness
        for row, slide in zip(m.slide_rows(), self.slides, strict=True):
            z = z + np.outer(row, row) * slide.stiffness(s)[:, None, None]
        return np.asarray(z)

    def receptance(self, frequency: ArrayLike, points: Real) -> Complex:
        """Return the compliance [m/N] between points, shape (f, p, p), at frequencies [Hz]; points (p, n).

        At 0 Hz a servo's integrator holds its slide, and a free slide gives way without end (infinite).
        """
        f = np.atleast_1d(np.asarray(frequency, dtype=float))
        if f.size and not (np.all(np.isfinite(f)) and f.min() >= 0.0):
            raise InputError(f"frequencies from {f.min():g} Hz; they must not be negative")
        rows = np.atleast_2d(np.asarray(points, dtype=float))
        out = np.empty((f.size, rows.shape[0], rows.shape[0]), dtype=np.complex128)
        moving = f > 0.0
        if moving.any():
            solved = np.linalg.solve(self.dynamic_stiffness(2j * np.pi * f[moving]), rows.T)
            out[moving] = rows @ solved
        if not moving.all():
            out[~moving] = self._static(rows)
        return out

    def stuck_stiffness(self) -> Real:
        """Return the stiffness matrix [N/m], shape (n, n), with the contacts that stick: they are springs."""
        k = self.structure.stiffness.copy()
        for row, slide in zip(self.structure.slide_rows(), self.slides, strict=True):
            if slide.friction.rate == 0.0:
                k += np.outer(row, row) * slide.friction.residue
        return k

    def _static(self, rows: Real) -> Real:
        """Compliance at 0 Hz: slides with a servo or a sticking contact are held, others must not matter."""
        m = self.structure
        held = np.array(
            [r for r, s in zip(m.slide_rows(), self.slides, strict=True) if s.servo is not None], dtype=float
        ).reshape(-1, m.size)
        k = self.stuck_stiffness()
        n, h = m.size, held.shape[0]
        bordered = np.block([[k, held.T], [held, np.zeros((h, h))]])
        if np.linalg.matrix_rank(bordered) < n + h:
            return np.full((rows.shape[0], rows.shape[0]), np.inf)
        right = np.vstack([rows.T, np.zeros((h, rows.shape[0]))])
        return np.asarray(rows @ np.linalg.solve(bordered, right)[:n])

    def matrix(self, frequency: ArrayLike) -> Complex:
        """Return the compliance of the tool [m/N], shape (f, 3, 3), at frequencies [Hz], stable or not."""
        return self.receptance(frequency, self.structure.tool)

    def compliance(
        self, frequency: ArrayLike, response: Sequence[str] = AXES, excitation: Sequence[str] = AXES
    ) -> xr.Dataset:
        """Return the labelled compliance of the tool at frequencies [Hz].

        Raises
        ------
        InputError
            When uniform motion is unstable: then no steady response exists.
        """
        self.require_stable()
        rows, columns = ([AXES.index(a) for a in names] for names in (response, excitation))
        values = self.matrix(frequency)[:, rows][:, :, columns]
        return make_compliance(np.atleast_1d(frequency), values, response, excitation)

    @cached_property
    def delay_equation(self) -> DelayEquation:
        """``x' = A x + B F + sum_a E_a K_a x(t - tau_a)``, tool ``C x``; x = (q, q', integrals, friction states)."""
        return _delay_equation(self)

    def poles(self) -> Complex:
        """Return the poles [rad/s], rightmost first; with dead times those near the origin and the unstable ones.

        A slide without servo or sticking contact leaves its rigid-body pole at s = 0.
        """
        return self.delay_equation.poles()

    def modes(self) -> Real:
        """Return natural frequency [Hz] and damping ratio [1] of each oscillating pole, shape (modes, 2), sorted."""
        return oscillations(self.poles())

    def unstable_poles(self) -> int:
        """Return the number of poles in the right half plane (argument principle with the exact dead times).

        A free slide, or a part behind a play, rests on the axis; then the poles themselves are counted, without those
        at the origin: rounding moves a double one by 1e-8 of the largest.
        """
        equation = self.delay_equation
        prompt = np.abs(np.linalg.eigvals(equation.prompt()))
        if prompt.min(initial=math.inf) > _ORIGIN * prompt.max(initial=0.0):
            return equation.unstable_poles()
        s = self.poles()
        largest = np.abs(s).max(initial=0.0)
        return int(np.sum((s.real > 1e-9 * largest) & (np.abs(s) > _ORIGIN * largest)))

    def require_stable(self) -> None:
        """Raise `InputError` when uniform motion is unstable."""
        count = self.unstable_poles()
        if count:
            raise InputError(
                f"uniform motion is unstable: {count} pole(s) in the right half plane, the rightmost at "
                f"{_named(self.poles()[0])}; there is no steady response. {self._advice()}"
            )

    def _advice(self) -> str:
        falling = [s.name for s in self.slides if s.friction.direct < 0.0]
        held = tuple(replace(s, friction=FrictionImpedance(max(s.friction.direct, 0.0))) for s in self.slides)
        if falling and replace(self, slides=held).unstable_poles() == 0:
            return (
                f"The friction of axis {', '.join(falling)} falls with speed at this feed (stick-slip): "
                "feed faster, or raise the velocity gain"
            )
        return "Lower Kp or Kv, raise Ti, or shorten the dead time of the servo"

    def state_space(self, pade_order: int = 6) -> tuple[Real, Real, Real]:
        """Return A (n, n), B (n, 3), C (3, n) of ``x' = A x + B F``, tool ``C x``.

        Exact without dead time; a dead time becomes a Pade fraction of `pade_order` (right to 1 % of a radian while
        ``w tau < 2 pade_order/3``).
        """
        return self.delay_equation.state_space(pade_order)


def _named(pole: complex) -> str:
    return f"{abs(pole) / (2.0 * math.pi):.3g} Hz, damping ratio {-pole.real / abs(pole):.3g}"


def _delay_equation(point: OperatingPoint) -> DelayEquation:
    m, rows = point.structure, point.structure.slide_rows()
    n = m.size
    driven = [i for i, s in enumerate(point.slides) if s.servo is not None]
    remembering = [i for i, s in enumerate(point.slides) if s.friction.residue != 0.0 and s.friction.rate > 0.0]
    size = 2 * n + len(driven) + len(remembering)
    inverse = np.linalg.inv(m.mass)
    damping, stiffness = m.damping.copy(), point.stuck_stiffness()
    for row, slide in zip(rows, point.slides, strict=True):
        damping += np.outer(row, row) * slide.friction.direct
    a = np.zeros((size, size))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, :n], a[n : 2 * n, n : 2 * n] = -inverse @ stiffness, -inverse @ damping
    b, c = np.zeros((size, 3)), np.zeros((3, size))
    b[n : 2 * n], c[:, :n] = inverse @ m.tool.T, m.tool
    delayed = []
    for at, i in enumerate(driven, start=2 * n):
        servo = point.slides[i].servo
        assert servo is not None
        a[at, :n] = rows[i]
        gain, inlet = np.zeros(size), np.zeros(size)
        gain[:n], gain[n : 2 * n] = rows[i] * (servo.Kv + 1.0 / servo.Ti), rows[i]
        gain[at] = servo.Kv / servo.Ti
        inlet[n : 2 * n] = inverse @ rows[i]
        if servo.delay == 0.0:
            a -= np.outer(inlet, servo.Kp * gain)
        else:
            delayed.append((servo.delay, inlet, -servo.Kp * gain))
    for at, i in enumerate(remembering, start=2 * n + len(driven)):
        friction = point.slides[i].friction
        a[at, n : 2 * n], a[at, at] = rows[i], -friction.rate
        a[n : 2 * n, at] -= inverse @ rows[i] * friction.residue
    return DelayEquation(a, b, c, tuple(delayed))
