"""Modes of a measured compliance: poles, mode shapes, stiffness with intervals; a modal model and a state space.

Poles of polynomials of rising order (`smfe.modes.stabilisation`) propose modes. The information criterion of the whole
matrix and the likelihood ratio of the lines around each mode decide how many there are (`smfe.modes.model_order`). They
are refined to maximum likelihood with free symmetric residues (`smfe.modes.pole_fit`), then with real mode shapes
(`smfe.modes.shapes`). The result is a `process.ModalModel`, and a state space that equals the free fit
(`smfe.modes.state_space`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import AXES, make_compliance
from process.machine.modes import ModalModel
from process.notebook import html_table
from process.types import Complex, Real
from smfe.modes.merged_lines import merged
from smfe.modes.model_order import OrderRules, choose, fit_poles, pair_distance
from smfe.modes.pole_fit import PoleFit, remainder_modes, unit_mode
from smfe.modes.response_matrix import Curves, ResponseMatrix, curves_of, matrix_of
from smfe.modes.rules import RULES
from smfe.modes.shapes import ShapeFit, components, fills_up, fit_shapes
from smfe.modes.stabilisation import Stabilisation, StabilityRules, stabilisation
from smfe.modes.state_space import StateSpace, energy_given, place_matrix, state_space
from smfe.modes.unexplained import resolution, unexplained

Row = tuple[float, float, float, Real, Real]
"""Frequency [Hz], damping ratio, stiffness [N/m] and direction of a mode; their deviations (`ModalFit.doubt`)."""

STAND_IN = np.array([0.0, 0.0, 1.0, 0.0])
"""Deviations of what is no mode of the machine but stands for what the modes leave out: its size is what was found."""

INTERVAL = 1.96
"""Standard deviations to either side of a 95 % interval."""


@dataclass(frozen=True)
class ModalRules:
    """How modes are looked for.

    Parameters
    ----------
    stability : StabilityRules, optional
        When a pole of one order is that of the order before.
    order : OrderRules, optional
        How many modes are looked for.
    accuracy : float, optional
        Where no noise was measured: share of the local magnitude down to which a model need not go [1].
    """

    stability: StabilityRules = field(default_factory=StabilityRules)
    order: OrderRules = field(default_factory=OrderRules)
    accuracy: float = RULES.unknown_share


@dataclass(frozen=True)
class ModalFit:
    """Modes of a measured matrix.

    Parameters
    ----------
    matrix : ResponseMatrix
        What was fitted.
    stable : Stabilisation
        The stabilisation diagram.
    free : PoleFit
        Poles with free symmetric residues and remainders.
    is_mode : ndarray of bool
        Which of its poles are modes of the band; the others describe its surroundings.
    shapes : ShapeFit or None
        Real mode shapes; None where the entries measured do not determine them.
    no_shapes : str
        Why there are none; empty where there are.
    resolution : ndarray, shape (poles,)
        Of each pole of the free fit: two modes of one shape nearer than this look like one [Hz].
    perhaps_two : ndarray, shape (poles,)
        Distance [Hz] of two modes that a pole may be, though the record does not decide it; NaN where it is one.
    """

    matrix: ResponseMatrix = field(repr=False)
    stable: Stabilisation = field(repr=False)
    free: PoleFit
    is_mode: NDArray[np.bool_]
    shapes: ShapeFit | None = field(repr=False)
    no_shapes: str = ""
    resolution: Real = field(default_factory=lambda: np.empty(0), repr=False)
    perhaps_two: Real = field(default_factory=lambda: np.empty(0), repr=False)

    @cached_property
    def unexplained(self) -> tuple[float, ...]:
        """Frequencies [Hz] of peaks of the response that no reported mode describes, and of poles that are no modes."""
        table = self.table()
        modes = table[["frequency_Hz", "damping"]].to_numpy(dtype=float).reshape(-1, 2)
        return unexplained(self.free, modes)

    @property
    def curves(self) -> Curves:
        """The curves that were fitted."""
        return self.free.curves

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the user must know about the fit."""
        return tuple(_warnings(self))

    def values(self, frequency: Real) -> Complex:
        """Return the free fit as a matrix [m/N], shape (f, responses, excitations); what was not measured is zero."""
        curves = self.free.curve_values(np.asarray(frequency, dtype=float))
        return place_matrix(self.free, curves, self.matrix.response, self.matrix.excitation)

    def compliance(self, frequency: Real) -> xr.Dataset:
        """Return the free fit as a labelled compliance, NaN where it was not measured."""
        values = self.values(frequency)
        values[:, ~np.isfinite(self.matrix.values).any(axis=0)] = np.nan
        return make_compliance(frequency, values, self.matrix.response, self.matrix.excitation)

    def state_space(self) -> StateSpace:
        """Return A, B, C, D, equal to the free fit; x, y and z in and out where axes were measured."""
        labelled = {*self.matrix.response, *self.matrix.excitation} <= set(AXES)
        response, excitation = (AXES, AXES) if labelled else (self.matrix.response, self.matrix.excitation)
        return state_space(self.free, tuple(response), tuple(excitation))

    def energy_given(self, frequency: Real | None = None) -> float:
        """Return the largest share by which the free fit gives energy at places that were both hit and measured."""
        both = tuple(p for p in self.curves.places if p in self.matrix.response and p in self.matrix.excitation)
        if not both:
            return float("nan")
        f = self.curves.frequency if frequency is None else frequency
        matrix = place_matrix(self.free, self.free.curve_values(f), both, both)
        size = np.linalg.norm(matrix, axis=(1, 2))
        return float(np.max(energy_given(matrix)[size > 0.1 * size.max()]))

    def modal_model(self, whole: bool = False) -> ModalModel:
        """Return the modes of the tool tip in x, y and z as a modal model, the upper remainder as stiff modes above.

        Parameters
        ----------
        whole : bool, optional
            With whatever else the fit needed for more than a hundredth of the median compliance: poles too
            broad or outside the band for modes of it, and the lower remainder, masses on their mounts, as soft modes
            far below. They are no modes of the machine, but without them the model does not give its compliance.

        Raises
        ------
        InputError
            When the shapes are not known, or the places are not axes.
        """
        rows = self._rows(whole)
        return ModalModel(*(np.array([row[k] for row in rows]) for k in range(4)))

    def doubt(self, whole: bool = False) -> Real:
        """Return standard deviations of what `modal_model` has, shape (M, 4).

        Relative ones of frequency, damping and stiffness; the largest of a component of the direction [rad]. What only
        stands for what the modes leave out has its frequency and damping by convention, with a deviation of zero.
        """
        return np.array([row[4] for row in self._rows(whole)])

    def _rows(self, whole: bool) -> list[Row]:
        shapes = self._require_shapes()
        if not set(self.curves.places) & set(AXES):
            raise InputError(
                f"the places of this matrix are {', '.join(self.curves.places)}; a modal model needs motions of the "
                "tool "
                "tip along x, y and z: name responses and excitations so"
            )
        modes, upper = _mode_rows(shapes, _modes_of_band(shapes)), _upper_rows(shapes)
        if not whole:
            return [*modes, *upper]
        others = [(*row[:4], STAND_IN) for row in _mode_rows(shapes, ~_modes_of_band(shapes))]
        more = _needed(shapes, [*others, *_lower_rows(shapes)])
        # What balances a remainder of negative stiffness, which no mode has, is worse than nothing without it.
        return min([*modes, *more, *upper], [*modes, *upper], key=lambda rows: _left(shapes, rows))

    def _require_shapes(self) -> ShapeFit:
        if self.shapes is None:
            raise InputError(self.no_shapes)
        return self.shapes

    def _repr_html_(self) -> str:
        """Return a table for a notebook: each mode with the standard deviations of what was found."""
        rows = []
        for number, row in enumerate(self.table().to_dict("records"), 1):
            cells = [f"{row['frequency_Hz']:.5g} ± {row['frequency_std_Hz']:.2g}"]
            cells.append(f"{100.0 * row['damping']:.3g} ± {100.0 * row['damping_std']:.2g}")
            known = np.isfinite(row.get("stiffness_N_um", np.nan))
            cells.append(f"{row['stiffness_N_um']:.4g} ± {row['stiffness_std_N_um']:.2g}" if known else "not known")
            rows.append((number, *cells))
        head = ("mode", "frequency [Hz]", "damping [%]", "stiffness [N/µm]")
        return html_table("Modes, ± one standard deviation", rows, head, self.warnings)

    def table(self) -> pd.DataFrame:
        """Return one row a mode with 95 % intervals; stiffness and direction are NaN where no shape is known."""
        return pd.DataFrame(_shape_rows(self) if self.shapes is not None else _pole_rows(self))


