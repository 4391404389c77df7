"""The estimators of sweep milling on a synthetic experiment, written out plainly: nothing is taken from the packages.

Five modes, an eight-insert cutter, tooth passing 18 to 50 Hz; the force is that of the closed form, the machine answers
without regeneration. Judged by the rms over 22-46 Hz of ``||dPhi||_F/||Phi||_F``. Three estimators at a frequency f:

(A) transform of the whole pass, least squares over the lines within +-B of f;
(B) order tracking: ``int w(t) x(t) exp(-j h N theta) dt`` over a Hann window round the moment when harmonic h is at f;
(C) as (A), the compliance a polynomial of second order over the lines, and one per pass for what its ends leave.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from scipy import fft, signal
from truth.sweep import Modes

RATE = 8192.0
SWEPT = (18.0, 50.0)
JUDGED = np.arange(22.0, 46.01, 0.25)
TEETH, DIAMETER, APPROACH, FEED = 8, 0.125, math.pi / 4.0, 2e-4
CUTTING, EDGE = (1800e6, 700e6, 250e6), (30e3, 45e3, 5e3)
LEAD = 0.5
"""Air before a cut that ends in air [s]."""

WINDOWS = (0.25, 0.5, 1.0, 2.0)
TRIOS = {
    "A": (0.3, 0.5, 0.85),
    "B": (0.5, 0.5, 0.5),
    "C": (0.8, 0.8, 0.8),
    "E": (0.5, 0.5, 0.95),
    "D": (0.5, 0.5, 1.0),
}
"""Widths of down, up and central milling over the diameter. D: two halves and their sum, the slot."""

Real = np.ndarray
Complex = np.ndarray


def ram(stiffer: float = 1.0) -> Modes:
    """Return the five modes; frequencies and damping are given, stiffness and directions are our choice."""
    u = np.array([[0.1, 0.8, 0.6], [0.7, 0.7, 0.1], [1.0, 0.1, 0.05], [0.1, 0.3, 1.0], [0.5, -0.8, 0.2]])
    k = stiffer * np.array([40e6, 60e6, 35e6, 80e6, 90e6])
    f, zeta = np.array([24.0, 29.0, 34.0, 58.0, 95.0]), np.array([0.022, 0.026, 0.03, 0.03, 0.04])
    return Modes(f, zeta, k, u / np.linalg.norm(u, axis=1)[:, None])


def arc(cut: str, share: float) -> tuple[float, float]:
    """Entry and exit [rad] for a width over the diameter."""
    if cut == "central":
        return 0.5 * math.pi - math.asin(share), 0.5 * math.pi + math.asin(share)
    reach = math.acos(1.0 - 2.0 * share)
    return (math.pi - reach, math.pi) if cut == "down" else (0.0, reach)


def tooth_force(phi: Real, entry: float, leave: float, depth: float) -> Real:
    """Force of one tooth on the tool (3, n) [N] at angles in 0..2 pi."""
    sk, ck = math.sin(APPROACH), math.cos(APPROACH)
    s, c = np.sin(phi), np.cos(phi)
    t, r, a = (depth * (k * FEED * s + e / sk) for k, e in zip(CUTTING, EDGE, strict=True))
    normal = r * sk + a * ck
    force = np.array([-normal * s - t * c, t * s - normal * c, r * ck - a * sk])
    return np.where((phi >= entry) & (phi <= leave), force, 0.0)


def harmonic(cut: str, share: float, h: int, depth: float = 2e-3) -> Complex:
    """Amplitude of harmonic h of the tooth passing, ``(N/pi) int f exp(-j h N phi) dphi`` [N]."""
    entry, leave = arc(cut, share)
    x, weight = np.polynomial.legendre.leggauss(200)
    phi = 0.5 * (leave - entry) * (x + 1.0) + entry
    wave = np.exp(-1j * h * TEETH * phi) * weight * 0.5 * (leave - entry)
    return TEETH / math.pi * tooth_force(phi, entry, leave, depth) @ wave


def condition(trio: str, h: int = 1) -> float:
    """Condition number of the forces of three passes at one harmonic."""
    forces = [harmonic(cut, share, h) for cut, share in zip(("down", "up", "central"), TRIOS[trio], strict=True)]
    return float(np.linalg.cond(np.array(forces).T))


@dataclass(frozen=True)
class Pass:
    """Angle [rad], force (3, n) [N] and acceleration (3, n) [m/s2] of a pass, its sweep [Hz/s], where it begins [s]."""

    cut: str
    angle: Real
    force: Real
    acceleration: Real
    slope: float
    begin: float


@functools.cache
def _shaken(seconds: float, tail: float, cut: str, share: float, depth: float, stiffer: float) -> Pass:
    """Sweep a pass; without a free decay behind it there is no air before it either."""
    lead = LEAD if tail else 0.0
    t = np.arange(round((lead + seconds + tail) * RATE)) / RATE - lead
    slope = (SWEPT[1] - SWEPT[0]) / seconds
    angle = 2.0 * math.pi / TEETH * (SWEPT[0] * t + 0.5 * slope * t**2)
    grid = np.arange(28800) * 2.0 * math.pi / 28800 / TEETH
    each = [tooth_force(grid + 2.0 * math.pi * j / TEETH, *arc(cut, share), depth) for j in range(TEETH)]
    force = np.array([np.interp(angle, grid, row, period=2.0 * math.pi / TEETH) for row in np.sum(each, axis=0)])
    force[:, (t < 0.0) | (t >= seconds)] = 0.0
    return Pass(cut, angle, force, accelerated(ram(stiffer), force), slope, lead)


def accelerated(modes: Modes, force: Real) -> Real:
    """Answer of the modes to a force that is linear between samples."""
    out = np.zeros_like(force)
    for f, z, k, u in zip(modes.frequency, modes.damping, modes.stiffness, modes.direction, strict=True):
        w = 2.0 * math.pi * f
        num, den, _ = signal.cont2discrete(([w**2 / k, 0.0, 0.0], [1.0, 2.0 * z * w, w**2]), 1.0 / RATE, "foh")
        out += np.outer(u, signal.lfilter(num.ravel(), den, u @ force))
    return out


def experiment(seconds: float, tail: float, trio: str = "A", depth: float = 2e-3, stiffer: float = 1.0) -> list[Pass]:
    """Return the three passes of a sweep that lasts so long, with so much free decay behind it [s]."""
    pairs = zip(("down", "up", "central"), TRIOS[trio], strict=True)
    return [_shaken(seconds, tail, cut, share, depth, stiffer) for cut, share in pairs]


def noisy(passes: list[Pass], motion: float, force: float, seed: int) -> list[Pass]:
    """Add noise, whose rms per sample is given at 4096 Hz."""
    rng = np.random.default_rng(seed)
    more = math.sqrt(RATE / 4096.0)
    return [
        Pass(
            p.cut,
            p.angle,
            p.force + more * force * rng.standard_normal(p.force.shape),
            p.acceleration + more * motion * rng.standard_normal(p.force.shape),
            p.slope,
            p.begin,
        )
        for p in passes
    ]


def _lines(p: Pass) -> tuple[Real, Complex, Complex]:
    """Frequency (n,), force and displacement (n, 3) at the lines of a whole pass."""
    f = fft.rfftfreq(p.angle.size, 1.0 / RATE)
    inside = (f > SWEPT[0]) & (f < SWEPT[1])
    force, motion = (fft.rfft(x, axis=1)[:, inside].T for x in (p.force, p.acceleration))
    return f[inside], force, motion / -((2.0 * math.pi * f[inside, None]) ** 2)


def whole_pass(passes: list[Pass], half: float, order: int = 0, transient: bool = False, at: Real = JUDGED) -> Complex:
    """(A): order 0; (C): order 2, with `transient` a polynomial of its own for each pass. Shape (f, 3, 3)."""
    seen = [_lines(p) for p in passes]
    out = np.empty((at.size, 3, 3), dtype=complex)
    for i, f0 in enumerate(at):
        pieces = [_near(*lines, f0, half, order) for lines in seen]
        rows = [row for row, _, _ in pieces]
        if transient:
            sizes = [row.shape[0] for row in rows]
            own = [np.zeros((n, len(seen), order + 1), dtype=complex) for n in sizes]
            for k, (block, (_, power, _)) in enumerate(zip(own, pieces, strict=True)):
                block[:, k] = power * np.abs(seen[k][1]).mean()
            rows = [np.concatenate([r, b.reshape(len(r), -1)], axis=1) for r, b in zip(rows, own, strict=True)]
        right = np.concatenate([motion for _, _, motion in pieces])
        out[i] = np.linalg.lstsq(np.concatenate(rows), right, rcond=None)[0][:3].T
    return out


def _near(
    f: Real, force: Complex, motion: Complex, f0: float, half: float, order: int
) -> tuple[Complex, Real, Complex]:
    """Rows of the equations at the lines within a band, else at the nearest; powers of the distance; motions."""
    near = np.abs(f - f0) <= half + 1e-9
    if not near.any():
        near = np.abs(f - f0) <= np.abs(f - f0).min()
    power = ((f[near] - f0) / half)[:, None] ** np.arange(order + 1)
    return (power[:, :, None] * force[near][:, None, :]).reshape(near.sum(), -1), power, motion[near]


def own_lines(passes: list[Pass]) -> Real:
    """Lines of the transform of the passes within the band."""
    f = _lines(passes[0])[0]
    return f[(f >= JUDGED[0]) & (f <= JUDGED[-1])]


def orders(passes: list[Pass], window: float, harmonics: int = 3) -> Complex:
    """(B): one column a pass and harmonic that reaches the frequency. Shape (f, 3, 3)."""
    size = round(window * RATE)
    hann = 0.5 - 0.5 * np.cos(2.0 * math.pi * (np.arange(size) + 0.5) / size)
    out = np.empty((JUDGED.size, 3, 3), dtype=complex)
    for i, f0 in enumerate(JUDGED):
        left, right = [], []
        for p in passes:
            for h in range(1, harmonics + 1):
                centre = (f0 / h - SWEPT[0]) / p.slope
                if not 0.0 <= centre * p.slope <= SWEPT[1] - SWEPT[0]:
                    continue
                first = round((p.begin + centre) * RATE) - size // 2
                # A window that begins before the record or ends behind it is cut off.
                piece = slice(max(first, 0), min(first + size, p.angle.size))
                shape = hann[piece.start - first : piece.stop - first]
                wave = shape * np.exp(-1j * h * TEETH * p.angle[piece])
                left.append(p.force[:, piece] @ wave)
                right.append(p.acceleration[:, piece] @ wave / -((2.0 * math.pi * f0) ** 2))
        out[i] = np.linalg.lstsq(np.array(left), np.array(right), rcond=None)[0].T
    return out


def error(estimate: Complex, stiffer: float = 1.0, at: Real = JUDGED) -> float:
    """Rms over the band of the relative error, where there is an estimate."""
    truth = ram(stiffer).compliance(at)
    size = np.sum(np.abs(truth) ** 2, axis=(1, 2))
    return float(np.sqrt(np.nanmean(np.sum(np.abs(estimate - truth) ** 2, axis=(1, 2)) / size)))
