"""Forces over time that excite an axis: hits, stepped sines, sweeps, multisines, binary sequences, sums, late ones."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from process.errors import InputError
from process.types import Real

_PIECE = 8192


def _positive(unit: str, **values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < math.inf:
            raise InputError(f"the {name} is {value:g} {unit}; it must be positive")


def _timing(amplitude: float, start: float) -> None:
    if not math.isfinite(amplitude) or not 0.0 <= start < math.inf:
        raise InputError(
            f"a force of {amplitude:g} N from {start:g} s on; the force must be finite, the start not negative"
        )


def _periods(periods: int) -> None:
    if periods < 1 or periods != int(periods):
        raise InputError(f"{periods} periods; give a whole number from 1 up")


class Excitation(ABC):
    """A force as a function of time: on the tip, or added to the force of the servo."""

    @abstractmethod
    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s], shape (n,)."""

    @property
    @abstractmethod
    def shortest(self) -> float:
        """Shortest event [s] that the step has to resolve."""

    @property
    @abstractmethod
    def end(self) -> float:
        """Time [s] after which there is no force."""

    def jumps(self) -> tuple[Real, Real]:
        """Return the times [s], rising, at which a force that is held changes, and by how much [N]; by default none.

        From a jump on, `force` has its later value.
        """
        return np.zeros(0), np.zeros(0)


@dataclass(frozen=True)
class HalfSine(Excitation):
    """Hammer hit: a half-sine pulse of given impulse and duration; its peak is ``pi/2 impulse/duration``.

    Parameters
    ----------
    impulse : float
        [N s]. On an idle axis this, not the peak force, decides whether the carriage breaks away.
    duration : float, optional
        Contact time [s].
    start : float, optional
        [s]; the low-pass of the record needs some samples before the hit.
    """

    impulse: float
    duration: float = 4e-3
    start: float = 0.02

    def __post_init__(self) -> None:
        """Refuse a pulse that does not last."""
        if not (0.0 < self.duration < math.inf and 0.0 <= self.start < math.inf and math.isfinite(self.impulse)):
            raise InputError(
                f"a pulse of {self.impulse:g} N s, {self.duration:g} s long, at {self.start:g} s; "
                "the duration must be positive, the start not negative, and all finite"
            )

    @classmethod
    def from_peak(cls, peak: float, duration: float = 4e-3, start: float = 0.02) -> HalfSine:
        """Return the pulse of a peak force [N]; its impulse is ``2/pi peak duration``."""
        return cls(2.0 / math.pi * peak * duration, duration, start)

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s]."""
        u = (np.asarray(time, dtype=float) - self.start) / self.duration
        inside = (u > 0.0) & (u < 1.0)
        peak = 0.5 * np.pi * self.impulse / self.duration
        return np.where(inside, peak * np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0)

    @property
    def shortest(self) -> float:
        """The pulse [s]."""
        return self.duration

    @property
    def end(self) -> float:
        """End of the pulse [s]."""
        return self.start + self.duration


@dataclass(frozen=True)
class SteppedSine(Excitation):
    """Actuator: a sine of constant amplitude, phase-continuous from step to step.

    Parameters
    ----------
    frequencies : tuple of float
        Frequency of each step [Hz].
    amplitude : float
        [N].
    dwell : float
        Time a step [s].
    start : float, optional
        [s].
    """

    frequencies: tuple[float, ...]
    amplitude: float
    dwell: float = 1.5
    start: float = 0.02

    def __post_init__(self) -> None:
        """Refuse a sine without frequency or time."""
        if not self.frequencies or not all(0.0 < v < math.inf for v in (*self.frequencies, self.dwell)):
            raise InputError(
                f"frequencies {self.frequencies} Hz for {self.dwell:g} s each; all must be positive and finite"
            )
        _timing(self.amplitude, self.start)

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s], ``A sin(2 pi int f dt)``."""
        f = np.asarray(self.frequencies)
        turns = np.concatenate([[0.0], np.cumsum(f * self.dwell)])
        u = (time - self.start) / self.dwell
        k = np.clip(np.floor(u).astype(int), 0, f.size - 1)
        inside = (u >= 0.0) & (u < f.size)
        phase = 2.0 * np.pi * (turns[k] + f[k] * (u - k) * self.dwell)
        return np.where(inside, self.amplitude * np.sin(phase), 0.0)

    @property
    def shortest(self) -> float:
        """Half a period of the highest frequency [s]."""
        return 0.5 / max(self.frequencies)

    @property
    def end(self) -> float:
        """End of the last step [s]."""
        return self.start + self.dwell * len(self.frequencies)


