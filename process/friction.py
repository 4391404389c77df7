"""Friction laws of guideways and drives, and their identification from steady runs.

A law gives the force that opposes the motion: ``m x'' = F - law.force(x')``. All quantities are SI; `process.units`
turns ``mm/min`` into m/s (N min/mm into N s/m and min/mm into s/m both have the factor 6e4).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import stats
from scipy.optimize import least_squares, nnls

from process import _friction_kernels as kernels
from process.errors import InputError


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not value > 0.0:
            raise InputError(f"{name.replace('_', ' ')} is {value:g}; it must be positive (SI units)")


def _not_negative(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 <= value < math.inf:
            raise InputError(f"{name.replace('_', ' ')} is {value:g}; give a finite value >= 0 (SI units)")


class FrictionLaw(ABC):
    """Friction without memory: a force for each velocity. Subclasses are frozen dataclasses."""

    @abstractmethod
    def packed(self) -> tuple[int, NDArray[np.float64]]:
        """Return the code of the law and its parameters, as `process._friction_kernels` takes them."""

    def force(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """Return the force [N] that opposes the motion at velocities [m/s] of any shape."""
        v = np.asarray(velocity, dtype=float)
        out = np.empty(v.size)
        kernels.friction_forces(*self.packed(), np.ascontiguousarray(v).reshape(-1), out)
        return out.reshape(v.shape)

    def slope(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """Return the local damping ``d force / d velocity`` [N s/m] at velocities [m/s] of any shape."""
        v = np.asarray(velocity, dtype=float)
        out = np.empty(v.size)
        kernels.friction_slopes(*self.packed(), np.ascontiguousarray(v).reshape(-1), out)
        return out.reshape(v.shape)


@dataclass(frozen=True)
class Viscous(FrictionLaw):
    """Force in proportion to velocity: ``sigma v``.

    Parameters
    ----------
    sigma : float
        Viscous coefficient [N s/m].
    """

    sigma: float

    def __post_init__(self) -> None:
        """Refuse a negative coefficient."""
        _not_negative(sigma=self.sigma)

    def packed(self) -> tuple[int, NDArray[np.float64]]:
        """Return the code of the law and its parameters."""
        return kernels.VISCOUS, np.array([self.sigma])


@dataclass(frozen=True)
class Coulomb(FrictionLaw):
    """Constant force against the motion: ``F tanh(kt v)``, which is ``F sign(v)`` for an infinite kt.

    Parameters
    ----------
    coulomb : float
        Sliding force F [N].
    kt : float, optional
        Steepness at rest [s/m]. A time simulation needs a finite one.
    """

    coulomb: float
    kt: float = math.inf

    def __post_init__(self) -> None:
        """Refuse a negative force or steepness."""
        _not_negative(coulomb_force=self.coulomb)
        _positive(kt=self.kt)

    def packed(self) -> tuple[int, NDArray[np.float64]]:
        """Return the code of the law and its parameters."""
        return kernels.COULOMB, np.array([self.coulomb, 0.0, self.kt])


@dataclass(frozen=True)
class CoulombViscous(FrictionLaw):
    """Coulomb and viscous friction: ``F tanh(kt v) + sigma v``.

    Parameters
    ----------
    coulomb : float
        Sliding force F [N].
    sigma : float
        Viscous coefficient [N s/m].
    kt : float, optional
        Steepness at rest [s/m]; infinite means sign(v).
    """

    coulomb: float
    sigma: float
    kt: float = math.inf

    def __post_init__(self) -> None:
        """Refuse negative parameters."""
        _not_negative(coulomb_force=self.coulomb, sigma=self.sigma)
        _positive(kt=self.kt)

    def packed(self) -> tuple[int, NDArray[np.float64]]:
        """Return the code of the law and its parameters."""
        return kernels.COULOMB, np.array([self.coulomb, self.sigma, self.kt])


@dataclass(frozen=True)
class Andersson(FrictionLaw):
    """Stribeck curve through a smooth sign (Andersson et al. 2007; Eq. 5 of Franco et al. 2024).

    ``f(v) = [Fc + (Fs - Fc) exp(-(|v|/vs)^delta)] tanh(kt v) + sigma v``

    Parameters
    ----------
    coulomb : float
        Sliding force Fc [N].
    static : float
        Largest static force Fs [N].
    stribeck_speed : float
        Velocity vs at which the Stribeck boost has fallen to 1/e [m/s].
    sigma : float
        Viscous coefficient [N s/m].
    kt : float
        Steepness at rest [s/m]; infinite means sign(v).
    delta : float, optional
        Shape of the Stribeck curve.
    negative : Andersson, optional
        The law for negative velocity, with its own positive parameters; by default the same.
    """

    coulomb: float
    static: float
    stribeck_speed: float
    sigma: float
    kt: float
    delta: float = 1.0
    negative: Andersson | None = None

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        _not_negative(coulomb_force=self.coulomb, static_force=self.static, sigma=self.sigma)
        _positive(stribeck_speed=self.stribeck_speed, kt=self.kt, delta=self.delta)
        if self.negative is not None and self.negative.negative is not None:
            raise InputError("the law for negative velocity has itself one for negative velocity; give it without")

    def _one_way(self) -> list[float]:
        return [self.coulomb, self.static, self.stribeck_speed, self.sigma, self.kt, self.delta]

    def packed(self) -> tuple[int, NDArray[np.float64]]:
        """Return the code of the law and its parameters."""
        backwards = self if self.negative is None else self.negative
        return kernels.ANDERSSON, np.array(self._one_way() + backwards._one_way())


class MemoryLaw(ABC):
    """Friction with memory: internal states that a velocity history drives. Subclasses are frozen dataclasses."""

    coulomb: float
    static: float
    stribeck_speed: float
    sigma: float
    delta: float

    @abstractmethod
    def packed(self) -> tuple[int, NDArray[np.float64]]:
        """Return the code of the law and its parameters, as `process._friction_kernels.friction_step` takes them."""

    @property
    @abstractmethod
    def states(self) -> int:
        """Number of internal states; all zero is the relaxed law."""

    @property
    @abstractmethod
    def stiffness(self) -> float:
        """Stiffness of the contact while it sticks [N/m]."""

    def steady_force(self, velocity: ArrayLike) -> NDArray[np.float64]:
        """Return the force [N] under constant velocity: ``s(v) sign(v) + sigma v`` with the Stribeck curve s."""
        v = np.asarray(velocity, dtype=float)
        boost = (self.static - self.coulomb) * np.exp(-((np.abs(v) / self.stribeck_speed) ** self.delta))
        return np.asarray((self.coulomb + boost) * np.sign(v) + self.sigma * v)

    def history(self, velocity: ArrayLike, step: float) -> NDArray[np.float64]:
        """Return the force [N] at the end of each step [s] of a velocity history [m/s], shape (n,), from rest."""
        v = np.ascontiguousarray(velocity, dtype=float)
        if v.ndim != 1 or not step > 0.0:
            raise InputError(f"velocity of shape {v.shape} and step {step:g} s: give shape (n,) and a positive step")
        out = np.empty(v.size)
        kernels.friction_history(*self.packed(), np.zeros(self.states), v, step, out)
        return out

    def _check(self) -> None:
        _not_negative(sigma=self.sigma)
        _positive(
            coulomb_force=self.coulomb, static_force=self.static, stribeck_speed=self.stribeck_speed, delta=self.delta
        )


@dataclass(frozen=True)
class LuGre(MemoryLaw):
    """Bristles that bend and slip (Canudas de Wit et al. 1995).

    ``z' = v - k |v| z / s(v)``, ``f = k z + d z' + sigma v``, ``s(v) = Fc + (Fs - Fc) exp(-(|v|/vs)^delta)``

    Parameters
    ----------
    bristle_stiffness : float
        Stiffness k of the contact [N/m].
    bristle_damping : float
        Damping d of the bristles [N s/m].
    coulomb, static : float
        Sliding and largest static force [N].
    stribeck_speed : float
        Velocity vs [m/s].
    sigma : float
        Viscous coefficient [N s/m].
    delta : float, optional
        Shape of the Stribeck curve.
    """

    bristle_stiffness: float
    bristle_damping: float
    coulomb: float
    static: float
    stribeck_speed: float
    sigma: float
    delta: float = 1.0

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        self._check()
        _positive(bristle_stiffness=self.bristle_stiffness)
        _not_negative(bristle_damping=self.bristle_damping)

    def packed(self) -> tuple[int, NDArray[np.float64]]:
        """Return the code of the law and its parameters."""
        bristle = [self.bristle_stiffness, self.bristle_damping, self.sigma]
        return kernels.LUGRE, np.array([*bristle, self.coulomb, self.static, self.stribeck_speed, self.delta])

    @property
    def states(self) -> int:
        """One: the bend of the bristles [m]."""
        return 1

    @property
    def stiffness(self) -> float:
        """Stiffness of the contact while it sticks [N/m]."""
        return self.bristle_stiffness


@dataclass(frozen=True)
class GeneralisedMaxwellSlip(MemoryLaw):
    """Parallel elements that stick and slip (Al-Bender, Lampaert, Swevers 2005).

    An element that sticks follows ``F' = k v`` until it carries its share a of the Stribeck curve s(v); then
    ``F' = C (a - F/s(v))`` (signs for v > 0) until the velocity reverses. The force is their sum and ``sigma v``.

    Parameters
    ----------
    element_stiffness : tuple of float
        Stiffness k of each element [N/m].
    share : tuple of float
        Share a of each element; the sum is 1.
    coulomb, static : float
        Sliding and largest static force [N].
    stribeck_speed : float
        Velocity vs [m/s].
    sigma : float
        Viscous coefficient [N s/m].
    attraction : float
        Rate C at which a slipping element is drawn to the Stribeck curve [N/s].
    delta : float, optional
        Shape of the Stribeck curve.
    """

    element_stiffness: tuple[float, ...]
    share: tuple[float, ...]
    coulomb: float
    static: float
    stribeck_speed: float
    sigma: float
    attraction: float
    delta: float = 1.0

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        self._check()
        _positive(attraction=self.attraction)
        if len(self.element_stiffness) != len(self.share) or not self.share:
            given = f"{len(self.element_stiffness)} stiffnesses and {len(self.share)} shares"
            raise InputError(f"{given} were given; give as many of both")
        for k, a in zip(self.element_stiffness, self.share, strict=True):
            _positive(element_stiffness=k, share=a)
        if not math.isclose(sum(self.share), 1.0, rel_tol=1e-6):
            raise InputError(f"the shares sum to {sum(self.share):g}; they must sum to 1")

    def packed(self) -> tuple[int, NDArray[np.float64]]:
        """Return the code of the law and its parameters."""
        curve = [self.coulomb, self.static, self.stribeck_speed, self.delta, self.sigma, self.attraction]
        elements = [x for pair in zip(self.element_stiffness, self.share, strict=True) for x in pair]
        return kernels.MAXWELL_SLIP, np.array(curve + elements)

    @property
    def states(self) -> int:
        """One an element: its force [N]."""
        return len(self.share)

    @property
    def stiffness(self) -> float:
        """Stiffness of the contact while it sticks [N/m]."""
        return sum(self.element_stiffness)


PARAMETERS = ("coulomb", "static", "stribeck_speed", "sigma")
"""What steady runs identify, for each direction."""


@dataclass(frozen=True)
class FrictionFit:
    """A friction law identified from steady runs.

    Attributes
    ----------
    law : Andersson
        The law, with its own parameters for negative velocity where both directions were run.
    estimates : xarray.Dataset
        ``value``, ``std`` (direction, parameter), SI; NaN where a parameter is not part of the law;
        ``residual_std(direction)`` [N]; ``runs(direction)``. Direction is 1 or -1.
    status : str
        "ok", or what the runs could not resolve.
    """

    law: Andersson
    estimates: xr.Dataset
    status: str


@dataclass(frozen=True)
class _Side:
    """Fit of one direction: value and std (4,), in the order of `PARAMETERS`; chance of no Stribeck curve."""

    value: NDArray[np.float64]
    std: NDArray[np.float64]
    residual: float
    runs: int
    chance: float = 0.0


def fit_friction_curve(
    velocity: ArrayLike, force: ArrayLike, force_std: ArrayLike | None = None, *, kt: float, delta: float = 1.0
) -> FrictionFit:
    """Identify the Stribeck curve from runs at constant feeds, each direction by itself.

    Weighted least squares of ``[Fc + (Fs - Fc) exp(-(|v|/vs)^delta)] tanh(kt |v|) + sigma |v|``: the law is linear in
    Fc, Fs - Fc and sigma, so that vs is scanned first; then all four are refined with none negative.

    Parameters
    ----------
    velocity : array_like, shape (n,)
        Feed of each run [m/s]; the sign is the direction.
    force : array_like, shape (n,)
        Mean drive force of each run [N], of the sign of the velocity.
    force_std : array_like, shape (n,), optional
        Standard deviation of each force [N]; without it, the scatter about the curve is taken.
    kt : float
        Steepness at rest [s/m]; steady sliding does not show it.
    delta : float, optional
        Shape of the Stribeck curve.

    Returns
    -------
    FrictionFit
        Law, values and standard deviations.

    Raises
    ------
    InputError
        For a run at rest, or fewer than four different feeds in a direction.
    """
    return _fit(velocity, force, force_std, kt, delta, least=4)


def fit_coulomb_curve(
    velocity: ArrayLike, force: ArrayLike, force_std: ArrayLike | None = None, *, kt: float
) -> FrictionFit:
    """Identify Coulomb and viscous friction from runs at constant feeds: the limit without a Stribeck curve.

    Parameters
    ----------
    velocity, force, force_std, kt
        As in `fit_friction_curve`; two different feeds in a direction are enough.

    Returns
    -------
    FrictionFit
        The law has ``static = coulomb``.
    """
    return _fit(velocity, force, force_std, kt, 1.0, least=2)


def _fit(
    velocity: ArrayLike, force: ArrayLike, force_std: ArrayLike | None, kt: float, delta: float, least: int
) -> FrictionFit:
    v, f = np.asarray(velocity, dtype=float), np.asarray(force, dtype=float)
    std = None if force_std is None else np.asarray(force_std, dtype=float)
    _positive(kt=kt, delta=delta)
    _check_runs(v, f, std, least)
    sides: dict[int, _Side] = {}
    for direction in (1, -1):
        here = v * direction > 0.0
        if here.any():
            fit_side = _fit_stribeck if least == 4 else _fit_coulomb
            weight = None if std is None else 1.0 / std[here]
            sides[direction] = fit_side(np.abs(v[here]), direction * f[here], weight, kt, delta)
    laws = {d: Andersson(*_law_values(s.value), kt=kt, delta=delta) for d, s in sides.items()}
    first, *rest = laws.values()
    law = first if not rest else replace(first, negative=rest[0])
    return FrictionFit(law, _estimates(sides), _fit_status(sides))


def _law_values(value: NDArray[np.float64]) -> tuple[float, float, float, float]:
    coulomb, static, speed, sigma = (float(x) for x in value)
    return coulomb, coulomb if math.isnan(static) else static, 1.0 if math.isnan(speed) else speed, sigma


def _check_runs(v: NDArray[np.float64], f: NDArray[np.float64], std: NDArray[np.float64] | None, least: int) -> None:
    if v.ndim != 1 or v.shape != f.shape or (std is not None and std.shape != v.shape):
        raise InputError(f"velocity of shape {v.shape} and force of shape {f.shape}; give one value a run to each")
    if v.size == 0 or not (np.all(np.isfinite(v)) and np.all(np.isfinite(f))) or np.any(v == 0.0):
        raise InputError("a run has no feed, or a value that is not finite; leave such runs out")
    if std is not None and not np.all(std > 0.0):
        raise InputError("a standard deviation of the force is not positive; give positive ones or none")
    for direction, name in ((1.0, "positive"), (-1.0, "negative")):
        feeds = np.unique(v[v * direction > 0.0]).size
        if 0 < feeds < least:
            raise InputError(f"{feeds} different feeds in {name} direction; {least} are needed, run more feeds")


def _covariance(jacobian: NDArray[np.float64], residual: NDArray[np.float64], known: bool) -> NDArray[np.float64]:
    """``(J^T J)^-1``, times the scatter where the noise is not known; NaN without degrees of freedom."""
    freedom = residual.size - jacobian.shape[1]
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    if known:
        return np.asarray(inverse)
    return np.asarray(inverse * (float(residual @ residual) / freedom if freedom > 0 else math.nan))


def _fit_coulomb(
    v: NDArray[np.float64], f: NDArray[np.float64], weight: NDArray[np.float64] | None, kt: float, delta: float
) -> _Side:
    w = np.ones(v.size) if weight is None else weight
    basis = np.stack([np.tanh(kt * v), v], axis=1)
    (coulomb, sigma), _ = nnls(basis * w[:, None], f * w)
    residual = f - basis @ [coulomb, sigma]
    std = np.sqrt(np.diag(_covariance(basis * w[:, None], residual * w, weight is not None)))
    nan = math.nan
    value, spread = np.array([coulomb, nan, nan, sigma]), np.array([std[0], nan, nan, std[1]])
    return _Side(value, spread, _scatter(residual, 2), v.size)


def _scatter(residual: NDArray[np.float64], unknowns: int) -> float:
    return math.sqrt(float(residual @ residual) / max(residual.size - unknowns, 1))


def _fit_stribeck(
    v: NDArray[np.float64], f: NDArray[np.float64], weight: NDArray[np.float64] | None, kt: float, delta: float
) -> _Side:
    w = np.ones(v.size) if weight is None else weight

    def model(p: NDArray[np.float64]) -> NDArray[np.float64]:
        boost = (p[1] - p[0]) * np.exp(-((v / p[2]) ** delta))
        return np.asarray((p[0] + boost) * np.tanh(kt * v) + p[3] * v)

    def basis(speed: float) -> NDArray[np.float64]:
        fall, sign = np.exp(-((v / speed) ** delta)), np.tanh(kt * v)
        return np.asarray(np.stack([sign, sign * fall, v], axis=1) * w[:, None])

    speeds = np.geomspace(0.2 * v.min(), 2.0 * v.max(), 200)
    speed = float(speeds[np.argmin([nnls(basis(s), f * w)[1] for s in speeds])])
    coulomb, boost, sigma = nnls(basis(speed), f * w)[0]
    scale = np.array([np.abs(f).max(), np.abs(f).max(), speed, np.abs(f).max() / v.max()])
    start = np.array([coulomb, coulomb + boost, speed, sigma]) / scale
    # A Stribeck speed far below the slowest run cannot be seen; it would only send the static force to infinity.
    low = np.array([0.0, 0.0, speeds[0] / speed, 0.0])

    def misfit(q: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((f - model(q * scale)) * w)

    found = least_squares(misfit, np.maximum(start, low + 1e-9), bounds=(low, np.inf), xtol=1e-14, ftol=1e-14)
    value = np.asarray(found.x * scale)
    jacobian = np.asarray(found.jac, dtype=float)
    std = scale * np.sqrt(np.diag(_covariance(jacobian, found.fun, weight is not None)))
    chance = _chance(basis(1.0)[:, [0, 2]], f * w, float(found.fun @ found.fun), weight is not None)
    return _Side(value, std, _scatter(f - model(value), 4), v.size, chance)


def _chance(line: NDArray[np.float64], f: NDArray[np.float64], remaining: float, known: bool) -> float:
    """Probability that runs without a Stribeck curve gain as much by fitting one (chi-square, or F test)."""
    gained = nnls(line, f)[1] ** 2 - remaining
    if known:
        return float(stats.chi2.sf(gained, 2))
    freedom = f.size - 4
    if freedom < 1:
        return 1.0
    return float(stats.f.sf(gained / 2.0 * freedom / max(remaining, 1e-300), 2, freedom))


def _estimates(sides: dict[int, _Side]) -> xr.Dataset:
    units = ["N", "N", "m/s", "N s/m"]
    both = ("direction", "parameter")
    return xr.Dataset(
        {
            "value": (both, np.array([s.value for s in sides.values()]), {"units": ", ".join(units)}),
            "std": (both, np.array([s.std for s in sides.values()]), {"units": ", ".join(units)}),
            "residual_std": ("direction", [s.residual for s in sides.values()], {"units": "N"}),
            "runs": ("direction", [s.runs for s in sides.values()], {"units": "1"}),
        },
        coords={"direction": list(sides), "parameter": list(PARAMETERS), "unit": ("parameter", units)},
    )


def _fit_status(sides: dict[int, _Side]) -> str:
    """Say where the Stribeck curve is not resolved by the runs."""
    for direction, side in sides.items():
        if side.chance > 0.05:
            name = "positive" if direction > 0 else "negative"
            return (
                f"the Stribeck curve in {name} direction is not resolved: a straight line fits the runs as well "
                f"(chance {side.chance:.2g}); run more and slower feeds, or use fit_coulomb_curve"
            )
    return "ok"
