"""Real mode shapes by maximum likelihood: one vector a mode, reciprocal by its form.

    Phi_ij = sum_p v_pi v_pj / (1 - r^2 + 2 j zeta_p r) + U_ij u(w) + L_ij l(w),    r = f/f_p,
    v = direction/sqrt(stiffness)

with the remainders of `smfe.modes.pole_fit`. The vectors are what a `process.ModalModel` and a campaign's ``[[model]]``
hold. All errors count, also those that entries of one row share: the residual of every frequency is made white with
the factor of its covariance. Residues of the free fit give the start, ``v v^T = Re(2 j w_d R)/w^2``.

Hits that lean, channels that are a per cent off or late leave poles where they are and make residues that no real shape
has. Poles that are free would then move, and modes be added, to describe errors: where real shapes leave significantly
more than free residues do, the poles are those of the free fit, with their deviations, and only shapes are fitted.

Entries that were not measured have no say. Places that no measured entry connects (xx and yy without xy) are separate
machines: a mode of both is two modes with one pole, and the compliance between them is rigid, as everywhere in smfe.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from process.errors import InputError
from process.types import Complex, Real
from smfe.modes.pole_fit import (
    Descent,
    PoleFit,
    Remainders,
    descend,
    inflation,
    information,
    remainder_modes,
    scaled_inverse,
    scaled_step,
    unit_mode,
)
from smfe.modes.response_matrix import Curves
from smfe.modes.rules import RULES

FINAL = Descent(40, tries=10, least=1e-7, step=scaled_step)
ROUGH = replace(FINAL, iterations=10, share=1e-4)
"""Convergence of the reported shapes, and while it is decided which modes there are."""


@dataclass(frozen=True)
class ShapeFit:
    """Modes with real shapes.

    Parameters
    ----------
    curves : Curves
        What was fitted.
    poles : ndarray, shape (p, 2)
        Natural frequency [Hz] and damping ratio.
    shape : ndarray, shape (p, places)
        v [(m/N)^(1/2)], in the order of ``curves.places``.
    remainders : Remainders
        Which the model has.
    coefficient : ndarray, shape (g, remainders)
        Compliance of the remainders at 0 Hz [m/N], lower first.
    origin : tuple of int
        Which pole of the free fit each mode comes from; modes of one frequency come from the same.
    residual_lines : float
        Lines over which the residual of the free fit belongs together.
    chi : float
        Weighted sum of squares of the residual over ``curves.counted_lines``.
    pole_std : ndarray, shape (p, 2), or None
        Standard deviations of poles that were taken from the free fit as they are; None: they were fitted here.
    """

    curves: Curves = field(repr=False)
    poles: Real
    shape: Real = field(repr=False)
    remainders: Remainders
    coefficient: Real = field(repr=False)
    origin: tuple[int, ...]
    residual_lines: float = 1.0
    chi: float = np.inf
    pole_std: Real | None = field(default=None, repr=False)

    @property
    def unknowns(self) -> int:
        """Real unknowns."""
        return int(self.poles.size + self.shape.size + self.coefficient.size)

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the residual."""
        return max(self.curves.real_data - self.unknowns, 1.0)

    @property
    def misfit(self) -> float:
        """Root of chi over its degrees of freedom."""
        return float(np.sqrt(self.chi / self.degrees_of_freedom))

    @property
    def information(self) -> float:
        """Bayesian information criterion; smaller is better (`smfe.modes.pole_fit.information`)."""
        return information(self.chi, self.curves.real_data, self.unknowns)

    @property
    def stiffness(self) -> Real:
        """Modal stiffness [N/m] of the unit direction."""
        return np.asarray(1.0 / np.maximum(np.sum(self.shape**2, axis=1), 1e-300))

    @property
    def direction(self) -> Real:
        """Unit vectors, the largest component positive, shape (p, places)."""
        unit = self.shape / np.maximum(np.linalg.norm(self.shape, axis=1, keepdims=True), 1e-150)
        largest = np.take_along_axis(unit, np.argmax(np.abs(unit), axis=1)[:, None], axis=1)
        return np.asarray(unit * np.where(largest < 0.0, -1.0, 1.0))

    @cached_property
    def covariance(self) -> Real:
        """Covariance of (f, zeta, v) of each mode in turn, then the remainders of each curve."""
        gram, _ = _normal(self, _whitening(self.curves))
        lines, factor = self.curves.error_lines, inflation(self.chi, self.degrees_of_freedom, self.curves.noise_known)
        if not self.curves.noise_known or factor > 1.0:
            lines = max(lines, self.residual_lines)
        return scaled_inverse(gram) * lines * factor

    @cached_property
    def std(self) -> dict[str, Real]:
        """Standard deviations: frequency [Hz], damping, stiffness [N/m], direction (p, places)."""
        size = 2 + self.shape.shape[1]
        blocks = [self.covariance[k * size : (k + 1) * size, k * size : (k + 1) * size] for k in range(len(self.poles))]
        out: dict[str, list[Real]] = {"frequency": [], "damping": [], "stiffness": [], "direction": []}
        for block, v, k in zip(blocks, self.shape, self.stiffness, strict=True):
            own = block[2:, 2:]
            out["frequency"].append(np.sqrt(block[0, 0]))
            out["damping"].append(np.sqrt(block[1, 1]))
            out["stiffness"].append(2.0 * k**2 * np.sqrt(v @ own @ v))
            across = (np.eye(v.size) - np.outer(v, v) * k) * np.sqrt(k)
            out["direction"].append(np.sqrt(np.maximum(np.diag(across @ own @ across.T), 0.0)))
        found = {name: np.array(values) for name, values in out.items()}
        if self.pole_std is not None:
            found["frequency"], found["damping"] = self.pole_std.T
        return found

    @property
    def resolved(self) -> NDArray[np.bool_]:
        """Which modes have a stiffness that is known at all: twice its error is less than it."""
        return np.asarray(self.std["stiffness"] < RULES.unresolved * self.stiffness)

    @property
    def left(self) -> Complex:
        """What the modes leave of every curve [m/N], shape (g, n)."""
        model = self.curves.over_lines(lambda f: self.curve_values(f).T)
        return np.asarray(self.curves.values - model.T)

    def curve_values(self, frequency: Real) -> Complex:
        """Return the model of every curve [m/N], shape (g, f), at frequencies [Hz]."""
        first, second = _places(self.curves)
        gain = np.stack([unit_mode(frequency, f, z) for f, z in self.poles])
        modes = np.einsum("pg,pf->gf", self.shape[:, first] * self.shape[:, second], gain)
        return np.asarray(modes + self.coefficient @ _remainder_rows(self.curves.frequency, frequency, self.remainders))