@dataclass(frozen=True)
class HammerHits(Excitation):
    """Hammer train: equal half-sine pulses at chosen times; pulses that overlap add up.

    Parameters
    ----------
    impulse : float
        Of each hit [N s].
    times : tuple of float
        Start of each hit [s].
    duration : float, optional
        Contact time of a hit [s].
    """

    impulse: float
    times: tuple[float, ...]
    duration: float = 4e-3

    def __post_init__(self) -> None:
        """Refuse a train without hits, and pulses that are none."""
        if not self.times:
            raise InputError("a hammer train without hits; give the time of at least one")
        _ = self.hits  # Each checks itself.

    @property
    def hits(self) -> tuple[HalfSine, ...]:
        """The single hits."""
        return tuple(HalfSine(self.impulse, self.duration, start) for start in self.times)

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s]."""
        return _total(self.hits, time)

    @property
    def shortest(self) -> float:
        """A pulse [s]."""
        return self.duration

    @property
    def end(self) -> float:
        """End of the last pulse [s]."""
        return max(self.times) + self.duration


@dataclass(frozen=True)
class Sum(Excitation):
    """Several excitations at once: two tones, hits on a multisine.

    Parameters
    ----------
    parts : tuple of Excitation
        What is added up.
    """

    parts: tuple[Excitation, ...]

    def __post_init__(self) -> None:
        """Refuse a sum of nothing."""
        if not self.parts:
            raise InputError("a sum of no excitations; give at least one")

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s]."""
        return _total(self.parts, time)

    def jumps(self) -> tuple[Real, Real]:
        """Return the times [s] of the jumps of all parts, and their heights [N]."""
        times, heights = (np.concatenate(v) for v in zip(*(part.jumps() for part in self.parts), strict=True))
        order = np.argsort(times)
        return times[order], heights[order]

    @property
    def shortest(self) -> float:
        """Shortest event of all parts [s]."""
        return min(part.shortest for part in self.parts)

    @property
    def end(self) -> float:
        """End of the last part [s]."""
        return max(part.end for part in self.parts)


@dataclass(frozen=True)
class Late(Excitation):
    """An excitation that acts some time after it was asked for: behind a dead time.

    Parameters
    ----------
    asked : Excitation
        As it was asked for.
    delay : float
        [s].
    """

    asked: Excitation
    delay: float

    def __post_init__(self) -> None:
        """Refuse what would come too early."""
        if not 0.0 <= self.delay < math.inf:
            raise InputError(f"a force comes {self.delay:g} s late; give zero or more")

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s]."""
        return self.asked.force(np.asarray(time, dtype=float) - self.delay)

    def jumps(self) -> tuple[Real, Real]:
        """Return the times [s] of the jumps, and their heights [N]."""
        times, heights = self.asked.jumps()
        return times + self.delay, heights

    @property
    def shortest(self) -> float:
        """Shortest event [s]."""
        return self.asked.shortest

    @property
    def end(self) -> float:
        """When the last of it has come [s]."""
        return self.asked.end + self.delay


def _total(parts: Sequence[Excitation], time: Real) -> Real:
    total = np.zeros(np.shape(time))
    for part in parts:
        total += part.force(time)
    return total


@dataclass(frozen=True)
class Chirp(Excitation):
    """Sweep whose frequency changes linearly with time, ``A w(t) sin(2 pi (f1 t + (f2 - f1) t^2/(2 T)))``.

    The window w rises and falls as half a cosine at both ends.

    Parameters
    ----------
    first, last : float
        Frequency at the start and at the end [Hz]; the sweep may fall.
    amplitude : float
        [N].
    duration : float
        T [s].
    taper : float, optional
        Length of each tapered end [s]; zero is none.
    start : float, optional
        [s].
    """

    first: float
    last: float
    amplitude: float
    duration: float
    taper: float = 0.0
    start: float = 0.02

    def __post_init__(self) -> None:
        """Refuse a sweep without frequency, time, or untapered middle."""
        _positive("Hz", first=self.first, last=self.last)
        _positive("s", duration=self.duration)
        _timing(self.amplitude, self.start)
        if not 0.0 <= self.taper <= 0.5 * self.duration:
            raise InputError(
                f"a taper of {self.taper:g} s at each end of a sweep of {self.duration:g} s; give zero to half of it"
            )

    def frequency(self, time: Real) -> Real:
        """Return the frequency [Hz] at times [s] of the sweep."""
        u = (np.asarray(time, dtype=float) - self.start) / self.duration
        return np.asarray(self.first + (self.last - self.first) * u)

    def _turns(self, u: Real) -> Real:
        """Periods done at the share u of the duration."""
        return np.asarray(self.duration * (self.first * u + 0.5 * (self.last - self.first) * u**2))

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s]."""
        u = np.clip((np.asarray(time, dtype=float) - self.start) / self.duration, 0.0, 1.0)
        inside = (u > 0.0) & (u < 1.0)
        # Distance from the nearer end, in tapers: a taper of zero leaves the inside at 1.
        edge = np.minimum(u, 1.0 - u) * self.duration / max(self.taper, 1e-300)
        window = 0.5 - 0.5 * np.cos(np.pi * np.minimum(edge, 1.0))
        return np.where(inside, self.amplitude * window * np.sin(2.0 * np.pi * self._turns(u)), 0.0)

    @property
    def shortest(self) -> float:
        """Half a period of the highest frequency [s]."""
        return 0.5 / max(self.first, self.last)

    @property
    def end(self) -> float:
        """End of the sweep [s]."""
        return self.start + self.duration


