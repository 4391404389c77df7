"""Frequency responses from the lines of whole records: a polynomial over neighbouring lines, and one for the transient.

The transform of a record of n samples obeys, line by line,

    X(f) = Phi(f) F(f) + T(f) + noise,

where T, the motion that the record begins with less that which it leaves behind, is as smooth as Phi (Pintelon and
Schoukens 2012, 6.3 and ch. 7). Over a band around each frequency both are polynomials of second order, found by least
squares; what is left of the lines is the noise, and with it the error is known. No window, so no leakage: a wide band
averages more noise, a narrow one bends with a lightly damped mode, and of several the widest is taken that agrees with
all narrower ones (Lepski's rule). It holds for any force whose lines are not smooth themselves: noise, bursts, chirps.

The noise of the force, of the power N a line, takes ``N/S_FF`` from a least squares; with N known, it is subtracted
from the normal equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats

from process.types import Complex, Real
from smfe.identification.actuator.rules import RULES


@dataclass(frozen=True)
class RecordLines:
    """Transform of one record.

    Parameters
    ----------
    spacing : float
        Of the lines, one over the length of the record [Hz]; line k lies at ``k spacing``.
    force : ndarray of complex, shape (lines, e)
        Transforms of the forces.
    motion : ndarray of complex, shape (lines, r)
        Transforms of the motion.
    rest : bool, optional
        Whether the record seems to begin and to end at rest.
    """

    spacing: float
    force: Complex
    motion: Complex
    rest: bool = False


@dataclass(frozen=True)
class Sums:
    """Normal equations of one band of each record: shapes (m, f, k, k), (m, f, k, r), (m, f, r), (m,).

    Parameters
    ----------
    gram, cross, power
        Of forces times powers of the distance, and of the motion, without what the transient can explain.
    lines : ndarray, shape (m,)
        Complex equations that are left.
    moments : ndarray of complex, shape (m, f, p, p)
        Sums of products of the terms: what white noise of the force of power 1 adds to `gram`.
    half_width : float
        Of the band [Hz].
    at : ndarray of complex, shape (f, p)
        The terms at the frequencies themselves.
    """

    gram: Complex
    cross: Complex
    power: Real
    lines: Real
    moments: Complex
    half_width: float
    at: Complex

    def of(self, record: int) -> Sums:
        """Return those of one record."""
        part = slice(record, record + 1)
        return replace(
            self,
            gram=self.gram[part],
            cross=self.cross[part],
            power=self.power[part],
            lines=self.lines[part],
            moments=self.moments[part],
        )


@dataclass(frozen=True)
class Local:
    """Responses of one width: compliance (f, r, e), covariance (f, r, e, e), noise of the motion (f, r).

    ``degrees_of_freedom`` is that of each part, ``share`` of the motion is what the force explains,
    ``loss`` what the noise of the force was found to take (f, r, e), ``coefficients`` those of the terms (f, r, k).
    """

    response: Complex
    covariance: Complex
    noise: Real
    degrees_of_freedom: Real
    share: Real
    loss: Complex
    half_width: float
    coefficients: Complex

    @property
    def std(self) -> Real:
        """Root mean square of the complex error, shape (f, r, e)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=2, axis2=3).real, 0.0))


def half_widths(records: Sequence[RecordLines], span: float, poles: int = 0) -> list[float]:
    """Return the half widths to try [Hz], each twice the one before.

    The narrowest has twice as many lines, beyond those of the transients, as there are unknowns.
    """
    unknowns = (RULES.order + 1 + 2 * poles) * records[0].force.shape[1]
    smooth = RULES.order + 1 + 2 * poles
    per_hertz = sum(1.0 / r.spacing for r in records)
    needed = 3.0 * unknowns + smooth * len(records)
    out = [max(0.5 * needed / per_hertz, max(0.5 * (smooth + 1) * r.spacing for r in records))]
    while out[-1] < 0.125 * span and 4.0 * out[-1] / max(r.spacing for r in records) < RULES.most_lines:
        out.append(2.0 * out[-1])
    return out