def fit_modes(
    compliance: xr.Dataset | ResponseMatrix,
    *,
    band: tuple[float, float] | None = None,
    poles: Real | None = None,
    rules: ModalRules | None = None,
) -> ModalFit:
    """Fit modes to a measured matrix.

    Parameters
    ----------
    compliance : xarray.Dataset or ResponseMatrix
        Labelled compliance, any part of the matrix; or arrays of any size.
    band : (float, float), optional
        Only these frequencies are fitted [Hz].
    poles : array_like, shape (p, 2), optional
        Frequency [Hz] and damping ratio to start from; their number is then kept instead of looked for.
    rules : ModalRules, optional
        How modes are looked for.

    Returns
    -------
    ModalFit
        Poles, shapes, diagram.

    Raises
    ------
    InputError
        When the data cannot carry a fit: too few lines, no mode above the noise, none inside the band.
    """
    rules = rules or ModalRules()
    matrix = compliance if isinstance(compliance, ResponseMatrix) else matrix_of(compliance)
    if band is not None:
        matrix = matrix.within(*band)
    curves = curves_of(matrix, rules.accuracy)
    stable = stabilisation(matrix, curves, rules.stability)
    curves = merged(curves)
    if poles is None:
        free = choose(curves, stable.candidates, rules.order)
    else:
        free = fit_poles(curves, np.asarray(poles, dtype=float).reshape(-1, 2))
    is_mode = _are_modes(free.poles, free.pole_std, curves) & ~fills_up(free)
    if not is_mode.any():
        raise InputError(
            f"no mode of its own lies between {curves.frequency[0]:.4g} and {curves.frequency[-1]:.4g} Hz: what is "
            "seen there belongs to modes outside, or is too wide to be a mode; measure a wider band or "
            "with finer resolution"
        )
    shapes, reason = None, ""
    try:
        shapes = fit_shapes(free, is_mode)
    except InputError as error:  # poles are known all the same
        reason = str(error)
    if shapes is not None and (reason := _why_not(free, shapes)):
        shapes = None
    numbers = range(len(free.poles))
    apart = np.array([resolution(free, k) if is_mode[k] else np.nan for k in numbers])
    perhaps = np.array([pair_distance(free, k) if is_mode[k] else np.nan for k in numbers])
    return ModalFit(matrix, stable, free, is_mode, shapes, reason, apart, perhaps)


