"""The elastic and rigid motion of a machine between tool and guideways, as mass, damping and stiffness matrices.

``M q'' + C q' + K q = T^T F + sum_a S_a^T f_a``: tool displacement ``T q``, slide displacement of axis a ``S_a q``,
force F on the tool and force f_a of drive and guideway on the slide. Displacements are deviations from the ramp.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from process.drive.axis import Drive
from process.errors import InputError
from process.labels import AXES, axis_index
from process.machine.modes import ModalModel
from process.types import Real

_WRONG = {
    "mass": "not positive definite; a mode may not carry more mass than the axis that it rides on: check both",
    "damping": "not positive semi-definite: it would feed energy in; check its signs",
    "stiffness": "not positive semi-definite: the structure would push itself apart; check its signs",
}


@dataclass(frozen=True)
class Structure:
    """A machine without drives and friction: its slides are free.

    Parameters
    ----------
    mass, damping, stiffness : array_like, shape (n, n)
        Symmetric matrices of the coordinates q; M positive definite, C and K positive semi-definite.
    tool : array_like, shape (3, n)
        Participation of each coordinate at the tool, in x, y and z.
    slides : mapping
        Axis name -> participation of each coordinate at that axis's guideway, shape (n,).

    Raises
    ------
    InputError
        When shapes differ, or a matrix is not that of a passive structure.
    """

    mass: Real
    damping: Real = field(repr=False)
    stiffness: Real = field(repr=False)
    tool: Real = field(repr=False)
    slides: Mapping[str, Real] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Store plain float arrays and refuse what is not a passive structure."""
        for name in ("mass", "damping", "stiffness", "tool"):
            object.__setattr__(self, name, np.atleast_2d(np.asarray(getattr(self, name), dtype=float)))
        rows = {axis: np.asarray(row, dtype=float).reshape(-1) for axis, row in self.slides.items()}
        object.__setattr__(self, "slides", rows)
        n = self.mass.shape[0]
        shapes = [self.mass.shape, self.damping.shape, self.stiffness.shape, (n, self.tool.shape[1])]
        if any(s != (n, n) for s in shapes) or self.tool.shape[0] != 3 or any(r.size != n for r in rows.values()):
            raise InputError(
                f"mass {self.mass.shape}, damping {self.damping.shape}, stiffness {self.stiffness.shape}, tool "
                f"{self.tool.shape}, slides {[r.size for r in rows.values()]}; for n coordinates give (n, n) three "
                "times, (3, n) and (n,) for each slide"
            )
        axis_index(list(rows))
        self._check_passive()

    def _check_passive(self) -> None:
        for name in ("mass", "damping", "stiffness"):
            matrix = getattr(self, name)
            if not np.all(np.isfinite(matrix)) or np.abs(matrix - matrix.T).max() > 1e-9 * np.abs(matrix).max():
                raise InputError(f"the {name} matrix is not finite and symmetric; a passive structure's is")
            # Scaled to a unit diagonal, so that coordinates of any unit count alike.
            scale = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
            scale[scale == 0.0] = 1.0
            least = float(np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min())
            if least < (1e-12 if name == "mass" else -1e-9):
                raise InputError(f"the {name} matrix is {_WRONG[name]}")

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return int(self.mass.shape[0])

    def slide_rows(self) -> Real:
        """Return the participation of all slides, shape (axes, n), in the order of `slides`."""
        return np.array(list(self.slides.values())).reshape(len(self.slides), self.size)

    def locked(self, axes: Collection[str] | None = None) -> Structure:
        """Return the structure with the slides of some axes held, by default all; the others stay slides."""
        held = list(self.slides) if axes is None else [a for a in self.slides if a in axes]
        if not held:
            return self
        free = self.held_directions(held)

        def cut(matrix: Real) -> Real:
            small = free.T @ matrix @ free
            return np.asarray(0.5 * (small + small.T))

        slides = {axis: row @ free for axis, row in self.slides.items() if axis not in held}
        return Structure(cut(self.mass), cut(self.damping), cut(self.stiffness), self.tool @ free, slides)

    def held_directions(self, axes: Collection[str]) -> Real:
        """Return an orthonormal basis (n, m) of the coordinates that move no slide of these axes.

        Raises
        ------
        InputError
            When nothing can move then.
        """
        rows = np.array([self.slides[axis] for axis in axes])
        _, singular, vectors = np.linalg.svd(rows)
        free = vectors[int(np.sum(singular > 1e-12 * singular.max())) :].T
        if not free.size:
            raise InputError("with its slides held nothing of this structure can move; give it at least one mode")
        return np.asarray(free)


