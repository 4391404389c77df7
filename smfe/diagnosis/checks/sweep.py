"""What an inversion of sweeps takes for granted: an open loop, and one posture within a pass.

The cut answers to vibration, so a motion that other forces cause comes back as a force: least squares then mixes the
machine with the cut. The passing of the teeth does not depend on vibration: as an instrument it gives
``G = S_yr/S_ur`` without that bias (joint input-output identification; Van den Hof and Schrama 1993). A machine that
changes along a pass gives other compliances in its first and in its second half.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr
from scipy import fft, stats

from process.errors import InputError
from process.labels import sample_interval
from process.types import Complex, Real
from smfe.diagnosis.checks.rules import RULES
from smfe.diagnosis.checks.suspect import Suspect, warning
from smfe.identification.errors.difference import Difference, compare
from smfe.identification.spectra.spectra import motion_axes
from smfe.identification.sweep.local_polynomial import LocalPolynomial
from smfe.identification.sweep.passes import SweepPass, end_pieces, in_cut, whole_record
from smfe.identification.sweep.sweep import identify_sweep


def sweep_suspects(
    name: str, passes: Sequence[SweepPass], teeth: int, frequency_range: tuple[float, float]
) -> Iterator[Suspect]:
    """Yield suspicions about what an inversion of sweeps takes for granted: ``regeneration_bias``, ``posture``."""
    biased = regeneration_difference(passes, teeth, frequency_range)
    if biased is not None and matters(biased):
        yield warning(
            "regeneration_bias",
            name,
            f"with the passing of the teeth as instrument the compliance differs by {100.0 * biased.size:.2g} % "
            f"({_chance(biased.p_value)}, most at {biased.worst:.4g} Hz): part of the forces answers to vibration that "
            "other forces cause",
            "cut less deep and away from chatter, find what shakes the machine, or use the instrument",
        )
    halves = posture_difference(passes, frequency_range)
    if halves is not None and matters(halves):
        yield warning(
            "posture",
            name,
            f"the first and the second half of the passes give compliances that differ by {100.0 * halves.size:.2g} % "
            f"({_chance(halves.p_value)}, most at {halves.worst:.4g} Hz)",
            "sweep over a shorter way, or from other positions; feed and level change along a pass, too",
        )


def matters(found: Difference) -> bool:
    """Return whether a difference is more than noise, and large enough to matter."""
    return found.p_value < RULES.p_value and found.size > RULES.notable


def posture_difference(passes: Sequence[SweepPass], frequency_range: tuple[float, float]) -> Difference | None:
    """Compare compliances of the first and of the second half of the passes.

    A frequency that the fundamental of the tooth passing visits in one half is visited by a harmonic in the other.
    None where the halves have no frequency in common that both can solve.
    """
    half = RULES.half_width
    estimator = LocalPolynomial(resolution=2.0 * half, half_widths=(half,), order=RULES.order, rational=False)
    halves: tuple[list[SweepPass], list[SweepPass]] = ([], [])
    for p in passes:  # with the air on its side
        cutting = np.flatnonzero(in_cut(p.record))
        middle = int(cutting[0] + cutting[-1]) // 2 if cutting.size else p.record.sizes["time"] // 2
        for which, piece in zip(halves, (slice(None, middle), slice(middle, None)), strict=True):
            which.append(SweepPass(p.record.isel(time=piece), p.label, p.arc))
    try:
        first, second = (identify_sweep("half", h, frequency_range, estimator).compliance for h in halves)
    except InputError:
        return None
    a, b = (v["compliance"].values for v in (first, second))
    covariance = first["compliance_covariance"].values + second["compliance_covariance"].values
    size = 0.5 * np.abs(a + b)
    # Where the variance of one half is large, transients are what is left of it, not noise.
    variance = np.trace(covariance, axis1=2, axis2=3).real.sum(axis=1)
    known = np.nan_to_num(variance, nan=np.inf) < RULES.halves_known**2 * np.nansum(size**2, axis=(1, 2))
    return _compare(first["frequency"].values[known], (a - b)[known], covariance[known], size[known])


def regeneration_difference(
    passes: Sequence[SweepPass], teeth: int, frequency_range: tuple[float, float]
) -> Difference | None:
    """Compare least squares with instruments: what passes with the teeth, and nothing else.

    None where a pass has no ``spindle_angle``, or the instruments have too little power at all frequencies.
    """
    if not passes or any("spindle_angle" not in p.record for p in passes):
        return None
    response = [a for a in "xyz" if all(a in motion_axes(p.record)[1] for p in passes)]
    half = RULES.half_width
    reach = (max(frequency_range[0] - half, 0.1), frequency_range[1] + half)
    blocks = []
    for p in passes:
        found = whole_record(p.record, reach, response)
        noise = end_pieces(p.record, "force")
        dt = sample_interval(p.record)
        power = np.minimum(noise[:, 0], noise[:, -1]) ** 2 * dt**2 * p.record.sizes["time"]
        lines = _references(p.record, teeth, reach)
        blocks.append((found.frequency, found.force[:, :, 0], found.displacement[:, :, 0], lines, power))
    frequency = np.arange(frequency_range[0] + half, frequency_range[1], 2.0 * half)
    solved = {float(f): both for f in frequency if (both := _both(blocks, float(f))) is not None}
    if not solved:
        return None
    change, noise, spread, size = (np.stack(x) for x in zip(*solved.values(), strict=True))
    return _unweighted(np.array(list(solved)), change, noise, spread, size)


def _references(record: xr.Dataset, teeth: int, reach: tuple[float, float]) -> Complex:
    """Return transforms of ``exp(j h N theta)`` while the tool cuts, shape (f, harmonics)."""
    dt, n = sample_interval(record), record.sizes["time"]
    length = fft.next_fast_len(n, real=True)
    frequency = fft.fftfreq(length, dt)
    # As `whole_record` takes its lines.
    low, high = np.searchsorted(frequency[: length // 2], [reach[0] - 1e-9, reach[1] + 1e-9])
    angle, cut = record["spindle_angle"].values, in_cut(record)
    waves = [np.exp(1j * h * teeth * angle) * cut for h in range(1, RULES.harmonics + 1)]
    return np.stack([dt * fft.fft(w, length)[low:high] for w in waves], axis=1)


def _both(
    blocks: Sequence[tuple[Real, Complex, Complex, Complex, Real]], centre: float
) -> tuple[Complex, Complex, Complex | Real, Real] | None:
    """Return instruments minus least squares, the two factors of its covariance, and the size of the compliance.

    At a frequency; the factors are the covariance of the noise of the responses and that of the columns.
    """
    half, powers = RULES.half_width, np.arange(RULES.order + 1)
    regressors, instruments, responses = [], [], []
    loss = np.zeros((3 * powers.size, 3 * powers.size))
    for k, (frequency, force, motion, lines, noise) in enumerate(blocks):
        at = slice(*np.searchsorted(frequency, [centre - half, centre + half]))
        shift = (frequency[at] - centre) / half
        terms = shift[None, :] ** powers[:, None]
        regressors.append(_products(terms, force[at].T))
        own = np.zeros((len(blocks), RULES.harmonics * powers.size, shift.size), dtype=complex)
        own[k] = _products(terms, lines[at].T)
        instruments.append(own.reshape(-1, shift.size))
        responses.append(motion[at].T)
        loss += np.kron(terms @ terms.T, np.diag(noise))
    u, z, y = (np.concatenate(v, axis=1) for v in (regressors, instruments, responses))
    # Orthonormal rows of what the instruments span; instruments without power here span nothing.
    length = np.linalg.norm(z, axis=1, keepdims=True)
    present = (length > 1e-3 * length.max(initial=1e-300))[:, 0]
    _, singular, rows = np.linalg.svd(z[present] / length[present], full_matrices=False)
    rank = int(np.sum(singular > 1e-6 * singular.max(initial=1e-300)))
    basis = rows[:rank]
    if rank < u.shape[0] or y.shape[1] < 2 * rank:
        return None
    passed = (u @ basis.conj().T) @ basis
    plain, by_teeth = u @ u.conj().T, passed @ passed.conj().T
    if np.linalg.cond(by_teeth) > 1e10:
        return None
    inverse, through = np.linalg.inv(plain), np.linalg.inv(by_teeth)
    squares, instrumental = y @ u.conj().T @ inverse, y @ passed.conj().T @ through
    # Noise of the force sensor takes from least squares what is expected: E[P] = P (1 - N (U U^H)^-1).
    change = (instrumental - squares - instrumental @ loss @ inverse)[:, :3]
    rest = y - instrumental @ u
    noise = rest @ rest.conj().T / (y.shape[1] - u.shape[0])
    # Hausman 1978: what least squares shares with the instruments cancels.
    return change, noise, (through - inverse)[:3, :3], np.abs(instrumental[:, :3])


def _products(terms: Real, signals: Complex) -> Complex:
    """Every signal times every power of the shift, shape (powers * signals, lines)."""
    return np.asarray((terms[:, None, :] * signals[None, :, :]).reshape(-1, terms.shape[1]))


def _unweighted(
    frequency: Real, change: Complex, noise: Complex | Real, spread: Complex | Real, size: Real
) -> Difference:
    """Compare differences of shape (f, rows, 3) with nothing, by the sum of their squares.

    Instruments and least squares agree in some directions by construction, so that no inverse of the covariance is to
    be trusted, and none is needed: with ``C = noise x spread`` at each frequency the sum of ``|d|^2`` of circular noise
    has the mean ``sum tr C`` and the variance ``sum tr C^2``, and is about chi^2 with ``2 (sum tr C)^2/sum tr C^2``
    degrees of freedom (Satterthwaite, Biometrics 2, 1946).
    """
    squares = np.sum(np.abs(change) ** 2, axis=(1, 2))
    mean = (np.einsum("faa->f", noise) * np.einsum("faa->f", spread)).real
    variance = (np.einsum("fab,fba->f", noise, noise) * np.einsum("fab,fba->f", spread, spread)).real
    whole = float(mean.sum())
    degrees_of_freedom = 2.0 * whole**2 / float(variance.sum())
    p_value = float(stats.chi2.sf(degrees_of_freedom * float(squares.sum()) / whole, degrees_of_freedom))
    beyond = max(float(squares.sum()) - whole, 0.0)
    relative = float(np.sqrt(beyond / max(float(np.sum(size**2)), 1e-300)))
    return Difference(relative, p_value, float(frequency[int(np.argmax(squares / mean))]), int(frequency.size))


def _compare(frequency: Real, change: Complex, covariance: Complex, size: Real) -> Difference | None:
    """Compare differences of shape (f, rows, 3) with covariances ``E[d_j conj(d_k)]``, shape (f, rows, 3, 3)."""
    usable = np.isfinite(change).all(axis=(1, 2)) & np.isfinite(covariance).all(axis=(1, 2, 3))
    if not usable.any():
        return None
    d, c = change[usable], covariance[usable]
    lines, rows, columns = d.shape
    whole = np.zeros((lines, rows, columns, rows, columns), dtype=complex)
    whole[:, np.arange(rows), :, np.arange(rows)] = c.swapaxes(0, 1)
    n = rows * columns
    return compare(frequency[usable], d.reshape(lines, n), whole.reshape(lines, n, n), size[usable], rows=rows)


def _chance(p_value: float) -> str:
    """Return a probability as far as a test can tell it."""
    return f"p = {p_value:.1e}" if p_value >= 1e-16 else "p < 1e-16"