def _why_not(free: PoleFit, shapes: ShapeFit) -> str:
    """Return why mode shapes are worth nothing; empty where they are worth something."""
    f = free.curves.frequency
    # As mobilities: the lowest lines of accelerations integrated twice are the largest compliances, and noise, which a
    # free fit follows.
    own, other = (f * c.curve_values(f) for c in (free, shapes))
    away = float(np.linalg.norm(own - other) / np.linalg.norm(own))
    if not _modes_of_band(shapes).any():
        return (
            "no mode has a stiffness that is known: the residues are not those of real shapes at places that move "
            "with the force; check delays and signs of the channels, or measure the driving points"
        )
    if away > RULES.no_shape:
        return (
            f"real mode shapes are {100.0 * away:.0f} % away from the free fit: the phase between force and motion is "
            "not that of a machine at one place; check delays and signs of the channels"
        )
    return ""


def model_error(fit: ModalFit) -> str:
    """Return in words how far the modal model is from what was measured: ``sqrt(sum |d|^2/sum |Phi|^2)``."""
    curves = fit.curves
    model = fit.modal_model().compliance(curves.frequency, AXES, AXES)["compliance"]
    known = np.isfinite(curves.std)
    own = np.stack([model.sel(response=r, excitation=e).values for r, e in curves.pairs])
    left = np.sum(np.abs(own - curves.values)[known] ** 2) / np.sum(np.abs(curves.values)[known] ** 2)
    return f"{100.0 * float(np.sqrt(left)):.2g} % of its size away"


