"""What no smooth model of an axis explains in a drive record: the noise that a diagnosis whitens with.

A reference with far more parameters than any cause of the catalogue (piecewise-linear friction over speed and over
position for each direction, pre-sliding, jerk, snap, drifts, a periodic force) is fitted to the force. Its residual is
held to be noise, and an autoregression of it (Yule-Walker over whole moves, those with a residual above twice the
median left out) whitens:

``e_n = (y_n + a_1 y_(n-1) + ... + a_p y_(n-p))/sigma``.

A force that is periodic in position or in time, and one that lasts a moment, are looked for in the residual of the
reference; what is found there by looking everywhere must be beyond what noise alone has somewhere.

The reference also says how far up in frequency a record can be used. The axis moves in closed loop: where its motion
comes from disturbances and not from the reference position, drive force over motion is minus the controller and no
property of the axis (Forssell and Ljung, Automatica 35, 1999); it looks like a flexibility and a longer delay. Motion
of which a share r comes from noise is correlated with it by sqrt(r), and N values then see a flexibility of likelihood
ratio N r. Of 60 rigid axes that were simulated ten were taken for flexible, or suspected of it, at 13 dB, none at
20 dB; of 44 others one was at 20 dB, not at 23 dB.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import linalg, signal

from process.types import Real
from smfe.diagnosis.drive.filters import Motion
from smfe.diagnosis.drive.rules import RULES

_SLIDES = (RULES.finest_slide, 5e-6, 2.5e-5)


@dataclass(frozen=True)
class Whitener:
    """An autoregression: ``e = (y + a y_before)/sigma``."""

    coefficients: Real  # shape (p,): a_1 ... a_p.
    sigma: float  # standard deviation of the innovations, in the unit of the signal

    @property
    def taps(self) -> Real:
        """Weights of the newest value, the one before ..., over sigma."""
        return np.concatenate(([1.0], self.coefficients)) / self.sigma

    @property
    def stable(self) -> bool:
        """Whether the noise that it whitens does not grow."""
        return bool(np.all(np.abs(np.roots(np.concatenate(([1.0], self.coefficients)))) < 1.0))

    @property
    def order(self) -> int:
        """Values needed before the first."""
        return self.coefficients.size

    def __call__(self, values: Real) -> Real:
        """Return the whitened values, `order` fewer than were given."""
        return np.convolve(values, self.taps, mode="valid")


def fit_whitener(residuals: Sequence[Real], regressors: Real | None = None) -> Whitener:
    """Return the whitener of what least squares has left in each move.

    What its `regressors`, (n, k) over all moves, have taken from the noise, most of it slow, is put back: noise is
    drawn from the autoregression and projected off them; the covariances are moved until those of the draws are the
    ones observed.
    """
    kept, sizes = _kept(residuals), [r.size for r in residuals]
    observed, values = _covariances(np.concatenate(residuals), sizes, kept), _values(residuals, kept)
    found = _autoregression(observed, values)
    if regressors is None:
        return found
    basis = _orthonormal(regressors)
    white = np.random.default_rng(0).standard_normal((RULES.drawn, RULES.settles + sum(sizes)))
    given = observed.copy()
    for _ in range(RULES.rounds):
        drawn = _projected(_coloured(found, white), basis)
        given = given + observed - np.mean(_covariances(drawn, sizes, kept), axis=0)
        better = _autoregression(given, values)
        if not better.stable:
            break
        found = better
    return found


def without_memory(residuals: Sequence[Real]) -> Whitener:
    """Return the whitener of first order, which cannot have learned a wave."""
    kept, sizes = _kept(residuals), [r.size for r in residuals]
    return _autoregression(_covariances(np.concatenate(residuals), sizes, kept)[:2], _values(residuals, kept))


def learned_again(
    found: Whitener, residuals: Sequence[Real], regressors: Real, draws: int
) -> Iterator[tuple[Whitener, Sequence[Real]]]:
    """Yield whiteners that records of the noise of `found` would give, and what least squares leaves of each record.

    `residuals` and `regressors` are those that `found` was learned from (`fit_whitener`).
    """
    kept, basis, sizes = _kept(residuals), _orthonormal(regressors), [r.size for r in residuals]
    whole = _coloured(found, np.random.default_rng(1).standard_normal((draws, RULES.settles + sum(sizes))))
    left = _projected(whole.copy(), basis)
    before, after = (_covariances(y, sizes, kept) for y in (whole, left))
    taken = np.mean(before, axis=0) - np.mean(after, axis=0)
    for lags, moves in zip(after, _split(left, sizes), strict=True):
        yield _autoregression(lags + taken, _values(residuals, kept)), moves


def degrees_of_freedom_left(found: Whitener, residuals: Sequence[Real], regressors: Real) -> list[float]:
    """Return the sum of squares that white noise of one unit leaves of each move behind least squares, whitened.

    It is the number of whitened values less what the least squares takes, most of it from slow noise and from moves
    that few others are like. Of the residuals only their sizes count.
    """
    sizes = [r.size for r in residuals]
    white = np.random.default_rng(2).standard_normal((RULES.drawn, RULES.settles + sum(sizes)))
    left = _split(_projected(_coloured(found, white), _orthonormal(regressors)), sizes)
    squares = [[float(np.sum(np.square(found(move)))) for move in moves] for moves in left]
    return [float(x) for x in np.mean(squares, axis=0)]


def _coloured(found: Whitener, white: Real) -> Real:
    return np.asarray(
        found.sigma * signal.lfilter([1.0], [1.0, *found.coefficients], white, axis=1)[:, RULES.settles :]
    )


def _projected(drawn: Real, basis: Real) -> Real:
    drawn -= (drawn @ basis) @ basis.T
    return drawn


def _split(drawn: Real, sizes: Sequence[int]) -> list[list[Real]]:
    """Each draw, move by move."""
    return [np.split(x, np.cumsum(sizes)[:-1]) for x in drawn]


def _kept(residuals: Sequence[Real]) -> list[bool]:
    size = np.array([math.sqrt(float(np.mean(np.square(r)))) for r in residuals])
    return [bool(rms <= 2.0 * np.median(size)) for rms in size]


def _values(residuals: Sequence[Real], kept: Sequence[bool]) -> int:
    return sum(r.size for r, good in zip(residuals, kept, strict=True) if good)


def _covariances(values: Real, sizes: Sequence[int], kept: Sequence[bool]) -> Real:
    """Autocovariances to lag `DriveRules.order` of the moves that are kept, (..., order + 1), of records (..., n)."""
    move = np.repeat(np.arange(len(sizes)), sizes)
    good = np.asarray(kept)[move]
    found = []
    for k in range(RULES.order + 1):
        first, last = values[..., : move.size - k], values[..., k:]
        within = good[k:] & (move[k:] == move[: move.size - k])
        found.append((first * last) @ within.astype(float))
    return np.stack(found, axis=-1) / float(np.sum(good))


def _autoregression(lags: Real, values: int) -> Whitener:
    """Solve Yule and Walker's equations for the order of least ``N log(sigma^2) + 2 p``."""
    # A ridge of 1e-6 keeps what the low-pass has taken away from being blown up.
    lags = lags * np.where(np.arange(lags.size) == 0, 1.0 + 1e-6, 1.0)
    best, found = math.inf, Whitener(np.zeros(0), math.sqrt(max(float(lags[0]), 1e-300)))
    for order in range(1, lags.size):
        coefficients = np.asarray(linalg.solve_toeplitz(lags[:order], -lags[1 : order + 1]))
        power = max(float(lags[0] + coefficients @ lags[1 : order + 1]), 1e-300)
        merit = values * math.log(power) + 2.0 * order
        if merit < best:
            best, found = merit, Whitener(coefficients, math.sqrt(power))
    return found


