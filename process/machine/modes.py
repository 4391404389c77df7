"""Modal models and the compliance and state space that belong to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.errors import InputError
from process.labels import AXES, make_compliance
from process.notebook import html_table
from process.types import Complex, Real

HIGHEST_DAMPING = 0.999
"""Largest damping ratio that a search may try: at 1 a mode does not vibrate any more and is refused."""


@dataclass(frozen=True)
class ModalModel:
    """A linear machine seen from the tool: real modes with viscous damping.

    The compliance is ``Phi(f) = sum_r u_r u_r^T / (k_r (1 - (f/f_r)^2 + 2 j zeta_r f/f_r))``, :eq:`modes`.

    Parameters
    ----------
    frequency : array_like, shape (modes,)
        Undamped natural frequency [Hz].
    damping : array_like, shape (modes,)
        Damping ratio [1].
    stiffness : array_like, shape (modes,)
        Modal stiffness [N/m] that belongs to the vectors as given (they are not normalised).
    direction : array_like, shape (modes, 3)
        Mode vector (x, y, z) at the tool.

    Raises
    ------
    InputError
        When shapes differ or a frequency, stiffness or damping ratio is not positive.
    """

    frequency: Real
    damping: Real
    stiffness: Real
    direction: Real = field(repr=False)

    def __post_init__(self) -> None:
        """Store plain float arrays and refuse what is not a passive machine."""
        for name in ("frequency", "damping", "stiffness"):
            object.__setattr__(self, name, np.atleast_1d(np.asarray(getattr(self, name), dtype=float)))
        object.__setattr__(self, "direction", np.atleast_2d(np.asarray(self.direction, dtype=float)))
        n = self.frequency.size
        if self.damping.shape != (n,) or self.stiffness.shape != (n,) or self.direction.shape != (n, 3):
            raise InputError(
                f"{n} frequencies, {self.damping.size} damping ratios, {self.stiffness.size} stiffnesses and "
                f"directions of shape {self.direction.shape}; each mode needs one of each and a direction (x, y, z)"
            )
        for name in ("frequency", "damping", "stiffness"):
            values = getattr(self, name)
            if not np.all(np.isfinite(values) & (values > 0.0)):
                raise InputError(f"{name} of a mode is {values.min():g}; it must be positive")
        if self.damping.max(initial=0.0) >= 1.0:
            raise InputError(
                f"the damping ratio of a mode is {self.damping.max():g}, which does not vibrate; give a ratio below 1: "
                "2 % are 0.02"
            )

    @property
    def mass(self) -> Real:
        """Modal mass [kg], ``k / (2 pi f)^2``."""
        return self.stiffness / (2.0 * np.pi * self.frequency) ** 2

    def _repr_html_(self) -> str:
        """Return a table for a notebook, a row a mode."""
        rows = [
            (k, f, 100.0 * z, 1e-6 * s, m, ", ".join(f"{u:.3g}" for u in direction))
            for k, (f, z, s, m, direction) in enumerate(
                zip(
                    self.frequency.tolist(),
                    self.damping.tolist(),
                    self.stiffness.tolist(),
                    self.mass.tolist(),
                    self.direction.tolist(),
                    strict=True,
                ),
                1,
            )
        ]
        head = ("mode", "frequency [Hz]", "damping [%]", "stiffness [N/µm]", "mass [kg]", "direction (x, y, z)")
        return html_table("Modes at the tool", rows, head)

    def matrix(self, frequency: ArrayLike) -> Complex:
        """Return the compliance matrix [m/N], shape (frequencies, 3, 3), at frequencies [Hz]."""
        f = np.atleast_1d(np.asarray(frequency, dtype=float))
        ratio = f[:, None] / self.frequency
        gain = 1.0 / (self.stiffness * (1.0 - ratio**2 + 2j * self.damping * ratio))
        return np.asarray(np.einsum("fr,ri,rj->fij", gain, self.direction, self.direction))

    def compliance(
        self, frequency: ArrayLike, response: Sequence[str] = AXES, excitation: Sequence[str] = AXES
    ) -> xr.Dataset:
        """Return the labelled compliance at frequencies [Hz]."""
        rows = [AXES.index(a) for a in response]
        columns = [AXES.index(a) for a in excitation]
        values = self.matrix(frequency)[:, rows][:, :, columns]
        return make_compliance(np.atleast_1d(frequency), values, response, excitation)

    def state_space(
        self,
    ) -> tuple[Real, Real, Real]:
        """Return A, B, C of ``q' = A q + B F``, ``r = C q`` with modal positions first, then velocities."""
        n = self.frequency.size
        w = 2.0 * np.pi * self.frequency
        a = np.zeros((2 * n, 2 * n))
        a[:n, n:] = np.eye(n)
        a[n:, :n] = -np.diag(w**2)
        a[n:, n:] = -np.diag(2.0 * self.damping * w)
        b = np.zeros((2 * n, 3))
        b[n:] = self.direction / self.mass[:, None]
        c = np.zeros((3, 2 * n))
        c[:, :n] = self.direction.T
        return a, b, c