def _are_modes(poles: Real, std: Real, curves: Curves) -> NDArray[np.bool_]:
    """Return which poles lie in the band, are no broader than modes are, and are known to within their width."""
    natural, damping = poles.T
    inside = (natural > curves.frequency[0]) & (natural < curves.frequency[-1]) & (damping < RULES.mode_damping)
    return np.asarray(inside & (std[:, 0] < 2.0 * damping * natural) & (std[:, 1] < damping))


def _modes_of_band(shapes: ShapeFit) -> NDArray[np.bool_]:
    std = np.stack([shapes.std["frequency"], shapes.std["damping"]], axis=1)
    return _are_modes(shapes.poles, std, shapes.curves) & shapes.resolved


def _in_axes(curves: Curves, vector: Real) -> Real:
    """Return the components of the tool tip; other places are left out."""
    out = np.zeros(3)
    for place, value in zip(curves.places, vector, strict=True):
        if place in AXES:
            out[AXES.index(place)] = value
    return out


def _at_tool(curves: Curves) -> NDArray[np.bool_]:
    return np.array([place in AXES for place in curves.places])


def _mode_rows(shapes: ShapeFit, keep: NDArray[np.bool_]) -> list[Row]:
    """Return frequency, damping, stiffness, direction of each mode; places that nothing connects are modes apart."""
    out = []
    parts = components(shapes.curves)
    for k in np.flatnonzero(keep)[np.argsort(shapes.poles[keep, 0])]:
        for part in parts:
            v = np.zeros(shapes.shape.shape[1])
            v[part] = shapes.shape[k, part]
            v[~_at_tool(shapes.curves)] = 0.0
            size = float(v @ v)
            if size > 1e-4 * float(np.sum(shapes.shape[k] ** 2)):
                unit = v / np.sqrt(size)
                turned = unit * np.sign(unit[np.argmax(np.abs(unit))])
                natural, damping = (float(value) for value in shapes.poles[k])
                of = (natural, damping, float(shapes.stiffness[k]))
                doubt = np.array([shapes.std[n][k] for n in ("frequency", "damping", "stiffness")]) / of
                turn = float(np.max(shapes.std["direction"][k][_at_tool(shapes.curves)]))
                out.append((natural, damping, 1.0 / size, _in_axes(shapes.curves, turned), np.append(doubt, turn)))
    return out


def _upper_rows(shapes: ShapeFit) -> list[Row]:
    """Return the upper remainder as modes of real shape far above the band, those of negative stiffness left out."""
    largest = RULES.upper_share * float(np.abs(shapes.curves.values).max())
    return [row for row in _remainder_rows(shapes, "upper") if 1.0 / row[2] > largest]


def _lower_rows(shapes: ShapeFit) -> list[Row]:
    """Return the lower remainder as masses on soft mounts, those of negative mass left out.

    Their frequency is a tenth of the lowest line, where the mounts change the compliance by a hundredth.
    """
    soft = RULES.mount_share * float(shapes.curves.frequency[0])
    return [
        (soft, RULES.mount_damping, stiffness * (soft / natural) ** 2, direction, STAND_IN)
        for natural, _, stiffness, direction, _ in _remainder_rows(shapes, "lower")
    ]