def _orthonormal(columns: Real) -> Real:
    if columns.shape[1] == 0:
        return columns
    scale = np.sqrt(np.mean(np.square(columns), axis=0))
    left, singular, _ = np.linalg.svd(columns[:, scale > 0.0] / scale[scale > 0.0], full_matrices=False)
    return np.asarray(left[:, singular > 1e-10 * singular[0]])


def reference(m: Motion) -> Real:
    """Return the regressors of the reference, shape (n, k): N for unit coefficients."""
    speed = np.abs(m.velocity) / np.abs(m.velocity).max()
    place = (m.position - m.position.min()) / max(float(np.ptp(m.position)), 1e-300)
    columns = [m.acceleration, m.jerk, m.snap, *(m.sliding(d) for d in _SLIDES)]
    columns += [m.time, m.time * m.velocity]
    for way in (m.velocity > 0.0, m.velocity <= 0.0):
        columns += [way * hat for hat in _hats(speed, RULES.reference_speeds)]
        columns += [way * hat for hat in _hats(place, np.linspace(0.0, 1.0, RULES.reference_positions))]
    return np.stack(columns, axis=1)


def _hats(x: Real, nodes: Sequence[float] | Real) -> list[Real]:
    unit = np.eye(len(nodes))
    return [np.interp(x, nodes, row) for row in unit]


