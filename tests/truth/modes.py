"""Frequency responses of free beams and machines with random modes, as a workshop would measure them.

Everything is a sum of second-order terms written out here (numpy only). Drawn at random: how many modes, their damping
(.01 to 5 %), pairs .05 to 1 % apart with shapes alike or not, modes out of the band, rigid motion of a free part, how
many responses (1 to 30) and references, lines (400 to 64,000), the quantity measured (accelerance, mobility,
compliance), its white noise, and whether the noise is stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

QUANTITIES = {"compliance": 0, "mobility": 1, "accelerance": 2}
"""Number of derivatives by time."""


@dataclass(frozen=True)
class Draw:
    """One record and the truth behind it.

    Parameters
    ----------
    kind : str
        "beam" or "machine".
    quantity : str
        Measured quantity over force.
    frequency : ndarray, shape (n,)
        [Hz].
    values : ndarray of complex, shape (n, responses, excitations)
        Of the quantity, with noise [SI].
    std : ndarray like values or None
        Root mean square of the complex noise where it is stated.
    sigma : ndarray, shape (responses, excitations)
        Root mean square of the complex noise [SI].
    response, excitation : tuple of str
        Names of places.
    modes : ndarray, shape (m, 2)
        Natural frequency [Hz] and damping ratio of the modes inside the band, rising.
    parts : ndarray of complex, shape (m, responses, excitations)
        Residue of each over j: compliance is ``part/(w_n^2 - w^2 + 2 j zeta w_n w)``.
    pairs : tuple of (int, int)
        Modes that were drawn as close pairs.
    """

    kind: str
    quantity: str
    frequency: Real
    values: Complex
    std: Real | None
    sigma: Real
    response: tuple[str, ...]
    excitation: tuple[str, ...]
    modes: Real
    parts: Real
    pairs: tuple[tuple[int, int], ...]

    @property
    def turned(self) -> Complex:
        """``(j w)^k`` of the quantity, shape (n,): it over compliance."""
        return (2j * np.pi * self.frequency) ** QUANTITIES[self.quantity]


def term(frequency: Real, natural: float, damping: float) -> Complex:
    """``1/(w_n^2 - w^2 + 2 j zeta w_n w)`` [s2]."""
    w, own = 2.0 * np.pi * frequency, 2.0 * np.pi * natural
    return 1.0 / (own**2 - w**2 + 2j * damping * own * w)


def beam_shape(number: int, x: Real) -> tuple[float, Real]:
    """Return beta L and shape of a bending mode of a free beam at places 0 to 1, 2 at its ends."""
    known = (4.730040744862704, 7.853204624095838, 10.995607838001671, 14.137165491257464)
    b = known[number] if number < 4 else (number + 1.5) * np.pi
    # Written without the difference of large numbers, from either end.
    near = np.exp(-b * x) + np.cos(b * x) - np.sin(b * x)
    sign = 1.0 if number % 2 == 0 else -1.0
    return b, near + sign * np.exp(-b * (1.0 - x))


def draw(seed: int) -> Draw:
    """Return one record, drawn at random."""
    rng = np.random.default_rng([seed, 4711])
    beam = rng.random() < 0.5
    quantity = str(rng.choice(list(QUANTITIES), p=[0.3, 0.2, 0.5]))
    lines = int(np.exp(rng.uniform(np.log(400.0), np.log(64_000.0))))
    count = int(rng.choice([1, 1, 2, 3, 5, 8, 12, 20, 30]))
    references = min(count, int(rng.choice([1, 1, 1, 2, 3])))
    if lines * count * references > 250_000:  # more than this is not kept in one file
        references, count = 1, max(1, 250_000 // lines)
    damping = _dampings(rng)
    modes, shapes, rigid, top = (_beam if beam else _machine)(rng, count, references, damping)
    f = np.linspace(0.0, top, lines + 1)[1:]
    if not beam:
        f = f[f > 0.02 * top]
    modes, shapes, pairs = _paired(rng, modes, shapes, damping)
    drive = shapes[:, :references]
    parts = shapes[:, :, None] * drive[:, None, :]
    w2 = (2.0 * np.pi * f) ** 2
    clean = -rigid[None, :, :] / w2[:, None, None] + 0.0j
    for (natural, zeta), own in zip(modes, parts, strict=True):
        clean += term(f, natural, zeta)[:, None, None] * own
    clean *= ((2j * np.pi * f) ** QUANTITIES[quantity])[:, None, None]
    inside = (modes[:, 0] > 1.02 * f[0]) & (modes[:, 0] < 0.98 * f[-1])
    number = np.cumsum(inside) - 1
    kept = tuple((int(number[a]), int(number[b])) for a, b in pairs if inside[a] and inside[b])
    level = 10.0 ** rng.uniform(-5.0, -1.5) if rng.random() < 0.85 else 0.0
    # A sensor has one noise; it is measured against the middle size of the response, which no single peak sets.
    sigma = level * np.sqrt(np.median(np.abs(clean) ** 2, axis=0)) * np.exp(0.3 * rng.standard_normal(clean.shape[1:]))
    noise = rng.standard_normal((2, *clean.shape))
    values = clean + sigma / np.sqrt(2.0) * (noise[0] + 1j * noise[1])
    stated = level > 0.0 and rng.random() < 0.6
    std = np.broadcast_to(sigma, clean.shape).copy() if stated else None
    response = tuple(f"p{k}" for k in range(count))
    return Draw(
        "beam" if beam else "machine",
        quantity,
        f,
        values,
        std,
        sigma,
        response,
        response[:references],
        modes[inside],
        parts[inside],
        kept,
    )


def _dampings(rng: np.random.Generator) -> tuple[float, float]:
    """Return a middle damping ratio of the part and how much its modes differ (of the logarithm)."""
    return float(np.exp(rng.uniform(np.log(2e-4), np.log(0.03)))), float(rng.uniform(0.1, 0.8))


def _zeta(rng: np.random.Generator, damping: tuple[float, float], count: int) -> Real:
    return np.clip(damping[0] * np.exp(damping[1] * rng.standard_normal(count)), 1e-4, 0.05)


def _beam(rng, count, references, damping):
    """Bending of a free beam in one plane or two: modes, mass-normalised shapes, rigid motion, end of the band."""
    x = np.concatenate([[0.0], rng.uniform(0.0, 1.0, count - 1)])
    first, mass = float(np.exp(rng.uniform(np.log(20.0), np.log(200.0)))), float(np.exp(rng.uniform(-1.0, 4.0)))
    bending = int(rng.integers(3, 11))
    b = np.array([beam_shape(k, x)[0] for k in range(bending + 4)])
    natural = first * (b / b[0]) ** 2
    top = 0.5 * (natural[bending - 1] + natural[bending])
    shapes = np.array([beam_shape(k, x)[1] for k in range(bending + 4)]) / np.sqrt(mass)
    lever = 12.0 * np.outer(x - 0.5, x[:references] - 0.5)
    rigid = (1.0 + lever) / mass
    return np.stack([natural, _zeta(rng, damping, natural.size)], axis=1), shapes, rigid, top


def _machine(rng, count, references, damping):
    """A machine on its feet: modes anywhere, shapes at random, some modes above the band."""
    number, top = int(rng.integers(2, 10)), float(np.exp(rng.uniform(np.log(100.0), np.log(5000.0))))
    apart = np.sort(rng.uniform(np.log(0.06 * top), np.log(0.95 * top), number))
    natural = np.concatenate([np.exp(apart), top * rng.uniform(1.1, 2.5, 3)])
    shapes = rng.standard_normal((natural.size, count)) / np.sqrt(np.exp(rng.uniform(2.0, 7.0)))
    zeta = _zeta(rng, (max(damping[0], 2e-3), damping[1]), natural.size)
    return np.stack([natural, zeta], axis=1), shapes, np.zeros((count, references)), top


def _paired(rng, modes, shapes, damping):
    """Give some modes a neighbour .05 to 1 % away, of a shape like theirs or of its own."""
    pairs: list[tuple[int, int]] = []
    for k in range(len(modes) - 4):
        if rng.random() < 0.12:
            apart = float(np.exp(rng.uniform(np.log(5e-4), np.log(1e-2))))
            near = np.array([modes[k, 0] * (1.0 + apart), _zeta(rng, damping, 1)[0]])
            own = rng.standard_normal(shapes.shape[1]) * np.sqrt(np.mean(shapes[k] ** 2))
            shape = own if rng.random() < 0.6 else shapes[k] * rng.uniform(0.4, 1.2)
            pairs.append((k, len(modes)))
            modes, shapes = np.concatenate([modes, near[None]]), np.concatenate([shapes, shape[None]])
    rank = np.argsort(modes[:, 0])
    place = np.argsort(rank)
    return modes[rank], shapes[rank], tuple((int(place[a]), int(place[b])) for a, b in pairs)


def evidence(record: Draw, number: int) -> float:
    """Return by how much chi-square rises when a mode is left out and the others make good for it to first order.

    The others: residues of every curve and their own poles, near the mode; infinite without noise.
    """
    if not record.sigma.any():
        return float("inf")
    natural, zeta = record.modes[number]
    f = record.frequency
    reach = max(12.0 * zeta * natural, 12.0 * (f[1] - f[0]))
    lines = np.flatnonzero(np.abs(f - natural) < reach)
    lines = lines[:: max(1, lines.size // 600)]
    step = max(1.0, np.sum(np.abs(f - natural) < reach) / max(lines.size, 1))
    f = f[lines]
    turned = record.turned[lines]
    near = [k for k in range(len(record.modes)) if k != number and abs(record.modes[k, 0] - natural) < 2.0 * reach]
    columns = [np.ones(f.size, complex), (f - natural) / reach + 0.0j]
    for k in near:
        own = 2.0 * np.pi * record.modes[k, 0]
        s = own * (-record.modes[k, 1] + 1j * np.sqrt(1.0 - record.modes[k, 1] ** 2))
        pole = record.modes[k, 1] * own / (2j * np.pi * f - s)
        columns += [
            pole,
            pole**2,
        ]  # a residue of its own and a shift of the pole in every curve: no less than it can do
    q, _ = np.linalg.qr(np.stack(columns, axis=1))
    own = term(f, natural, zeta)
    left = own - q @ (q.conj().T @ own)
    size = np.sum(np.abs(left * np.abs(turned)) ** 2) * step
    return float(2.0 * size * np.sum(record.parts[number] ** 2 / record.sigma**2))