def _remainder_rows(shapes: ShapeFit, which: str) -> list[Row]:
    """Return a remainder as modes of real shape, those of negative stiffness left out."""
    if not getattr(shapes.remainders, which):
        return []
    curves = shapes.curves
    column, (natural, damping) = (0, -1)[which == "upper"], remainder_modes(curves.frequency)[which == "upper"]
    places = curves.places
    matrix = np.zeros((len(places),) * 2)
    for value, (r, e) in zip(shapes.coefficient[:, column], curves.pairs, strict=True):
        matrix[places.index(r), places.index(e)] = matrix[places.index(e), places.index(r)] = value
    there = _at_tool(curves)
    size, vectors = np.linalg.eigh(np.where(np.outer(there, there), matrix, 0.0))
    return [
        (natural, damping, 1.0 / float(s), _in_axes(curves, v), STAND_IN)
        for s, v in zip(size, vectors.T, strict=True)
        if s > 0.0
    ]


def _needed(shapes: ShapeFit, rows: list[Row]) -> list[Row]:
    """Return the rows that are more than a small share of the median compliance somewhere in the band."""
    f, least = shapes.curves.frequency, RULES.upper_share * float(np.median(np.abs(shapes.curves.values)))
    found = []
    for row in rows:
        natural, damping, stiffness, direction, _ = row
        ratio = f / natural
        size = float(np.max(1.0 / np.abs(1.0 - ratio**2 + 2j * damping * ratio))) / stiffness
        if size * float(np.max(direction**2)) > least:
            found.append(row)
    return found


def _left(shapes: ShapeFit, rows: Sequence[Row]) -> float:
    """Return the squares that modes leave of the compliance at the tool, over its noise."""
    curves, total = shapes.curves, 0.0
    for values, std, (r, e) in zip(curves.values, curves.std, curves.pairs, strict=True):
        if not {r, e} <= set(AXES):
            continue
        left = values.copy()
        for natural, damping, stiffness, direction, _ in rows:
            along = direction[AXES.index(r)] * direction[AXES.index(e)] / stiffness
            left -= along * unit_mode(curves.frequency, natural, damping)
        total += float(np.sum(np.abs(left / std) ** 2))
    return total


def _orders(fit: ModalFit, natural: float, damping: float) -> int:
    """Return in how many orders of the diagram a pole was stable."""
    near = (np.abs(fit.stable.frequency - natural) < damping * natural) & (fit.stable.level >= 2)
    return len(np.unique(fit.stable.order[near]))


def _shape_rows(fit: ModalFit) -> list[dict[str, object]]:
    shapes = fit._require_shapes()
    rows = []
    keep = _modes_of_band(shapes)
    for k in np.flatnonzero(keep)[np.argsort(shapes.poles[keep, 0])]:
        row = _pole_row(fit, shapes.poles[k], np.array([shapes.std["frequency"][k], shapes.std["damping"][k]]))
        stiffness, spread = float(shapes.stiffness[k]), float(shapes.std["stiffness"][k])
        row |= _with_interval("stiffness", "_N_um", 1e-6 * stiffness, 1e-6 * spread)
        for place, value, error in zip(fit.curves.places, shapes.direction[k], shapes.std["direction"][k], strict=True):
            row |= {f"direction_{place}": float(value), f"direction_{place}_std": float(error)}
        rows.append(row)
    return rows


def _pole_rows(fit: ModalFit) -> list[dict[str, object]]:
    return [_pole_row(fit, fit.free.poles[k], fit.free.pole_std[k]) for k in np.flatnonzero(fit.is_mode)]


def _pole_row(fit: ModalFit, pole: Real, std: Real) -> dict[str, object]:
    natural, damping = (float(v) for v in pole)
    row = _with_interval("frequency", "_Hz", natural, float(std[0]))
    row |= _with_interval("damping", "", damping, float(std[1]))
    # A mode with a shape comes from the pole of the free fit next to it.
    near = int(np.argmin(np.where(fit.is_mode, np.abs(fit.free.poles[:, 0] - natural), np.inf)))
    apart = {"resolution_Hz": float(fit.resolution[near])} if fit.resolution.size else {}
    return row | apart | {"stable_orders": _orders(fit, natural, damping)}


