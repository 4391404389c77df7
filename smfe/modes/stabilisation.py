"""Poles of a measured matrix from polynomials of rising order: the stabilisation diagram.

The matrix is written as a right fraction, row o being ``N_o(z) D(z)^-1`` with ``D(z) = sum_r A_r z^r``, an m x m matrix
polynomial for m excitations, and ``z = exp(j pi (f - f_first)/(f_last - f_first))``. The errors made linear,
``e_o = W_o [N_o - H_o D]``, are least squares in N and D; N is eliminated (poly-reference least squares complex
frequency, Guillaume et al. 2003). Since ``|z| = 1`` every matrix of the normal equations is made of sums over frequency
that depend on the difference of two powers alone. With the lowest coefficient of D fixed, poles that only describe
noise lie on the unstable side and are left out; physical ones stay where they are while the order rises.

Where a row lacks a column, every entry becomes a row of its own with one excitation (a common denominator). A matrix
with fewer responses than excitations is transposed, which changes no pole and allows higher orders.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster import hierarchy

from process.types import Complex, Real
from smfe.modes.response_matrix import Curves, ResponseMatrix
from smfe.modes.rules import RULES


@dataclass(frozen=True)
class StabilityRules:
    """When a pole of one order is that of the order before.

    Parameters
    ----------
    frequency, damping : float, optional
        Largest relative change [1].
    assurance : float, optional
        Least modal assurance criterion of the participation vectors [1].
    share : float, optional
        Share of the orders in which a pole must be stable to be proposed as a mode.
    """

    frequency: float = 0.01
    damping: float = 0.05
    assurance: float = 0.9
    share: float = 0.15


@dataclass(frozen=True)
class Stabilisation:
    """All stable poles of all orders.

    Parameters
    ----------
    order : ndarray of int, shape (k,)
        Order of the polynomial.
    frequency : ndarray, shape (k,)
        [Hz].
    damping : ndarray, shape (k,)
        Damping ratio.
    level : ndarray of int, shape (k,)
        0: new; 1: frequency as in the order before; 2: damping too; 3: vector too.
    candidates : ndarray, shape (c, 3)
        Frequency [Hz], damping ratio and number of orders of what stays where it is; most orders first.
    """

    order: NDArray[np.int64]
    frequency: Real
    damping: Real
    level: NDArray[np.int64]
    candidates: Real


def stabilisation(matrix: ResponseMatrix, curves: Curves, rules: StabilityRules | None = None) -> Stabilisation:
    """Return the poles of all orders and which of them stay.

    Parameters
    ----------
    matrix : ResponseMatrix
        What was measured.
    curves : Curves
        Its noise levels.
    rules : StabilityRules, optional
        When a pole is that of the order before.
    """
    rules = rules or StabilityRules()
    frequency, rows, weight = _rows(matrix, curves)
    inputs = rows.shape[2]
    most = int(np.clip(RULES.largest_system // inputs, 8, RULES.most_orders))
    most = max(2, min(most, (frequency.size - 2) // 2))
    sums = _sums(frequency, rows, weight, most)
    orders, found, levels = [], [], []
    before: tuple[Real, Complex] | None = None
    for order in range(2, most + 1):
        poles, vectors = _poles(sums, order, inputs, frequency)
        level = np.zeros(len(poles), dtype=np.int64) if before is None else _level(poles, vectors, *before, rules)
        orders.append(np.full(len(poles), order))
        found.append(poles)
        levels.append(level)
        before = poles, vectors
    every = np.concatenate(found)
    level = np.concatenate(levels)
    candidates = _candidates(every[level >= 2], max(3.0, rules.share * (most - 1)), rules)
    return Stabilisation(np.concatenate(orders), every[:, 0], every[:, 1], level, candidates)


def _rows(matrix: ResponseMatrix, curves: Curves) -> tuple[Real, Complex, Real]:
    """Return frequency, rows (n, rows, inputs) and their weights (n, rows); gaps weigh nothing."""
    there = np.isin(matrix.frequency, curves.frequency)
    f, values = matrix.frequency[there], matrix.values[there]
    level: Real = np.empty(values.shape)
    place = {frozenset(pair): g for g, pair in enumerate(curves.pairs)} | {p: g for g, p in enumerate(curves.pairs)}
    for i, r in enumerate(matrix.response):
        for j, e in enumerate(matrix.excitation):
            g = place.get((r, e), place.get(frozenset((r, e))))
            level[:, i, j] = np.inf if g is None else curves.std[g]
    if values.shape[1] < values.shape[2]:
        values, level = values.transpose(0, 2, 1), level.transpose(0, 2, 1)
    known = np.isfinite(values)
    complete = known.all(axis=2)
    if complete.sum() * values.shape[2] < 0.99 * known.sum():
        values, level = values.reshape(f.size, -1, 1), level.reshape(f.size, -1, 1)
        known = known.reshape(f.size, -1, 1)
        complete = known[:, :, 0]
    with np.errstate(divide="ignore"):
        weight = np.where(complete, 1.0 / np.sqrt(np.mean(level**2, axis=2)), 0.0)
    rows = np.where(known, values, 0.0)
    used = weight.any(axis=0) & (rows * weight[:, :, None]).any(axis=(0, 2))
    return f, rows[:, used], weight[:, used]


@dataclass(frozen=True)
class _Sums:
    """Sums over frequency of ``W^2 z^d`` times nothing, H and ``H^H H``, for d = -most .. most.

    Shapes (2 most + 1, rows), (.., rows, m), (.., rows, m, m).
    """

    one: Complex
    single: Complex
    double: Complex
    most: int


def _sums(frequency: Real, rows: Complex, weight: Real, most: int) -> _Sums:
    angle = np.pi * (frequency - frequency[0]) / (frequency[-1] - frequency[0])
    power = np.exp(1j * np.outer(np.arange(-most, most + 1), angle))
    # Weights of all rows are brought to one size: a factor on a row is none on its equation.
    square = (weight / np.sqrt(np.mean(weight**2, axis=0))) ** 2
    size = np.sqrt(np.sum(square[:, :, None] * np.abs(rows) ** 2, axis=(0, 2)))
    scaled = rows / size[:, None]
    n, o, m = rows.shape
    single = power @ (square[:, :, None] * scaled).reshape(n, -1)
    double = np.stack(
        [
            power @ (square[:, r, None, None] * scaled[:, r, :, None].conj() * scaled[:, r, None, :]).reshape(n, -1)
            for r in range(o)
        ],
        axis=1,
    )
    return _Sums(power @ square.astype(complex), single.reshape(-1, o, m), double.reshape(-1, o, m, m), most)


def _poles(sums: _Sums, order: int, inputs: int, frequency: Real) -> tuple[Real, Complex]:
    """Return stable poles of one order inside the band, and their vectors of participation."""
    m, size = inputs, order + 1
    difference = np.subtract.outer(np.arange(size), np.arange(size)).T + sums.most  # s - r at [r, s]
    total = np.zeros((size * m, size * m), dtype=complex)
    for o in range(sums.one.shape[1]):
        r = sums.one[difference, o]
        s = -sums.single[difference, o].reshape(size, size * m)
        t = sums.double[difference, o].transpose(0, 2, 1, 3).reshape(size * m, size * m)
        total += t - s.conj().T @ np.linalg.lstsq(r, s, rcond=1e-13)[0]
    free = np.linalg.lstsq(total[m:, m:], -total[m:, :m], rcond=1e-14)[0]
    companion = np.zeros((order * m, order * m), dtype=complex)
    companion[:m] = np.concatenate([-free[k * m : (k + 1) * m] for k in range(order)], axis=1)
    companion[m:, :-m] = np.eye((order - 1) * m)
    inverse, vectors = np.linalg.eig(companion)
    large = np.abs(inverse) > 1e-6
    span = frequency[-1] - frequency[0]
    # z = exp(s dt) with dt = 1/(2 span), counted from the first line.
    s = -np.log(inverse[large]) * 2.0 * span + 2j * np.pi * frequency[0]
    shapes = vectors[-m:, large]
    natural = np.abs(s) / (2.0 * np.pi)
    damping = -s.real / np.abs(s)
    physical = (damping > 0.0) & (damping < RULES.mode_damping) & (s.imag > 0.0)
    physical &= (natural > frequency[0]) & (natural < frequency[-1])
    rank = np.argsort(natural[physical])
    return np.stack([natural, damping], axis=1)[physical][rank], shapes[:, physical][:, rank]


def _level(poles: Real, vectors: Complex, old: Real, old_vectors: Complex, rules: StabilityRules) -> NDArray[np.int64]:
    """Return how much of each pole was there one order before."""
    out = np.zeros(len(poles), dtype=np.int64)
    for i, (natural, damping) in enumerate(poles):
        near = np.flatnonzero(np.abs(old[:, 0] / natural - 1.0) < rules.frequency)
        for j in near:
            level = 1
            if abs(old[j, 1] / damping - 1.0) < rules.damping:
                level = 3 if _assurance(vectors[:, i], old_vectors[:, j]) > rules.assurance else 2
            out[i] = max(out[i], level)
    return out


def _assurance(a: Complex, b: Complex) -> float:
    """Return the modal assurance criterion ``|a^H b|^2/(a^H a b^H b)``."""
    return float(np.abs(np.vdot(a, b)) ** 2 / max(np.vdot(a, a).real * np.vdot(b, b).real, 1e-300))


def _candidates(stable: Real, least: float, rules: StabilityRules) -> Real:
    """Return the middle of each cluster of stable poles and the number of its poles, most first."""
    if len(stable) < 2:
        return np.empty((0, 3))
    # A distance of one is the change that is allowed between two orders, damping to be met less closely.
    place = np.stack([np.log(stable[:, 0]) / rules.frequency, np.log(stable[:, 1]) / (6.0 * rules.damping)], axis=1)
    member = hierarchy.fclusterdata(place, 1.5, criterion="distance", method="average")
    out = []
    for number in np.unique(member):
        group = stable[member == number]
        if len(group) >= least:
            out.append((*np.median(group, axis=0), float(len(group))))
    return np.array(sorted(out, key=lambda row: -row[2])).reshape(-1, 3)
