"""How well the axes follow a move: the price of gains that are chosen for the cut.

Position over setpoint is ``T = (a s + Kv)/s V/(B + G)`` (`smfe.tuning.loops`), a the velocity feed-forward.

* ``following``: the lag behind a ramp at constant feed, ``(1 - a) v/Kv``, of the slowest axis.
* ``circle``: a circle of radius R at feed v turns at ``w = v/R``; the radius comes out as ``|T(jw)| R``, and as an
  ellipse where the axes differ.
* ``corner``: one axis stops where the other starts; the least distance of the path from the corner. The response to a
  step of feed is ``s(t) = (2/pi) int_0^inf Re T(jw) (1 - cos w t)/w^2 dw`` (a ramp through T), T linear between the
  frequencies of the grid, the integrals of each piece in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from process.errors import InputError
from process.types import Complex, Real
from smfe.campaign.tune import MOVES

_TIMES = np.geomspace(1e-4, 4.0, 160)
"""Times after the corner at which the path is looked at [s]."""


@dataclass(frozen=True)
class Move:
    """A move and the error that counts in it.

    Parameters
    ----------
    kind : {"following", "circle", "corner"}
        What is moved.
    feed : float
        [m/s].
    radius : float, optional
        Of the circle [m].

    Raises
    ------
    InputError
        For an unknown move, a feed that is not positive, or a circle without radius.
    """

    kind: str = "following"
    feed: float = 1.0 / 60.0
    radius: float | None = None

    def __post_init__(self) -> None:
        """Refuse moves that say too little."""
        if self.kind not in MOVES:
            raise InputError(f"the move is '{self.kind}'; name one of {', '.join(MOVES)}")
        if not 0.0 < self.feed < math.inf:
            raise InputError(f"the feed of the move is {self.feed:g} m/s; it must be positive")
        if self.kind == "circle" and not (self.radius is not None and 0.0 < self.radius < math.inf):
            raise InputError("a circle needs its radius, e.g. radius='20 mm'")

    @property
    def frequency(self) -> tuple[float, ...]:
        """Frequency of the circle [Hz], none for other moves."""
        return () if self.radius is None or self.kind != "circle" else (self.feed / self.radius / (2.0 * math.pi),)

    @property
    def words(self) -> str:
        """What the error is, as a sentence begins."""
        feed = f"at {6e4 * self.feed:g} mm/min"
        if self.kind == "circle":
            return f"error of a circle of {2e3 * (self.radius or 0.0):g} mm diameter {feed}"
        return f"following error {feed}" if self.kind == "following" else f"rounding of a corner {feed}"

    def error(self, frequency: Real, follows: Complex, kv: Real, feed_forward: Real) -> Real:
        """Return the error [m], shape (c,).

        Parameters
        ----------
        frequency : ndarray, shape (f,)
            [Hz].
        follows : ndarray of complex, shape (c, a, f)
            T of each axis.
        kv, feed_forward : ndarray, shape (c, a)
            Position gain [1/s] and feed-forward [1].
        """
        lag = (1.0 - feed_forward) * self.feed / kv
        if self.kind == "following":
            return np.asarray(lag.max(axis=1))
        if self.kind == "circle":
            return self._circle(frequency, follows)
        return self._corner(frequency, follows, lag)

    def _circle(self, frequency: Real, follows: Complex) -> Real:
        assert self.radius is not None
        one = follows[:, :, int(np.argmin(np.abs(frequency - self.frequency[0])))]
        # One axis alone: the other is taken to be like it. Two: the path is an ellipse.
        x, y = one[:, 0], one[:, min(1, one.shape[1] - 1)]
        turn = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 181))
        radius = np.hypot((x[:, None] * turn).real, (y[:, None] * turn).imag)
        return np.asarray(self.radius * np.abs(radius - 1.0).max(axis=1))

    def _corner(self, frequency: Real, follows: Complex, lag: Real) -> Real:
        travelled = self.feed * np.einsum("caf,tf->cat", follows.real, _ramp_weights(frequency))
        starts = travelled[:, -1]
        stops = self.feed * _TIMES - lag[:, :1] - travelled[:, 0]
        return np.asarray(np.hypot(starts, stops).min(axis=1))


def _ramp_weights(frequency: Real) -> Real:
    """Return weights, shape (times, f): ``sum_f weight Re T`` is the way after a step of speed from 0 to 1 [s].

    Below the first frequency T is 1, beyond the last zero.
    """
    w = np.concatenate([[0.0], 2.0 * np.pi * frequency])
    turns = w * _TIMES[:, None]
    sine, cosine = special.sici(np.maximum(turns, 1e-12))
    # Antiderivatives of (1 - cos w t)/w^2 and (1 - cos w t)/w.
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = np.where(w > 0.0, -(1.0 - np.cos(turns)) / w, 0.0) + _TIMES[:, None] * np.where(w > 0.0, sine, 0.0)
    rising = np.where(w > 0.0, np.euler_gamma + np.log(np.maximum(turns, 1e-12)) - cosine, 0.0)
    step_flat, step_rising, width = np.diff(flat, axis=1), np.diff(rising, axis=1), np.diff(w)
    # T = T_1 + (T_2 - T_1)(w - w_1)/(w_2 - w_1) on each piece.
    share = (step_rising - w[:-1] * step_flat) / width
    out = np.zeros_like(flat)
    out[:, :-1] += step_flat - share
    out[:, 1:] += share
    # At zero frequency T is 1, as it nearly is at the first.
    out[:, 1] += out[:, 0]
    return np.asarray(2.0 / np.pi * out[:, 1:])