def _with_interval(name: str, unit: str, value: float, std: float) -> dict[str, object]:
    return {
        f"{name}{unit}": value,
        f"{name}_std{unit}": std,
        f"{name}_low{unit}": value - INTERVAL * std,
        f"{name}_high{unit}": value + INTERVAL * std,
    }


def _undecided(fit: ModalFit) -> list[str]:
    """Return what the fit leaves unexplained, and which modes may be two."""
    out = []
    if fit.unexplained:
        named = ", ".join(f"{f:.5g}" for f in fit.unexplained[: RULES.named_peaks])
        rest = len(fit.unexplained) - RULES.named_peaks
        more = f" and {rest} more" if rest > 0 else ""
        out.append(
            f"peaks at {named} Hz{more} stand out of the response and no mode describes them; fit the band around them "
            'alone, e.g. --band "LOW Hz" "HIGH Hz"'
        )
    for pole, apart in zip(fit.free.poles, fit.perhaps_two, strict=False):
        if np.isfinite(apart):
            out.append(
                f"the mode at {pole[0]:.6g} Hz may be two modes, {apart:.2g} Hz apart: its lines are described better "
                "by two, but not so that it is decided; measure further places, or with finer lines and less noise"
            )
    return out


def _warnings(fit: ModalFit) -> list[str]:
    out = []
    reported = fit.table()["frequency_Hz"].to_numpy(dtype=float)
    poles = fit.free.poles[_are_modes(fit.free.poles, fit.free.pole_std, fit.curves)]
    away = np.min(np.abs(poles[:, :1] - reported), axis=1, initial=np.inf)
    if (missing := poles[away > poles[:, 0] * poles[:, 1], 0]).size:
        named = ", ".join(f"{f:.5g}" for f in missing[: RULES.named_peaks])
        out.append(
            f"poles at {named} Hz are not given as modes: beside the others they are what errors of the measurement "
            "leave, or weak modes that such errors hide (channels that are late, hits that lean)"
        )
    if not fit.curves.noise_known:
        out.append("no standard deviation is known: intervals come from the residual of the fit alone")
    if fit.curves.reciprocity > RULES.not_reciprocal**2:
        out.append(
            f"mirrored entries differ by {np.sqrt(fit.curves.reciprocity):.2g} times their noise: the machine, or the "
            "measurement, is not reciprocal; the fit is to their mean"
        )
    if fit.curves.noise_known and fit.free.misfit > RULES.coarse:
        out.append(
            f"the fit misses the measured compliance by {fit.free.misfit:.3g} times its noise: there are modes that "
            "it does not hold, or the machine is not linear; give a narrower band"
        )
    out += _undecided(fit)
    given = fit.energy_given()
    if given > RULES.active:
        out.append(
            f"the fitted compliance gives out energy, up to {100.0 * given:.0f} % of its size: check signs and delays "
            "of the channels; a servo may do that"
        )
    if fit.shapes is None:
        out.append(f"no mode shapes: {fit.no_shapes}")
    elif fit.shapes.information > fit.free.information:
        out.append(
            f"real mode shapes explain the data less well than free residues (misfit {fit.shapes.misfit:.3g} against "
            f"{fit.free.misfit:.3g}): hits or sensors that lean, channels that are off, damping that does not act in "
            "proportion, or a servo; "
            + (
                "frequencies and damping are those of the free residues"
                if fit.shapes.pole_std is not None
                else "the difference is no more than noise makes"
            )
        )
    if fit.shapes is not None and not _modes_of_band(fit.shapes).all():
        out.append(
            "part of the compliance is described by poles outside the band or too broad for modes: no modes of it"
        )
    return out


def uncertainty(fit: ModalFit) -> dict[str, str]:
    """Return the relative standard deviations for ``uncertainty`` of a ``[[model]]``: the largest of any mode."""
    table = fit.table()
    out = {}
    for name, unit in (("frequency", "_Hz"), ("damping", ""), ("stiffness", "_N_um")):
        share = float(np.max(table[f"{name}_std{unit}"] / table[f"{name}{unit}"]))
        out[name] = f"{100.0 * min(share, 0.99):.3g} %"
    return out
