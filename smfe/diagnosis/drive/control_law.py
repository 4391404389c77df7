"""The control law of a drive, checked without the plant: reference, encoder and drive force must obey it.

``F = Kp [Kv (r - q) - q']`` with the velocity ``q'`` from backward differences of the encoder through a short filter.
Controls add to it what machines need: an integral part, feed-forward of velocity and acceleration, compensation of
friction, and their own sampling and filters. All of that is linear in reference and encoder and is found from the
record. What is left over is a command that was not logged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import minimize_scalar

from process.errors import InputError
from process.types import Real
from smfe.diagnosis.drive.rules import RULES


@dataclass(frozen=True)
class Gains:
    """Gains of a position controller around a velocity controller."""

    position: float  # Kv [1/s]
    velocity: float  # Kp [N s/m]

    def __post_init__(self) -> None:
        """Refuse gains that are none."""
        if not (0.0 < self.position < np.inf and 0.0 < self.velocity < np.inf):
            raise InputError(
                f"position gain {self.position:g} 1/s, velocity gain {self.velocity:g} N s/m; both must be positive"
            )


@dataclass(frozen=True)
class ControlLaw:
    """A control law with its velocity filter and whatever else a control adds."""

    gains: Gains  # as documented
    taps: Real  # shape (k,): weights of the newest, the last ... backward difference [1], sum 1
    noise: float  # standard deviation of what the law leaves, from the median [N]
    whole: Real  # factors of the columns of `_columns`
    scatter: float = 0.0  # relative standard deviation of the velocity gain by least squares [1]
    smooth: bool = False
    """Whether it holds behind moving means over a turn of the mains, up to a constant: sample by sample it leaves the
    noise of the encoder's differences."""
    limit: float = math.inf  # command from which on its integral part stands still [N]

    def lag(self, step: float) -> float:
        """Return the lag of the velocity [s] behind the newest encoder value: half a step and the mean tap."""
        return step * (0.5 + float(self.taps @ np.arange(self.taps.size)))

    def uncertainty(self, whole: float) -> Gains:
        """Return the relative standard deviations of the gains that the law shows, of a force with an rms `whole` [N].

        What is left of the force is not white: a command between the samples of the log, clocks that are apart. It may
        look like a column, and the gains are off by a few times its share of the force, or of what least squares makes
        of it where the axis follows its reference so well that both say the same. With an integral part the
        position gain is one of two roots, known the less the nearer they are.
        """
        told = max(RULES.told, RULES.off * self.noise / whole, RULES.off * self.scatter)
        _, both, product = self._factors
        apart = math.sqrt(max(both**2 - 4.0 * product, 0.0))
        return Gains(told * both / max(apart, RULES.off * told * both), told)

    def tells(self, whole: float) -> bool:
        """Whether the law shows gains that can be held against the documented ones, of a force with an rms [N]."""
        return self.plausible and self.uncertainty(whole).velocity <= RULES.vague

    @property
    def plausible(self) -> bool:
        """Whether the factors are those of a control."""
        velocity, both, product = self._factors
        return velocity > 0.0 and both > 0.0 and product >= 0.0

    @property
    def _factors(self) -> tuple[float, float, float]:
        """Kp, and the factors of error and of its integral over it."""
        velocity = -float(self.whole[1 : 1 + RULES.taps].sum())
        if velocity == 0.0:
            return 0.0, 0.0, 0.0
        both, product = self.whole[0] / velocity, self.whole[1 + RULES.taps] / velocity
        return velocity, float(both), float(product)

    @property
    def found(self) -> Gains:
        """Gains that the record shows; of the two that an integral part allows, the nearer to the documented one."""
        # F = Kp [e_v + int e_v/Ti] with e_v = Kv e + ...: factors Kp (Kv + 1/Ti) of e and Kp Kv/Ti of its integral.
        velocity, both, product = self._factors
        apart = math.sqrt(max(both**2 - 4.0 * product, 0.0))
        documented = self.gains.position
        either = [k for k in (0.5 * (both + apart), 0.5 * (both - apart)) if k > 0.0]
        return Gains(min(either, key=lambda k: abs(k - documented), default=both), velocity)

    def left(self, reference: Real, position: Real, force: Real, step: float) -> Real:
        """Return what a command has beyond the law as it was found [N], shape (n,)."""
        found = force - _columns(reference, position, step, np.abs(force) >= self.limit) @ self.whole
        if not math.isfinite(self.limit):
            return np.asarray(found)
        # Between two samples of the log an integral part may have stood still or not, and is off by that from there on.
        count = max(round(RULES.apart / step), 1)
        blocks = np.array_split(np.arange(found.size), max(found.size // count, 1))
        middle = [float(np.mean(b)) for b in blocks]
        return np.asarray(found - np.interp(np.arange(found.size), middle, [np.median(found[b]) for b in blocks]))


@dataclass(frozen=True)
class Pulse:
    """A command that was not logged: begin and end [s from the first sample], height [N]."""

    begin: float
    end: float
    height: float


def fit_laws(
    reference: Real, position: Real, force: Real, step: float, gains: Gains
) -> tuple[ControlLaw, ControlLaw | None]:
    """Find the law of all samples, which shows what was not logged, and that of `fit_gains`, which shows its gains.

    Where the second is told and the first has another velocity gain, that has taken the axis for its control (noise of
    the encoder makes its gains look smaller): what it leaves is no command. The second stands for it, smooth.
    """
    law = fit_control_law(reference, position, force, step, gains)
    pulses = unlogged_command(law, reference, position, force, step)[1]
    for known in (pulses, ()):  # what the wrong law leaves may leave nothing to be found beside
        shown = fit_gains(reference, position, force, step, gains, known)
        if shown is not None and shown.tells(float(np.std(force))):
            same = law.plausible and abs(law.found.velocity / shown.found.velocity - 1.0) <= RULES.same_gain
            return (law if same else replace(shown, smooth=True)), shown
    return law, shown


def fit_control_law(reference: Real, position: Real, force: Real, step: float, gains: Gains) -> ControlLaw:
    """Find a control law from a record (trimmed least squares, other gains allowed).

    It starts from the documented gain of the velocity and from what else leaves the least absolute values, which a
    command that was not logged hardly moves.
    """
    if not np.any(reference - position) or not np.ptp(position):
        raise InputError("the axis does not move, or follows its reference exactly: the record says nothing of the law")
    rows, taken = slice(2 * RULES.taps, position.size - RULES.ahead), slice(1, 1 + RULES.taps)
    columns = _columns(reference, position, step)
    law = _fitted(columns[rows], force[rows], gains)
    if float(np.std((force - columns @ law.whole)[rows])) <= RULES.better * law.noise:
        return law
    # Least absolute values of an integral part may end at a law that holds most of the time. One that leaves no more
    # than that, or next to nothing of the force, all of the time is it, and no command was added; unless it has taken
    # the axis for its control, which adds what was added to the command to what the encoder says.
    plain, left = _squares(columns, force, rows, gains)
    same = abs(plain.whole[taken].sum() - law.whole[taken].sum()) <= RULES.same_gain * abs(law.whole[taken].sum())
    little = plain.noise <= RULES.better * law.noise or np.max(np.abs(left)) <= RULES.nothing * np.std(force)
    if same and little:
        return plain
    # Nor was one where most of what this leaves goes with an integral part that does not wind up, and what then remains
    # is never much more than most of the time.
    limit = _limit(reference, position, force, step, rows)
    held, left = _squares(_columns(reference, position, step, np.abs(force) >= limit), force, rows, gains)
    if held.noise <= min(RULES.held * plain.noise, _spread(left) / RULES.held):
        return replace(held, limit=limit)
    return law


def _squares(columns: Real, force: Real, rows: slice, gains: Gains) -> tuple[ControlLaw, Real]:
    """Return the law of all columns by least squares of all values, none of them left out, and what it leaves [N]."""
    scale = np.sqrt(np.mean(np.square(columns), axis=0))
    scale[scale == 0.0] = 1.0
    whole = np.linalg.lstsq((columns / scale)[rows], force[rows], rcond=1e-12)[0] / scale
    left = (force - columns @ whole)[rows]
    taps = whole[1 : 1 + RULES.taps]
    shape = taps / taps.sum() if taps.sum() else np.eye(RULES.taps)[0]
    noise = max(float(np.std(left)), RULES.floor * float(np.ptp(force)))
    return ControlLaw(gains, shape, noise, whole, _scatter(columns[rows] / scale, left, scale, whole)), left


def _limit(reference: Real, position: Real, force: Real, step: float, rows: slice) -> float:
    """Return the command from which on an integral part that stands still explains most of it [N].

    Controls hold it there, lest it winds up while the drive cannot follow (Astrom and Hagglund, PID Controllers, 1995,
    section 3.5).
    """
    some = slice(rows.start, rows.stop, max(force.size // RULES.values_absolute, 1))
    integral = slice(1 + RULES.taps, 1 + RULES.taps + RULES.integral)
    plain = _columns(reference, position, step)
    unit = np.linalg.qr((plain / np.maximum(np.max(np.abs(plain), axis=0), 1e-300))[some])[0]
    largest = float(np.max(np.abs(force)))

    def leaves(limit: float) -> float:
        """Sum of squares that is left with what a limit adds to the law."""
        own = _columns(reference, position, step, np.abs(force) >= limit)[some, integral]
        own = np.column_stack([own, force[some]])
        own = own / np.maximum(np.max(np.abs(own), axis=0), 1e-300)
        for _ in range(2):
            own = own - unit @ (unit.T @ own)
        return float(np.asarray(np.linalg.qr(own, mode="r"))[-1, -1]) ** 2

    tried = largest * np.geomspace(RULES.lowest_held, 1.0, RULES.limits_tried, endpoint=False)
    found = [leaves(x) for x in tried]
    best, ratio = int(np.argmin(found)), float(tried[1] / tried[0])
    near = minimize_scalar(leaves, bounds=(tried[best] / ratio, tried[best] * ratio), method="bounded")
    return float(near.x if near.fun < found[best] else tried[best])


def fit_gains(
    reference: Real, position: Real, force: Real, step: float, gains: Gains, pulses: Sequence[Pulse] = ()
) -> ControlLaw | None:
    """Find the law from what a band-pass leaves of a record, for its gains; away from commands that were not logged.

    None where these leave too little, or the record has no samples within what the filter takes out.

    The differences of an encoder are noisy, which makes gains look smaller (errors in variables), hum is in the logged
    force alone, and an integral part adds up what two readings of one encoder differ by. The law is linear: it holds
    behind any filter, of moving means over a turn of the mains of both kinds less one over 0.2 s too.
    """

    def passed(values: Real) -> Real:
        values = _without_mains(values, step)
        return values - uniform_filter1d(values, round(RULES.slow_mean / step), axis=0)

    reach = round(RULES.slow_mean / step)
    if reach < 3:
        return None
    used = np.zeros(position.size, dtype=bool)
    used[reach : position.size - reach : max(round(RULES.gains_every / step), 1)] = True
    for p in pulses:
        used[max(round(p.begin / step) - reach, 0) : round(p.end / step) + reach] = False
    columns, given = passed(_columns(reference, position, step)), passed(force)
    if np.count_nonzero(used) < RULES.values_each * columns.shape[1]:
        return None
    return _fitted(columns[used], given[used], gains)


def _without_mains(values: Real, step: float) -> Real:
    """Return moving means over a turn of the mains of both kinds."""
    for seconds in RULES.means:
        values = uniform_filter1d(values, max(round(seconds / step), 1), axis=0)
    return values


def _fitted(columns: Real, force: Real, gains: Gains) -> ControlLaw:
    """Return the simplest law that leaves about as little as all of them.

    An integral part with its constant would take half of a command that is there half of the time: what is left most of
    the time counts first. Of the laws that leave as little then a richer one is taken only where it leaves less of all
    values, too: a part that acts while the axis gathers speed is no command, and hardly moves a median.
    """
    scale = np.sqrt(np.mean(np.square(columns), axis=0))
    scale[scale == 0.0] = 1.0
    rest = np.arange(1 + RULES.taps, scale.size)
    floor = RULES.floor * float(np.ptp(force))
    found = []
    for kept in (rest[:0], rest[RULES.integral :], rest):
        whole, left = _solved(columns / scale, force, scale, kept, gains)
        scatter = _scatter(columns / scale, left, scale, whole)
        taps = whole[1 : 1 + RULES.taps]
        # Of one sine error and encoder say the same, and no velocity gain is told.
        shape = taps / taps.sum() if taps.sum() else np.eye(RULES.taps)[0]
        law = ControlLaw(gains, shape, max(_spread(left), floor), whole, scatter)
        found.append((law, float(np.std(left))))
    possible = [x for x in found if x[0].plausible] or found
    least = RULES.better * min(law.noise for law, _ in possible)
    usual = [x for x in possible if x[0].noise <= least]
    least = RULES.better * max(min(all_ for _, all_ in usual), floor)
    usual = [x for x in usual if x[1] <= least]
    # The laws are nested. Were the part that a simpler one lacks not there, both would find one gain within the scatter
    # of the richer (Hausman, Econometrica 46, 1978); noise may hide what biases the gain by far more.
    richest = usual[-1][0]
    told = max(RULES.vague, RULES.off * richest.scatter) * richest._factors[0] if richest.plausible else math.inf
    return next(law for law, _ in usual if abs(law._factors[0] - richest._factors[0]) <= told)


def _scatter(columns: Real, left: Real, scale: Real, whole: Real) -> float:
    """Return the relative standard deviation of the velocity gain by least squares of columns over their scale.

    Neighbours of `RULES.gains_every` share most of the moving mean that they come from.
    """
    kept = whole != 0.0
    own = columns[:, kept]
    sums = (np.isin(np.arange(scale.size), np.arange(1, 1 + RULES.taps)) / scale)[kept]
    square = float(sums @ np.linalg.pinv(own.T @ own, rcond=1e-14, hermitian=True) @ sums)
    alike = RULES.means[0] / RULES.gains_every
    velocity = abs(float(whole[1 : 1 + RULES.taps].sum()))
    return float(np.std(left)) * math.sqrt(alike * max(square, 0.0)) / velocity if velocity > 0.0 else math.inf


def _solved(columns: Real, force: Real, scale: Real, rest: NDArray[np.int64], gains: Gains) -> tuple[Real, Real]:
    """Return factors of the columns, those of `rest` besides error and encoder, and what they leave [N].

    `columns` are given over their `scale`.
    """
    # Neighbouring differences are nearly alike: an orthonormal basis of the columns stands for them. The encoder's
    # come last, so that the first rows of the basis do without.
    order = np.concatenate([[0], rest, np.arange(1, 1 + RULES.taps)])
    basis, triangle = np.linalg.qr(columns[:, order])
    size = np.abs(np.diag(triangle))
    known = size > 1e-10 * size.max()
    unit, wanted = basis[:, known], force
    floor = RULES.floor * float(np.ptp(force))
    # With the documented gain of the velocity first: what the encoder does is what the axis makes of its force, and
    # free factors of the encoder would find the axis in place of the law.
    given = -gains.velocity * scale[1] * columns[:, 1]
    others = unit[:, : np.count_nonzero(known[: order.size - RULES.taps])]
    fixed = others.T @ (gains.velocity * gains.position * scale[0] * columns[:, 0] if not rest.size else wanted - given)
    some = slice(None, None, max(wanted.size // RULES.values_absolute, 1))
    few, asked = others[some], (wanted - given)[some]
    for _ in range(RULES.absolute if rest.size else 0):
        left = asked - few @ fixed
        weight = 1.0 / np.maximum(np.abs(left), max(0.1 * _spread(left), floor))
        before, fixed = fixed, np.linalg.solve((few.T * weight) @ few, few.T @ (weight * asked))
        if np.linalg.norm(fixed - before) < 1e-9 * np.linalg.norm(fixed):
            break
    solution = unit.T @ (given + others @ fixed)
    kept = np.zeros(wanted.size, dtype=bool)
    for _ in range(20):
        left = wanted - unit @ solution
        last, kept = kept, np.abs(left) <= RULES.trim * max(_spread(left), floor)
        if np.array_equal(last, kept):
            break
        # All but a few rows of an orthonormal basis: its products are as well conditioned as it is.
        own = unit[kept]
        solution = np.linalg.lstsq(own.T @ own, own.T @ wanted[kept], rcond=1e-12)[0]
    whole = np.zeros(scale.size)
    whole[order[known]] = np.linalg.solve(triangle[np.ix_(known, known)], solution) / scale[order[known]]
    return whole, wanted - unit @ solution


def _columns(reference: Real, position: Real, step: float, held: NDArray[np.bool_] | None = None) -> Real:
    """Return what a control makes its command of, shape (n, k).

    Error; backward differences of the encoder, the newest first; its integral, the reference, what the error gathers
    while the integral is `held`, and a constant (integral part); differences of the reference about the sample, whose
    sums and differences are its velocity and acceleration (feed-forward); its direction (compensation of friction).
    """
    error = reference - position
    difference = np.diff(position, prepend=position[0]) / step
    feed = np.diff(reference, prepend=reference[0]) / step
    late = [np.concatenate([np.zeros(k), difference[: difference.size - k]]) for k in range(RULES.taps)]
    padded = np.pad(feed, (RULES.taps, RULES.ahead), mode="edge")
    around = [padded[k : k + feed.size] for k in range(RULES.taps + RULES.ahead + 1)]
    slow = RULES.rest * float(np.max(np.abs(feed)))
    way = np.tanh(feed / slow) if slow > 0.0 else np.zeros_like(feed)
    going = np.ones_like(error) if held is None else np.where(held, 0.0, 1.0)
    gathered = step * np.cumsum((feed - difference) * (1.0 - going))
    integral = step * np.cumsum(error * going), step * np.cumsum(feed * going), gathered, np.ones_like(error)
    return np.stack([error, *late, *integral, *around, way], axis=1)


def unlogged_command(
    law: ControlLaw, reference: Real, position: Real, force: Real, step: float, material: float = 0.05
) -> tuple[Real, tuple[Pulse, ...]]:
    """Return what was added to the command of the law [N], sample by sample, and its pulses.

    A pulse is what stands out by ten standard deviations of the noise, by 2 % of the highest and by a share of the rms
    of the force, `material`, for three samples or more, of medians over five that leave edges where they are, with an
    impulse of that share for 20 ms (clocks a part of a sample apart leave less where a move begins). It lasts as long
    as half of that stands out, so that noise does not break it up. Its height is the median. Of a smooth law a pulse
    lasts as long as its means are above half of it, and is as high as they become. Of a law whose integral part stands
    still at a limit only what is shorter than half a second is told.
    """
    left = law.left(reference, position, force, step)
    if law.smooth:
        left = _without_mains(left, step)
        left -= np.median(left)
    left[: 2 * RULES.taps] = 0.0
    left[left.size - RULES.ahead :] = 0.0
    size = np.abs(median_filter(left, 2 * RULES.shortest_pulse - 1))
    noise = max(law.noise, _spread(left)) if law.smooth else law.noise
    least = max(RULES.detect * noise, RULES.pulse_share * float(size.max()), material * float(np.std(force)))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], (size > 0.5 * least).astype(np.int8), [0])))).reshape(-1, 2)
    pulses = []
    for a, b in edges:
        if np.count_nonzero(size[a:b] > least) < RULES.shortest_pulse:
            continue
        part = slice(a, b)
        if law.smooth:
            high = a + np.flatnonzero(size[a:b] > 0.5 * float(size[a:b].max()))
            part = slice(int(high[0]), int(high[-1]) + 1)
        top = np.flatnonzero(size[part] > RULES.top * float(size[part].max())) if law.smooth else slice(None)
        height = float(np.median(left[part][top]))
        pulse = Pulse(float(part.start * step), float(part.stop * step), height)
        if abs(height) * (pulse.end - pulse.begin) >= RULES.shortest * material * float(np.std(force)):
            pulses.append(pulse)
    return left, tuple(pulses)


def without_line(reference: Real, position: Real, force: Real, step: float, frequency: float | None) -> Real:
    """Return a drive force [N] without the tone of a frequency [Hz] that no control law gives, shape (n,).

    Least squares of the columns of a law and of a tone whose amplitude and phase may change linearly, as they seem to
    where the frequency is a little off.
    """
    if frequency is None:
        return force
    angle = 2.0 * math.pi * frequency * step * np.arange(force.size)
    slow = np.linspace(-1.0, 1.0, force.size)
    tone = np.stack([f(angle) * x for f in (np.cos, np.sin) for x in (np.ones_like(slow), slow)], axis=1)
    columns = np.column_stack([tone, _columns(reference, position, step)])
    size = np.sqrt(np.mean(np.square(columns), axis=0))
    size[size == 0.0] = 1.0
    found = np.linalg.lstsq(columns / size, force, rcond=1e-10)[0]
    return np.asarray(force - (tone / size[:4]) @ found[:4])


def _spread(values: Real) -> float:
    """Return the standard deviation of a normal distribution with the same median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