def sums_of(
    records: Sequence[RecordLines], frequency: Real, half_width: float, poles: Complex | None = None
) -> tuple[Sums, Sums]:
    """Sum the lines of each record within a band around each frequency; at the ends of the record the band is shifted.

    Parameters
    ----------
    records : sequence of RecordLines
        With the same forces and responses.
    frequency : ndarray, shape (f,)
        [Hz].
    half_width : float
        [Hz].
    poles : ndarray of complex, optional
        Resonances inside the bands, ``f_m + j zeta_m f_m`` [Hz]: the response may have them beside the polynomial.

    Returns
    -------
    (Sums, Sums)
        For records that begin and end at rest, and for others: without what a transient can explain.
    """
    known = np.zeros(0, complex) if poles is None else poles
    parts = [_of_record(r, frequency, half_width, known) for r in records]
    gram, cross, power, moments, lines = (np.stack([p[i] for p in parts], axis=1) for i in range(5))
    at = _terms(frequency[:, None], frequency, half_width, known)[:, 0]
    one, two = (Sums(gram[i], cross[i], power[i], lines[i], moments[i], half_width, at) for i in range(2))
    return one, two


def _terms(lines: Real, frequency: Real, half_width: float, poles: Complex) -> Complex:
    """Return the functions that make up a response at lines (f, w) around frequencies (f,), shape (f, w, terms).

    Powers of the distance; for each pole ``1/(f - lambda)`` and its derivative, so that a pole that is not quite right
    costs certainty and no bias.
    """
    away = (lines - frequency[:, None]) / half_width
    out = [away**p for p in range(RULES.order + 1)]
    for pole in poles:
        near = pole.imag / (lines - pole)
        out += [near, near**2]
    return np.stack(out, axis=-1).astype(complex)


