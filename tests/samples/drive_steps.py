"""Drive records beyond what a diagnosis asks: the force error cause by cause, and what a record repeats."""

import math
from dataclasses import dataclass, replace

import numpy as np

from smfe.diagnosis.drive import noise
from smfe.diagnosis.drive.balance import Channels, kind_of
from smfe.diagnosis.drive.filters import motion
from smfe.diagnosis.drive.noise import noise_draws
from smfe.diagnosis.drive.rules import RULES
from smfe.diagnosis.inference.fit import Target, fit
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.judgement.hypotheses import Bench
from smfe.progress import silent


@dataclass(frozen=True)
class ForceStep:
    """All values and the misfit of a joint fit; rms force error over rms force of the record, and of held-out ones."""

    values: dict
    chi2: float
    error: float
    held_out: tuple


def force_steps(family, causes, held_out=()):
    """Fit the baseline as it is declared and then one cause more at a time, everything anew each time.

    A cause may be the id of declared parameters (`Parameter.given`), which are then released.
    """
    given = {p.given for p in family.nuisances if p.given}
    released, taken, at, steps = [], [], None, []
    for cause in ("", *causes):
        released += [cause] if cause in given else []
        names = [p.name for p in family.nuisances if p.given in released]
        model = Model(family, family.conditions, None, names, given - set(released))
        target = Target({r: c.observed for r, c in enumerate(model.conditions)}, model.null())
        bench = Bench(model, target, 0, silent)
        if at is None:
            at = bench.null()
        else:
            at = fit(model, target, tuple(taken), at.u)
            bench.fits[at.causes] = at
        if cause and cause not in given:
            taken.append([c.key for c in model.causes].index(cause))
            taken.sort()
            at = bench.confirmed(bench.extend(at, [k for k in taken if k not in at.causes]))
        assert at.converged, (cause, at.reason)
        values = model.values(at.u)
        others = tuple(other.force_error(values) for other in held_out)
        steps.append(ForceStep(values, at.chi2, family.force_error(values), others))
    return tuple(steps)


def repeat_lag(position):
    """Return after how many samples a record of positions repeats itself to 0.1 % of its stroke (rms)."""
    n = position.size
    x = position - position.mean()
    size = 2 ** math.ceil(math.log2(2 * n))
    together = np.fft.irfft(np.abs(np.fft.rfft(x, size)) ** 2, size)[:n]
    squares = np.concatenate(([0.0], np.cumsum(x**2)))
    lags = np.arange(n // 2 + 1)
    apart = squares[n] - squares[lags] + squares[n - lags] - 2.0 * together[lags]
    rms = np.sqrt(np.maximum(apart, 0.0) / (n - lags)) / np.ptp(x)
    left = np.flatnonzero(rms > 1e-2)[0]
    inner = np.flatnonzero(rms[left:] < 1e-3) + left
    run = inner[: np.flatnonzero(np.diff(inner, append=n) > 1)[0] + 1]
    return int(run[np.argmin(rms[run])])


class Repeats:
    """A record that repeats its moves, with a model of it: residuals of a move, and of the same move earlier."""

    def __init__(self, record, axis, family, values):
        self.family, self.values, self.raw = family, values, Channels.read(record, axis)
        self.lag = repeat_lag(self.raw.position)
        self.moving = motion(self.raw.position, self.raw.step, 2.0 * family.model.resampler.cutoff)

    def residual(self, condition, lag):
        """Return force - model of a move [N], `lag` samples earlier; None where the record has nothing there."""
        data, filter_ = condition.data, self.family.model.resampler
        first = round((data.motion.time[0] - self.moving.time[0]) / self.raw.step) - lag
        if first < filter_.margin or first + data.drive.size > self.raw.force.size - filter_.margin:
            return None
        part = slice(first, first + data.drive.size)
        there = replace(data, motion=self.moving[part], drive=self.raw.force[part])
        return filter_(there.drive) - self.family.force(there, self.values)

    def _pairs(self, conditions):
        pairs = [(c, self.residual(c, 0), self.residual(c, self.lag)) for c in conditions]
        return [(c, a, b) for c, a, b in pairs if a is not None and b is not None]

    def repeatability(self):
        """Return period [s], rms between repeats for one of them [N], and rms that the model leaves every time [N]."""
        pairs = self._pairs(self.family.conditions)
        scatter = 0.5 * np.mean(np.square(np.concatenate([a - b for _, a, b in pairs])))
        whole = np.mean(np.square(np.concatenate([a for _, a, _ in pairs])))
        return self.lag * self.raw.step, math.sqrt(scatter), math.sqrt(max(whole - scatter, 0.0))

    def since_first_half(self):
        """Return the family whose baseline is the model with what it left of each move in the first half.

        The noise is that between repeats within the first half: two of them differ by the scatter of both.
        """
        differences = [(c, a - b) for c, a, b in self._pairs(self._half("first half"))]
        whitener = noise.fit_whitener([d for _, d in differences])
        kinds, none = [kind_of(c.settings) for c, _ in differences], np.zeros((sum(d.size for _, d in differences), 0))
        draws = noise_draws(whitener, [d for _, d in differences], none, kinds)
        squares = {}
        for c, d in differences:
            squares.setdefault(kind_of(c.settings), []).extend(np.square(whitener(d))[self._used(c, whitener)])
        every = np.mean(np.concatenate(list(squares.values())))
        back = self.lag * math.ceil(0.5 * self.raw.force.size / self.lag - 0.5)
        found = []
        for c in self._half("second half"):
            before = self.residual(c, back)
            if before is not None:
                size = math.sqrt(np.mean(squares.get(kind_of(c.settings), every)))
                used = self._used(c, whitener)
                observed = whitener(c.data.force - before)[used] / size
                found.append(replace(c, observed=observed, data=replace(c.data, noise=size, used=used), source=""))
        model = replace(self.family.model, whitener=whitener, draws=draws)
        return replace(self.family, model=model, conditions=tuple(found))

    def _used(self, condition, whitener):
        """Return which values count behind another whitener: where it stands nothing is read from the force."""
        filter_, moving = self.family.model.resampler, ~condition.data.motion.standing
        return filter_(moving.astype(float))[whitener.order :] >= RULES.least_moving

    def _half(self, source):
        return [c for c in self.family.conditions if c.source == source]
