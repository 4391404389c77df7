"""A fitted matrix as a real, stable state space, and whether it is that of a passive machine.

A pair of poles with residue ``R = F E^T`` (complex, rank r) is ``z' = s z + E^T u``, ``y = 2 Re(F z)``: with real and
imaginary parts of z as states

    A = [[Re s I, -Im s I], [Im s I, Re s I]],   B = [Re E^T; Im E^T],   C = 2 [Re F, -Im F].

Remainders are modes themselves (`modes.pole_fit`), so that nothing is left for D but zeros: no force moves the tool at
once, which the methods of `stability` rely on.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from process.types import Complex, Real
from smfe.modes.pole_fit import PoleFit, pole_values, remainder_modes

StateSpace = tuple[Real, Real, Real, Real]


def place_matrix(
    fit: PoleFit, values: NDArray[np.generic], response: tuple[str, ...], excitation: tuple[str, ...]
) -> Complex:
    """Return values of the curves, shape (g, ...), as a matrix of places, (..., responses, excitations), mirrored.

    What was not measured is zero: rigid.
    """
    out = np.zeros((*values.shape[1:], len(response), len(excitation)), dtype=complex)
    for own, (r, e) in zip(values, fit.curves.pairs, strict=True):
        for a, b in {(r, e), (e, r)}:
            if a in response and b in excitation:
                out[..., response.index(a), excitation.index(b)] = own
    return out


def state_space(fit: PoleFit, response: tuple[str, ...], excitation: tuple[str, ...]) -> StateSpace:
    """Return A, B, C, D of ``q' = A q + B F``, ``r = C q + D F``, equal to the fit at every frequency.

    Parameters
    ----------
    fit : PoleFit
        Poles, residues, remainders.
    response, excitation : tuple of str
        Places of the outputs and inputs; entries that were not measured are rigid.
    """
    blocks, inputs, outputs = [], [], []
    residues = place_matrix(fit, fit.residue.T, response, excitation)
    for s, residue in zip(pole_values(fit.poles), residues, strict=True):
        forward, back = _factors(residue)
        one = np.eye(forward.shape[1])
        blocks.append(np.block([[s.real * one, -s.imag * one], [s.imag * one, s.real * one]]))
        inputs.append(np.concatenate([back.real, back.imag]))
        outputs.append(2.0 * np.concatenate([forward.real, -forward.imag], axis=1))
    for name, (natural, damping) in zip(("lower", "upper"), remainder_modes(fit.curves.frequency), strict=True):
        stand_in = place_matrix(fit, fit.remainder(name), response, excitation)
        shape, force = (m.real for m in _factors(stand_in))
        one, w = np.eye(shape.shape[1]), 2.0 * np.pi * natural
        blocks.append(np.block([[0.0 * one, w * one], [-w * one, -2.0 * damping * w * one]]))
        inputs.append(np.concatenate([0.0 * force, w * force]))
        outputs.append(np.concatenate([shape, 0.0 * shape], axis=1))
    d = np.zeros((len(response), len(excitation)))
    return linalg.block_diag(*blocks), np.concatenate(inputs), np.concatenate(outputs, axis=1), d


def _factors(matrix: Complex) -> tuple[Complex, Complex]:
    """Return F (rows, rank) and E^T (rank, columns) with ``F E^T`` the matrix."""
    left, size, right = np.linalg.svd(matrix)
    # Singular values below 1e-13 of the largest are rounding.
    rank = int(np.sum(size > 1e-13 * max(float(size[0]), 1e-300)))
    root = np.sqrt(size[:rank])
    return left[:, :rank] * root, root[:, None] * right[:rank]


def energy_given(matrix: Complex) -> Real:
    """Return the energy that a compliance gives at each frequency as a share of its size, 0 for a passive machine.

    A passive machine takes energy from every force: ``j (Phi - Phi^H)/2`` has no negative eigenvalue. Returned is the
    most negative one over the norm of the matrix, its sign turned.

    Parameters
    ----------
    matrix : ndarray of complex, shape (n, k, k)
        [m/N], responses and excitations at the same places.
    """
    taken = 0.5j * (matrix - matrix.conj().transpose(0, 2, 1))
    size = np.linalg.norm(matrix, axis=(1, 2))
    least = np.linalg.eigvalsh(taken)[:, 0]
    return np.asarray(np.maximum(-least, 0.0) / np.where(size > 0.0, size, 1.0))