def _places(curves: Curves) -> tuple[list[int], list[int]]:
    names = curves.places
    return [names.index(r) for r, _ in curves.pairs], [names.index(e) for _, e in curves.pairs]


def _remainder_rows(grid: Real, frequency: Real, remainders: Remainders) -> Complex:
    """Return the remainders of unit stiffness, lower first, shape (remainders, f)."""
    below, above = remainder_modes(grid)
    rows = [
        unit_mode(frequency, *mode) for mode, there in ((below, remainders.lower), (above, remainders.upper)) if there
    ]
    return np.array(rows).reshape(len(rows), frequency.size) + 0.0j


def components(curves: Curves) -> list[list[int]]:
    """Return the places that measured entries connect, by number.

    Raises
    ------
    InputError
        When the entries of some places determine no shape: no driving point is among them.
    """
    first, second = _places(curves)
    left = set(range(len(curves.places)))
    out = []
    while left:
        reached, new = set[int](), {min(left)}
        while new:
            reached |= new
            new = {b for a, b in [*zip(first, second, strict=True), *zip(second, first, strict=True)] if a in reached}
            new -= reached
        left -= reached
        if not any(a == b and a in reached for a, b in zip(first, second, strict=True)):
            names = ", ".join(curves.places[k] for k in sorted(reached))
            raise InputError(
                f"no driving point (force and motion at one place) was measured among {names}: residues say only the "
                f"product of two components of a mode shape; measure one direct entry, e.g. "
                f"{curves.places[min(reached)] * 2}"
            )
        out.append(sorted(reached))
    return out