def residual(regressors: Real, response: Real) -> Real:
    """Return what least squares leaves of the response; columns may depend on each other."""
    scale = np.sqrt(np.mean(np.square(regressors), axis=0))
    scale[scale == 0.0] = 1.0
    solution = np.linalg.lstsq(regressors / scale, response, rcond=1e-10)[0]
    return np.asarray(response - (regressors / scale) @ solution)


def usable_band(
    force: Real, left: Real, step: float, highest: float, runs: Sequence[int], above: float = RULES.above_noise
) -> float:
    """Return the frequency [Hz] up to which the force stands `above` what the reference leaves, at most `highest`.

    Power densities with a resolution of 5 Hz, the mean over runs of values without a gap, each the median of three
    neighbours.
    """
    size = min(round(1.0 / (RULES.resolution * step)), *runs)
    total = np.zeros((2, size // 2 + 1))
    for values in np.split(np.stack([force, left]), np.cumsum(runs)[:-1], axis=1):
        f, density = signal.welch(values, 1.0 / step, nperseg=size)
        total += values.shape[1] * density
    ratio = signal.medfilt(total[0] / np.maximum(total[1], 1e-300), 3)[1:-1]
    low = np.flatnonzero(ratio < above)
    return float(min(f[1:-1][low[0]] if low.size else highest, highest))


def unbroken(runs: Sequence[int], order: int) -> Real:
    """Return 1 for each whitened value whose `order` values before are of its own run without a gap, else 0."""
    found = np.ones(sum(runs) - order)
    for joint in np.cumsum(runs)[:-1]:
        found[max(joint - order, 0) : joint] = 0.0
    return found


def strongest_wave(
    phase: Real,
    left: Real,
    whitener: Whitener,
    lowest: float,
    highest: float,
    runs: Sequence[int] = (),
    passed: Callable[[Real], Real] = np.ones_like,
) -> tuple[float, float] | None:
    """Return the wave that explains most of a residual [N], in cycles per second or metre, and its p-value.

    Least squares of cosine and sine over the phase, time [s] or position [m], in the whitened residual. Noise reaches
    twice ``z`` somewhere between the lowest and the highest wave with a probability of ``W sqrt(z) exp(-z)``, ``W =
    (highest - lowest) sqrt(4 pi var(phase))`` (Baluev, MNRAS 385, 2008), which pays for looking everywhere. None where
    there is no room between lowest and highest. `runs` are numbers of values that follow each other without a gap;
    `passed` is what the residual has of a wave of so many cycles from value to value: of a ripple at speed nothing.
    """
    waves = np.arange(lowest, highest, 0.2 / max(float(np.ptp(phase)), 1e-300))
    if waves.size == 0:
        return None
    used = unbroken(runs or (left.size,), whitener.order)
    white = whitener(left) * used
    white = white / math.sqrt(float(np.sum(np.square(white)) / np.sum(used)))
    waves = waves[np.argsort(-_roughly(waves, phase, white, whitener, used))[: RULES.hopeful]]
    parts = np.array_split(waves, waves.size * phase.size // RULES.at_once + 1)
    power = np.concatenate([_powers(part, phase, white, whitener, used, passed) for part in parts])
    best = int(np.argmax(power))
    z = max(0.5 * float(power[best]), 1.0)
    width = (highest - lowest) * math.sqrt(4.0 * math.pi * float(np.var(phase)))
    return float(waves[best]), min(1.0, max(width * math.sqrt(z), 1.0) * math.exp(-z))


def _roughly(waves: Real, phase: Real, white: Real, whitener: Whitener, used: Real) -> Real:
    """Return about what `_powers` gives of evenly spaced waves, from one Fourier transform over bins of the phase.

    Cosine and sine count as orthogonal and as large as the whitener makes a wave of their frequency at each value.
    """
    spacing, begin = float(waves[1] - waves[0]) if waves.size > 1 else 1.0, float(phase.min())
    count = round(1.0 / (spacing * np.ptp(phase))) * math.ceil(RULES.bins * float(np.ptp(phase)) * float(waves[-1]))
    width = 1.0 / (spacing * count)
    place = np.rint((phase - begin) / width).astype(np.int64)
    binned = np.bincount(place, weights=np.convolve(white, whitener.taps[::-1], mode="full"), minlength=count)
    moment = np.interp(waves, spacing * np.arange(count // 2 + 1), np.abs(np.fft.rfft(binned, count)))
    turns = np.sort(np.abs(np.diff(phase))[whitener.order - 1 :][used > 0.0])
    response = np.zeros(waves.size)
    for part in np.array_split(turns, RULES.speeds):
        _, gain = signal.freqz(whitener.taps, 1.0, 2.0 * math.pi * np.mod(waves * np.mean(part), 1.0))
        response += 0.5 * part.size * np.square(np.abs(gain))
    return np.asarray(np.square(moment) / np.maximum(response, 1e-300))


def _powers(
    waves: Real, phase: Real, white: Real, whitener: Whitener, used: Real, passed: Callable[[Real], Real]
) -> Real:
    """Decrease of the squares of a white residual by cosine and sine of each wave."""
    through = passed(np.outer(waves, np.abs(np.gradient(phase))))
    wave = through * np.exp(2j * math.pi * np.outer(waves, phase))
    wave = signal.oaconvolve(wave, whitener.taps[None, :], mode="valid", axes=1)
    cosine, sine = wave.real * used, wave.imag * used
    cc, ss, cs = (np.einsum("kn,kn->k", a, b) for a, b in ((cosine, cosine), (sine, sine), (cosine, sine)))
    c, s = cosine @ white, sine @ white
    return np.asarray((ss * c * c - 2.0 * cs * c * s + cc * s * s) / np.maximum(cc * ss - cs * cs, 1e-300))


def boxes(left: Real, whitener: Whitener, time: Real, runs: Sequence[int]) -> tuple[tuple[float, float, float], ...]:
    """Return begin, end [s] and sign of the boxes that noise does not explain; none as a rule.

    Boxes of 50, 100, 200 and 400 ms are moved over the residual [N]; of the width that stands out most, all beyond 5.5
    standard deviations that do not overlap, as noise of a hundred thousand places has but once in a hundred times.
    """
    step, used = float(time[1] - time[0]), unbroken(runs, whitener.order)
    white = whitener(left) * used
    white = white / math.sqrt(float(np.sum(np.square(white)) / np.sum(used)))
    score = np.correlate(white, whitener.taps[::-1], mode="full")
    best, found, width = RULES.stands_out, np.zeros(0), 0
    for seconds in (0.05, 0.1, 0.2, 0.4):
        n = max(round(seconds / step), 1)
        if 2 * n < left.size:
            size = float(np.linalg.norm(np.convolve(np.ones(n), whitener.taps)))
            sums = np.convolve(score, np.ones(n), mode="valid") / size
            if float(np.max(np.abs(sums))) > best:
                best, found, width = float(np.max(np.abs(sums))), sums, n
    out = []
    while found.size and np.max(np.abs(found)) > RULES.stands_out:
        k = int(np.argmax(np.abs(found)))
        out.append((float(time[k]), float(time[k + width - 1]) + step, math.copysign(1.0, found[k])))
        found[max(k - width + 1, 0) : k + width] = 0.0
    return tuple(sorted(out))


# --- How well the noise of a drive record is known: noises that the same few moves could as well have come from.


@dataclass(frozen=True)
class NoiseDraw:
    """One noise that the moves could have come from."""

    above: Real
    below: Real  # shape (p + 1,): filter from white noise to the whitened values that it would give
    size: dict[object, float]  # kind of move -> its standard deviation over that of the whitener

    def coloured_products(self, columns: Real) -> Real:
        """Return ``H^T X``, whose squares are the covariance of ``X^T e`` with ``e = H white``; X of shape (n, m)."""
        padded = np.concatenate([columns[::-1], np.zeros((RULES.fades, columns.shape[1]))])
        return np.asarray(signal.lfilter(self.above, self.below, padded, axis=0))


def noise_draws(
    whitener: Whitener, residuals: Sequence[Real], regressors: Real, kinds: Sequence[object]
) -> tuple[NoiseDraw, ...]:
    """Learn a whitener again from records that it would give: what the reference left in each move, and its kind."""
    below = np.concatenate(([1.0], whitener.coefficients))
    expected: dict[object, float] = {}
    for kind, left_over in zip(kinds, degrees_of_freedom_left(whitener, residuals, regressors), strict=True):
        expected[kind] = expected.get(kind, 0.0) + left_over
    found = []
    for again, moves in learned_again(whitener, residuals, regressors, RULES.noise_draws):
        if not again.stable:
            continue
        squares = dict.fromkeys(expected, 0.0)
        for kind, left in zip(kinds, moves, strict=True):
            squares[kind] += float(np.sum(np.square(again(left))))
        size = {kind: float(np.sqrt(expected[kind] / squares[kind])) for kind in expected}
        above = np.concatenate(([1.0], again.coefficients)) * whitener.sigma / again.sigma
        found.append(NoiseDraw(above, below, size))
    return tuple(found)