def _gathered(
    record: RecordLines, frequency: Real, half_width: float, poles: Complex
) -> tuple[NDArray[np.int64], Complex, Complex]:
    """Return the lines of the bands around frequencies (f, w), the terms there, and an orthonormal basis of transients.

    What the terms can follow over the band may be transient.
    """
    smooth = RULES.order + 1 + 2 * poles.size
    size = min(max(2 * round(half_width / record.spacing) + 1, smooth + 2), record.force.shape[0] - 1)
    first = np.clip(np.round(frequency / record.spacing).astype(int) - size // 2, 1, record.force.shape[0] - size)
    offsets = np.arange(size)
    lines = first[:, None] + offsets
    t = _terms(lines * record.spacing, frequency, half_width, poles)
    if poles.size:
        free = np.linalg.qr(t)[0]
    else:
        free = np.linalg.qr(((offsets - 0.5 * size) / size)[:, None] ** np.arange(RULES.order + 1))[0][None].astype(
            complex
        )
    return lines, t, free


def _of_record(
    record: RecordLines, frequency: Real, half_width: float, poles: Complex
) -> tuple[Complex, Complex, Real, Complex, NDArray[np.int64]]:
    n, e, r = frequency.size, record.force.shape[1], record.motion.shape[1]
    terms, smooth = RULES.order + 1 + 2 * poles.size, RULES.order + 1 + 2 * poles.size
    size, k = _gathered(record, frequency[:1], half_width, poles)[0].shape[1], terms * e
    gram, cross = np.empty((2, n, k, k), complex), np.empty((2, n, k, r), complex)
    power, moments = np.empty((2, n, r)), np.empty((2, n, terms, terms), complex)
    step = max(1, RULES.at_once // (size * (k + r)))
    for begin in range(0, n, step):
        here = slice(begin, begin + step)
        lines, t, free = _gathered(record, frequency[here], half_width, poles)
        turned = free.conj().swapaxes(1, 2)
        z = (t[..., :, None] * record.force[lines][..., None, :]).reshape(*lines.shape, k)
        x = record.motion[lines]
        gram[0, here], cross[0, here] = z.conj().swapaxes(1, 2) @ z, z.conj().swapaxes(1, 2) @ x
        power[0, here], moments[0, here] = np.sum(np.abs(x) ** 2, axis=1), t.conj().swapaxes(1, 2) @ t
        zt, xt = turned @ z, turned @ x
        gram[1, here], cross[1, here] = zt.conj().swapaxes(1, 2) @ zt, zt.conj().swapaxes(1, 2) @ xt
        power[1, here] = np.sum(np.abs(xt) ** 2, axis=1)
        moments[1, here] = (t * np.sum(np.abs(free) ** 2, axis=2)[..., None]).conj().swapaxes(1, 2) @ t
    for sums in (gram, cross, power, moments):
        sums[1] = sums[0] - sums[1]
    return gram, cross, power, moments, np.array([size, size - smooth])


def solve_sums(sums: Sums, weight: Real, force_noise: Real | None = None) -> Local:
    """Solve one width.

    Parameters
    ----------
    sums : Sums
        Of the width.
    weight : ndarray, shape (m, f, r)
        Inverse noise of the motion of each record.
    force_noise : ndarray, shape (m, f, e), optional
        Power of the noise of each force a line; it is subtracted.
    """
    m, f, k, _ = sums.gram.shape
    p = sums.at.shape[1]
    e = k // p
    gram = np.einsum("mfr,mfkl->frkl", weight, sums.gram, optimize=True)
    cross = np.einsum("mfr,mfkr->frk", weight, sums.cross, optimize=True)
    power = np.einsum("mfr,mfr->fr", weight, sums.power)
    clean = gram
    if force_noise is not None:
        each = np.einsum("mfpq,mfi,ij->mfpiqj", sums.moments, force_noise, np.eye(e), optimize=True).reshape(m, f, k, k)
        clean = gram - np.einsum("mfr,mfkl->frkl", weight, each, optimize=True)
    inverse = _inverse(clean)
    value = np.einsum("frkl,frl->frk", inverse, cross)
    shared = np.einsum("frk,frk->fr", value.conj(), cross).real
    curved = np.einsum("frk,frkl,frl->fr", value.conj(), gram, value, optimize=True).real
    left = np.maximum(power - 2.0 * shared + curved, 0.0)
    degrees_of_freedom = max(float(sums.lines.sum()) - k, 0.5)
    noise = left / degrees_of_freedom
    spread = inverse @ gram @ inverse.conj().swapaxes(-1, -2)
    # From coefficients to the response at the frequency itself.
    there = np.einsum("fp,ij->fipj", sums.at, np.eye(e)).reshape(f, 1, e, k)
    covariance = noise[..., None, None] * (there @ spread @ there.conj().swapaxes(-1, -2))
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.clip(1.0 - noise * sums.lines.sum() / power, 0.0, 1.0)
    plain = value if force_noise is None else np.einsum("frkl,frl->frk", _inverse(gram), cross)
    response, lower = ((there @ c[..., None])[..., 0] for c in (value, plain))
    return Local(
        response,
        covariance,
        noise,
        np.full(left.shape, 2.0 * degrees_of_freedom),
        share,
        response - lower,
        sums.half_width,
        value,
    )


def solve_either(both: tuple[Sums, Sums], weight: Real, force_noise: Real | None, rest: bool) -> Local:
    """Solve one width; where all records seem to rest at their ends, with a transient only where the lines show one.

    Of noise, the unknowns of the transients take one variance each from the sum of squares. Where they take clearly
    more, over all responses and neighbouring lines, there is a transient. Where there is none, leaving it out is not
    only weaker: the beginning of a chirp is a transient, and both cannot be separated.
    """
    free = solve_sums(both[1], weight, force_noise)
    if not rest:
        return free
    still = solve_sums(both[0], weight, force_noise)
    q = float(both[0].lines.sum() - both[1].lines.sum())
    without, with_it = still.noise * still.degrees_of_freedom / 2.0, free.noise * free.degrees_of_freedom / 2.0
    with np.errstate(invalid="ignore", divide="ignore"):
        worth = np.nan_to_num((without - with_it) / (q * free.noise), nan=np.inf, posinf=1e6).mean(axis=1)
    reach = 2 if worth.size > 4 else 0
    pooled = ndimage.uniform_filter1d(worth, 2 * reach + 1, mode="nearest")
    moved: NDArray[np.bool_] = np.asarray(pooled > 1.0 + 1.0 / np.sqrt(q * still.noise.shape[1]))
    if reach:
        moved = np.asarray(ndimage.binary_dilation(moved, iterations=reach))
    parts = {}
    for name in ("response", "covariance", "noise", "degrees_of_freedom", "share", "loss", "coefficients"):
        one, two = getattr(still, name), getattr(free, name)
        parts[name] = np.where(moved.reshape(-1, *(1,) * (one.ndim - 1)), two, one)
    return Local(**parts, half_width=free.half_width)


def _inverse(gram: Complex) -> Complex:
    """Return inverses of Hermitian matrices, scaled to a unit diagonal first; what is not determined counts as zero.

    NaN where one is not positive: the noise that was subtracted is more than all.
    """
    size = np.diagonal(gram, axis1=-2, axis2=-1).real
    bad = ~np.isfinite(gram).all(axis=(-1, -2)) | ~(size > 0.0).all(axis=-1)
    scale = 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0))
    unit = gram * scale[..., :, None] * scale[..., None, :]
    unit[bad] = np.eye(unit.shape[-1])
    value, vector = np.linalg.eigh(unit)
    bad |= value[..., 0] < -1e-9
    least = 1e-11 * value[..., -1:]
    inverse = (
        vector * np.where(value > least, 1.0 / np.maximum(value, least), 0.0)[..., None, :]
    ) @ vector.conj().swapaxes(-1, -2)
    inverse = inverse * scale[..., :, None] * scale[..., None, :]
    inverse[bad] = np.nan
    return np.asarray(inverse)


