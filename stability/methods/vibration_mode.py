"""The mode of vibration at a limit: how the tool moves, and which mode of the machine moves it most."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from process.types import Complex, Real
from stability.methods import _zero_order_kernels as _kernels
from stability.methods.rules import RULES
from stability.methods.zero_order_branches import Branches
from stability.problem import Modes, Samples

NO_MODE = 0
"""Number of the mode where nothing crosses."""


def modal_samples(modes: Modes) -> Samples:
    """Return the compliance of a machine on a grid that is as fine about each pole as the pole is sharp."""
    frequency = frequencies_about(modes.rate)
    return Samples(frequency, modes.matrix(frequency), np.ones(frequency.size - 1, dtype=bool), ())


def frequencies_about(
    poles: Complex, reach: float = RULES.reach_of_samples, density: float = RULES.density_of_samples
) -> Real:
    """Return frequencies [Hz] that are as fine about each pole [rad/s] as the pole is sharp."""
    pole = poles[poles.imag > 0.0] / (2.0 * math.pi)
    if pole.size == 0:
        pole = poles / (2.0 * math.pi)
    centre, width = np.abs(pole), np.maximum(np.abs(pole.real), 1e-6 * np.abs(pole))
    low, high = float(centre.min()) / reach, float(centre.max()) * reach
    spread = np.sinh(np.linspace(-20.0, 20.0, 2001))
    every = (centre[:, None] + width[:, None] * spread).ravel()
    every = np.unique(np.concatenate([[low, high], np.geomspace(low, high, 500), every]))
    every = every[(every >= low) & (every <= high)]
    count = np.arcsinh((every[:, None] - centre) / width).sum(axis=1) + np.log(every)
    even = np.linspace(count[0], count[-1], math.ceil(density * (count[-1] - count[0]) / math.log(2.0)) + 1)
    return np.unique(np.interp(even, count, every))


def vibration(
    branches: Branches,
    directional: Complex,
    chatter: Real,
    depth: Real,
    pitch: Real,
    speed: Real,
    flank: Real | None = None,
) -> tuple[Complex, Complex]:
    """Return force and displacement at each limit, shapes (speeds, 3); NaN without a limit.

    The force is the eigenvector of ``a (S A0 + j w A_d/v_c) Phi`` to the eigenvalue one, the displacement is ``Phi``
    times it, of length one, its largest component real and positive; S is the mean of ``1 - exp(-j w T)`` over the
    teeth.

    Parameters
    ----------
    branches : Branches
        Eigenvalues and compliance.
    directional : ndarray of complex, shape (3, 3)
        A0 [N/m2].
    chatter, depth, speed : ndarray, shape (speeds,)
        Chatter frequency [Hz], limit [m], spindle speed [rpm].
    pitch : ndarray, shape (teeth,)
        Angles between teeth [rad].
    flank : ndarray, shape (speeds, 3, 3), optional
        ``A_d/v_c`` of process damping [N s/m2 a metre depth]; none by default.
    """
    force, moved = np.full((2, speed.size, 3), np.nan, dtype=complex)
    at = np.flatnonzero(np.isfinite(depth))
    if at.size == 0:
        return force, moved
    phi = branches.compliance_at(chatter[at])
    waves = (chatter[at] * 60.0 / speed[at])[:, None] * pitch / (2.0 * math.pi)
    loop = (1.0 - np.exp(-2j * math.pi * waves)).mean(axis=1)[:, None, None] * directional
    if flank is not None:
        loop = loop + 2j * math.pi * chatter[at, None, None] * flank[at]
    force[at] = _kernels.null_vectors(loop @ phi - np.eye(3) / depth[at, None, None])
    r = (phi @ force[at][:, :, None])[:, :, 0]
    largest = np.take_along_axis(r, np.abs(r).argmax(axis=1)[:, None], axis=1)
    r = r * np.exp(-1j * np.angle(largest))
    # Where a force only acts in directions of unknown compliance, no motion is known of it.
    size = np.linalg.norm(r, axis=1)[:, None]
    moved[at] = np.divide(r, size, out=np.full_like(r, np.nan), where=size > 0.0)
    return force, moved


def dominant_modes(modes: Modes, force: Complex, chatter: Real) -> NDArray[np.int64]:
    """Return the number of the mode that moves the tool most, from 1 in the order of frequency; `NO_MODE` for none."""
    upper = np.flatnonzero(modes.rate.imag >= 0.0)
    upper = upper[np.argsort(np.abs(modes.rate[upper]))]
    known = np.where(np.isfinite(force), force, 0.0)
    pole = 2j * math.pi * np.nan_to_num(chatter)[:, None] - modes.rate[upper]
    share = np.abs(known @ modes.participation[upper].T / pole) * np.linalg.norm(modes.shape[:, upper], axis=0)
    return np.where(np.isfinite(chatter), share.argmax(axis=1) + 1, NO_MODE).astype(np.int64)