def two_mass_axes(drives: Mapping[str, Drive]) -> Structure:
    """Return independent axes of two masses each (Figure 10 of Franco et al. 2024): coordinates (x_t, x_m) an axis.

    Parameters
    ----------
    drives : mapping
        Axis name -> masses, stiffness and damping; servo and sigma are left to the machine. Axes that are not named
        are rigid.
    """
    n = 2 * len(drives)
    mass, damping, stiffness, tool = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((3, n))
    slides = {}
    spring = np.array([[1.0, -1.0], [-1.0, 1.0]])
    for i, (row, (axis, drive)) in enumerate(zip(axis_index(list(drives)), drives.items(), strict=True)):
        block = slice(2 * i, 2 * i + 2)
        mass[block, block] = np.diag([drive.tip_mass, drive.moving_mass])
        damping[block, block], stiffness[block, block] = drive.damping * spring, drive.stiffness * spring
        tool[row, 2 * i] = 1.0
        slides[axis] = np.eye(n)[2 * i + 1]
    return Structure(mass, damping, stiffness, tool, slides)


@dataclass(frozen=True)
class Host:
    """What an axis stands on: a bed that moves along the axis as one mass on a spring.

    Parameters
    ----------
    mass : float
        m_h [kg], without what the axis moves.
    frequency : float
        f_h [Hz] of the host alone: its spring is ``k_h = m_h (2 pi f_h)^2``.
    damping : float, optional
        Damping ratio of the host alone [1].
    """

    mass: float
    frequency: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a host without mass or spring."""
        if not (0.0 < self.mass < np.inf and 0.0 < self.frequency < np.inf and 0.0 <= self.damping < np.inf):
            raise InputError(
                f"a host of {self.mass:g} kg at {self.frequency:g} Hz with a damping ratio of {self.damping:g}; mass "
                "and frequency must be positive, the damping not negative"
            )


def hosted(structure: Structure, hosts: Mapping[str, Host]) -> Structure:
    """Return the structure whose axes stand on flexible hosts.

    Each host adds a coordinate h behind the others; the slide moves against it, ``S_a q - h``, so that drive and
    guideway push the carriage one way and the host the other. With a carriage m_m that friction holds on its host, and
    a tip m_t on the spring k, the tool has an antiresonance where ``w^2 = (k_h + k)/(m_h + m_m)``, and its resonances
    are the roots of ``(k_h + k - (m_h + m_m) w^2)(k - m_t w^2) = k^2``.

    Parameters
    ----------
    structure : Structure
        Its coordinates are displacements in space, as those of `two_mass_axes` and `released_modes` are.
    hosts : mapping
        Axis name -> its host.

    Raises
    ------
    InputError
        When an axis has no slide.
    """
    unknown = [axis for axis in hosts if axis not in structure.slides]
    if unknown:
        raise InputError(
            f"a host under axis {', '.join(unknown)}, which does not move; the structure moves along "
            f"{', '.join(structure.slides) or 'no axis'}"
        )
    w = np.array([2.0 * np.pi * host.frequency for host in hosts.values()])
    mass = np.array([host.mass for host in hosts.values()])
    ratio = np.array([host.damping for host in hosts.values()])

    def below(matrix: Real, added: Real) -> Real:
        return linalg.block_diag(matrix, np.diag(added))

    on = {axis: -(np.array(list(hosts)) == axis).astype(float) for axis in structure.slides}
    return Structure(
        below(structure.mass, mass),
        below(structure.damping, 2.0 * ratio * w * mass),
        below(structure.stiffness, mass * w**2),
        np.hstack([structure.tool, np.zeros((3, mass.size))]),
        {axis: np.concatenate([row, on[axis]]) for axis, row in structure.slides.items()},
    )


def released_modes(
    idle: ModalModel,
    moving_mass: Mapping[str, float],
    tip_mass: float | None = None,
    coupling: ArrayLike | Mapping[str, ArrayLike] | None = None,
) -> Structure:
    """Return the structure whose slides, when held, give the idle modes, and that moves as a whole along its axes.

    Coordinates are the slides s and the modes p: tool ``E s + U p``, mass ``[[m, L], [L^T, m_r]]``. L is the momentum
    of a mode along an axis for a unit of its velocity (fixed-interface modes, Craig and Bampton 1968). A hammer at the
    tool does not show it; without `coupling` the mass of each mode is taken to sit at the tool: ``L = m_tip u``.

    Parameters
    ----------
    idle : ModalModel
        Modes of the machine at rest, slides held by friction.
    moving_mass : mapping
        Axis name -> all mass that moves with the axis [kg], tip included. Other axes have no slide.
    tip_mass : float, optional
        Mass at the tool [kg]; default that of each mode, ``m_r/|u_r|^2``.
    coupling : array_like, shape (axes, modes), or mapping, optional
        L itself [kg], in the order of `moving_mass`; or axis name -> its row, shape (modes,), for some of them.

    Raises
    ------
    InputError
        When a mass is not positive, modes would carry more mass than their axis, or a row has another length.
    """
    for axis, mass in moving_mass.items():
        if not (np.isfinite(mass) and mass > 0.0):
            raise InputError(f"the moving mass of axis {axis} is {mass:g} kg; it must be positive")
    if tip_mass is not None and not tip_mass > 0.0:
        raise InputError(f"the tip mass is {tip_mass:g} kg; it must be positive")
    rows = axis_index(list(moving_mass))
    shapes, a = idle.direction, len(rows)
    if coupling is None or isinstance(coupling, Mapping):
        at_tool = idle.mass / np.sum(shapes**2, axis=1) if tip_mass is None else np.full(idle.mass.size, tip_mass)
        momentum = (shapes * at_tool[:, None]).T[rows]
        for axis, row in (coupling or {}).items():
            given = np.atleast_1d(np.asarray(row, dtype=float))
            if axis not in moving_mass or given.shape != (idle.mass.size,):
                raise InputError(
                    f"the coupling of axis {axis} has {given.size} values; give {idle.mass.size}, the momentum of "
                    f"each mode, for the axes {', '.join(moving_mass)}"
                )
            momentum[list(moving_mass).index(axis)] = given
    else:
        momentum = np.asarray(coupling, dtype=float).reshape(a, idle.mass.size)
    total = np.diag(np.array(list(moving_mass.values()), dtype=float))
    held = np.zeros((a, a))
    zero = np.zeros((a, idle.mass.size))
    w = 2.0 * np.pi * idle.frequency
    return Structure(
        np.block([[total, momentum], [momentum.T, np.diag(idle.mass)]]),
        np.block([[held, zero], [zero.T, np.diag(2.0 * idle.damping * w * idle.mass)]]),
        np.block([[held, zero], [zero.T, np.diag(idle.stiffness)]]),
        np.hstack([np.eye(3)[:, rows], shapes.T]),
        {axis: np.eye(a + idle.mass.size)[i] for i, axis in enumerate(moving_mass)},
    )


def free_modes(
    frequency: ArrayLike, damping: ArrayLike, mass: ArrayLike, tool: ArrayLike, slides: Mapping[str, ArrayLike]
) -> Structure:
    """Return the structure of modes found with free slides, rigid-body modes included.

    Parameters
    ----------
    frequency : array_like, shape (modes,)
        Natural frequency [Hz]; 0 is a rigid-body mode.
    damping : array_like, shape (modes,)
        Damping ratio [1]; of a rigid-body mode it has no effect.
    mass : array_like, shape (modes,)
        Modal mass [kg] that belongs to the vectors as given.
    tool : array_like, shape (modes, 3)
        Mode vector (x, y, z) at the tool.
    slides : mapping
        Axis name -> participation of each mode at that guideway, shape (modes,).
    """
    f, zeta, m = (np.atleast_1d(np.asarray(v, dtype=float)) for v in (frequency, damping, mass))
    if not (f.shape == zeta.shape == m.shape and np.all(f >= 0.0) and np.all(zeta >= 0.0) and np.all(m > 0.0)):
        raise InputError(
            f"{f.size} frequencies (least {f.min():g} Hz), {zeta.size} damping ratios (least {zeta.min():g}), {m.size} "
            f"masses (least {m.min():g} kg); give one each per mode, masses positive, the others not negative"
        )
    w = 2.0 * np.pi * f
    rows = {axis: np.asarray(row, dtype=float) for axis, row in slides.items()}
    shapes = np.atleast_2d(np.asarray(tool, dtype=float))
    return Structure(np.diag(m), np.diag(2.0 * zeta * w * m), np.diag(m * w**2), shapes.T, rows)


@dataclass(frozen=True)
class Posture:
    """A structure that changes with the position of one axis: matrices interpolated linearly between positions.

    A mean of positive definite matrices is one, so every interpolated structure is passive.

    Parameters
    ----------
    axis : {"x", "y", "z"}
        The axis whose position counts.
    positions : array_like, shape (p,)
        Positions [m], rising.
    structures : tuple of Structure
        One a position, with the same coordinates in the same order (a mode keeps its sign).
    """

    axis: str
    positions: Real
    structures: tuple[Structure, ...]

    def __post_init__(self) -> None:
        """Refuse postures that cannot be interpolated."""
        at = np.atleast_1d(np.asarray(self.positions, dtype=float))
        object.__setattr__(self, "positions", at)
        first = self.structures[0] if self.structures else None
        if self.axis not in AXES or at.size != len(self.structures) or at.size < 2 or np.any(np.diff(at) <= 0.0):
            raise InputError(
                f"axis {self.axis!r}, {at.size} positions, {len(self.structures)} structures; give x, y or z, at least "
                "two rising positions and a structure for each"
            )
        for other in self.structures:
            if first is None or other.size != first.size or list(other.slides) != list(first.slides):
                raise InputError(
                    "the structures of a posture have different coordinates or slides; give the same to all"
                )

    def at(self, position: float) -> Structure:
        """Return the structure at a position [m].

        Raises
        ------
        InputError
            Outside the positions: nothing is extrapolated.
        """
        p = self.positions
        if not p[0] <= position <= p[-1]:
            raise InputError(
                f"position {position * 1e3:g} mm of axis {self.axis} is outside {p[0] * 1e3:g} to {p[-1] * 1e3:g} mm, "
                "where the posture is known"
            )
        i = int(np.clip(np.searchsorted(p, position) - 1, 0, p.size - 2))
        share = float((position - p[i]) / (p[i + 1] - p[i]))
        one, two = self.structures[i], self.structures[i + 1]

        def mean(a: Real, b: Real) -> Real:
            return np.asarray((1.0 - share) * a + share * b)

        return Structure(
            mean(one.mass, two.mass),
            mean(one.damping, two.damping),
            mean(one.stiffness, two.stiffness),
            mean(one.tool, two.tool),
            {name: mean(row, two.slides[name]) for name, row in one.slides.items()},
        )