@dataclass(frozen=True)
class LogarithmicChirp(Chirp):
    """Sweep with equal time an octave: ``f(t) = f1 (f2/f1)^(t/T)``, phase ``2 pi f1 T/ln(f2/f1) [(f2/f1)^(t/T) - 1]``.

    Parameters are those of `Chirp`.
    """

    def frequency(self, time: Real) -> Real:
        """Return the frequency [Hz] at times [s] of the sweep."""
        u = (np.asarray(time, dtype=float) - self.start) / self.duration
        return np.asarray(self.first * (self.last / self.first) ** u)

    def _turns(self, u: Real) -> Real:
        rate = math.log(self.last / self.first)
        if rate == 0.0:
            return np.asarray(self.first * self.duration * u)
        return np.asarray(self.first * self.duration * np.expm1(rate * u) / rate)


def all_harmonics(lowest: int, highest: int) -> tuple[int, ...]:
    """Return the harmonics lowest to highest for a `Multisine`."""
    if not 1 <= lowest <= highest:
        raise InputError(f"harmonics {lowest} to {highest}; give 1 <= lowest <= highest")
    return tuple(range(lowest, highest + 1))


def odd_harmonics(lowest: int, highest: int) -> tuple[int, ...]:
    """Return the odd harmonics lowest to highest: the even lines of the response then show even distortion alone."""
    odd = tuple(k for k in all_harmonics(lowest, highest) if k % 2)
    if not odd:
        raise InputError(f"no odd harmonic from {lowest} to {highest}; widen the band")
    return odd


def odd_random_harmonics(lowest: int, highest: int, group: int = 4, seed: int = 0) -> tuple[int, ...]:
    """Return odd harmonics of which one in each group of `group` is left out at random.

    The lines left out detect odd distortion, the even ones even distortion (Pintelon and Schoukens 2012, 4.3).
    """
    odd = odd_harmonics(lowest, highest)
    if not 2 <= group <= len(odd):
        raise InputError(f"groups of {group} among {len(odd)} odd harmonics; give 2 to {len(odd)}")
    rng = np.random.default_rng(seed)
    omitted = {odd[i + int(rng.integers(group))] for i in range(0, len(odd) - group + 1, group)}
    return tuple(k for k in odd if k not in omitted)