def find_pole(
    records: Sequence[RecordLines], weight: Real, band: tuple[float, float], start: complex, others: Complex,
    steps: int = 12,
) -> complex | None:  # fmt: skip
    """Return the resonance in a band that explains its lines best, by Gauss and Newton's steps from a first guess.

    The coefficients c1 of ``1/(f - lambda)`` and c2 of its derivative, of all responses together, say by how much the
    pole has to move: ``c2/c1``.

    Parameters
    ----------
    records : sequence of RecordLines
        With one force.
    weight : ndarray, shape (m, 1, r)
        Inverse noise of the motion.
    band : (float, float)
        [Hz].
    start : complex
        First guess [Hz].
    others : ndarray of complex
        Poles that are known already.

    Returns
    -------
    complex or None
        None where none is found that explains a fifth of what is left without it.
    """
    centre, half = np.array([0.5 * (band[0] + band[1])]), 0.5 * (band[1] - band[0])
    least = 0.05 * min(r.spacing for r in records)
    rest = all(r.rest for r in records)
    scale = weight[:, 0].mean(axis=0)

    def left(found: Local) -> float:
        return float(np.sum(scale * found.noise[0]))

    before = left(solve_either(sums_of(records, centre, half, others), weight, None, rest))
    pole, best, cost = start, None, RULES.worth * before
    for _ in range(steps):
        poles = np.append(others, pole)
        found = solve_either(sums_of(records, centre, half, poles), weight, None, rest)
        total = left(found)
        if not np.isfinite(total):
            break
        if total < cost:
            best, cost = pole, total
        one, two = found.coefficients[0, :, -2], found.coefficients[0, :, -1]
        size = np.sum(scale * np.abs(one) ** 2)
        if not size > 0.0:
            break
        move = complex(np.sum(scale * one.conj() * two) / size) * pole.imag
        move *= min(1.0, 0.7 * pole.imag / max(abs(move), 1e-300))
        pole = complex(np.clip(pole.real + move.real, *band), max(pole.imag + move.imag, least))
        if abs(move) < 1e-4 * pole.imag:
            break
    return best


