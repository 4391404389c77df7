"""What is to be tuned, for which cut, within which limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields

import numpy as np

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.servo import Servo
from process.errors import InputError
from process.types import Complex, Real
from smfe.campaign.tune import GOALS
from smfe.limits.cut_conditions import rotation
from smfe.tuning.plants import Source
from smfe.tuning.tracking import Move
from stability.problem import Cut


@dataclass(frozen=True)
class Goal:
    """What the gains are to maximise.

    Parameters
    ----------
    kind : {"least_depth", "removal_rate", "depths"}
        The least stable depth over a range of spindle speeds; the highest removal rate at a stable depth within it;
        the least stable depth at the speeds given.
    speeds : tuple of float
        Lowest and highest speed, or the speeds themselves for ``depths`` [rpm].
    deepest : float, optional
        Depth that the tool or the work allows at most [m]; a removal rate counts no deeper.
    """

    kind: str
    speeds: tuple[float, ...]
    deepest: float = math.inf

    def __post_init__(self) -> None:
        """Refuse goals that say too little."""
        if self.kind not in GOALS:
            raise InputError(f"the goal is '{self.kind}'; name one of {', '.join(GOALS)}")
        if not self.speeds or min(self.speeds) <= 0.0 or not math.isfinite(max(self.speeds)):
            raise InputError(f"the goal has spindle speeds {self.speeds}; they must be positive, in rpm")
        if self.kind != "depths" and not (len(self.speeds) == 2 and self.speeds[0] < self.speeds[1]):
            raise InputError(f"{self.kind} needs a range of spindle speeds, lowest and highest; {self.speeds} is none")

    @property
    def words(self) -> str:
        """What is maximised."""
        if self.kind == "depths":
            return f"least stable depth at {', '.join(f'{n:g}' for n in self.speeds)} rpm"
        over = f"over {self.speeds[0]:g} to {self.speeds[1]:g} rpm"
        return f"least stable depth {over}" if self.kind == "least_depth" else f"highest stable removal rate {over}"


@dataclass(frozen=True)
class Limits:
    """What commissioning allows; None does not limit. They hold for each axis.

    Parameters
    ----------
    velocity_peak, position_peak : float or None
        Highest amplitude of the closed velocity and position loop [dB].
    gain_margin : float or None
        Of velocity and position loop, both cut at the drive force, at least [dB].
    phase_margin : float or None
        The same [deg].
    velocity_bandwidth, position_bandwidth : float or None
        -3 dB bandwidth of the closed loops, at least [Hz].
    tracking_error : float or None
        Error of the move, at most [m].
    """

    velocity_peak: float | None = 3.0
    position_peak: float | None = 0.0
    gain_margin: float | None = None
    phase_margin: float | None = None
    velocity_bandwidth: float | None = None
    position_bandwidth: float | None = None
    tracking_error: float | None = None

    def __post_init__(self) -> None:
        """Refuse limits that are no numbers."""
        for one in fields(self):
            value = getattr(self, one.name)
            if value is not None and not math.isfinite(value):
                raise InputError(f"the limit {one.name} is {value}; leave it out, or give a number")


LIMIT_WORDS = {
    "velocity_peak": ("peak of the closed velocity loop", "at most", "dB", 1.0),
    "position_peak": ("peak of the closed position loop", "at most", "dB", 1.0),
    "gain_margin": ("gain margin", "at least", "dB", 1.0),
    "phase_margin": ("phase margin", "at least", "deg", 1.0),
    "velocity_bandwidth": ("bandwidth of the velocity loop", "at least", "Hz", 1.0),
    "position_bandwidth": ("bandwidth of the position loop", "at least", "Hz", 1.0),
    "tracking_error": ("tracking error", "at most", "um", 1e6),
}
"""Limit -> what it is, from which side it limits, unit shown and its factor."""


@dataclass(frozen=True)
class Task:
    """Everything that a search for gains needs.

    Parameters
    ----------
    source : Source
        Machine model or measurements.
    tool, arc, coefficients
        The cut.
    goal : Goal
        What to maximise.
    limits : Limits
        What commissioning allows.
    move : Move
        Whose error is weighed against the depth.
    feed_forward : float or None
        Velocity feed-forward [1]; None: as large as the position limit allows, for each set of gains.
    robust : float
        The modes may lie this share lower or higher: the worst of lower, nominal and higher counts.
    present : mapping of str to tuple of Servo
        Controllers that are there now, a servo for each axis.
    width_of_cut, feed_per_tooth : float
        [m]; for the removal rate.
    feed_direction : float
        From +x towards +y [rad].
    seed : int
        Of the search.
    """

    source: Source
    tool: Tool
    arc: AnyEngagement
    coefficients: CuttingCoefficients
    goal: Goal
    limits: Limits = field(default_factory=Limits)
    move: Move = field(default_factory=Move)
    feed_forward: float | None = 0.0
    robust: float = 0.1
    present: Mapping[str, tuple[Servo, ...]] = field(default_factory=dict)
    width_of_cut: float = math.nan
    feed_per_tooth: float = math.nan
    feed_direction: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what cannot be tuned."""
        Cut(self.tool, self.arc, self.coefficients).require_equal_pitch("gains")
        if not 0.0 <= self.robust < 0.5:
            raise InputError(f"robust is {self.robust:g}; give the share by which modes may move, from 0 to below 50 %")
        if self.feed_forward is not None and not 0.0 <= self.feed_forward <= 1.0:
            raise InputError(f"the feed-forward is {self.feed_forward:g}; give 0 to 1, or 'largest'")

    @property
    def directional(self) -> Complex:
        """Mean directional matrix [N/m2] in the axes of the machine, shape (3, 3)."""
        turn = rotation(self.feed_direction)
        return np.asarray(turn.T @ Cut(self.tool, self.arc, self.coefficients).directional_matrix() @ turn)

    @property
    def periods(self) -> Real:
        """Tooth periods [s] of the speeds of the goal."""
        return 60.0 / (self.tool.teeth * np.array(self.goal.speeds))

    @property
    def changes(self) -> tuple[float, ...]:
        """Shares by which the modes are moved, the nominal machine first."""
        return (0.0, -self.robust, self.robust) if self.robust else (0.0,)

    @property
    def changes_between(self) -> tuple[float, ...]:
        """Shares from lower to higher modes, the nominal machine first: at one speed the worst may lie between."""
        even = np.linspace(-self.robust, self.robust, 9)
        return (0.0, *(float(v) for v in even if abs(v) > 1e-12)) if self.robust else (0.0,)

    def removal_rate(self, speed: Real, depth: Real) -> Real:
        """Return the removal rate [m^3/s] at speeds [rpm] and depths [m]."""
        area = self.width_of_cut * self.feed_per_tooth * self.tool.teeth
        return np.asarray(speed / 60.0 * np.minimum(depth, self.goal.deepest) * area)
