"""Checks of compliances: passivity, time skew, reciprocity, sizes, a constant factor between measurements."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np
import xarray as xr

from process.types import Complex, Real
from smfe.campaign import Model
from smfe.diagnosis.checks.rules import RULES
from smfe.diagnosis.checks.suspect import Suspect, fault, warning
from smfe.results import MEASUREMENT

FACTORS: dict[str, float] = {
    "a force in kN taken as N, or the like": 1e3,
    "an acceleration in g taken as m/s^2": 9.80665,
    "a force in lbf taken as N": 4.4482216152605,
}
"""Well-known mistakes of units and the factor that each makes."""


def driving_points(compliance: xr.Dataset) -> list[str]:
    """Return the axes that are both response and excitation."""
    array = compliance["compliance"]
    return [str(a) for a in array["response"].values if a in array["excitation"].values]


def entry(compliance: xr.Dataset, response: str, excitation: str) -> tuple[Complex, Real]:
    """Return values [m/N] and standard deviation [m/N] of one entry, shape (f,); zero where it is unknown."""
    at = {"response": response, "excitation": excitation}
    phi = compliance["compliance"].sel(at).values
    std = compliance["compliance_std"].sel(at).values if "compliance_std" in compliance else np.zeros(phi.shape)
    return phi, np.nan_to_num(std)


def _clear(compliance: xr.Dataset, axis: str) -> tuple[Real, Complex, Real]:
    """Frequency, compliance and standard deviation of the lines of a driving point that stand out of their noise."""
    phi, std = entry(compliance, axis, axis)
    f = compliance["frequency"].values
    keep = np.isfinite(phi) & (f > 0.0) & (np.abs(phi) > RULES.clear * std)
    return f[keep], phi[keep], std[keep]


def known_factor(size: float, within: float = 0.1) -> str:
    """Return which mistake of units makes a factor, "" where none does."""
    near = (t for t, f in FACTORS.items() if min(abs(size / f - 1.0), abs(size * f - 1.0)) < within)
    return next(near, "")


def skew_suspects(name: str, compliance: xr.Dataset) -> Iterator[Suspect]:
    """Look for a time skew between force and motion: a driving point that gives out energy, and not if it is shifted.

    A passive driving point has ``Im Phi < 0``; a motion that is recorded tau late turns it to
    ``Im(Phi exp(-j w tau))``. The shift that leaves the least energy given out is reported when it leaves less than a
    fifth. Energy that no shift explains means another sign, axis or place, and is not called a skew.
    """
    for axis in driving_points(compliance):
        f, phi, std = _clear(compliance, axis)
        if f.size < 20:
            continue
        # Beyond an eighth of the shortest period a shift would turn resonances over as well.
        shifts = np.linspace(-0.125, 0.125, 161) / float(f[-1])
        passive = np.maximum(RULES.clear * std, RULES.slack * np.abs(phi))
        turned = [(phi * np.exp(2j * np.pi * f * tau)).imag for tau in (0.0, *shifts)]
        before, *shares = (float(np.mean(imaginary > passive)) for imaginary in turned)
        good = np.flatnonzero(np.array(shares) <= min(shares) + 0.01)  # of these the smallest shift
        best = int(good[np.argmin(np.abs(shifts[good]))])
        if before > RULES.active and shares[best] < 0.2 * before:
            yield warning(
                "time_skew",
                f"{name}, {axis}{axis}",
                f"a driving point that gives out energy (at {100.0 * before:.0f} % of its clear lines), but not if the "
                f"motion is recorded {abs(shifts[best]) * 1e6:.0f} us or more too "
                f"{'late' if shifts[best] > 0.0 else 'early'}",
                "put one signal on both channels; declare a delay on the channel that is late",
            )


def reciprocity_suspects(name: str, compliance: xr.Dataset) -> Iterator[Suspect]:
    """Compare ``Phi_ij`` with ``Phi_ji`` where both were measured: difference beyond noise, over their size.

    A line counts where its mean, weighted by the inverse variances, is known to 20 %: lines picked by the size of a
    noisy entry would be those where noise made it large. The difference must be beyond noise at the median line, too.
    """
    for a, b in combinations(driving_points(compliance), 2):
        one, std_one = entry(compliance, a, b)
        two, std_two = entry(compliance, b, a)
        variance = std_one**2 + std_two**2
        weight = np.divide(std_two**2, variance, out=np.full(variance.shape, 0.5), where=variance > 0.0)
        mean, square = weight * one + (1.0 - weight) * two, np.abs(one - two) ** 2
        clear = np.isfinite(mean) & (np.sqrt(variance) < RULES.known * np.abs(mean))
        if np.count_nonzero(clear) < 5 or np.median((square - RULES.clear * variance)[clear]) < 0.0:
            continue
        one, two, beyond = one[clear], two[clear], float(np.sum(square[clear] - variance[clear]))
        share = math.sqrt(max(beyond, 0.0) / float(np.sum(np.abs(one) * np.abs(two))))
        if share <= 0.2:
            continue
        ratio, where = complex(np.vdot(two, one) / np.vdot(two, two)), f"{name}, {a}{b} and {b}{a}"
        if unit := known_factor(abs(ratio)):
            yield fault(
                "unit_error",
                where,
                f"their ratio is {abs(ratio):.4g}; a linear machine is reciprocal: this is the factor of {unit}",
                "correct the unit of the channel in [channels]",
                (MEASUREMENT, name),
            )
        else:
            yield warning(
                "sensor_axis",
                where,
                f"the two entries differ by {100.0 * share:.0f} % beyond noise; a linear machine is reciprocal. "
                f"Their ratio is {abs(ratio):.3g} at {np.degrees(np.angle(ratio)):.0f} deg",
                "check axes, signs and gains of both sensors; friction and servo break reciprocity only when the level "
                "differs",
            )


def stiffness_suspects(name: str, compliance: xr.Dataset) -> Iterator[Suspect]:
    """Name driving points whose dynamic stiffness at the largest resonance no tool tip has."""
    low, high = RULES.dynamic_stiffness
    for axis in driving_points(compliance):
        phi = np.abs(_clear(compliance, axis)[1])
        stiffness = 1.0 / float(np.quantile(phi, 0.98)) if phi.size >= 5 else low
        if not low <= stiffness <= high:
            yield fault(
                "unit_error",
                f"{name}, {axis}{axis}",
                f"its dynamic stiffness at the largest resonance is {stiffness:.3g} N/m; machines have {low:g} to "
                f"{high:g} N/m there",
                "correct the unit, scale or sensitivity of force or motion in [channels]",
                (MEASUREMENT, name),
            )


def model_suspects(compliances: Mapping[str, xr.Dataset], models: Sequence[Model]) -> Iterator[Suspect]:
    """Name measurements whose compliance is that of a declared model times a well-known factor of units.

    The median of ``|Phi / Phi_model|`` over the lines where both are at least a tenth of their largest: a peak that
    lies elsewhere than the model says moves it little.
    """
    for model in models:
        for name, compliance in compliances.items():
            ratio = {a: _of_model(compliance, model, a) for a in driving_points(compliance)}
            for text, factor in ((t, f) for t, f in FACTORS.items() if f > RULES.least_factor):
                off = {a: min(abs(math.log(r / factor)), abs(math.log(r * factor))) for a, r in ratio.items() if r}
                axes = [a for a in off if off[a] < math.log(RULES.of_model)]
                if axes:
                    yield fault(
                        "unit_error",
                        f"{name}, {', '.join(2 * a for a in axes)}",
                        f"it is {', '.join(f'{ratio[a]:.3g} in {a}{a}' for a in axes)} times the compliance of the "
                        f"model '{model.name}': this is the factor of {text}",
                        "correct the unit of the channel in [channels], or the model",
                        (MEASUREMENT, name),
                    )


def _of_model(compliance: xr.Dataset, model: Model, axis: str) -> float:
    """Median ratio of a driving point to that of a model; 0 where too few lines are clear in both."""
    phi, std = entry(compliance, axis, axis)
    k, phi = "xyz".index(axis), np.abs(phi)
    declared = np.abs(model.modal.matrix(compliance["frequency"].values)[:, k, k])
    clear = np.isfinite(phi) & (phi > RULES.clear * std) & (declared > 0.1 * declared.max(initial=0.0))
    if np.count_nonzero(clear) < 10:
        return 0.0
    # Where both have their peaks: a mode that the model does not know says nothing about a unit.
    both = clear & (phi > 0.1 * phi[clear].max())
    return float(np.median(phi[both] / declared[both])) if np.count_nonzero(both) >= 5 else 0.0


def factor_suspects(compliances: Mapping[str, xr.Dataset], accused: Collection[str] = ()) -> Iterator[Suspect]:
    """Compare measurements of the same machine: a ratio that is the same number at every frequency is no physics.

    The one that the others outvote is left out, else the one that is `accused` by something else; both where nothing
    distinguishes them, because either may be the wrong one.
    """
    differ: list[tuple[str, str, str, complex]] = []
    agree = dict.fromkeys(compliances, 0)
    for one, two in combinations(compliances, 2):
        for axis in sorted(set(driving_points(compliances[one])) & set(driving_points(compliances[two]))):
            found = _constant_ratio(compliances[one], compliances[two], axis)
            if found is not None and abs(found - 1.0) < 0.1:
                agree[one], agree[two] = agree[one] + 1, agree[two] + 1
            elif found is not None:
                differ.append((one, two, axis, found))
    for one, two, axis, ratio in differ:
        wrong = [n for n in (one, two) if agree[n] == min(agree[one], agree[two])]
        wrong = [n for n in wrong if n in accused] or wrong
        cause, why = "sensor_gain", "the gain of a sensor differs between them"
        if unit := known_factor(abs(ratio), 0.05):
            cause, why = "unit_error", f"this is the factor of {unit}"
        elif abs(np.angle(ratio)) > 0.9 * np.pi:
            why = "one of them has the wrong sign"
        if len(wrong) == 1:
            why += f"; the other measurements agree with {two if wrong[0] == one else one}"
        yield fault(
            cause,
            f"{one} and {two}, {axis}{axis}",
            f"their ratio is {abs(ratio):.4g} at {np.degrees(np.angle(ratio)):.0f} deg at every frequency: {why}",
            "compare the acceleration of a free mass under a known force, |a/F| = 1/m, with both chains",
            *((MEASUREMENT, n) for n in wrong),
        )


def _constant_ratio(one: xr.Dataset, two: xr.Dataset, axis: str) -> complex | None:
    """Ratio one/two (least squares) where it is constant over frequency, and 1 or clearly not 1."""
    f, phi, std = _clear(one, axis)
    f2, phi2, _ = _clear(two, axis)
    if f.size < 10 or f2.size < 10:
        return None
    inside = (f >= f2[0]) & (f <= f2[-1])
    if np.count_nonzero(inside) < 10:
        return None
    mine, size = phi[inside], float(np.linalg.norm(phi[inside]))
    other = np.interp(f[inside], f2, phi2.real) + 1j * np.interp(f[inside], f2, phi2.imag)
    ratio = complex(np.vdot(other, mine) / np.vdot(other, other))
    misfit = float(np.linalg.norm(mine - ratio * other)) / size
    allowed = max(RULES.flat, 3.0 * float(np.linalg.norm(std[inside])) / size)
    return None if misfit > allowed or 0.1 <= abs(ratio - 1.0) < 5.0 * misfit else ratio