def choose(solved: Sequence[Local], charged: float = 0.0) -> tuple[Local, Real, NDArray[np.bool_]]:
    """Take, line by line and row by row, the widest band but one that agrees with all narrower ones.

    Returns
    -------
    Local
        What was taken, its error charged with what even the narrowest band bends.
    ndarray, shape (f, r)
        Half width of the band [Hz].
    ndarray of bool, shape (f, r)
        Where even the two narrowest differ.
    """
    rows = solved[0].response.shape[:2]
    index, agrees = np.zeros(rows, dtype=int), np.ones(rows, dtype=bool)
    for k in range(1, len(solved)):
        for narrower in solved[:k]:
            away = np.abs(solved[k].response - narrower.response)
            scale = np.maximum(narrower.std, 1e-300)
            agrees &= np.nan_to_num(away / scale).max(axis=2) <= RULES.agreement
            # What bends within the narrow band makes it uncertain, so that all agrees with it; its residual shows that.
            most = stats.f.isf(RULES.stronger, narrower.degrees_of_freedom.max(), solved[k].degrees_of_freedom.max())
            agrees &= ~(narrower.noise > most * solved[k].noise)
        # A mode bends the response over several lines; a single line whose noise agrees does not count.
        agrees = ndimage.minimum_filter(agrees, size=(3, 1), mode="nearest")
        index[agrees] = k
    bent = ~agrees & (index == 0) if len(solved) > 1 else np.ones(rows, dtype=bool)
    # The widest that agrees may be bent by as much as the noise of those it was compared with; one less is not.
    index = np.maximum(index - 1, 0)
    f, r = np.ogrid[: rows[0], : rows[1]]
    parts = {
        name: np.array([getattr(s, name) for s in solved])[index, f, r]
        for name in ("response", "covariance", "noise", "degrees_of_freedom", "share", "loss")
    }
    if len(solved) > 1:
        # The error of a polynomial of order 2 grows eightfold with twice the width; modes narrower than that less.
        wider = np.minimum(index + 1, len(solved) - 1)
        step = np.array([s.response for s in solved])[wider, f, r] - parts["response"]
        bias = np.where(bent[..., None], 0.5 * step, charged * step)
        parts["covariance"] = parts["covariance"] + bias[..., :, None] * bias[..., None, :].conj()
    width = np.array([s.half_width for s in solved])[index]
    return Local(**parts, half_width=float(np.mean(width)), coefficients=np.zeros(0, complex)), width, bent


def _uneven(
    records: Sequence[RecordLines], frequency: Real, poles: Complex, sums: Sums, local: Local, weight: Real,
    force_noise: Real,
) -> Local:  # fmt: skip
    """Return a solution whose covariance knows that noise of one force comes through the response: most at its peak.

    Each line has the noise ``N_x + |Phi|^2 N``, and the scores of the lines add up to ``sum conj(z) z (N_x + |Phi|^2
    N)``, where the residual only gives the mean.
    """
    gram = np.einsum("mfr,mfkl->frkl", weight, sums.gram, optimize=True)
    inverse = _inverse(gram)
    scores, through = np.zeros_like(gram), np.zeros(local.noise.shape)
    for record, w, power in zip(records, weight, force_noise[..., 0], strict=True):
        lines, t, free = _gathered(record, frequency, sums.half_width, poles)
        z = t * record.force[lines]
        if sums.lines[0] < lines.shape[1]:
            z = z - free @ (free.conj().swapaxes(1, 2) @ z)
        noise = power[:, None, None] * np.abs(t @ local.coefficients.swapaxes(1, 2)) ** 2
        scores += w[..., None, None] ** 2 * np.einsum("fwk,fwr,fwl->frkl", z.conj(), noise, z, optimize=True)
        through += w * noise.sum(axis=1)
    white = np.maximum(local.noise - through / sums.lines.sum(), 0.0)
    spread = inverse @ (white[..., None, None] * gram + scores) @ inverse.conj().swapaxes(-1, -2)
    there = sums.at[:, None, None, :]
    return replace(local, covariance=np.asarray(there @ spread @ there.conj().swapaxes(-1, -2)))