def fit_shapes(free: PoleFit, keep: NDArray[np.bool_] | None = None) -> ShapeFit:
    """Return the real modes that fit best, starting from the poles and residues of a free fit.

    Parameters
    ----------
    free : PoleFit
        Its poles and residues.
    keep : ndarray of bool, optional
        Poles that are modes; the others stay in the model as well, as what surrounds them.

    Raises
    ------
    InputError
        When no driving point was measured, or a mode would give out energy.
    """
    parts = components(free.curves)
    white, modes = _whitening(free.curves), np.ones(len(free.poles), bool) if keep is None else keep
    matrices = [_static(free, k) for k in range(len(free.poles))]
    shape = np.stack([_leading(m, parts) for m in matrices])
    _require_positive(free, shape, modes)
    # A residue without any positive part has no real shape to start from; what is no mode of the band fills it up.
    first, last = free.curves.frequency[[0, -1]]
    fills = (free.poles[:, 0] > first) & (free.poles[:, 0] < last) & fills_up(free)
    there = np.flatnonzero((np.sum(shape**2, axis=1) > 0.0) & ~fills)
    fit = _with_all(free, modes, _start(free, there, shape[there]), parts, white)
    if not _significant(free, fit, white):
        return fit
    held = replace(_start(free, there, shape[there]), pole_std=free.pole_std[there])
    return _with_all(free, modes, held, parts, white)


def _with_all(
    free: PoleFit, modes: NDArray[np.bool_], start: ShapeFit, parts: list[list[int]], white: Complex | Real
) -> ShapeFit:
    """Return the fit with the modes that are known, and second vectors where the criterion wants them."""
    fit = _resolved(_refined(start, white), white)
    for _ in range(RULES.most_repeated):
        more = _with_repeated(free, modes, fit, parts, white)
        if more is None or more.information >= fit.information:
            break
        fit = more
    return _refined(fit, white, FINAL)


def _significant(free: PoleFit, fit: ShapeFit, white: Complex | Real) -> bool:
    """Whether real shapes leave significantly more than free residues do."""
    alone = float(np.sum(_white(free.left.T[:, :, None], white) ** 2)) / fit.curves.counted_lines
    scale = max(alone / free.degrees_of_freedom, 1e-300)  # exact data leave nothing
    more = (fit.chi - alone) / (max(scale, 1.0) if fit.curves.noise_known else scale)
    return bool(stats.chi2.sf(more, max(free.unknowns - fit.unknowns, 1)) < RULES.p_value_shapes)


def fills_up(free: PoleFit) -> NDArray[np.bool_]:
    """Return which poles only describe what the others leave of errors of the measurement, shape (p,).

    The residue of a mode is real and positive, ``v v^T`` (two such of a symmetric machine), whoever measures it. One
    that is not is no mode of a machine where it hardly adds to the response at its own frequency, or is narrower than
    the record has lines for (a tone of the mains).
    """
    try:
        parts = components(free.curves)
    except InputError:
        return np.zeros(len(free.poles), dtype=bool)
    first, second = _places(free.curves)
    spacing = np.gradient(free.curves.frequency)
    out = []
    for k, (natural, damping) in enumerate(free.poles):
        own = 2j * np.sqrt(1.0 - damping**2) * free.residue[k] / (2.0 * np.pi * natural)
        left = _static(free, k)
        for _ in range(2):
            v = _leading(left, parts)
            left = left - np.outer(v, v)
        away = np.hypot(np.linalg.norm(left[first, second]), np.linalg.norm(own.imag))
        whole = np.linalg.norm(free.curve_values(np.array([natural])))
        weak = 0.5 * np.linalg.norm(own) / damping < RULES.fills_up * whole
        narrow = 2.0 * damping * natural < np.interp(natural, free.curves.frequency, spacing)
        out.append(away > RULES.not_real * np.linalg.norm(own) and (weak or narrow))
    return np.array(out, dtype=bool)


