"""The control law of a drive, checked without the plant: reference, encoder and drive force must obey it.

``F = Kp [Kv (r - q) - q']`` with the velocity ``q'`` from backward differences of the encoder through a short filter of
unit gain, which is found from the record. What is left over is a command that was not logged, or other gains.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    """A control law with its velocity filter."""

    gains: Gains  # as documented
    taps: Real  # shape (k,): weights of the newest, the last ... backward difference [1], sum 1
    noise: float  # standard deviation of what the law leaves, from the median [N]

    def lag(self, step: float) -> float:
        """Return the lag of the velocity [s] behind the newest encoder value: half a step and the mean tap."""
        return step * (0.5 + float(self.taps @ np.arange(self.taps.size)))

    def force(self, reference: Real, position: Real, step: float) -> tuple[Real, Real]:
        """Return position and velocity part of the commanded force [N]; their sum is the command.

        The first values, fewer than `taps`, take the record to have been at rest before.
        """
        difference = np.diff(position, prepend=position[0]) / step
        velocity = np.convolve(difference, self.taps)[: position.size]
        gains = self.gains
        return gains.velocity * gains.position * (reference - position), -gains.velocity * velocity


@dataclass(frozen=True)
class Pulse:
    """A command that was not logged: begin and end [s from the first sample], height [N]."""

    begin: float
    end: float
    height: float


def fit_control_law(reference: Real, position: Real, force: Real, step: float, gains: Gains) -> ControlLaw:
    """Find the velocity filter of a control law from a record (trimmed least squares, other gains allowed)."""
    error = reference - position
    difference = np.diff(position, prepend=position[0]) / step
    rows = np.arange(RULES.taps, position.size)
    regressors = np.stack([error[rows], *(-difference[rows - k] for k in range(RULES.taps))], axis=1)
    scale = np.sqrt(np.mean(np.square(regressors), axis=0))
    if np.any(scale == 0.0):
        raise InputError("the axis does not move, or follows its reference exactly: the record says nothing of the law")
    floor = RULES.floor * float(np.ptp(force))
    # From the documented gains on: least squares over everything would spread a hidden command over all taps.
    solution = gains.velocity * np.array([gains.position, 1.0, *np.zeros(RULES.taps - 1)])
    kept = np.zeros(rows.size, dtype=bool)
    for _ in range(20):
        left = force[rows] - regressors @ solution
        before, kept = kept, np.abs(left) <= RULES.trim * max(_spread(left), floor)
        if np.array_equal(before, kept):
            break
        solution = np.linalg.lstsq(regressors[kept] / scale, force[rows][kept], rcond=None)[0] / scale
    taps = solution[1:] / solution[1:].sum()
    return ControlLaw(gains, taps, max(_spread(force[rows] - regressors @ solution), floor))


def unlogged_command(
    law: ControlLaw, reference: Real, position: Real, force: Real, step: float
) -> tuple[Real, tuple[Pulse, ...]]:
    """Return what was added to the command of the law [N], sample by sample, and its pulses.

    A pulse is what stands out by ten standard deviations of the noise, and by 2 % of the highest, for three samples or
    more; its height is the median.
    """
    left = force - sum(law.force(reference, position, step))
    left[: law.taps.size] = 0.0
    out = np.abs(left) > max(RULES.detect * law.noise, RULES.pulse_share * float(np.max(np.abs(left))))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], out.astype(np.int8), [0])))).reshape(-1, 2)
    pulses = tuple(
        Pulse(float(a * step), float(b * step), float(np.median(left[a:b])))
        for a, b in edges
        if b - a >= RULES.shortest_pulse
    )
    return left, pulses


def _spread(values: Real) -> float:
    """Return the standard deviation of a normal distribution with the same median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
