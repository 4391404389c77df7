"""Stages of instruments that turn a true record into a measured one: sensors, filters, clocks and converters.

A stage takes a record and returns one: those before the sampling at the rate of the simulation, those after it at that
of the record. `process.instruments.sensors.Sensors` puts them in order.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy import fft, interpolate, signal

from process.errors import InputError
from process.labels import AXES, RECORD_VECTORS, axis_index, sample_interval
from process.types import Complex, Real

Triple = tuple[float, float, float]

FINE = 8
"""Samples of the simulation for each of the record, where a stage works before the sampling."""

_SETTLED = 12.0
"""Time constants after which the response of a sensor is taken to be over."""


def _not_negative(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 <= value < math.inf:
            raise InputError(f"the {name.replace('_', ' ')} is {value:g}; it must be zero or positive")


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < math.inf:
            raise InputError(f"the {name.replace('_', ' ')} is {value:g}; it must be positive")


def _split(channel: str) -> tuple[str, list[int]]:
    """Return the vector and its rows: ``"force"`` is all three, ``"force_x"`` one."""
    if channel in RECORD_VECTORS:
        return channel, [0, 1, 2]
    vector, _, axis = channel.rpartition("_")
    if vector not in RECORD_VECTORS or axis not in AXES:
        raise InputError(
            f"channel '{channel}' is not known; give one of {', '.join(RECORD_VECTORS)}, or with _x, _y, _z"
        )
    return vector, [AXES.index(axis)]


def _changed(record: xr.Dataset, vector: str, change: Callable[[Real], Real]) -> xr.Dataset:
    """Return the record with one vector changed, shape (3, n); a record without it stays as it is."""
    if vector not in record:
        return record
    old = record[vector]
    new = old.copy(data=change(np.array(old.transpose("axis", "time").values, dtype=float)))
    return record.assign({vector: new})


class Stage(ABC):
    """One thing that an instrument does to a record."""

    @abstractmethod
    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the output for a record of force, acceleration [SI] and so on, on x, y and z."""


# --- before the sampling ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Resonance(Stage):
    """A sensor as a mass on a spring: ``1/(1 - (f/f_d)^2 + 2 j zeta f/f_d)`` on all axes of a channel.

    Parameters
    ----------
    channel : str
        "force" or "acceleration", or one axis of it.
    frequency : float
        f_d [Hz]: mounted resonance of an accelerometer, natural frequency of a dynamometer with its work.
    damping : float, optional
        zeta [1].
    """

    channel: str
    frequency: float
    damping: float = 0.02

    def __post_init__(self) -> None:
        """Refuse a frequency or damping that is not possible."""
        _split(self.channel)
        _positive(natural_frequency=self.frequency, damping=self.damping)

    def response(self, frequency: ArrayLike) -> Complex:
        """Return the complex gain [1] at frequencies [Hz]."""
        r = np.asarray(frequency, dtype=float) / self.frequency
        return np.asarray(1.0 / (1.0 - r**2 + 2j * self.damping * r))

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record as the sensor follows it."""
        settle = _SETTLED / (2.0 * math.pi * self.frequency * min(self.damping, 1.0))
        return _filtered(record, self.channel, self.response, settle)


def _filtered(record: xr.Dataset, channel: str, response: Callable[[Real], Complex], settle: float) -> xr.Dataset:
    """Multiply the spectrum of a channel by a response [1]; both ends are continued point-symmetrically by `settle`."""
    vector, rows = _split(channel)
    interval = sample_interval(record)

    def change(values: Real) -> Real:
        count = values.shape[1]
        before = min(count - 1, math.ceil(settle / interval))
        total = int(fft.next_fast_len(count + 2 * before, real=True))
        ends = (before, total - count - before)
        longer = np.pad(values[rows], ((0, 0), ends), mode="reflect", reflect_type="odd")
        gain = response(np.asarray(fft.rfftfreq(total, interval), dtype=float))
        values[rows] = fft.irfft(np.multiply(fft.rfft(longer), gain), total)[:, before : before + count]
        return values

    return _changed(record, vector, change)


@dataclass(frozen=True)
class Sensitivity(Stage):
    """Linear mixing of the axes: gain errors, cross-axis sensitivity, misalignment, wrong signs; ``measured = S true``.

    Parameters
    ----------
    channel : str
        "force" or "acceleration".
    matrix : tuple of three triples
        S; rows are what is shown, columns what there is. The unit matrix is a perfect sensor.
    """

    channel: str
    matrix: tuple[Triple, Triple, Triple]

    def __post_init__(self) -> None:
        """Refuse a matrix that is none."""
        s = np.asarray(self.matrix, dtype=float)
        if s.shape != (3, 3) or not np.all(np.isfinite(s)) or self.channel not in RECORD_VECTORS:
            raise InputError(
                f"the sensitivity of '{self.channel}' is a matrix of shape {s.shape}; a vector channel and 3 x 3 "
                "finite numbers are needed"
            )

    @classmethod
    def gains(cls, channel: str, factors: Sequence[float]) -> Sensitivity:
        """Return a sensor that multiplies each axis by a factor; -1 turns a sign."""
        return cls._of(channel, np.diag(np.asarray(factors, dtype=float)))

    @classmethod
    def rotated(cls, channel: str, axis: str, angle: float) -> Sensitivity:
        """Return a sensor turned by an angle [rad] about an axis (right hand): it reads ``R^T`` times the truth."""
        i = axis_index([axis])[0]
        j, k = (i + 1) % 3, (i + 2) % 3
        r = np.eye(3)
        r[j, j] = r[k, k] = math.cos(angle)
        r[j, k], r[k, j] = -math.sin(angle), math.sin(angle)
        return cls._of(channel, r.T)

    @classmethod
    def _of(cls, channel: str, matrix: Real) -> Sensitivity:
        one, two, three = ((float(a), float(b), float(c)) for a, b, c in matrix)
        return cls(channel, (one, two, three))

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with its axes mixed."""
        return _changed(record, self.channel, lambda values: np.asarray(self.matrix) @ values)