def _resolved(fit: ShapeFit, white: Complex | Real) -> ShapeFit:
    """Take away modes whose stiffness is not known at all, the least known first, while the criterion falls.

    Such modes belong to residues that no real shape can have: two poles that take back what the other gives.
    """
    while len(fit.poles) > 1 and not fit.resolved.all():
        worst = int(np.argmax(fit.std["stiffness"] / fit.stiffness))
        keep = np.arange(len(fit.poles)) != worst
        origin = tuple(o for o, k in zip(fit.origin, keep, strict=True) if k)
        std = None if fit.pole_std is None else fit.pole_std[keep]
        less = replace(fit, poles=fit.poles[keep], shape=fit.shape[keep], origin=origin, pole_std=std)
        tried = _refined(less, white)
        if tried.information >= fit.information:
            return fit
        fit = tried
    return fit


def _start(free: PoleFit, numbers: NDArray[np.int64], shape: Real) -> ShapeFit:
    rows = [free.remainder(name) for name in ("lower", "upper") if getattr(free.remainders, name)]
    coefficient = np.array(rows).reshape(len(rows), len(free.coefficient)).T
    origin, poles = tuple(int(k) for k in numbers), free.poles[numbers]
    return ShapeFit(free.curves, poles, shape, free.remainders, coefficient, origin, free.correlated_lines)


def _static(free: PoleFit, number: int) -> Real:
    """Return ``Re(2 j w_d R)/w^2`` as a matrix over places [m/N], NaN where it was not measured."""
    natural, damping = free.poles[number]
    w = 2.0 * np.pi * natural
    values = (2j * w * np.sqrt(1.0 - damping**2) * free.residue[number]).real / w**2
    first, second = _places(free.curves)
    out = np.full((len(free.curves.places),) * 2, np.nan)
    out[first, second] = values
    out[second, first] = values
    return out


def _leading(matrix: Real, parts: list[list[int]]) -> Real:
    """Return v with ``v v^T`` near the measured entries of a matrix, part by part."""
    out = np.zeros(len(matrix))
    for part in parts:
        block = matrix[np.ix_(part, part)]
        known = np.isfinite(block)
        filled = np.where(known, block, 0.0)
        size, vectors = np.linalg.eigh(filled)
        v = vectors[:, -1] * np.sqrt(max(size[-1], 0.0))
        for _ in range(30):  # what was not measured follows from what was
            total = known @ v**2
            v = np.where(total > 0.0, 0.5 * v + 0.5 * (filled @ v) / np.where(total > 0.0, total, 1.0), 0.0)
        out[part] = v
    return out


def _require_positive(free: PoleFit, shape: Real, keep: NDArray[np.bool_]) -> None:
    """Refuse modes that give out energy where they are among the strong ones; weak ones get no shape anyway."""
    first, second = _places(free.curves)
    direct = [g for g, (a, b) in enumerate(zip(first, second, strict=True)) if a == b]
    height = np.abs(free.residue).max(axis=1) / (free.poles[:, 0] * free.poles[:, 1])
    for k in np.flatnonzero(keep & (height >= RULES.strong * height[keep].max())):
        natural, damping = free.poles[k]
        turned = (2j * np.sqrt(1.0 - damping**2) * free.residue[k, direct]).real
        spread = 2.0 * free.residue_std[k, direct]
        if np.all(turned < 0.0) and turned.min() < -5.0 * spread[np.argmin(turned)]:
            names = ", ".join(free.curves.pairs[direct[i]][0] * 2 for i in np.flatnonzero(turned < 0.0))
            raise InputError(
                f"the mode at {natural:.4g} Hz gives out energy at its driving point ({names}): force or motion has "
                "the wrong sign, or they are not measured at the same place; declare sign = -1 on the channel"
            )
    if not np.abs(shape[keep]).max(initial=0.0) > 0.0:
        raise InputError("no mode of this compliance has a positive driving point; check the signs of its channels")


