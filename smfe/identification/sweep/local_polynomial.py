"""The default estimator of a sweep: whole-record transforms, local polynomials of several widths, a rational model.

Over a band of neighbouring lines the compliance is a polynomial (:eq:`local-polynomial`; Pintelon and Schoukens 2012,
ch. 7): free of leakage at any sweep rate for a record that runs from rest to rest; otherwise a polynomial takes up the
transient.

Everything is one errors-in-variables least squares: columns are the lines of all passes, inputs are the forces, a
transient for each pass that does not run from rest to rest, and what repeats with the spindle where an air cut was
recorded. The noise of the forces is taken out of the normal equations, the noise of the motion weights the passes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage, stats

from process.errors import InputError
from process.types import Complex, Real
from smfe.identification.errors.result import in_words
from smfe.identification.sweep.delay import delay_of
from smfe.identification.sweep.least_squares import (
    Bands,
    Equations,
    Estimate,
    Lines,
    bin_lines,
    residual_power,
    residual_products,
    ring,
    shift_matrix,
    solve_bands,
)
from smfe.identification.sweep.noise import floored, force_noise, noise_between, pooled_noise, possible, shared_noise
from smfe.identification.sweep.passes import PreparedPass, SweepPass, whole_record
from smfe.identification.sweep.rational import fit_rational
from smfe.identification.sweep.rules import RULES
from smfe.identification.sweep.spindle_orders import (
    background_noise,
    instrumented,
    orders_in_band,
    spindle_waves,
)

Step = Callable[[int, int], None]


@dataclass(frozen=True)
class LocalPolynomial:
    """Whole-record transform; over a band around each frequency the compliance is a polynomial.

    A wide band averages more noise, a narrow one bends with a lightly damped mode. Each band of `half_widths` is tried
    and, row by row, the widest one is taken that agrees with all narrower ones within `agreement` standard deviations
    of these (Lepski's rule).

    Parameters
    ----------
    resolution : float, optional
        Step of the resulting frequency axis [Hz].
    half_widths : tuple of float, optional
        Half widths of the bands to choose from [Hz], rising.
    order : int, optional
        Order of the polynomial.
    agreement : float, optional
        Largest accepted difference, in standard deviations.
    rational : bool, optional
        Fit a rational model to the whole band, too, and take it but where a band contradicts it (`sweep.rational`).
    instrument_teeth : int, optional
        Teeth of the tool, to use the passing of the teeth as instrument: only the part of the forces that goes with
        harmonics of the spindle angle counts. Against bias by regeneration.
    position_dependent : bool, optional
        Let the compliance change along the pass, in proportion to the way from its middle; twice as many unknowns.
    """

    resolution: float = 0.25
    half_widths: tuple[float, ...] = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
    order: int = 2
    agreement: float = 2.0
    rational: bool = True
    instrument_teeth: int | None = None
    position_dependent: bool = False

    def axis(self, frequency_range: tuple[float, float], passes: Sequence[SweepPass]) -> Real:
        """Return the frequency axis [Hz]."""
        low, high = (round(f / self.resolution) for f in frequency_range)
        return np.asarray(np.arange(low, high + 1) * self.resolution)

    def reach(self, frequency: Real) -> tuple[float, float]:
        """Return the band [Hz] whose lines are needed."""
        widest = max(self.half_widths)
        return max(float(frequency[0]) - widest, 0.1), float(frequency[-1]) + widest

    def unknowns(self, transient: Sequence[bool]) -> int:
        """Return the number of unknowns a row, with three forces and no air cut."""
        return (self.order + 1) * (3 + sum(transient))

    def error_lines(self, half_width: float) -> float:
        """Return how many lines of the axis share an error.

        The estimate at the centre is a weighted mean over the band; ``1/sum(weight^2)`` is its effective width, 8/9 of
        the half width for order 2.
        """
        return max(1.0, 2.0 * half_width / (self.resolution * _sum_of_squares(self.order)))


@cache
def _sum_of_squares(order: int) -> float:
    """Return 401 times the sum of the squared weights of 401 lines in the value at their middle."""
    shift = np.linspace(-1.0, 1.0, 401)
    weight = np.linalg.pinv(shift[:, None] ** np.arange(order + 1))[0]
    return shift.size * float(weight @ weight)


BANDS = LocalPolynomial(half_widths=(0.125, 0.25, 0.5, 1.0), agreement=2.5, rational=False)
"""Narrow bands alone. The default errs less."""


def solve_local(
    estimator: LocalPolynomial,
    passes: Sequence[PreparedPass],
    frequency: Real,
    axes: Sequence[str],
    response: Sequence[str],
    background: Sequence[PreparedPass] = (),
    progress: Step | None = None,
) -> Estimate:
    """Solve with every half width that the records can fill and with a rational model, and choose row by row.

    Parameters
    ----------
    estimator : LocalPolynomial
        Its settings.
    passes : sequence of SweepPass
        At least as many directions as `axes`.
    frequency : ndarray, shape (f,)
        [Hz].
    axes, response : sequence of str
        Axes of the forces and of the motion.
    background : sequence of SweepPass, optional
        Air cuts: the spindle turns over the same speeds and nothing is cut.
    progress : callable, optional
        Called with (done, of).

    Returns
    -------
    Estimate
        With half width and degrees of freedom; twice as many excitations where the fit depends on position.

    Raises
    ------
    InputError
        For records that are too short.
    """
    tests, excitations, noise = _tests(estimator, passes, background, frequency, axes, response)
    instruments, shares = _instruments(estimator, passes, tests, frequency, excitations)
    widths = usable_widths(estimator, [*passes, *background], tests[0].inputs.shape[1])
    data = _data(estimator, tests, instruments, shares, frequency, excitations, noise)
    weight = _weights(data, estimator, _width_for_noise(data, widths))
    steps = len(widths) + 1
    solved, losses, bands, done = [], [], None, 0
    for number, width in enumerate(widths):
        side = _bins(data, width)
        bands = _grown(bands, data, weight, [*range(-side, -done), *range(done, side)])
        estimate, loss = _solution(data, bands, estimator.error_lines(width))
        solved.append(estimate)
        losses.append(loss)
        done = side
        if progress is not None:
            progress(number + 1, steps)
    model = estimator.rational and instruments is None
    found = _choose(estimator, widths, solved, frequency, cautious=model)
    noise_width = _width_for_noise(data, widths)
    products = _residual_noise(data, estimator, noise_width, weight)[1]
    shared = shared_noise(products, *_pooled_lines(data, estimator, noise_width))
    level = 1.0 / np.sqrt(weight[data.first].mean(axis=1))
    assert found.half_width is not None
    found = replace(found, between=noise_between(found.covariance, shared, level, found.half_width))
    if model:
        by_width = dict(zip(widths, solved, strict=True))
        lost = losses[min(2, len(losses) - 1)]
        found = _with_rational(estimator, data, weight, by_width, found, (shared, level), lost)
    floor = RULES.model_error**2 * np.mean(np.abs(found.compliance) ** 2, axis=2)
    found = replace(found, covariance=found.covariance + floor[..., None, None] * np.eye(found.compliance.shape[2]))
    assert found.between is not None
    found = replace(found, between=possible(found.covariance, found.between))
    if progress is not None:
        progress(steps, steps)
    return _about_noise(found, losses[min(2, len(losses) - 1)], noise, frequency)


# --- from records to equations ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Noise:
    """Noise of the inputs of each test at the bins: shapes (b, j, j) and (b, j, r), for each line of a test."""

    force: Callable[[Real], list[Complex]]
    shared: Callable[[Real], list[Complex]] | None
    spread: float
    """Relative standard deviation of the power."""
    air: bool = True
    """Whether it was seen in the air, not only bounded."""


def _tests(
    estimator: LocalPolynomial,
    passes: Sequence[PreparedPass],
    background: Sequence[PreparedPass],
    frequency: Real,
    axes: Sequence[str],
    response: Sequence[str],
) -> tuple[list[Lines], int, _Noise | None]:
    """Return inputs and responses of all tests, the number of excitations, and the noise of the forces."""
    reach, everything = estimator.reach(frequency), [*passes, *background]
    moving = estimator.position_dependent
    tests = [force_lines(p, reach, axes, response, moving and k < len(passes)) for k, p in enumerate(everything)]
    e = len(axes) * (2 if moving else 1)
    tests = [t if t.inputs.shape[1] == e else with_inputs(t, np.zeros_like(t.inputs)) for t in tests]
    transient = [not p.at_rest for p in passes] + [True] * len(background)
    if background:
        orders = orders_in_band(everything, (float(frequency[0]), float(frequency[-1])))
        teeth = estimator.instrument_teeth
        tests = [with_inputs(t, spindle_waves(p, orders, reach, teeth)) for t, p in zip(tests, everything, strict=True)]
        transient = [True] * len(everything)
    noise = _known_noise(tests, passes, background, axes, frequency, e)
    return transients(tests, transient), e, noise


def force_lines(
    sweep: PreparedPass, reach: tuple[float, float], axes: Sequence[str], response: Sequence[str], moving: bool
) -> Lines:
    """Return forces and displacements of a pass at its lines.

    With `moving`, the forces come twice: as they are, and times the place along the pass, from -1 to 1.
    """
    found = whole_record(sweep.record, reach, response)
    rows = [found.excitation.index(a) for a in axes]
    inputs = [found.force[:, rows, 0]]
    if moving:
        force = sweep.record["force"]
        place = xr.DataArray(sweep.place, {"time": force["time"]}, ("time",))
        moved = whole_record(sweep.record.assign(force=force * place), reach, response)
        inputs.append(moved.force[:, rows, 0])
    return Lines(found.frequency, np.concatenate(inputs, axis=1), found.displacement[:, :, 0])


def with_inputs(lines: Lines, more: Complex) -> Lines:
    """Return the lines with more inputs behind those they have."""
    return Lines(lines.frequency, np.concatenate([lines.inputs, more], axis=1), lines.response)


def transients(tests: Sequence[Lines], transient: Sequence[bool]) -> list[Lines]:
    """Give each test with transient ends one input of its own: 1 at all lines."""
    out = []
    for k, lines in enumerate(tests):
        own = np.zeros((lines.frequency.size, sum(transient)), dtype=complex)
        if transient[k]:
            own[:, sum(transient[:k])] = 1.0
        out.append(with_inputs(lines, own))
    return out


def _instruments(
    estimator: LocalPolynomial,
    passes: Sequence[PreparedPass],
    tests: Sequence[Lines],
    frequency: Real,
    excitations: int,
) -> tuple[list[Lines] | None, Real]:
    """Return the tests with their forces projected on the passing of the teeth, and which share of noise comes through.

    An air cut has no teeth that pass: its forces have no part.
    """
    if estimator.instrument_teeth is None:
        return None, np.ones(len(tests))
    orders = [h * estimator.instrument_teeth for h in range(1, RULES.instrument_harmonics + 1)]
    out, shares = [], np.zeros(len(tests))
    for k, lines in enumerate(tests):
        if k >= len(passes):
            silent = np.where(np.arange(lines.inputs.shape[1]) < excitations, 0.0, lines.inputs)
            out.append(Lines(lines.frequency, silent, lines.response))
            continue
        p = passes[k]
        waves = spindle_waves(p, orders, estimator.reach(frequency), estimator.instrument_teeth, cut_only=True)
        projected, shares[k] = instrumented(lines, waves, excitations, p.label)
        out.append(projected)
    return out, shares


def _known_noise(
    tests: Sequence[Lines],
    passes: Sequence[PreparedPass],
    background: Sequence[PreparedPass],
    axes: Sequence[str],
    frequency: Real,
    e: int,
) -> _Noise | None:
    """Return the noise of the forces: from air cuts, else from the air at the ends of the records."""
    everything = [*passes, *background]
    length = [p.seconds for p in everything]
    along = [_along(p) if e > len(axes) and k < len(passes) else np.eye(1) for k, p in enumerate(everything)]
    along = [m if m.shape[0] * len(axes) == e else np.diag([1.0, 0.0]) for m in along]
    if background:
        n = len(axes)
        air = [
            (Lines(t.frequency, np.delete(t.inputs, range(n, e), axis=1), t.response), s)
            for t, s in list(zip(tests, length, strict=True))[len(passes) :]
        ]
        rows = np.array([m[0] for m in along])

        def force(at: Real) -> list[Complex]:
            seen = background_noise(air, n, at).force
            return [
                np.einsum("xy,bij->bxiyj", m, seen).reshape(-1, e, e) * s for m, s in zip(along, length, strict=True)
            ]

        def shared(at: Real) -> list[Complex]:
            seen = background_noise(air, n, at).shared
            return [
                np.einsum("x,bir->bxir", m, seen).reshape(at.size, e, -1) * s for m, s in zip(rows, length, strict=True)
            ]

        return _Noise(force, shared, 1.0 / float(np.sqrt(background_noise(air, n, frequency[:1]).degrees_of_freedom)))
    found = force_noise(passes, list(axes), (float(frequency[0]), float(frequency[-1])))
    if found is None:
        return None
    density = found.density

    def quiet_ends(at: Real) -> list[Complex]:
        each = [np.kron(m, np.diag(density)) * s for m, s in zip(along, length, strict=True)]
        return [np.broadcast_to(p.astype(complex), (at.size, e, e)) for p in each]

    return _Noise(quiet_ends, None, found.spread, found.air)


def _along(sweep: PreparedPass) -> Real:
    """Mean of the products of 1 and the place along the pass, shape (2, 2)."""
    place = sweep.place
    return np.array([[1.0, place.mean()], [place.mean(), np.mean(place**2)]])


def usable_widths(estimator: LocalPolynomial, passes: Sequence[PreparedPass], inputs: int) -> list[float]:
    """Return the half widths over which the passes give at least twice as many lines as there are unknowns."""
    together = sum(p.seconds for p in passes)
    needed = 2.0 * (estimator.order + 1) * inputs
    usable = [w for w in sorted(estimator.half_widths) if 2.0 * w * together >= needed]
    if not usable:
        widest = max(estimator.half_widths)
        raise InputError(
            f"the passes last {together:.3g} s together: {2.0 * widest * together:.0f} lines within {widest:g} Hz of a "
            f"frequency for {needed / 2.0:.0f} unknowns; at least {needed / (2.0 * widest):.3g} s are needed: sweep "
            "more slowly or add passes"
        )
    return usable


@dataclass(frozen=True)
class _Data:
    """Bins of all passes: raw for residuals, clean to solve, seen for what the solution rests on.

    Without instruments, clean and seen are raw without the noise of the forces.
    """

    raw: Equations
    clean: Equations
    seen: Equations
    spread: Equations
    frequency: Real
    first: NDArray[np.int64]
    excitations: int
    trusted: bool
    """Whether the noise of the forces is known, and taken out; else it is bounded, and charged."""
    noise_spread: float
    """Relative standard deviation of the noise power of the forces; 0 where it is not known."""
    force_noise: Complex
    """Noise of the forces a line, shape (b, tests, e, e)."""

    @property
    def solved(self) -> Equations:
        """What the solution comes from."""
        return self.clean if self.trusted else self.raw


def _data(
    estimator: LocalPolynomial,
    tests: Sequence[Lines],
    instruments: Sequence[Lines] | None,
    shares: Real,
    frequency: Real,
    excitations: int,
    noise: _Noise | None,
) -> _Data:
    step = estimator.resolution / (2 * max(2, round(estimator.resolution / min(estimator.half_widths))))
    side = max(1, round(max(estimator.half_widths) / step))
    bins = 2 * side + round((frequency[-1] - frequency[0]) / step)
    edges = frequency[0] + step * (np.arange(bins + 1) - side)
    raw = bin_lines(tests, edges, estimator.order)
    first = side + np.round((frequency - frequency[0]) / step).astype(int)
    e, j, r = excitations, tests[0].inputs.shape[1], tests[0].response.shape[1]
    power = np.zeros((bins, len(tests), j, j), dtype=complex)
    shared = np.zeros((bins, len(tests), j, r), dtype=complex)
    if noise is not None:
        power[:, :, :e, :e] = np.stack(noise.force(raw.centre), axis=1)
        if noise.shared is not None:
            shared[:, :, :e] = np.stack(noise.shared(raw.centre), axis=1)
    spread = raw if instruments is None else bin_lines(instruments, edges, estimator.order)
    solvable = raw if instruments is None else bin_lines(tests, edges, estimator.order, instruments)
    through, together = (np.asarray(shares[:, None, None] * v, dtype=np.complex128) for v in (power, shared))
    clean = solvable.without_input_noise(through, together)
    seen = clean if instruments is None else spread.without_input_noise(through)
    trusted = noise is None or noise.air
    if not trusted:
        seen, power = raw, np.zeros_like(power)
    known = 0.0 if noise is None else noise.spread
    return _Data(raw, clean, seen, spread, frequency, first, excitations, trusted, known, power[:, :, :e, :e])


def _bins(data: _Data, width: float) -> int:
    return max(1, round(width / data.raw.step))


def _at_bins(data: _Data, values: Real) -> Real:
    """Return values given at the frequencies at the bins, nearest first, shape (b, ...)."""
    nearest = np.abs(data.raw.centre[:, None] - data.frequency).argmin(axis=1)
    return np.asarray(values[nearest])


# --- noise of the motion ----------------------------------------------------------------------------------------------


def _width_for_noise(data: _Data, widths: Sequence[float]) -> float:
    """Return the narrowest half width with four lines for each unknown; with fewer, residuals say little."""
    lines = data.raw.moment[:, :, 0, 0].sum(axis=1).mean() / data.raw.step
    enough = [w for w in widths if 2.0 * w * lines >= 4.0 * data.raw.unknowns]
    return enough[0] if enough else widths[-1]


def _weights(data: _Data, estimator: LocalPolynomial, width: float, rounds: int = 4) -> Real:
    """Learn the inverse noise power of each response in each pass, shape (b, tests, r).

    The first round weights all passes alike, so that a noisy one leaves its mark on the residual of the quiet ones;
    solving again with what was learnt takes it away. Noise of the forces comes through the compliance, so it peaks with
    it and is known; what is left is smooth, white for an accelerometer: as a displacement it falls with the fourth
    power of frequency.
    """
    weight = np.ones(data.raw.joint.shape[:3])
    reach = max(1, round(RULES.noise_reach / estimator.resolution))
    whitened = (data.frequency / data.frequency[0])[:, None, None] ** 4
    below = np.minimum((np.maximum(data.raw.centre, 0.0) / data.frequency[0]) ** 4, 1.0)[:, None, None]
    lines, _ = _pooled_lines(data, estimator, width)
    for _ in range(rounds):
        coefficients, products = _residual_noise(data, estimator, width, weight)
        mean = np.maximum(np.diagonal(products, axis1=2, axis2=3).real, 0.0)
        phi = coefficients[..., : data.excitations]
        through = np.einsum("frj,ftkj,frk->ftr", phi, data.force_noise[data.first], phi.conj(), optimize=True).real
        through = np.minimum(_median(through, reach // 2), 0.95 * _median(mean, reach // 2))
        rest = _median((mean - through) * whitened, reach) / whitened
        noise = pooled_noise(floored(np.maximum(rest, 0.05 * mean) + through), lines)
        weight = _at_bins(data, 1.0 / noise) * below
    return weight


def _residual_noise(data: _Data, estimator: LocalPolynomial, width: float, weight: Real) -> tuple[Complex, Complex]:
    """Return the coefficients of one width, (f, r, k), and the mean products of residuals a line, (f, tests, r, r)."""
    side, k = _bins(data, width), data.raw.unknowns
    coefficients, _ = solve_bands(ring(data.solved, data.first, weight, range(-side, side)))
    tests, r = data.raw.joint.shape[1:3]
    residual, each = np.zeros((data.first.size, tests, r, r), dtype=complex), np.zeros((data.first.size, tests))
    for offset in range(-side, side):
        at = data.first + offset
        shift = shift_matrix((offset + 0.5) * data.raw.step, estimator.order)
        moved = np.einsum("kl,frl->frk", np.kron(shift, np.eye(k // (estimator.order + 1))), coefficients)
        here = Equations(
            data.raw.centre[at], data.raw.step, data.raw.gram[at], data.raw.cross[at], data.raw.joint[at],
            data.raw.moment[at],
        )  # fmt: skip
        residual += residual_products(here, moved)
        each += here.moment[:, :, 0, 0]
    lines = each.sum(axis=1)
    fair = (lines / np.maximum(lines - k, 1.0))[:, None, None, None]
    each = each[..., None, None]
    return coefficients, np.where(each > 0, residual / np.maximum(each, 1.0) * fair, np.nan)


def _pooled_lines(data: _Data, estimator: LocalPolynomial, width: float) -> tuple[Real, int]:
    """Return the independent lines within `SweepRules.noise_reach`, (f, tests), and how many neighbours that is."""
    side, reach = _bins(data, width), max(1, round(RULES.noise_reach / estimator.resolution))
    count = np.sum([data.raw.moment[data.first + o, :, 0, 0] for o in range(-side, side)], axis=0)
    free = 1.0 - np.minimum(data.raw.unknowns / np.maximum(count.sum(axis=1, keepdims=True), 1.0), 0.9)
    # Bands of neighbours overlap, or leave lines between them out.
    return count * free * min(1.0 + reach * estimator.resolution / width, 2.0 * reach + 1.0), reach


def _median(values: Real, reach: int) -> Real:
    """Return the median over `reach` neighbours to either side along the first axis; NaN counts for nothing."""
    edge = np.full((reach, *values.shape[1:]), np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([edge, values, edge]), 2 * reach + 1, axis=0)
    known = np.isfinite(windows).any(axis=-1)
    return np.where(known, np.nanmedian(np.where(known[..., None], windows, 0.0), axis=-1), np.nan)


# --- one width --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Both:
    """Bands with and without the noise of the forces."""

    raw: Bands
    clean: Bands
    spread: Bands
    force: Complex
    loss: Complex


def _grown(bands: _Both | None, data: _Data, weight: Real, offsets: Sequence[int]) -> _Both:
    """Return the bands with more bins."""
    e = data.excitations
    raw, clean = (ring(q, data.first, weight, offsets) for q in (data.raw, data.clean))
    spread = raw if data.spread is data.raw else ring(data.spread, data.first, weight, offsets)
    together = [q.gram[:, :, 0, :e, 0, :e].sum(axis=1) for q in (data.spread, data.seen)]
    force, left = (np.sum([q[data.first + o] for o in offsets], axis=0) for q in together)
    new = _Both(raw, clean, spread, force, force - left)
    if bands is None:
        return new
    whole = bands.raw + raw
    wide = whole if spread is raw else bands.spread + spread
    return _Both(whole, bands.clean + clean, wide, bands.force + new.force, bands.loss + new.loss)


def _solution(data: _Data, bands: _Both, error_lines: float) -> tuple[Estimate, Complex]:
    """Solve one width at all frequencies; return also what the noise of the forces would have taken, (f, r, e)."""
    e, k = data.excitations, data.raw.unknowns
    value, inverse = solve_bands(bands.clean if data.trusted else bands.raw)
    lines = bands.raw.lines[:, None]
    left = residual_power(bands.raw, value)
    degrees_of_freedom = np.maximum(lines - k, 0.0)
    mean = left / np.where(degrees_of_freedom > 0.0, degrees_of_freedom, np.nan)
    # (G - L)^-1 G (G - L)^-1: the noise of the forces is part of the residual, not of the curvature.
    spread = inverse @ bands.spread.gram @ inverse.conj().swapaxes(-1, -2)
    covariance = (mean[..., None, None] * spread)[..., :e, :e]
    total = bands.raw.power
    coherence = np.clip(1.0 - mean * lines / np.where(total > 0.0, total, np.nan), 0.0, 1.0)
    noisy = data.noise_spread > 0.0 and bands.spread is bands.raw
    other = solve_bands(bands.raw if data.trusted else bands.clean)[0] if noisy else value
    loss = (value - other)[..., :e]
    covariance = covariance + data.noise_spread**2 * loss[..., :, None] * loss[..., None, :].conj()
    condition = _condition(bands)
    # Where the noise leaves the compliance open, its linearised uncertainty says nothing.
    open_to = data.noise_spread * np.linalg.norm(loss, axis=(1, 2)) > RULES.most_open * np.linalg.norm(
        value[..., :e], axis=(1, 2)
    )
    condition = np.where(open_to, np.inf, condition)
    shape = np.broadcast_to(degrees_of_freedom, left.shape)
    return Estimate(value[..., :e], covariance, coherence, condition, error_lines, None, 2.0 * shape), loss


def _condition(bands: _Both) -> Real:
    """Condition number of the forces without their noise; infinite where noise is most of the weakest direction."""
    clean = np.linalg.eigvalsh(bands.force - bands.loss)
    whole = np.linalg.eigvalsh(bands.force)
    largest, smallest = whole[:, -1], clean[:, 0]
    drowned = smallest <= (1.0 - RULES.largest_noise_share) * np.maximum(whole[:, 0], 0.0)
    usable = (smallest > 1e-14 * largest) & ~drowned & (largest > 0.0)
    return np.where(usable, np.sqrt(largest / np.where(usable, smallest, 1.0)), np.inf)


# --- the choice -------------------------------------------------------------------------------------------------------


def _choose(
    estimator: LocalPolynomial, widths: Sequence[float], solved: Sequence[Estimate], frequency: Real, cautious: bool
) -> Estimate:
    """Take, row by row, the widest band that agrees with all narrower ones; charge what even the narrowest bends."""
    rows = solved[0].compliance.shape[:2]
    index = np.zeros(rows, dtype=int)
    agrees = np.ones(rows, dtype=bool)
    for k in range(1, len(widths)):
        for narrower in solved[:k]:
            agrees &= difference(solved[k], narrower) <= estimator.agreement
        # A mode bends the compliance over several lines; a single line that agrees by accident does not count.
        agrees = ndimage.median_filter(agrees, size=(5, 1), mode="mirror")
        index[agrees] = k
    if cautious:
        # The widest that agrees may be bent by as much as its own noise: one less is not.
        index = np.maximum(index - 1, 0)
    f, r = np.ogrid[: rows[0], : rows[1]]
    compliance, covariance, coherence, degrees_of_freedom = (
        np.array([getattr(s, name) for s in solved])[index, f, r]
        for name in ("compliance", "covariance", "coherence", "degrees_of_freedom")
    )
    condition = np.array([s.condition for s in solved])[index, f].max(axis=1)
    warnings: tuple[str, ...] = ()
    if len(widths) > 1:
        bent = (index == 0) & ~agrees
        # The bias of a polynomial of order p grows with width^(p+1), so a wider band differs by growth times the bias.
        growth = (widths[1] / widths[0]) ** (estimator.order + 1) - 1.0
        bias = np.where(bent[..., None], (solved[1].compliance - solved[0].compliance) / growth, 0.0)
        clear = np.abs(bias) > np.sqrt(np.diagonal(covariance, axis1=2, axis2=3).real)
        covariance = covariance + bias[..., :, None] * bias[..., None, :].conj()
        if clear.any():
            where = in_words(frequency, clear.any(axis=(1, 2)))
            warnings = (
                f"resonances are narrower than the finest band of {2 * widths[0]:g} Hz in {where}: their peaks come "
                "out too low by about what the standard deviation says; sweep more slowly so that the lines lie "
                "closer, and use smaller half_widths",
            )
    width = np.asarray(widths)[index]
    lines = float(np.mean([estimator.error_lines(w) for w in width.ravel()]))
    return Estimate(compliance, covariance, coherence, condition, lines, width, degrees_of_freedom, warnings)


def difference(a: Estimate, b: Estimate) -> Real:
    """Return the largest difference within a row in standard deviations of b (at least `same_entry`), shape (f, r)."""
    scale = np.hypot(b.std, RULES.same_entry * np.abs(b.compliance))
    ratio = np.abs(a.compliance - b.compliance) / np.where(scale > 0.0, scale, np.inf)
    return np.asarray(np.nan_to_num(ratio).max(axis=2))


def _with_rational(
    estimator: LocalPolynomial,
    data: _Data,
    weight: Real,
    solved: Mapping[float, Estimate],
    found: Estimate,
    noise: tuple[Complex, Real],
    loss: Complex,
) -> Estimate:
    """Take the rational model where it agrees with what was chosen and with all narrower bands (half width -> band).

    Rows that share noise share errors, and rows of the model share its poles as well.
    """
    assert found.half_width is not None
    assert found.degrees_of_freedom is not None
    e, f = data.excitations, data.frequency
    band = (float(f[0]) - 1.0, float(f[-1]) + 1.0)
    fit = fit_rational(data.solved, data.raw, weight, band, f, e, known=data.noise_spread)
    scale = max(1.0, fit.misfit)
    covariance = fit.covariance * scale
    if not data.trusted:
        # Noise that is only bounded bends all bands, and the model, alike.
        covariance = covariance + data.noise_spread**2 * loss[..., :, None] * loss[..., None, :].conj()
    model = replace(found, compliance=fit.value, covariance=covariance)
    agrees = np.ones(found.half_width.shape, dtype=bool)
    limit = model_agreement(estimator, list(solved), e, float(f[-1] - f[0]))
    for width, s in solved.items():
        narrower = found.half_width >= width - 1e-12
        agrees &= ~narrower | (difference(model, s) <= limit)
    agrees = ndimage.median_filter(agrees, size=(5, 1), mode="mirror")
    lack, contradicted = lack_of_fit(model, found, estimator)
    size = np.sum(found.std**2, axis=2)
    charged = np.sum(np.diagonal(covariance + lack, axis1=2, axis2=3).real, axis=2)
    take = agrees & (np.sum(model.std**2, axis=2) < size) & ~(contradicted & (charged >= size))
    covariance = covariance + lack
    linear = np.where(take[..., None, None], fit.linear * scale, found.covariance)
    both = (take[:, :, None] & take[:, None, :])[:, :, None, :, None]
    between = noise_between(linear, *noise, np.where(take, np.inf, found.half_width)) + np.where(
        both, fit.between * scale, 0.0
    )
    half_width: Real = np.where(
        take, np.maximum((f[-1] - f[0]) / (2.0 * fit.terms), found.half_width), found.half_width
    )
    return replace(
        found,
        error_lines=float(np.mean([estimator.error_lines(float(w)) for w in half_width.ravel()])),
        compliance=np.where(take[..., None], fit.value, found.compliance),
        covariance=np.where(take[..., None, None], covariance, found.covariance),
        half_width=half_width,
        between=between,
        degrees_of_freedom=np.where(
            take, 2.0 * fit.degrees_of_freedom / found.compliance.shape[1], found.degrees_of_freedom
        ),
        delay=delay_of(fit.poles, fit.residue, fit.residue_variance * scale, (float(f[0]), float(f[-1]))),
    )


def model_agreement(estimator: LocalPolynomial, widths: Sequence[float], excitations: int, span: float) -> float:
    """Return the largest difference of a row of the model from the bands, in standard deviations.

    The square of a circular difference over its variance has the distribution ``exp(-x)``; the largest of n exceeds
    ``ln(n/p)`` with a probability of at most p. Over the band there are ``span/(2 w)`` independent estimates of half
    width w for each entry. A band that takes the place of a model that is right has several times its variance over
    hertz, so that false alarms would rule the error.
    """
    looks = excitations * sum(max(1.0, span / (2.0 * w)) for w in widths)
    return max(estimator.agreement, math.sqrt(math.log(looks / RULES.false_alarm)))


def lack_of_fit(model: Estimate, found: Estimate, estimator: LocalPolynomial) -> tuple[Complex, NDArray[np.bool_]]:
    """Return the variance that a model lacks, and whether noise alone leaves no such difference.

    It lacks what it differs from the bands by, beyond their noise. A wrong model differs everywhere a little; pooled
    over neighbouring frequencies this is significant before a single line is. Of noise alone the pooled square is a
    mean of independent exponential variables, a gamma variable, often half as large again as its mean where bands are
    wide: that is charged, but no reason to leave a model for a band of several times its variance.

    Parameters
    ----------
    model : Estimate
        The rational model.
    found : Estimate
        The bands that were chosen beside it, with their half widths.
    estimator : LocalPolynomial
        Its settings.

    Returns
    -------
    ndarray, shape (f, r, e, e)
        Variance to add [m2/N2].
    ndarray of bool, shape (f, r)
        Where the bands contradict the model, with `SweepRules.false_alarm` in a whole sweep.
    """
    assert found.half_width is not None
    variance = np.maximum(found.std**2, 1e-300)
    scale = variance + (RULES.same_entry * np.abs(found.compliance)) ** 2
    ratio = np.nan_to_num(np.abs(model.compliance - found.compliance) ** 2 / scale, nan=1.0).mean(axis=2)
    size = 2 * round(RULES.lack_reach / estimator.resolution) + 1
    inside = ndimage.uniform_filter1d(np.ones_like(ratio), size, axis=0, mode="constant")
    pooled = ndimage.uniform_filter1d(ratio, size, axis=0, mode="constant") / inside
    independent = found.compliance.shape[2] * np.maximum(RULES.lack_reach / found.half_width, 1.0)
    beyond = np.where(pooled > 1.0 + 1.0 / np.sqrt(independent), pooled - 1.0, 0.0)
    # The entries of a row err alike, in the weakest direction of the forces: they count as one.
    widths, which = np.unique(found.half_width, return_inverse=True)
    lines = np.array([estimator.error_lines(float(w)) for w in widths])[which.reshape(ratio.shape)]
    number = size * inside / lines
    looks = ratio.size / size + ratio.shape[1]
    contradicted = stats.gamma.sf(pooled * number, number) < RULES.false_alarm / looks
    return np.asarray(beyond[..., None, None] * np.eye(variance.shape[2]) * variance[..., None, :]), contradicted


def _about_noise(found: Estimate, loss: Complex, noise: _Noise | None, frequency: Real) -> Estimate:
    """Say what noise on the forces would have taken, or that it is not known."""
    if noise is None:
        text = (
            "no pass has a quiet piece of air before or after the cut, and none cuts for two seconds, so what noise on "
            "the forces takes from the compliance is unknown"
        )
        return replace(found, warnings=(*found.warnings, text))
    share = np.linalg.norm(loss, axis=2) / np.maximum(np.linalg.norm(found.compliance, axis=2), 1e-300)
    solved = np.where(np.isfinite(found.condition)[:, None], share, 0.0)
    most = min(float(np.nan_to_num(solved).max()), 1.0)
    if most <= 0.01:
        return found
    at = frequency[int(np.argmax(np.nan_to_num(solved).max(axis=1)))]
    if not noise.air:
        text = (
            f"no pass has a quiet piece of air before or after the cut: noise on the forces, as far as the cut has "
            f"room for it, lowers the compliance by up to {100.0 * most:.2g} % (at {at:g} Hz), which is in the "
            "standard deviation: record from air to air"
        )
        return replace(found, warnings=(*found.warnings, text))
    text = (
        f"noise on the forces would lower the compliance by up to {100.0 * most:.2g} % (at {at:g} Hz); it is taken "
        "out, and how well it is known is in the standard deviation: a quieter sensor or a deeper cut would do better"
    )
    return replace(found, warnings=(*found.warnings, text))