@dataclass(frozen=True)
class Multisine(Excitation):
    """Sum of equal cosines with random phases, exactly periodic: ``A sum_k cos(2 pi k f0 t + phi_k)``.

    Parameters
    ----------
    fundamental : float
        f0 [Hz]; the period is 1/f0.
    harmonics : tuple of int
        k, rising: `all_harmonics`, `odd_harmonics`, `odd_random_harmonics`, or any other.
    rms : float
        Root mean square of the force [N]; ``A = rms sqrt(2/n)`` for n harmonics.
    periods : int, optional
        Number of periods.
    seed : int, optional
        Of the phases, uniform from 0 to 2 pi.
    start : float, optional
        [s].
    """

    fundamental: float
    harmonics: tuple[int, ...]
    rms: float
    periods: int = 1
    seed: int = 0
    start: float = 0.02

    def __post_init__(self) -> None:
        """Refuse a grid without lines."""
        _positive("Hz", fundamental=self.fundamental)
        _periods(self.periods)
        _timing(self.rms, self.start)
        k = np.asarray(self.harmonics)
        if not k.size or not np.issubdtype(k.dtype, np.integer) or k[0] < 1 or np.any(np.diff(k) < 1):
            raise InputError(f"harmonics {self.harmonics}; give whole numbers from 1 up, rising, each once")

    @property
    def period(self) -> float:
        """Period [s], ``1/f0``."""
        return 1.0 / self.fundamental

    @property
    def frequencies(self) -> Real:
        """Frequencies that are excited [Hz]."""
        return self.fundamental * np.asarray(self.harmonics, dtype=float)

    @property
    def detection_lines(self) -> Real:
        """Frequencies up to the highest that are not excited [Hz]: a linear axis does not respond there."""
        silent = np.setdiff1d(np.arange(1, self.harmonics[-1] + 1), self.harmonics)
        return np.asarray(self.fundamental * silent)

    @property
    def phases(self) -> Real:
        """Phase of each harmonic [rad]."""
        return np.asarray(np.random.default_rng(self.seed).uniform(0.0, 2.0 * np.pi, len(self.harmonics)))

    @property
    def crest_factor(self) -> float:
        """Peak over root mean square [1], on a grid of 16 points in the shortest period."""
        one = np.arange(16 * self.harmonics[-1]) / (16 * self.harmonics[-1])
        return float(np.abs(self._periodic(one)).max()) / abs(self.rms)

    def _periodic(self, turn: Real) -> Real:
        """Force [N] at shares of the period in [0, 1): Horner's rule in ``exp(2 pi j turn)``."""
        coefficient = np.zeros(self.harmonics[-1] + 1, dtype=np.complex128)
        coefficient[list(self.harmonics)] = self.rms * math.sqrt(2.0 / len(self.harmonics)) * np.exp(1j * self.phases)
        out = np.empty(turn.size)
        # In pieces that stay in the cache.
        for i in range(0, turn.size, _PIECE):
            z = np.exp(2j * np.pi * turn[i : i + _PIECE])
            value = np.zeros_like(z)
            for c in coefficient[::-1]:
                value *= z
                value += c
            out[i : i + _PIECE] = value.real
        return out

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s]."""
        turn = (np.asarray(time, dtype=float) - self.start) * self.fundamental
        inside = (turn >= 0.0) & (turn < self.periods)
        out = np.zeros(turn.shape)
        out[inside] = self._periodic(turn[inside] % 1.0)
        return out

    @property
    def shortest(self) -> float:
        """Half a period of the highest frequency [s]."""
        return 0.5 / float(self.frequencies[-1])

    @property
    def end(self) -> float:
        """End of the last period [s]."""
        return self.start + self.periods * self.period


@dataclass(frozen=True)
class PseudoRandom(Excitation):
    """Binary sequence of maximum length, ``+-A``, held between clock ticks.

    A register of n bits gives ``N = 2^n - 1`` ticks a period; sampled once a tick, the autocorrelation over A^2 is 1 at
    lag 0 and -1/N at any other. The line k/(N T) of the held signal has the power
    ``2 A^2 (N + 1)/N^2 sinc(k/N)^2`` (one-sided): empty at multiples of the clock.

    Parameters
    ----------
    amplitude : float
        A [N].
    clock : float
        Ticks a second [Hz], 1/T; the power falls by 3 dB at 0.44 of it.
    register : int
        Bits n, 2 to 20.
    periods : int, optional
        Number of periods.
    start : float, optional
        [s].
    """

    amplitude: float
    clock: float
    register: int = 10
    periods: int = 1
    start: float = 0.02

    def __post_init__(self) -> None:
        """Refuse a sequence that there is not."""
        _positive("Hz", clock=self.clock)
        _periods(self.periods)
        _timing(self.amplitude, self.start)
        if not 2 <= self.register <= 20:
            raise InputError(f"a shift register of {self.register} bits; give 2 to 20 (a period of 2^n - 1 ticks)")

    @property
    def length(self) -> int:
        """Ticks in a period, N."""
        return int(2**self.register - 1)

    @property
    def period(self) -> float:
        """Period [s], N over the clock."""
        return self.length / self.clock

    def sequence(self) -> Real:
        """Return one period of the force [N], a value a tick, shape (N,)."""
        bits = signal.max_len_seq(self.register)[0]
        return np.asarray(self.amplitude * (2.0 * bits - 1.0))

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s]."""
        # A time that is a tick but for rounding belongs to the tick.
        tick = np.floor((np.asarray(time, dtype=float) - self.start) * self.clock + 1e-6).astype(int)
        inside = (tick >= 0) & (tick < self.periods * self.length)
        return np.where(inside, self.sequence()[tick % self.length], 0.0)

    def jumps(self) -> tuple[Real, Real]:
        """Return the ticks [s] at which the force changes, with the first and the last, and by how much [N]."""
        held = np.concatenate([[0.0], np.tile(self.sequence(), self.periods), [0.0]])
        change = np.diff(held)
        at = np.flatnonzero(change)
        return self.start + at / self.clock, change[at]

    @property
    def shortest(self) -> float:
        """One tick [s]."""
        return 1.0 / self.clock

    @property
    def end(self) -> float:
        """End of the last period [s]."""
        return self.start + self.periods * self.period