def _whitening(curves: Curves) -> Complex | Real:
    """Return W with ``W S W^H`` twice the unit matrix for the errors S of each frequency, shape (n, g, g).

    Twice: real and imaginary part then have a variance of one each. Missing entries have rows and columns of zeros.
    Independent errors: the diagonal alone, shape (n, g).
    """
    if curves.covariance is None:
        return np.asarray(curves.weight.T)
    there = np.isfinite(curves.std).T
    scale = np.where(there, np.where(there, curves.std.T, 1.0), 1.0)
    joint = curves.covariance / (scale[:, :, None] * scale[:, None, :])
    mask = there[:, :, None] & there[:, None, :]
    joint = np.where(mask, joint, 0.0)
    # Half a percent on the diagonal: a covariance from few columns may be of deficient rank.
    step = np.arange(len(curves.pairs))
    joint[:, step, step] = 1.005
    factor = np.linalg.cholesky(joint)
    inverse = np.linalg.inv(factor) * np.sqrt(2.0)
    return np.asarray(np.where(mask, inverse / scale[:, None, :], 0.0))


def _white(values: Complex, white: Complex | Real) -> Real:
    """Return white real residuals of values, shape (n, g, k): real parts over imaginary parts, (2 n g, k)."""
    turned = white[:, :, None] * values if white.ndim == 2 else white @ values
    flat = turned.reshape(-1, values.shape[2])
    return np.concatenate([flat.real, flat.imag])


def _left(fit: ShapeFit, white: Complex | Real) -> Real:
    """Return the white residual, shape (2 n g,)."""
    return _white(fit.left.T[:, :, None], white)[:, 0]


def _solved(fit: ShapeFit, white: Complex | Real) -> ShapeFit:
    """Return the fit with its chi."""
    return replace(fit, chi=float(np.sum(_left(fit, white) ** 2)) / fit.curves.counted_lines)


def _own_slopes(fit: ShapeFit, gains: Complex, rows: Complex, number: int) -> tuple[Complex, NDArray[np.int64]]:
    """Return the derivatives of one curve by the unknowns that it depends on, and their numbers.

    Parameters
    ----------
    gains : ndarray of complex, shape (n, 3, p)
        Gain of each mode and its derivatives by frequency and damping.
    rows : ndarray of complex, shape (n, remainders)
        Remainders of unit stiffness.
    number : int
        The curve.
    """
    (first, second), size = _places(fit.curves), 2 + fit.shape.shape[1]
    one, other = first[number], second[number]
    at = size * np.arange(len(fit.poles))
    product = fit.shape[:, one] * fit.shape[:, other]
    parts = [gains[:, 1] * product, gains[:, 2] * product]
    numbers = [at, at + 1]
    if one == other:
        parts.append(2.0 * gains[:, 0] * fit.shape[:, one])
        numbers.append(at + 2 + one)
    else:
        parts += [gains[:, 0] * fit.shape[:, other], gains[:, 0] * fit.shape[:, one]]
        numbers += [at + 2 + one, at + 2 + other]
    parts.append(rows)
    numbers.append(size * len(fit.poles) + rows.shape[1] * number + np.arange(rows.shape[1]))
    return np.concatenate(parts, axis=1), np.concatenate(numbers)


def _gains(frequency: Real, poles: Real) -> Complex:
    """Return gain of each mode and its derivatives by frequency [1/Hz] and damping, shape (n, 3, p)."""
    ratio = frequency[:, None] / poles[:, 0]
    gain = 1.0 / (1.0 - ratio**2 + 2j * poles[:, 1] * ratio)
    by_frequency = gain**2 * (-2.0 * ratio + 2j * poles[:, 1]) * ratio / poles[:, 0]
    return np.stack([gain, by_frequency, -(gain**2) * 2j * ratio], axis=1)