Chosen = tuple[Local, Real, NDArray[np.bool_]]
"""What `choose` returns."""


def with_poles(
    records: Sequence[RecordLines], frequency: Real, weight: Real, force_noise: Real, chosen: Chosen, finest: float
) -> Chosen:  # fmt: skip
    """Give the responses poles where even the narrowest band bends: resonances narrower than the records resolve.

    Parameters
    ----------
    records, frequency, weight, force_noise
        As of `sums_of` and `solve_sums`.
    chosen : Chosen
        Without poles.
    finest : float
        Half width of the narrowest band [Hz].

    Returns
    -------
    Chosen
        The covariance is infinite where a resonance is too narrow for the records.
    """
    found, width, bent = chosen
    rest = all(r.rest for r in records)
    width, bent = width.copy(), bent.copy()
    response, covariance = found.response.copy(), found.covariance.copy()
    names = ("share", "degrees_of_freedom", "loss", "noise")
    share, degrees_of_freedom, loss, noise = (getattr(found, n).copy() for n in names)
    where = np.asarray(bent.any(axis=1))
    # Stretches closer to each other than a band belong together.
    step = float(np.median(np.diff(frequency)))
    where = ndimage.binary_dilation(where, iterations=max(1, round(3.0 * finest / step)))
    label, count = ndimage.label(where)
    for number in range(1, count + 1):
        lines = np.flatnonzero(label == number)
        band = max(frequency[lines[0]] - 6.0 * finest, records[0].spacing), frequency[lines[-1]] + 6.0 * finest
        centre_weight = weight[:, [lines[lines.size // 2]]]
        poles, left = np.zeros(0, complex), bent[lines]
        for _ in range(RULES.most_poles):
            excess = np.sum(weight[:, lines].mean(axis=0) * np.abs(response[lines, :, 0]) ** 2 * left, axis=1)
            start = complex(frequency[lines[int(np.argmax(excess))]], 0.3 * finest)
            pole = find_pole(records, centre_weight, band, start, poles)
            if pole is None:
                break
            poles = np.append(poles, pole)
            tried = half_widths(records, 4.0 * (band[1] - band[0]) + 64.0 * finest, poles.size)
            solved = []
            for w in tried:
                both = sums_of(records, frequency[lines], w, poles)
                local = solve_either(both, weight[:, lines], force_noise[:, lines], rest)
                solved.append(
                    _uneven(
                        records, frequency[lines], poles, both[not rest], local, weight[:, lines], force_noise[:, lines]
                    )
                )
            new, wide, left = choose(solved, 0.3)
            better = np.sum(new.std**2, axis=2) < np.sum(found.std[lines] ** 2, axis=2)
            better |= bent[lines] & ~left
            for old, fresh in (
                (response, new.response), (covariance, new.covariance), (share, new.share),
                (degrees_of_freedom, new.degrees_of_freedom),
                (loss, new.loss), (noise, new.noise), (width, wide), (bent, left),
            ):  # fmt: skip
                at = better.reshape(better.shape + (1,) * (fresh.ndim - 2))
                old[lines] = np.where(at, fresh, old[lines])
            found = replace(
                found,
                response=response,
                covariance=covariance,
                share=share,
                degrees_of_freedom=degrees_of_freedom,
                loss=loss,
                noise=noise,
            )
            if not left.any():
                break
        if bent[lines].any():
            # Poles that do not explain all of a stretch may explain none of it rightly.
            away = response[lines] - chosen[0].response[lines]
            covariance[lines] += away[..., :, None] * away[..., None, :].conj()
        for pole in poles:
            finest_line = min(r.spacing for r in records)
            if 2.0 * pole.imag < RULES.resolved * finest_line:
                near = np.abs(frequency - pole.real) < 3.0 * max(pole.imag, finest_line)
                covariance[near] = np.inf
    return found, width, bent
