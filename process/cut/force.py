"""Mechanistic cutting forces: coefficients, directional matrices, force harmonics.

Frame: x feed, y normal to it, z tool axis away from the work, tool clockwise, tooth angle ``phi`` from +y towards
+x. With ``s = sin phi``, ``c = cos phi``, approach angle ``k``, edge length ``b = a_p/sin k`` and chip thickness
``h = (f_z s + dx s + dy c) sin k - dz cos k``::

    (F_t, F_r, F_a) = (K_tc, K_rc, K_ac) b h + (K_te, K_re, K_ae) b
    F on the tool   = [[-c, -sin k s, -cos k s], [s, -sin k c, -cos k c], [0, cos k, -sin k]] (F_t, F_r, F_a)

so that ``F = a_p P (s, c, 1)^T (s, c, 1) Q d`` for a dynamic displacement d, with `force_projection` P and
`chip_projection` Q: :eq:`cutting-force`, :eq:`projections`. Source: Altintas, Manufacturing Automation; Altintas 2001
(three-dimensional form).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from process.cut.engagement import AnyEngagement
from process.cut.tool import Tool
from process.errors import InputError
from process.notebook import html_table
from process.types import Complex, Real
from process.units import RANGES, si


@dataclass(frozen=True, init=False)
class CuttingCoefficients:
    """Mechanistic coefficients of a work material with a tool. Numbers are SI; texts carry their unit, "1900 N/mm^2".

    Parameters
    ----------
    Ktc, Krc, Kac : float or str
        Tangential, radial, axial cutting coefficients [N/m2].
    Kte, Kre, Kae : float or str, optional
        Edge coefficients [N/m].

    Raises
    ------
    InputError
        When a coefficient is not finite or the tangential one is not positive.
    """

    Ktc: float
    Krc: float
    Kac: float
    Kte: float = 0.0
    Kre: float = 0.0
    Kae: float = 0.0

    def __init__(
        self,
        Ktc: float | str,
        Krc: float | str,
        Kac: float | str,
        Kte: float | str = 0.0,
        Kre: float | str = 0.0,
        Kae: float | str = 0.0,
    ) -> None:
        """Turn texts into SI; refuse coefficients that are no numbers and a work material that pushes the tool."""
        for name, value in (("Ktc", Ktc), ("Krc", Krc), ("Kac", Kac)):
            object.__setattr__(self, name, si(value, "pressure"))
        for name, value in (("Kte", Kte), ("Kre", Kre), ("Kae", Kae)):
            object.__setattr__(self, name, si(value, "line_force"))
        for coefficient in fields(self):
            value = getattr(self, coefficient.name)
            if not math.isfinite(value):
                raise InputError(f"{coefficient.name} is {value:g}; a cutting coefficient must be a finite number")
        if not self.Ktc > 0.0:
            raise InputError(f"K_tc is {self.Ktc / 1e6:g} N/mm^2; the tangential coefficient must be positive")

    @property
    def cutting(self) -> Real:
        """(K_tc, K_rc, K_ac) [N/m2]."""
        return np.array([self.Ktc, self.Krc, self.Kac])

    @property
    def edge(self) -> Real:
        """(K_te, K_re, K_ae) [N/m]."""
        return np.array([self.Kte, self.Kre, self.Kae])

    def _repr_html_(self) -> str:
        """Return a table for a notebook."""
        known = ((f.name, RANGES[f.name]) for f in fields(self))
        rows = [(name, shown.shown * getattr(self, name), shown.unit) for name, shown in known]
        return html_table("Cutting coefficients", rows)


@dataclass(frozen=True)
class ProcessDamping:
    """Resistance of the worn flank to waves on the surface, SI.

    While an edge of length b cuts at the speed ``v_c = pi D n`` and moves into the work at ``v_n`` along its chip
    normal, its flank displaces material: ``F_r = C b v_n/v_c`` [N/m m = N] against ``v_n``, and ``mu F_r`` along the
    cutting speed. Small vibration: the equivalent linear damper, for both signs of ``v_n``. Source: Ahmadi & Altintas,
    Int. J. Mach. Tools Manuf. 2011; :eq:`process-damping`.

    Parameters
    ----------
    coefficient : float
        ``C = K_sp L_w^2/4`` [N/m], with the indentation coefficient ``K_sp`` (force over displaced volume, N/m3) and
        the length ``L_w`` [m] of the wear land on the flank; `from_wear_land`.
    friction : float, optional
        Friction coefficient mu between flank and work [1].

    Raises
    ------
    InputError
        When one of them is negative or not finite.
    """

    coefficient: float
    friction: float = 0.3

    def __post_init__(self) -> None:
        """Refuse a flank that drives the vibration."""
        for name, value in (("coefficient", self.coefficient), ("friction", self.friction)):
            if not 0.0 <= value < math.inf:
                raise InputError(f"the {name} of the process damping is {value:g}; it must be finite and not negative")

    @classmethod
    def from_wear_land(cls, indentation: float, wear_land: float, friction: float = 0.3) -> ProcessDamping:
        """Return the damping of an indentation coefficient K_sp [N/m3] and a wear land L_w [m]."""
        return cls(0.25 * indentation * wear_land**2, friction)


NO_DAMPING = ProcessDamping(0.0)
"""A sharp edge."""


def force_projection(triple: Real, approach_angle: float) -> Real:
    """Return P with ``T(phi) K = P (sin phi, cos phi, 1)`` for a triple K = (tangential, radial, axial).

    ``P = [[-K_n, -K_t, 0], [K_t, -K_n, 0], [0, 0, K_z]]`` with ``K_n = K_r sin k + K_a cos k`` and
    ``K_z = K_r cos k - K_a sin k``; the unit is that of the triple.
    """
    sin_k, cos_k = math.sin(approach_angle), math.cos(approach_angle)
    tangential, radial, axial = triple
    normal = radial * sin_k + axial * cos_k
    along = radial * cos_k - axial * sin_k
    return np.array([[-normal, -tangential, 0.0], [tangential, -normal, 0.0], [0.0, 0.0, along]])


def chip_projection(approach_angle: float) -> Real:
    """Return ``Q = diag(1, 1, -cot k)``: edge length times chip thickness is ``a_p (s, c, 1) Q d``."""
    return np.diag([1.0, 1.0, -1.0 / math.tan(approach_angle)])


def _antiderivative(power: int, phi: ArrayLike) -> Complex:
    """Return the integral of ``exp(-j power phi)``."""
    phi = np.asarray(phi, dtype=float)
    return phi.astype(complex) if power == 0 else np.exp(-1j * power * phi) / (-1j * power)


# (sin, cos, 1) as sums of exp(+j n phi): harmonic n -> coefficients of the three functions.
_TRIG = {1: np.array([-0.5j, 0.5, 0.0]), -1: np.array([0.5j, 0.5, 0.0]), 0: np.array([0.0, 0.0, 1.0])}


@lru_cache(maxsize=256)
def gram_matrix(arc: AnyEngagement, order: int = 0) -> Complex:
    """Return ``integral (s, c, 1)(s, c, 1)^T exp(-j order phi) dphi`` over all arcs, in closed form, shape (3, 3).

    Cached and therefore read-only: a fit of coefficients needs the same arcs thousands of times.
    """
    total = np.zeros((3, 3), dtype=complex)
    for n, a in _TRIG.items():
        for m, b in _TRIG.items():
            power = order - n - m
            span = sum(_antiderivative(power, part.exit) - _antiderivative(power, part.entry) for part in arc.arcs)
            total += np.outer(a, b) * span
    total.flags.writeable = False
    return total


def twisted_gram(arc: AnyEngagement, angle: Real, twist: float) -> Real:
    """Return ``(s, c, 1)(s, c, 1)^T`` where in the cut, averaged over a helical edge, shape (n, 3, 3).

    The tip is at `angle` [rad], any number of turns, and the upper end `twist` [rad] behind it: ``(integral
    phi - twist to phi)/twist`` of what a straight edge does, in closed form.
    """

    def antiderivative(phi: Real) -> Real:
        s, c, twice = np.sin(phi), np.cos(phi), 0.25 * np.sin(2.0 * phi)
        rows = [[0.5 * phi - twice, 0.5 * s * s, -c], [0.5 * s * s, 0.5 * phi + twice, s], [-c, s, phi]]
        return np.moveaxis(np.array(rows), (0, 1), (-2, -1))

    def upto(phi: Real) -> Real:
        turns, rest = np.divmod(phi, 2.0 * math.pi)
        out = np.zeros((*phi.shape, 3, 3))
        for part in arc.arcs:
            start = antiderivative(np.array(part.entry))
            whole = antiderivative(np.array(part.exit)) - start
            out += turns[..., None, None] * whole + antiderivative(np.clip(rest, part.entry, part.exit)) - start
        return out

    return np.asarray((upto(angle) - upto(angle - twist)) / twist)


def directional_matrix(tool: Tool, arc: AnyEngagement, coefficients: CuttingCoefficients, order: int = 0) -> Complex:
    """Return the Fourier coefficient of the directional matrix, ``A_r = N/(2 pi) P Gram_r Q``.

    For r = 0 :eq:`directional-matrix`. `order` r counts tooth passing harmonics; ``F = a_p A_0 (1 - exp(-j w T)) Phi
    F`` is the zero-order loop.

    Parameters
    ----------
    tool : Tool
        Teeth must be equally spaced.
    arc : Engagement or Engagements
        One arc of engagement or several.
    coefficients : CuttingCoefficients
        Cutting coefficients; edge terms do not enter.
    order : int, optional
        Harmonic of the tooth passing frequency.

    Returns
    -------
    ndarray of complex, shape (3, 3)
        [N/m2]: force over displacement, per depth of cut.

    Raises
    ------
    InputError
        For unequal pitch, and for a helix with an order other than zero: its mean over the depth depends on the depth.
    """
    _require_equal_pitch(tool, "the directional matrix")
    if order != 0 and tool.helix_angle > 0.0:
        raise InputError(
            f"harmonic {order} of the directional matrix is not available for a helix of "
            f"{math.degrees(tool.helix_angle):g} deg; straight edges are needed: a helix makes it depend on the depth. "
            "Ask for order 0, or leave helix_angle out to neglect the helix"
        )
    projection = force_projection(coefficients.cutting, tool.approach_angle)
    gram = gram_matrix(arc, order * tool.teeth)
    return tool.teeth / (2.0 * math.pi) * projection @ gram @ chip_projection(tool.approach_angle)


def mean_torque(tool: Tool, arc: AnyEngagement, coefficients: CuttingCoefficients, feed_per_tooth: float) -> float:
    """Return the mean torque on the spindle over the depth of cut [N m per m].

    ``M/a_p = D/2 N/(2 pi) (K_tc f_z sum(cos phi_st - cos phi_ex) + K_te sum(phi_ex - phi_st)/sin k)``. A periodic
    vibration changes nothing of it: what it adds to the chip of a tooth it takes from that of the next.

    Parameters
    ----------
    tool, arc, coefficients
        The cut; straight edges are taken.
    feed_per_tooth : float
        [m].
    """
    chip = sum(math.cos(part.entry) - math.cos(part.exit) for part in arc.arcs)
    force = coefficients.Ktc * feed_per_tooth * chip + coefficients.Kte / math.sin(tool.approach_angle) * arc.arc
    return 0.5 * tool.diameter * tool.teeth / (2.0 * math.pi) * force


def force_harmonics(
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    depth: float,
    feed_per_tooth: float,
    orders: ArrayLike,
) -> Complex:
    """Return the harmonics of the static cutting force on a tool with equal teeth and no run-out.

    This is :eq:`force-harmonics`, ``F_h = (N/pi) integral f(phi) exp(-j h N phi) dphi`` with
    ``f = a_p (f_z P (s^2, s c, s) + P_e (s, c, 1)/sin k)``; a helix multiplies harmonic h by the mean of
    ``exp(-j h N lag)`` over the depth, the lag being ``2 z tan(helix)/D``.

    Parameters
    ----------
    tool, arc, coefficients
        The cut.
    depth, feed_per_tooth : float
        a_p and f_z [m].
    orders : array_like of int, shape (n,)
        Harmonics h of the tooth passing frequency, h >= 1.

    Returns
    -------
    ndarray of complex, shape (n, 3)
        Peak amplitudes [N] of ``Re(F_h exp(j h N theta))``.

    Raises
    ------
    InputError
        For unequal pitch or run-out: the force then has lines at the spindle orders between these harmonics.
    """
    _require_equal_pitch(tool, "the force harmonics")
    if not tool.equal_radius:
        microns = ", ".join(f"{1e6 * r:g}" for r in tool.runout or ())
        raise InputError(
            f"the tool has a run-out of {microns} um; the force harmonics hold for teeth on one circle. Use a time "
            "simulation, or leave runout out to neglect it"
        )
    chip = force_projection(coefficients.cutting, tool.approach_angle)
    edge = force_projection(coefficients.edge, tool.approach_angle) / math.sin(tool.approach_angle)
    rows = []
    for h in np.atleast_1d(np.asarray(orders, dtype=int)):
        gram = gram_matrix(arc, int(h) * tool.teeth)
        per_depth = feed_per_tooth * chip @ gram[:, 0] + edge @ gram[:, 2]
        rows.append(tool.teeth / math.pi * depth * per_depth * _helix_factor(tool, depth, int(h)))
    return np.array(rows)


def _require_equal_pitch(tool: Tool, what: str) -> None:
    if not tool.equal_pitch:
        degrees = ", ".join(f"{math.degrees(p):g}" for p in tool.pitch_angles or ())
        raise InputError(
            f"the tool has unequal pitch ({degrees} deg); {what} can be had for equally spaced teeth only. Use a time "
            "simulation, or leave pitch_angles out to treat the teeth as equally spaced"
        )


def _helix_factor(tool: Tool, depth: float, order: int) -> complex:
    """Return the mean over the depth of ``exp(-j h N lag(z))``."""
    turn = order * tool.teeth * 2.0 * depth * math.tan(tool.helix_angle) / tool.diameter
    return 1.0 + 0.0j if turn == 0.0 else complex((1.0 - np.exp(-1j * turn)) / (1j * turn))