def _normal(fit: ShapeFit, white: Complex | Real) -> tuple[Real, Real]:
    """Return Gram matrix of the white slopes by all unknowns, and their product with the residual."""
    curves = fit.curves
    gains = curves.over_lines(lambda f: _gains(f, fit.poles))
    rows = curves.over_lines(lambda f: _remainder_rows(curves.frequency, f, fit.remainders).T)
    gram, gradient = np.zeros((fit.unknowns,) * 2), np.zeros(fit.unknowns)
    own = [_own_slopes(fit, gains, rows, g) for g in range(len(curves.pairs))]
    if white.ndim == 2:  # every curve by itself: it depends on few of the unknowns
        left = fit.left.T * white
        for g, (slope, numbers) in enumerate(own):
            columns = slope * white[:, g, None]
            gram[np.ix_(numbers, numbers)] += (columns.conj().T @ columns).real
            gradient[numbers] += (columns.conj().T @ left[:, g]).real
        return gram, gradient
    every = np.zeros((curves.frequency.size, len(own), fit.unknowns), dtype=complex)
    for g, (slope, numbers) in enumerate(own):
        every[:, g, numbers] = slope
    slopes = _white(every, white)
    return slopes.T @ slopes, slopes.T @ _left(fit, white)


def _refined(fit: ShapeFit, white: Complex | Real, rules: Descent = ROUGH) -> ShapeFit:
    """Return the nearest least of chi."""

    def normal(at: ShapeFit) -> tuple[Real, Real]:
        gram, gradient = _normal(at, white)
        if at.pole_std is not None:
            held = np.arange(at.poles.size + at.shape.size).reshape(len(at.poles), -1)[:, :2].ravel()
            gram[held], gram[:, held], gradient[held] = 0.0, 0.0, 0.0
            gram[held, held] = np.mean(np.diag(gram))
        return gram, gradient

    return descend(_solved(fit, white), normal, lambda at, d: _solved(_moved(at, d), white), rules)


def _moved(fit: ShapeFit, step: Real) -> ShapeFit:
    """Return the fit with its unknowns moved, within what a mode can be."""
    modes = step[: fit.poles.size + fit.shape.size].reshape(len(fit.poles), -1)
    rest = step[modes.size :].reshape(fit.coefficient.shape)
    if fit.pole_std is not None:
        return replace(fit, shape=fit.shape + modes[:, 2:], coefficient=fit.coefficient + rest)
    width = fit.poles[:, 0] * fit.poles[:, 1]
    change = np.stack([np.clip(modes[:, 0], -width, width), modes[:, 1]], axis=1)
    poles = fit.poles + change
    poles[:, 1] = np.clip(
        poles[:, 1],
        np.maximum(0.5 * fit.poles[:, 1], RULES.least_damping),
        np.minimum(2.0 * fit.poles[:, 1], RULES.most_damping),
    )
    return replace(fit, poles=poles, shape=fit.shape + modes[:, 2:], coefficient=fit.coefficient + rest)


def _with_repeated(
    free: PoleFit, modes: NDArray[np.bool_], fit: ShapeFit, parts: list[list[int]], white: Complex | Real
) -> ShapeFit | None:
    """Return the fit with one vector more for the mode whose residue asks for it most.

    Hits and sensors that lean by 2 degrees, and channels 1 % off, ask for up to 4 % of a mode's own.
    """
    best: tuple[float, int, Real] | None = None
    for k in map(int, np.flatnonzero(modes)):
        own = fit.shape[np.array(fit.origin) == k]
        if not len(own):
            continue
        v = _leading(_static(free, k) - own.T @ own, parts)
        share = float(v @ v) / float(np.sum(own**2))
        if share > RULES.second_vector and (best is None or share > best[0]):
            best = share, k, v
    if best is None:
        return None
    _, k, v = best
    held = fit.pole_std is not None
    repeated = free.poles[[k]] * [[1.0 if held else 1.0 + 0.1 * free.poles[k, 1], 1.0]]
    tried = replace(
        fit,
        poles=np.concatenate([fit.poles, repeated]),
        shape=np.concatenate([fit.shape, v[None, :]]),
        origin=(*fit.origin, k),
        pole_std=None if fit.pole_std is None else np.concatenate([fit.pole_std, free.pole_std[[k]]]),
    )
    return _refined(tried, white)
