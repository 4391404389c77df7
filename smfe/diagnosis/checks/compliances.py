"""Checks of compliances: passivity, time skew, reciprocity, sizes, a constant factor between measurements."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, permutations, product

import numpy as np
import xarray as xr

from process.labels import AXES
from process.types import Complex, Real
from smfe.campaign import Model
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.checks.rules import RULES
from smfe.diagnosis.checks.suspect import Part, Suspect, fault, note, warning
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


Clear = tuple[Real, Complex, Real]
"""Frequency [Hz], compliance and its standard deviation [m/N] of some lines, shape (f,) each."""


def _clear(compliance: xr.Dataset, axis: str) -> Clear:
    """Frequency, compliance and standard deviation of the lines of a driving point that stand out of their noise."""
    phi, std = entry(compliance, axis, axis)
    f = compliance["frequency"].values
    keep = np.isfinite(phi) & (f > 0.0) & (np.abs(phi) > RULES.clear * std)
    return f[keep], phi[keep], std[keep]


def known_factor(size: float, within: float = 0.1) -> str:
    """Return which mistake of units makes a factor, "" where none does."""
    near = (t for t, f in FACTORS.items() if min(abs(size / f - 1.0), abs(size * f - 1.0)) < within)
    return next(near, "")


def skew_suspects(name: str, compliance: xr.Dataset, tolerances: Tolerances | None = None) -> Iterator[Suspect]:
    """Look for a time skew between force and motion: a driving point that gives out energy, and not if it is shifted.

    A passive driving point has ``Im Phi < 0``; a motion that is recorded tau late turns it to
    ``Im(Phi exp(-j w tau))``. The shift that leaves the least energy given out is reported when it leaves less than a
    fifth, and is more than clocks differ by anyhow. Energy that no shift explains means another sign,
    axis or place, and is not called a skew.
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
        usual = 1.5 * (tolerances or Tolerances()).clock
        if before > RULES.active and shares[best] < 0.2 * before and abs(shifts[best]) > usual:
            yield warning(
                "time_skew",
                f"{name}, {axis}{axis}",
                f"a driving point that gives out energy (at {100.0 * before:.0f} % of its clear lines), but not if the "
                f"motion is recorded {abs(shifts[best]) * 1e6:.0f} us or more too "
                f"{'late' if shifts[best] > 0.0 else 'early'}",
                "put one signal on both channels; declare a delay on the channel that is late",
            )


@dataclass(frozen=True)
class _Pair:
    """Two entries that must be equal on the lines that count, their noise, and what angles put into them."""

    one: Complex  # Phi_ij
    two: Complex  # Phi_ji
    variance: tuple[Real, Real]  # of each
    direct: tuple[Real, Real]  # |Phi_ii|^2, |Phi_jj|^2
    angle: float  # variance of the angles, of both entries together

    @property
    def ratio(self) -> complex:
        """The first entry over the second, by least squares."""
        return complex(np.vdot(self.two, self.one) / np.vdot(self.two, self.two))

    @property
    def within_noise(self) -> bool:
        """Whether noise explains the difference at the median line."""
        beyond = np.abs(self.one - self.two) ** 2 - RULES.clear * (self.variance[0] + self.variance[1])
        return bool(np.median(beyond) < 0.0)

    def apart(self, factor: complex = 1.0) -> float:
        """Difference over size beyond noise and angles, the column of the first entry divided by a factor."""
        column, size = self.one / factor, abs(factor) ** 2
        noise = self.variance[0] / size + self.variance[1]
        allowed = RULES.oblique * self.angle * (self.direct[0] + self.direct[1] / size)
        beyond = float(np.sum(np.abs(column - self.two) ** 2 - noise - allowed))
        return math.sqrt(max(beyond, 0.0) / float(np.sum(np.abs(column) * np.abs(self.two))))