@dataclass(frozen=True)
class Inertia(Stage):
    """Mass between a cut and the force sensor that carries it: ``F_measured = F - m a``.

    A dynamometer reads the force on the machine behind its plate, or on the tool in it. A force sensor outside a mass
    that moves with the tool reads more than the force on the tool: `Stinger`, `HammerTip`.

    Parameters
    ----------
    mass : float
        m [kg], moving with the measured acceleration.
    """

    mass: float

    def __post_init__(self) -> None:
        """Refuse a negative mass."""
        _not_negative(mass=self.mass)

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with the inertia force taken off the force."""
        motion = record["acceleration"].values
        return _changed(record, "force", lambda force: force - self.mass * motion)


@dataclass(frozen=True)
class Stinger(Stage):
    """Mass between the force sensor of an actuator and the tool it moves with: ``F_measured = F + m a``.

    Parameters
    ----------
    mass : float
        m [kg].
    """

    mass: float

    def __post_init__(self) -> None:
        """Refuse a negative mass."""
        _not_negative(mass=self.mass)

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with the force that moves the mass put on the force."""
        motion = record["acceleration"].values
        return _changed(record, "force", lambda force: force + self.mass * motion)


@dataclass(frozen=True)
class HammerTip(Stinger):
    """Mass of a hammer's tip before its force sensor: ``F_measured = F + m a`` while it touches and moves along."""

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with the force that moves the tip put on the pulses."""
        motion = record["acceleration"].values
        return _changed(record, "force", lambda f: np.where(f != 0.0, f + self.mass * motion, 0.0))


@dataclass(frozen=True)
class Drift(Stage):
    """Offset of a channel that grows with time, as of a charge amplifier: ``rate t``.

    Parameters
    ----------
    channel : str
        "force", "acceleration", or one axis of it.
    rate : float
        [unit of the channel / s].
    """

    channel: str
    rate: float

    def __post_init__(self) -> None:
        """Refuse an unknown channel."""
        _split(self.channel)

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with the offset."""
        vector, rows = _split(self.channel)
        t = record["time"].values

        def change(values: Real) -> Real:
            values[rows] += self.rate * (t - t[0])
            return values

        return _changed(record, vector, change)


@dataclass(frozen=True)
class Tone(Stage):
    """A periodic disturbance in one channel: a pump, the mains, an unbalanced spindle.

    Parameters
    ----------
    channel : str
        One axis of a channel, "acceleration_x".
    amplitude : float
        [unit of the channel].
    frequency : float, optional
        [Hz]; give this or `order`.
    order : float, optional
        Periods a turn of the spindle: ``A cos(order angle + phase)``.
    phase : float, optional
        [rad]; default: random, from the seed.
    """

    channel: str
    amplitude: float
    frequency: float | None = None
    order: float | None = None
    phase: float | None = None

    def __post_init__(self) -> None:
        """Refuse a tone without or with two frequencies."""
        _split(self.channel)
        _not_negative(amplitude=self.amplitude)
        if (self.frequency is None) == (self.order is None):
            raise InputError(f"a tone in {self.channel} needs a frequency [Hz] or an order of the spindle, one of them")
        _positive(frequency_of_a_tone=self.frequency or self.order or 0.0)

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with the tone added; a tone locked to a spindle that does not turn is silent."""
        random = float(rng.uniform(0.0, 2.0 * math.pi))
        phase = random if self.phase is None else self.phase
        if self.order is None:
            angle = 2.0 * np.pi * (self.frequency or 0.0) * record["time"].values
        elif "spindle_angle" in record:
            angle = self.order * record["spindle_angle"].values
        else:
            return record
        vector, rows = _split(self.channel)

        def change(values: Real) -> Real:
            values[rows] += self.amplitude * np.cos(angle + phase)
            return values

        return _changed(record, vector, change)


@dataclass(frozen=True)
class AntiAlias(Stage):
    """Butterworth low-pass before the sampling, the same for force and acceleration.

    Parameters
    ----------
    order : int
        Order; the roll-off is 20 dB a decade for each.
    corner : float
        Frequency at which the gain is ``1/sqrt 2`` [Hz].
    """

    order: int
    corner: float

    def __post_init__(self) -> None:
        """Refuse an order or corner that is not possible."""
        _positive(corner=self.corner)
        if not 1 <= self.order <= 20:
            raise InputError(f"an anti-alias filter of order {self.order}; give 1 to 20")

    def response(self, frequency: ArrayLike) -> Complex:
        """Return the complex gain [1] at frequencies [Hz]."""
        _, poles, _ = signal.butter(self.order, 1.0, analog=True, output="zpk")
        s = 1j * np.asarray(frequency, dtype=float) / self.corner
        return np.asarray(1.0 / np.prod(s[..., None] - poles, axis=-1))

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with both channels low-passed."""
        slowest = math.sin(math.pi / (2 * self.order))
        settle = _SETTLED / (2.0 * math.pi * self.corner * slowest)
        for channel in ("force", "acceleration"):
            record = _filtered(record, channel, self.response, settle)
        return record


