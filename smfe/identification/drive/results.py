"""What is found of a drive: parameters with their intervals, as rows of a table."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pandas as pd
from scipy import optimize, special, stats

from process.types import Real
from smfe.identification.drive.rules import RULES


@dataclass(frozen=True)
class Estimate:
    """Value, standard deviation and 95 % interval."""

    value: float
    std: float
    low: float
    high: float

    @classmethod
    def single(cls, value: float, std: float, degrees_of_freedom: float) -> Estimate:
        """Return the estimate of Student's distribution."""
        reach = float(stats.t.ppf(0.5 + 0.5 * RULES.level, degrees_of_freedom)) * std
        return cls(value, std, value - reach, value + reach)

    @classmethod
    def mixed(cls, share: Real, value: Real, std: Real, degrees_of_freedom: Real) -> Estimate:
        """Return the estimate of a mixture of Student's distributions, all arguments (n,); the shares sum up to one."""
        mean = float(share @ value)
        spread = math.sqrt(float(share @ (std**2 + (value - mean) ** 2)))
        ends = []
        for tail in (0.5 - 0.5 * RULES.level, 0.5 + 0.5 * RULES.level):
            each = value + stats.t.ppf(tail, degrees_of_freedom) * std
            least, most = float(each.min()), float(each.max())
            if most - least > 1e-9 * spread:
                least = optimize.brentq(
                    lambda q, p=tail: float(share @ special.stdtr(degrees_of_freedom, (q - value) / std)) - p,
                    least,
                    most,
                )
            ends.append(least)
        return cls(mean, spread, ends[0], ends[1])

    def widened(self, std: float, degrees_of_freedom: float) -> Estimate:
        """Return the estimate with a further, independent error."""
        if std <= 0.0:
            return self
        more = float(stats.t.ppf(0.5 + 0.5 * RULES.level, degrees_of_freedom)) * std
        down, up = math.hypot(self.value - self.low, more), math.hypot(self.high - self.value, more)
        return Estimate(self.value, math.hypot(self.std, std), self.value - down, self.value + up)


@dataclass(frozen=True)
class DriveParameter:
    """One parameter of a drive.

    Attributes
    ----------
    name : str
        "inertia", "coulomb", "viscous", "static", "stribeck_speed", "delay" or "constant".
    direction : str
        "forward", "backward" or "both".
    value, std, low, high : float
        Value, its standard deviation and 95 % interval [SI]; the value is NaN where the record does not determine it.
    unit : str
        Unit of all four.
    note : str
        Why there is no value, or what it includes.
    """

    name: str
    direction: str
    value: float
    std: float
    low: float
    high: float
    unit: str
    note: str = ""

    @classmethod
    def of(cls, name: str, way: str, found: Estimate, unit: str, note: str = "") -> DriveParameter:
        """Return the row of an estimate."""
        return cls(name, way, found.value, found.std, found.low, found.high, unit, note)


def positive(name: str, way: str, found: Estimate, unit: str, reason: str, note: str = "") -> DriveParameter:
    """One positive parameter; without a value, but with its interval, where that is not on one side of zero."""
    row = DriveParameter.of(name, way, found, unit, note)
    if found.low > 0.0:
        return row
    low, why = (found.low, "not possible: it is negative") if found.high < 0.0 else (0.0, "not determined")
    return DriveParameter(name, way, math.nan, found.std, low, found.high, unit, f"{why}; {reason}")


@dataclass(frozen=True)
class DriveFit:
    """What the records of one measurement say of the drive of one axis.

    Attributes
    ----------
    axis : str
        Axis that the drive moves.
    rotary : bool
        Whether angles and torques were recorded; else positions and forces.
    parameters : tuple of DriveParameter
        In the order of the report.
    band : float
        Highest frequency of the balance [Hz].
    remaining : float
        Root mean square of what the balance leaves of the drive force, over that of the force [1].
    notes : tuple of str
        What was noticed.
    friction : DataFrame
        Drive force without inertia, ripple [N or N m] over velocity [m/s or rad/s]: rows of kind "motion" (values of
        the record), "steady run" (means with their 95 % interval) and "curve" (what was identified).
    """

    axis: str
    rotary: bool
    parameters: tuple[DriveParameter, ...]
    band: float
    remaining: float
    notes: tuple[str, ...]
    friction: pd.DataFrame