def reciprocity_suspects(name: str, compliance: xr.Dataset, tolerances: Tolerances | None = None) -> Iterator[Suspect]:
    """Compare ``Phi_ij`` with ``Phi_ji`` where both were measured: difference beyond noise, over their size.

    A line counts where its mean, weighted by the inverse variances, is known to 20 %, or each entry is: lines picked by
    the size of a noisy entry would be those where noise made it large. The difference must be beyond noise at the
    median line, too, and beyond what hits that lean and sensors that are turned or talk across put of the direct
    entries into the cross terms: an angle theta puts ``theta (Phi_ii + Phi_jj)`` into them.
    """
    found = _pairs_of(compliance, tolerances or Tolerances())
    for (a, b), pair in found.items():
        if pair.within_noise:
            continue
        ratio = pair.ratio
        where, unit = f"{name}, {a}{b} and {b}{a}", _unit_of(found, a, b)
        # A column of another unit is mended by its factor: what is then left is that of any machine.
        if unit and pair.apart(ratio) <= RULES.apart_entries < replace(pair, direct=_less(pair, ratio)).apart():
            yield fault(
                "unit_error",
                where,
                f"their ratio is {abs(ratio):.4g}; a linear machine is reciprocal: this is the factor of {unit}",
                "correct the unit of the channel in [channels]",
                (MEASUREMENT, name),
            )
        elif (size := pair.apart()) > RULES.apart_entries:
            # Beside the direct entries a weak cross term changes no limit, whatever leans.
            beside = np.sum(np.abs(pair.one - pair.two) ** 2) / np.sum(np.sqrt(pair.direct[0] * pair.direct[1]))
            yield (warning if beside > RULES.beside**2 else note)(
                "sensor_axis",
                where,
                f"the two entries differ by {100.0 * size:.0f} % beyond noise and what leaning hits and turned sensors "
                f"explain; a linear machine is reciprocal. Their ratio is {abs(ratio):.3g} at "
                f"{np.degrees(np.angle(ratio)):.0f} deg",
                "check axes, signs and gains of both sensors; friction and servo break reciprocity only when the level "
                "differs",
            )


def _pairs_of(compliance: xr.Dataset, tolerances: Tolerances) -> dict[tuple[str, str], _Pair]:
    """Return the pairs of entries of which enough lines are known."""
    found = {}
    for a, b in combinations(driving_points(compliance), 2):
        one, std_one = entry(compliance, a, b)
        two, std_two = entry(compliance, b, a)
        variance = std_one**2 + std_two**2
        weight = np.divide(std_two**2, variance, out=np.full(variance.shape, 0.5), where=variance > 0.0)
        mean = weight * one + (1.0 - weight) * two
        known = np.sqrt(variance) < RULES.known * np.abs(mean)
        known |= (std_one < RULES.known * np.abs(one)) & (std_two < RULES.known * np.abs(two))
        clear = np.isfinite(mean) & known
        if np.count_nonzero(clear) < 5:
            continue
        direct = [np.nan_to_num(np.abs(entry(compliance, x, x)[0][clear]) ** 2) for x in (a, b)]
        noise, angle = (std_one[clear] ** 2, std_two[clear] ** 2), 2.0 * _oblique(tolerances) ** 2
        found[a, b] = _Pair(one[clear], two[clear], noise, (direct[0], direct[1]), angle)
    return found


def _unit_of(found: Mapping[tuple[str, str], _Pair], a: str, b: str) -> str:
    """Return which mistake of units parts ``Phi_ab`` from ``Phi_ba``; "" where it is none.

    A factor of units turns no sign. That of a force along b is in ``Phi_cb`` as well, that of a motion along a in
    ``Phi_ac``: a third axis on which neither shows says that it is chance.
    """

    def of(response: str, excitation: str) -> complex:
        if (response, excitation) in found:
            return found[response, excitation].ratio
        return 1.0 / found[excitation, response].ratio if (excitation, response) in found else math.nan

    ratio = of(a, b)
    if abs(np.angle(ratio)) > RULES.no_turn:
        return ""
    others = [abs(of(*pair)) for c in AXES if c not in (a, b) for pair in ((c, b), (a, c))]
    if all(abs(math.log(other / abs(ratio))) > RULES.same_factor for other in others) and others:
        return ""
    return known_factor(abs(ratio))


def _less(pair: _Pair, ratio: complex) -> tuple[Real, Real]:
    """Return the direct entries as they are if the column of the first entry is too large by a factor."""
    return pair.direct[0], pair.direct[1] / abs(ratio) ** 2


def _oblique(tolerances: Tolerances) -> float:
    """Standard deviation of what a direct entry puts into a cross term, relative [1]."""
    angles = tolerances.setup_direction, tolerances.hit_direction, tolerances.mounting_angle
    return math.sqrt(sum(a**2 for a in angles) + tolerances.cross_talk**2)


# --- Channels of another sign, or exchanged.


