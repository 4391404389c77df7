"""What explains the differences between measurements: feed, level, controller, method, taken together.

Every peak of every entry is followed through all measurements. The logarithms of its frequency, damping ratio and
amplitude are described by an additive model of the conditions that vary, each as a set of categories,

    ln q_m = mean + sum over factors of beta(factor, category of m) + e_m,

by least squares weighted with 1/s_m^2, s_m being the relative standard deviation of the peak in measurement m. A
factor is judged by what the fit loses without it (``D`` more in chi^2 for ``r`` unknowns fewer): ``F =
(D/r)/(chi^2/dof)`` where measurements are left over and scatter by more than their errors say, chi^2 with r degrees
of freedom otherwise. Factors that a design does not separate are named instead of guessed: those that always
change together are aliased and are judged together, as one term.

Where a design has them, products of two terms are judged as well: an **interaction** is a feed that acts with one
controller and not with the other. Each is added to the additive model alone and judged by what the fit gains. The
three quantities of a peak are judged one by one and jointly, with the covariance of their errors in each measurement
(those of damping and amplitude are nearly one).

One rule decides what is significant: the p values of all rows of a table, joint ones and interactions included, are
corrected for their number (Holm 1979) and compared with `LEVEL`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr
from scipy import stats

from process.errors import InputError
from process.types import Real
from smfe.comparison.peaks import TOLERANCE, Peak, Peaks, all_peaks, matched

QUANTITIES = ("frequency", "damping", "amplitude")
CONDITIONS = ("method", "controller", "feed", "level", "position", "added_mass", "temperature")
"""Factors, in the order in which they are listed. ``level`` is the force level, for a sweep the depth of cut."""

LEVEL = 0.05
"""Probability that any row of a table is called significant where no condition does anything."""

JOINT = "all three"
"""Quantity of a row that judges frequency, damping and amplitude together."""

WITH = " + "
"""Between factors that the design does not separate."""

TIMES = " x "
"""Between the two terms of an interaction."""

COLUMNS = (
    *("response", "excitation", "frequency_Hz", "quantity", "factor", "categories", "measurements", "aliased_with"),
    *("lowest", "highest", "effect_percent", "effect_std_percent", "effect_low_percent", "effect_high_percent"),
    *(
        "explained_percent",
        "degrees_of_freedom",
        "left_over",
        "test",
        "statistic",
        "p",
        "p_family",
        "significant",
        "misfit",
    ),
)


@dataclass(frozen=True)
class Design:
    """Which measurement was made under what.

    Parameters
    ----------
    factors : mapping of str to tuple of str
        Factor -> category of each measurement, only factors that vary.
    """

    factors: Mapping[str, tuple[str, ...]]

    def columns(self, names: Sequence[str]) -> Real:
        """Return the columns of some factors with that of the mean, shape (measurements, q)."""
        size = len(next(iter(self.factors.values())))
        blocks = [np.ones((size, 1))]
        for name in names:
            own = self.factors[name]
            blocks += [np.array([[float(c == other)] for c in own]) for other in sorted(set(own))[1:]]
        return np.concatenate(blocks, axis=1)

    def rank(self, names: Sequence[str]) -> int:
        """Return how many unknowns these factors with a mean determine."""
        return int(np.linalg.matrix_rank(self.columns(names)))

    def terms(self) -> list[tuple[str, ...]]:
        """Return the factors, those that no measurement separates as one term.

        A factor whose columns the others hold already has no test of its own. It is joined with those others that hold
        them; what is joined is judged together.
        """
        names = list(self.factors)
        joined = {name: {name} for name in names}
        for name in names:
            others = [n for n in names if n != name]
            if self.rank(names) > self.rank(others):
                continue
            # The fewest of the others that hold the columns of this one already.
            needed = list(others)
            for other in others:
                fewer = [n for n in needed if n != other]
                if self.rank([*fewer, name]) == self.rank(fewer):
                    needed = fewer
            group = {name}.union(*(joined[n] for n in needed))
            for member in group:
                joined[member] = group
        out = []
        for name in names:
            term = tuple(n for n in names if n in joined[name])
            if term not in out:
                out.append(term)
        return out

    def interactions(self) -> list[Product]:
        """Return the products of two terms that the design determines: both have changed, independently enough."""
        full, out = self.columns(list(self.factors)), []
        rank = int(np.linalg.matrix_rank(full))
        terms = self.terms()
        for i, first in enumerate(terms):
            for second in terms[i + 1 :]:
                a, b = self._combined(first), self._combined(second)
                columns = np.array(
                    [
                        [float(c == u and d == v) for c, d in zip(a, b, strict=True)]
                        for u in sorted(set(a))[1:]
                        for v in sorted(set(b))[1:]
                    ]
                ).T
                if columns.size and int(np.linalg.matrix_rank(np.concatenate([full, columns], axis=1))) > rank:
                    names = WITH.join(first), WITH.join(second)
                    every = "; ".join(", ".join(sorted(set(c))) for c in (a, b))
                    ends = f"{names[0]} at {min(b)}", f"{names[0]} at {max(b)}"
                    out.append(Product(TIMES.join(names), every, columns, ends))
        return out

    def _combined(self, term: tuple[str, ...]) -> tuple[str, ...]:
        """Return the category of each measurement, of factors that are not separated the categories together."""
        return tuple(" and ".join(c) for c in zip(*(self.factors[n] for n in term), strict=True))


@dataclass(frozen=True)
class Product:
    """Columns that a product of two terms adds to a design.

    Parameters
    ----------
    name, categories : str
        "feed x controller", and the categories of both.
    columns : ndarray, shape (measurements, q)
        Products of their columns.
    ends : (str, str)
        Of two terms of two categories each: at which category of the second the effect of the first is compared.
    """

    name: str
    categories: str
    columns: Real
    ends: tuple[str, str]


def conditions_of(compliance: xr.Dataset) -> dict[str, str]:
    """Return factor -> category of a measurement, as ``attrs`` of its compliance say.

    Raises
    ------
    InputError
        When ``attrs["conditions"]`` is no JSON object.
    """
    text = compliance.attrs.get("conditions", "{}")
    try:
        conditions = {str(k): str(v) for k, v in json.loads(text).items()}
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(
            f"the conditions of a compliance are {text!r}, which is no JSON object; write it again with `smfe identify`"
        ) from error
    conditions["method"] = str(compliance.attrs.get("method", "not stated"))
    level = conditions.get("force_level", conditions.get("depth_of_cut"))
    if level is not None:
        conditions["level"] = level
    return {name: conditions[name] for name in CONDITIONS if name in conditions}


def explain(identifications: Mapping[str, xr.Dataset], peaks: Peaks | None = None) -> pd.DataFrame:
    """Return what each condition explains of the differences of each peak.

    Parameters
    ----------
    identifications : mapping of str to xarray.Dataset
        Measurement -> compliance with ``attrs["method"]`` and ``attrs["conditions"]``, a JSON object of texts.
    peaks : mapping, optional
        Their peaks, from `all_peaks`; without them they are fitted.

    Returns
    -------
    pandas.DataFrame
        One row a peak, quantity and term of the model (`COLUMNS`): the ``effect`` is the difference of the category
        ``highest`` from ``lowest`` in percent with a 95 % interval (empty where the design does not determine it),
        ``explained_percent`` the share of the weighted differences that is lost without the factor (of an unbalanced
        design the shares do not add up), ``misfit`` the root of chi^2 over the degrees of freedom that are left over.
        No rows where fewer than two measurements or no condition vary.
    """
    conditions = {name: conditions_of(dataset) for name, dataset in identifications.items()}
    rows: list[dict[str, object]] = []
    peaks = all_peaks(identifications) if peaks is None else peaks
    for pair in dict.fromkeys(pair for found in peaks.values() for pair in found):
        for track in tracks({name: found[pair] for name, found in peaks.items() if pair in found}):
            rows += _track_rows(pair, track, conditions)
    frame = pd.DataFrame(rows, columns=list(COLUMNS))
    if len(frame):
        frame["p_family"] = holm(frame["p"].to_numpy(dtype=float))
        frame["significant"] = frame["p_family"] < LEVEL
    return frame


def holm(p: Real) -> Real:
    """Return p values corrected for their number (Holm 1979); NaN stays and does not count."""
    out = np.full(p.size, np.nan)
    known = np.flatnonzero(np.isfinite(p))
    order = known[np.argsort(p[known])]
    if order.size:
        out[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(order.size, 0, -1)), 1.0)
    return out


def tracks(peaks: Mapping[str, Sequence[Peak]]) -> list[dict[str, Peak]]:
    """Follow peaks through measurements: each joins the track of nearest frequency, one a measurement.

    The measurement with most peaks begins; the frequency of a track is the mean of the logarithms of its peaks.
    """
    out: list[dict[str, Peak]] = []
    for name in sorted(peaks, key=lambda n: -len(peaks[n])):
        own = list(peaks[name])
        taken: set[int] = set()
        centre = [np.exp(np.mean([np.log(p.frequency) for p in track.values()])) for track in out]
        for i, j in matched(centre, [p.frequency for p in own], TOLERANCE):
            out[i][name] = own[j]
            taken.add(j)
        out += [{name: peak} for j, peak in enumerate(own) if j not in taken]
    return sorted(out, key=lambda track: min(p.frequency for p in track.values()))


def _track_rows(
    pair: tuple[str, str], track: Mapping[str, Peak], conditions: Mapping[str, Mapping[str, str]]
) -> list[dict[str, object]]:
    """Return the rows of one peak."""
    names = [n for n in conditions if n in track]
    factors = {f: tuple(conditions[n].get(f, "not stated") for n in names) for f in CONDITIONS}
    varying = {f: c for f, c in factors.items() if len(set(c)) > 1}
    if len(names) < 2 or not varying:
        return []
    design = Design(varying)
    head = {
        "response": pair[0],
        "excitation": pair[1],
        "frequency_Hz": float(np.exp(np.mean([np.log(track[n].frequency) for n in names]))),
        "measurements": len(names),
    }
    peaks = [track[n] for n in names]
    value = np.array([[getattr(peak, quantity) for quantity in QUANTITIES] for peak in peaks])
    covariance = np.stack([error_covariance(peak) for peak in peaks])
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    rows = []
    for k, quantity in enumerate(QUANTITIES):
        found = judge(design, np.log(value[:, k]), std[:, k])
        rows += [head | {"quantity": quantity} | row for row in found]
    return rows + [head | {"quantity": JOINT} | row for row in judge(design, np.log(value), covariance)]


def error_covariance(peak: Peak) -> Real:
    """Return the covariance of the relative errors of frequency, damping and amplitude, shape (3, 3).

    It is bounded away from singular; and a peak of an exact curve, which claims no error at all, must not take all the
    weight.
    """
    std = np.array([max(getattr(peak, f"{q}_std") / getattr(peak, q), 1e-9) for q in QUANTITIES])
    matrix = np.eye(3)
    for (i, j), value in zip(((0, 1), (0, 2), (1, 2)), peak.correlation, strict=True):
        matrix[i, j] = matrix[j, i] = np.clip(value, -0.999, 0.999)
    values, vectors = np.linalg.eigh(matrix)
    matrix = (vectors * np.maximum(values, 1e-3)) @ vectors.T
    matrix /= np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
    return np.asarray(matrix * np.outer(std, std))


def judge(design: Design, logarithm: Real, errors: Real) -> list[dict[str, object]]:
    """Return what every term of a design, and every product of two, explains of a quantity, or of several together.

    Parameters
    ----------
    design : Design
        Conditions of the measurements.
    logarithm : ndarray, shape (measurements,) or (measurements, quantities)
        ln q.
    errors : ndarray, shape (measurements,) or (measurements, quantities, quantities)
        Relative standard deviation of q, or the covariance of the relative errors of several.
    """
    names, data = list(design.factors), _Data.of(logarithm, errors)
    full = design.columns(names)
    chi, beta, covariance = data.fit(full)
    total, _, _ = data.fit(full[:, :1])
    rank = design.rank(names)
    left = logarithm.shape[0] - rank
    rows = []
    for term in design.terms():
        others = [n for n in names if n not in term]
        unknowns = rank - design.rank(others)
        loss = max(data.fit(design.columns(others))[0] - chi, 0.0)
        row, scale = _judged(data, loss, total, unknowns, chi, left)
        row |= {
            "factor": WITH.join(term),
            "categories": "; ".join(", ".join(sorted(set(design.factors[n]))) for n in term),
            "aliased_with": WITH.join(term) if len(term) > 1 else "",
        }
        if data.quantities == 1 and len(term) == 1 and unknowns == len(set(design.factors[term[0]])) - 1:
            row |= _effect(design, term[0], names, beta, covariance * scale)
        rows.append(row)
    return rows + [_interaction(data, product, full, chi, total) for product in design.interactions()]


def _interaction(data: _Data, product: Product, full: Real, additive: float, total: float) -> dict[str, object]:
    """Return the row of a product of two terms, by what it gains over the additive model."""
    columns = np.concatenate([full, product.columns], axis=1)
    chi, beta, covariance = data.fit(columns)
    rank = int(np.linalg.matrix_rank(columns))
    unknowns, left = rank - int(np.linalg.matrix_rank(full)), columns.shape[0] - rank
    row, scale = _judged(data, max(additive - chi, 0.0), total, unknowns, chi, left)
    row |= {"factor": product.name, "categories": product.categories, "aliased_with": ""}
    if data.quantities == 1 and unknowns == 1 and product.columns.shape[1] == 1:
        low, high = product.ends
        row |= _change(low, high, float(beta[-1]), float(np.sqrt(covariance[-1, -1] * scale)))
    return row


def _judged(
    data: _Data, loss: float, total: float, unknowns: int, chi: float, left: int
) -> tuple[dict[str, object], float]:
    """Return the test of a term, and by what the variance of its errors is raised."""
    r, dof = unknowns * data.quantities, left * data.quantities
    # Scatter beyond the stated errors counts as error; less scatter than stated is no better knowledge.
    scale = max(chi / dof, 1.0) if dof else 1.0
    row: dict[str, object] = {
        "explained_percent": 100.0 * loss / total if total > 0.0 else float("nan"),
        "degrees_of_freedom": r,
        "left_over": dof,
        "misfit": float(np.sqrt(chi / dof)) if dof else float("nan"),
    }
    return row | _test(loss, r, dof, scale), scale


def _test(loss: float, unknowns: int, left: int, scale: float) -> dict[str, object]:
    if scale > 1.0:
        value = loss / unknowns / scale
        return {"test": "F", "statistic": value, "p": float(stats.f.sf(value, unknowns, left))}
    return {"test": "chi2", "statistic": loss, "p": float(stats.chi2.sf(loss, unknowns))}


def _effect(design: Design, name: str, names: list[str], beta: Real, covariance: Real) -> dict[str, object]:
    """Return the largest difference between two categories of a factor that the design determines."""
    start = 1 + sum(len(set(design.factors[n])) - 1 for n in names[: names.index(name)])
    categories = sorted(set(design.factors[name]))
    size = np.concatenate([[0.0], beta[start : start + len(categories) - 1]])
    low, high = int(np.argmin(size)), int(np.argmax(size))
    contrast = np.zeros(beta.size)
    for sign, at in ((-1.0, low), (1.0, high)):
        if at:
            contrast[start + at - 1] = sign
    change, std = float(size[high] - size[low]), float(np.sqrt(contrast @ covariance @ contrast))
    return _change(categories[low], categories[high], change, std)


def _change(lowest: str, highest: str, change: float, std: float) -> dict[str, object]:
    """Return a difference of logarithms as columns."""
    ends = [100.0 * np.expm1(change + side * 1.96 * std) for side in (-1.0, 1.0)]
    return {
        "lowest": lowest,
        "highest": highest,
        "effect_percent": 100.0 * np.expm1(change),
        "effect_std_percent": 100.0 * np.exp(change) * std,
        "effect_low_percent": ends[0],
        "effect_high_percent": ends[1],
    }


@dataclass(frozen=True)
class _Data:
    """Quantities of a peak in all measurements, whitened by the errors of each measurement.

    Parameters
    ----------
    value : ndarray, shape (measurements, quantities)
        What is described.
    whiten : ndarray, shape (measurements, quantities, quantities)
        Turns errors into independent ones of variance one.
    """

    value: Real
    whiten: Real

    @classmethod
    def of(cls, value: Real, errors: Real) -> _Data:
        value = value - value.mean(axis=0)  # every model has a mean; without it less is lost to rounding
        if value.ndim == 1:
            return cls(value[:, None], (1.0 / errors)[:, None, None])
        return cls(value, np.linalg.inv(np.linalg.cholesky(errors)))

    @property
    def quantities(self) -> int:
        return int(self.value.shape[1])

    def fit(self, columns: Real) -> tuple[float, Real, Real]:
        """Return chi^2, coefficients and their covariance of least squares (smallest norm where singular)."""
        right = np.einsum("mij,mj->mi", self.whiten, self.value).ravel()
        # Each quantity has coefficients of its own: whitened (kron of identity and row) measurement by measurement.
        weighted = np.einsum("mij,mc->mijc", self.whiten, columns).reshape(right.size, -1)
        inverse = np.linalg.pinv(weighted, rcond=1e-10)
        beta = inverse @ right
        return float(np.sum((right - weighted @ beta) ** 2)), beta, inverse @ inverse.T