@dataclass(frozen=True)
class Clock(Stage):
    """Time base of a channel or of a second recorder: it reads at t the value of ``t (1 + rate_error) - skew``.

    Parameters
    ----------
    channel : str
        "force", "acceleration", or one axis of it.
    skew : float, optional
        [s], positive where the channel comes late.
    rate_error : float, optional
        [1]; 20e-6 where the recorder's samples lie 20 ppm too far apart.
    """

    channel: str
    skew: float = 0.0
    rate_error: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a rate error of a half or more."""
        _split(self.channel)
        if not (math.isfinite(self.skew) and abs(self.rate_error) < 0.5):
            raise InputError(
                f"a clock with a skew of {self.skew:g} s and a rate error of {self.rate_error:g}; below 0.5"
            )

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with the channel read at the shifted times; the ends are held."""
        vector, rows = _split(self.channel)
        t = record["time"].values
        shifted = np.clip(t * (1.0 + self.rate_error) - self.skew, t[0], t[-1])

        def change(values: Real) -> Real:
            for row in rows:
                values[row] = interpolate.make_interp_spline(t, values[row], k=5)(shifted)
            return values

        return _changed(record, vector, change)


# --- after the sampling -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Noise(Stage):
    """White noise and, below a corner frequency, 1/f noise: one-sided density ``rms^2/(f_s/2) (1 + f_c/f)``.

    Parameters
    ----------
    channel : str
        "force" or "acceleration".
    rms : (float, float, float)
        Root mean square of the white part in the record, each axis [unit of the channel].
    corner : float, optional
        f_c [Hz], where the 1/f part has risen to the white one; zero is white noise.
    """

    channel: str
    rms: Triple
    corner: float = 0.0

    def __post_init__(self) -> None:
        """Refuse negative noise."""
        _not_negative(**{f"noise of {self.channel}": min(self.rms)}, corner_of_the_noise=self.corner)

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with noise from the generator."""
        if self.channel not in record:
            return record
        count = record.sizes["time"]
        if self.corner == 0.0:
            noise = rng.standard_normal((3, count))
        else:
            total = int(fft.next_fast_len(2 * count, real=True))
            f = np.asarray(fft.rfftfreq(total, sample_interval(record)), dtype=float)
            f[0] = f[1]
            spectrum = np.multiply(fft.rfft(rng.standard_normal((3, total))), np.sqrt(1.0 + self.corner / f))
            noise = np.asarray(fft.irfft(spectrum, total))[:, :count]
        return _changed(record, self.channel, lambda values: values + np.asarray(self.rms)[:, None] * noise)


@dataclass(frozen=True)
class Grid(Stage):
    """Resolution of an encoder: positions are whole multiples of it.

    Parameters
    ----------
    resolution : float
        [m].
    """

    resolution: float

    def __post_init__(self) -> None:
        """Refuse a resolution that is none."""
        _positive(resolution=self.resolution)

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record with its encoder positions rounded."""
        return _changed(record, "encoder_position", lambda x: np.round(x / self.resolution) * self.resolution)


@dataclass(frozen=True)
class Converter(Stage):
    """Analogue-digital converter: clips at its range, then rounds to steps of ``2 range/2^bits``.

    Parameters
    ----------
    channel : str
        "force", "acceleration", or one axis of it.
    range : float
        Largest value either way [unit of the channel].
    bits : int, optional
        Number of bits.
    """

    channel: str
    range: float
    bits: int = 24

    def __post_init__(self) -> None:
        """Refuse a converter without range."""
        _split(self.channel)
        _positive(range_of_the_converter=self.range)
        if not 2 <= self.bits <= 48:
            raise InputError(f"a converter of {self.bits} bits; give 2 to 48")

    @property
    def step(self) -> float:
        """Value of the last bit [unit of the channel]."""
        return math.ldexp(self.range, 1 - self.bits)

    def apply(self, record: xr.Dataset, rng: np.random.Generator) -> xr.Dataset:
        """Return the record as numbers of the converter."""
        vector, rows = _split(self.channel)
        half = 2 ** (self.bits - 1)

        def change(values: Real) -> Real:
            values[rows] = np.clip(np.round(values[rows] / self.step), -half, half - 1) * self.step
            return values

        return _changed(record, vector, change)
