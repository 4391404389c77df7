"""Audit of compliances: passivity, time skew, reciprocity, a constant factor between measurements."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
import xarray as xr

from process.types import Complex, Real
from smfe.diagnosis.checks.suspect import Suspect

FACTORS: dict[str, float] = {
    "a force in kN taken as N, or the like": 1e3,
    "an acceleration in g taken as m/s^2": 9.80665,
    "a force in lbf taken as N": 4.4482216152605,
}
"""Well-known mistakes of units and the factor that each makes."""

_CLEAR = 5.0  # standard deviations
_KNOWN = 0.2  # standard deviation over the mean of two reciprocal entries
_ACTIVE = 0.05  # share of lines that give out energy, which a collocated sensor does not show
_SLACK = 0.02  # of the magnitude: a degree of phase
_FLAT = 0.05  # misfit below which a ratio is a constant factor


def skew_suspects(name: str, compliance: xr.Dataset) -> list[Suspect]:
    """Look for a time skew between force and motion: a driving point that gives out energy, and not if it is shifted.

    A passive driving point has ``Im Phi < 0``; a motion that is recorded tau late turns it to
    ``Im(Phi exp(-j w tau))``. The shift that leaves the least energy given out is reported when it leaves less than a
    fifth. Energy that no shift explains means another sign, axis or place, and is not called a skew.
    """
    out = []
    for axis in _direct(compliance):
        f, phi, std = _clear(compliance, axis, axis)
        if f.size < 20:
            continue
        shift, before, after = _best_shift(f, phi, std)
        side = "late" if shift > 0.0 else "early"
        if before > _ACTIVE and after < 0.2 * before:
            out.append(
                Suspect(
                    "time_skew",
                    "warning",
                    f"{name}, {axis}{axis}",
                    f"a driving point that gives out energy (at {100.0 * before:.0f} % of its clear lines), but not "
                    f"if the motion is recorded {abs(shift) * 1e6:.0f} us or more too {side}",
                    "put one signal on both channels; declare a delay on the channel that is late",
                )
            )
    return out


def _best_shift(f: Real, phi: Complex, std: Real) -> tuple[float, float, float]:
    """Shift [s] that makes a driving point most passive; share of active lines without it and with it."""

    def active(tau: float) -> float:
        imaginary = (phi * np.exp(2j * np.pi * f * tau)).imag
        return float(np.mean(imaginary > np.maximum(_CLEAR * std, _SLACK * np.abs(phi))))

    # Beyond an eighth of the shortest period a shift would turn resonances over as well.
    reach = 0.125 / float(f[-1])
    shifts = np.linspace(-reach, reach, 161)
    shares = np.array([active(float(tau)) for tau in shifts])
    # The smallest of the shifts that are nearly as good as the best.
    good = np.flatnonzero(shares <= shares.min() + 0.01)
    best = int(good[np.argmin(np.abs(shifts[good]))])
    return float(shifts[best]), active(0.0), float(shares[best])


def reciprocity_suspects(name: str, compliance: xr.Dataset) -> list[Suspect]:
    """Compare ``Phi_ij`` with ``Phi_ji`` where both were measured: difference beyond noise, over their size.

    Lines count whose mean, weighted by the inverse variances, is known to `_KNOWN`: lines picked by the size of a noisy
    entry would be those where noise made it large. The difference counts where the median line shows it, too.
    """
    axes, out = _direct(compliance), []
    for i, a in enumerate(axes):
        for b in axes[i + 1 :]:
            one, std_one = _entry(compliance, a, b)
            two, std_two = _entry(compliance, b, a)
            variance = std_one**2 + std_two**2
            weight = np.divide(std_two**2, variance, out=np.full(variance.shape, 0.5), where=variance > 0.0)
            mean = weight * one + (1.0 - weight) * two
            clear = np.isfinite(mean) & (np.sqrt(variance) < _KNOWN * np.abs(mean))
            if np.count_nonzero(clear) < 5 or np.median((np.abs(one - two) ** 2 - _CLEAR * variance)[clear]) < 0.0:
                continue
            difference = np.abs(one - two)[clear] ** 2 - variance[clear]
            share = float(np.sqrt(max(difference.sum(), 0.0) / np.sum(np.abs(one[clear]) * np.abs(two[clear]))))
            if share > 0.2:
                ratio = complex(np.vdot(two[clear], one[clear]) / np.vdot(two[clear], two[clear]))
                unit = known_factor(abs(ratio))
                if unit:
                    out.append(
                        Suspect(
                            "unit_error",
                            "fault",
                            f"{name}, {a}{b} and {b}{a}",
                            f"their ratio is {abs(ratio):.4g}; a linear machine is reciprocal: this is the factor of "
                            f"{unit}",
                            "correct the unit of the channel in [channels]",
                            excludes=(("measurement", name),),
                        )
                    )
                    continue
                out.append(
                    Suspect(
                        "sensor_axis",
                        "warning",
                        f"{name}, {a}{b} and {b}{a}",
                        f"they differ by {100.0 * share:.0f} % beyond noise; a linear machine is reciprocal. Their "
                        f"ratio is {abs(ratio):.3g} at {np.degrees(np.angle(ratio)):.0f} deg",
                        "check axes, signs and gains of both sensors; friction and servo break reciprocity only when "
                        "the level differs",
                    )
                )
    return out


def known_factor(size: float, within: float = 0.1) -> str:
    """Return which mistake of units makes a factor, "" where none does."""
    for text, factor in FACTORS.items():
        if min(abs(size / factor - 1.0), abs(size * factor - 1.0)) < within:
            return text
    return ""


def factor_suspects(compliances: Mapping[str, xr.Dataset], accused: Collection[str] = ()) -> list[Suspect]:
    """Compare measurements of the same machine: a ratio that is the same number at every frequency is no physics.

    Whom it leaves out: the one that the others outvote, else the one that is `accused` by something else; both where
    nothing tells them apart, because either may be the wrong one.
    """
    names = list(compliances)
    differ: dict[tuple[str, str], list[tuple[str, complex]]] = {}
    agree: dict[str, int] = dict.fromkeys(names, 0)
    for i, one in enumerate(names):
        for two in names[i + 1 :]:
            for axis in sorted(set(_direct(compliances[one])) & set(_direct(compliances[two]))):
                found = _constant_ratio(compliances[one], compliances[two], axis)
                if found is not None and abs(found - 1.0) < 0.1:
                    agree[one], agree[two] = agree[one] + 1, agree[two] + 1
                elif found is not None:
                    differ.setdefault((one, two), []).append((axis, found))
    out = []
    for (one, two), entries in differ.items():
        fewest = min(agree[one], agree[two])
        wrong = [n for n in (one, two) if agree[n] == fewest]
        wrong = [n for n in wrong if n in accused] or wrong
        out += [_factor_suspect(one, two, axis, ratio, wrong) for axis, ratio in entries]
    return out


def _constant_ratio(one: xr.Dataset, two: xr.Dataset, axis: str) -> complex | None:
    """Ratio one/two (least squares) where it is constant over frequency, and 1 or clearly not 1."""
    f1, phi1, std1 = _clear(one, axis, axis)
    f2, phi2, _ = _clear(two, axis, axis)
    if f1.size < 10 or f2.size < 10:
        return None
    low, high = max(f1[0], f2[0]), min(f1[-1], f2[-1])
    inside = (f1 >= low) & (f1 <= high)
    if np.count_nonzero(inside) < 10:
        return None
    mine, noise = phi1[inside], std1[inside]
    other = np.interp(f1[inside], f2, phi2.real) + 1j * np.interp(f1[inside], f2, phi2.imag)
    ratio = complex(np.vdot(other, mine) / np.vdot(other, other))
    misfit = float(np.linalg.norm(mine - ratio * other) / np.linalg.norm(mine))
    allowed = max(_FLAT, 3.0 * float(np.linalg.norm(noise) / np.linalg.norm(mine)))
    if misfit > allowed or 0.1 <= abs(ratio - 1.0) < 5.0 * misfit:
        return None
    return ratio


def _factor_suspect(one: str, two: str, axis: str, ratio: complex, wrong: Sequence[str]) -> Suspect:
    size = abs(ratio)
    if abs(np.angle(ratio)) > 0.9 * np.pi:
        cause, told = "sensor_gain", "one of them has the wrong sign"
    else:
        cause, told = "sensor_gain", "the gain of a sensor differs between them"
    if unit := known_factor(size, 0.05):
        cause, told = "unit_error", f"this is the factor of {unit}"
    if len(wrong) == 1:
        told += f"; the other measurements agree with {two if wrong[0] == one else one}"
    return Suspect(
        cause,
        "fault",
        f"{one} and {two}, {axis}{axis}",
        f"their ratio is {size:.4g} at {np.degrees(np.angle(ratio)):.0f} deg at every frequency: {told}",
        "compare the acceleration of a free mass under a known force, |a/F| = 1/m, with both chains",
        excludes=tuple(("measurement", n) for n in wrong),
    )


def _direct(compliance: xr.Dataset) -> list[str]:
    array = compliance["compliance"]
    return [str(a) for a in array["response"].values if a in array["excitation"].values]


def _entry(compliance: xr.Dataset, response: str, excitation: str) -> tuple[Complex, Real]:
    phi = compliance["compliance"].sel(response=response, excitation=excitation).values
    if "compliance_std" not in compliance:
        return phi, np.zeros(phi.shape)
    std = compliance["compliance_std"].sel(response=response, excitation=excitation).values
    return phi, np.nan_to_num(std)


def _clear(compliance: xr.Dataset, response: str, excitation: str) -> tuple[Real, Complex, Real]:
    """Frequency, compliance and standard deviation of the lines that stand out of their noise."""
    phi, std = _entry(compliance, response, excitation)
    f = compliance["frequency"].values
    keep = np.isfinite(phi) & (f > 0.0) & (np.abs(phi) > _CLEAR * std)
    return f[keep], phi[keep], std[keep]