def mounting_suspects(name: str, compliance: xr.Dataset, *excludes: Part) -> Iterator[Suspect]:
    """Say which sign, or which exchange of two channels, mends a compliance whose driving points give out energy.

    A passive driving point has ``Im Phi_ii < 0``, and a linear machine is reciprocal. Of all that can be wrong with the
    channels of the motion (each with another sign, any two exchanged, and both) that is named which leaves least of the
    energy given out and of the asymmetry, where it is clearly least. The same fault in the channels of the force looks
    alike.
    """
    axes = driving_points(compliance)
    seen = _matrix(compliance, axes)
    if not axes or seen.shape[0] < 20:
        return
    before = _impossible(seen)
    if before < RULES.odd:
        return
    tried: dict[tuple[tuple[int, ...], tuple[int, ...]], float] = {}
    for order in permutations(range(len(axes))):
        if sum(i != k for k, i in enumerate(order)) > 2:
            continue  # two are exchanged, not three
        for signs in product((1, -1), repeat=len(axes)):
            mended = np.array(signs)[None, :, None] * seen[:, list(order), :]
            tried[order, signs] = _impossible(mended)
    plain = tuple(range(len(axes))), (1,) * len(axes)
    ranked = sorted(
        tried, key=lambda t: tried[t] + 0.02 * (sum(x < 0 for x in t[1]) + sum(i != k for k, i in enumerate(t[0])))
    )
    best = ranked[0]
    enough = RULES.mended if before >= RULES.impossible else RULES.mended_whole
    if best == plain or tried[best] > enough * before:
        return
    order, signs = best
    swapped = [axes[k] for k, i in enumerate(order) if i != k]
    turned = [axes[k] for k, x in enumerate(signs) if x < 0]
    evidence = (
        f"driving points give out energy, or entries that must be equal differ ({100.0 * before:.0f} % of the whole)"
    )
    said, do = [], []
    if swapped:
        said.append(f"with the motions along {swapped[0]} and {swapped[1]} exchanged")
        do.append(
            f"exchange the columns of acceleration_{swapped[0]} and acceleration_{swapped[1]} in [channels] (or the "
            "excitation of the records, if the hits were called by the wrong axis)"
        )
    if len(turned) == len(axes) > 1:
        said.append("with the sign of all forces turned round")
        do.append(
            "declare sign = -1 on the force channels: forces act on the tool, and a dynamometer under the work reads "
            "the reaction"
        )
    elif turned:
        said.append(f"with the sign of {' and '.join(turned)} turned round")
        do.append(f"declare sign = -1 on {' and '.join(f'acceleration_{a}' for a in turned)} (or on the force there)")
    yield fault(
        "sensor_axis" if swapped else "sensor_gain",
        name,
        f"{evidence}; {' and '.join(said)} {100.0 * tried[best]:.0f} % are left",
        "; ".join(do),
        *excludes,
    )


def _matrix(compliance: xr.Dataset, axes: Sequence[str]) -> Complex:
    """Return the square mobility of some axes, over 2 pi, where the machine answers above its noise, (f, n, n).

    Of a compliance the lines below its modes would count most, which integrated noise makes large.
    """
    if not axes:  # places that are no axes of the machine, as along a beam
        return np.zeros((0, 0, 0), complex)
    pairs = [[entry(compliance, a, b) for b in axes] for a in axes]
    phi = np.array([[p[0] for p in row] for row in pairs]).transpose(2, 0, 1)
    std = np.array([[p[1] for p in row] for row in pairs]).transpose(2, 0, 1)
    f = compliance["frequency"].values[:, None, None]
    phi, std = f * phi, f * std
    size = np.abs(phi).max(axis=(1, 2), initial=0.0)
    clear = np.isfinite(phi).all(axis=(1, 2)) & (size > RULES.clear * std.max(axis=(1, 2), initial=0.0))
    if not clear.any():
        return np.asarray(phi[clear])
    # Elsewhere a small imaginary part decides.
    return np.asarray(phi[clear & (size >= RULES.answering * np.median(size[clear]))])


def _impossible(phi: Complex) -> float:
    """Return the share of a compliance that no passive, reciprocal machine has, (f, n, n) -> 0 to about 1."""
    direct = np.einsum("faa->fa", phi)
    given_out = float(np.sum(np.maximum(direct.imag, 0.0) ** 2)) / max(float(np.sum(direct.imag**2)), 1e-300)
    apart = float(np.sum(np.abs(phi - phi.swapaxes(1, 2)) ** 2)) / max(2.0 * float(np.sum(np.abs(phi) ** 2)), 1e-300)
    return math.sqrt(0.5 * (given_out + apart))


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
    # Of n measurements there are n^2/2 pairs: what each has alone is taken once.
    clear = {name: {axis: _clear(c, axis) for axis in driving_points(c)} for name, c in compliances.items()}
    for one, two in combinations(compliances, 2):
        for axis in sorted(clear[one].keys() & clear[two].keys()):
            found = _constant_ratio(clear[one][axis], clear[two][axis])
            if found is not None and abs(found - 1.0) < 0.1:
                agree[one], agree[two] = agree[one] + 1, agree[two] + 1
            elif found is not None and min(turn := abs(np.angle(found)), np.pi - turn) < RULES.no_turn:
                # No gain turns a phase by 70 degrees: that does an axis near sticking and slipping.
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


def _constant_ratio(one: Clear, two: Clear) -> complex | None:
    """Ratio one/two (least squares) where it is constant over frequency, and 1 or clearly not 1."""
    (f, phi, std), (f2, phi2, _) = one, two
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
