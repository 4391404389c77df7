"""A modal machine with all that has been changed, and how hard it is shaken: what its compliance is reckoned from."""

from __future__ import annotations

from typing import NamedTuple

from process.types import Real


class Changed(NamedTuple):
    """A modal machine with all that has been changed; alike for values that change nothing."""

    frequency: tuple[float, ...]  # of each mode [Hz]
    damping: tuple[float, ...]  # of each mode [1]
    stiffness: tuple[float, ...]  # of each mode [N/m]
    direction: tuple[float, ...]  # mode vectors, one after the other, length 3 M
    springs: tuple[float, ...] = ()  # S, length M^2, or empty
    gyroscopic: tuple[float, ...] = ()  # G [1/Hz], length M^2, or empty
    mass: float = 0.0  # at the tool [kg]
    slip: tuple[float, ...] = ()
    hardening: tuple[float, ...] = ()
    """Joint: share of the stiffness of a mode that is lost, or gained, at the amplitude of reference if the mode moves
    nothing else; its unit vector v."""
    mode: tuple[float, ...] = ()
    """A further mode: its compliance along x, y, z as ``sqrt(m/N)``, its frequency and damping, 0."""
    residual: tuple[float, ...] = ()  # compliance of what is above the band: xx, yy, zz, xy, yz, zx [m/N]
    iwan: tuple[float, ...] = ()
    """Joint whose elements have a largest travel (Iwan 1966): share of the stiffness of a mode that they are, amplitude
    over that of reference at which all of them slip, its unit vector v. Of a share beyond `RULES.largest_share` those
    that slip last are not there."""


class Shaken(NamedTuple):
    """How hard a machine is shaken."""

    method: str  # impact, or sine or multisine: "hammer" or "actuator"
    level: float  # impulse [N s], or amplitude of a sine of the same rms [N]
    reference: float  # amplitude of reference in scaled coordinates [sqrt(J)]
    power: Real | None = None
    """Share of the power of a multisine that each line stands for, (f,); None: one sine after another."""
    impulses: tuple[float, ...] = ()  # of the hits along x, y, z [N s]; empty: all of `level`
    duration: float = 0.0
    """Contact time of the hits [s]; 0: a joint counts with one stiffness for the whole decay."""
