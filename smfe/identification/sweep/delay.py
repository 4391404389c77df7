"""Motion that is recorded later than the force, or earlier: seen in the residues of the modes.

Filters, charge amplifiers and recorders delay channels by tens of microseconds, each by its own. Motion that is late by
d turns a compliance by ``exp(-j w d)``: a degree is nearly 2 % of a compliance, in quadrature, and neither a coherence
nor a residual reveals it. The modes do: with damping in proportion to mass and stiffness the residue of every entry in
``A/(f - lambda)`` is real; a delay turns all residues of a mode by ``-2 pi f_m d``, in proportion to its frequency.
Damping that is not in proportion turns modes both ways: a force moves nothing at once, so that the imaginary parts of
``A`` sum up to nothing over all modes (Ewins, Modal Testing, 2000, ch. 2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from process.types import Complex, Real
from smfe.identification.sweep.rules import RULES


@dataclass(frozen=True)
class Delay:
    """By how much the motion comes later than the force.

    Parameters
    ----------
    late : float
        [s].
    std : float
        Its standard deviation, with what the modes differ by [s].
    modes : int
        Modes that were seen.
    """

    late: float
    std: float
    modes: int

    @property
    def real(self) -> bool:
        """Whether it is more than the modes differ by."""
        return abs(self.late) > RULES.clear_delay * self.std

    def in_words(self) -> str:
        """Return what was found, with its figures, and what to do."""
        side, other = ("late", "motion") if self.late > 0.0 else ("early", "force")
        modes = f"{self.modes} modes are" if self.modes > 1 else "one mode is"
        return (
            f"the motion reads {1e6 * abs(self.late):.3g} +- {2e6 * self.std:.1g} us too {side} against the force: "
            f"the residues of {modes} turned in proportion to frequency, as by filters or recorders that delay the "
            f"channels differently. Declare the delay of the {other} channels in [channels]; what this would change is "
            "in the standard deviation"
        )


def delay_of(poles: Complex, residue: Complex, variance: Real, band: tuple[float, float]) -> Delay | None:
    """Return the delay found from the residues of the modes within a band, or None without a mode.

    Parameters
    ----------
    poles : ndarray of complex, shape (m,)
        [Hz], imaginary part ``zeta f``.
    residue : ndarray of complex, shape (m, r, e)
        Of each entry, in ``A/(f - pole)``.
    variance : ndarray, shape (m, r, e)
        Of their complex errors.
    band : (float, float)
        [Hz].
    """
    weight = 1.0 / np.maximum(variance, 1e-300)
    size = np.sum(weight * np.abs(residue) ** 2, axis=(1, 2))
    phase = 0.5 * np.angle(np.sum(weight * residue**2, axis=(1, 2)))
    noise = 1.0 / np.sqrt(2.0 * np.maximum(size, 1e-300))
    damping = poles.imag / np.maximum(np.abs(poles), 1e-300)
    height = np.linalg.norm(residue, axis=(1, 2)) / np.maximum(np.abs(poles.imag), 1e-300)
    used = (poles.real > band[0]) & (poles.real < band[1]) & (noise < RULES.known_phase)
    used &= (damping > RULES.mode_damping[0]) & (damping < RULES.mode_damping[1])
    used &= height > RULES.mode_height * np.max(height, where=used, initial=0.0)
    count = int(used.sum())
    if not count:
        return None
    slope = -2.0 * math.pi * poles.real[used]
    w = 1.0 / (noise[used] ** 2 + (RULES.mode_turn if count > 1 else RULES.lone_mode_turn) ** 2)
    curvature = float(np.sum(w * slope**2))
    late = float(np.sum(w * slope * phase[used])) / curvature
    scatter = float(np.sum(w * (phase[used] - slope * late) ** 2)) / max(count - 1, 1)
    return Delay(late, math.sqrt(max(scatter, 1.0) / curvature), count)


def changed_by_delay(compliance: Complex, frequency: Real, late: float) -> Complex:
    """Return by how much a compliance changes where the motion is late [s], same shape as `compliance` (f, r, e)."""
    turn = np.exp(2j * np.pi * frequency * late) - 1.0
    return np.asarray(compliance * turn[:, None, None])
