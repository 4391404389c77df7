"""A mode that nobody declared, seen in what declared poles leave."""

import numpy as np
import pytest

from process.machine.modes import ModalModel
from smfe.diagnosis.frf.further_mode import further_mode
from smfe.diagnosis.frf.noise import Excited

F = np.linspace(20.0, 300.0, 700)
EVERY = tuple((r, e) for r in "xyz" for e in "xyz")
TRUE = ModalModel(
    np.array([45.0, 80.0, 152.0]),
    np.array([0.03, 0.02, 0.025]),
    np.array([40e6, 45e6, 90e6]),
    np.array([[0.98, 0.1, -0.15], [0.05, 0.99, 0.1], [0.6, -0.78, 0.2]]),
)
ALONG = np.array([0.55, 0.6, -0.58]) / np.linalg.norm([0.55, 0.6, -0.58])


def declared(rng):
    """Poles half a per cent off, damping by a third, stiffness by a tenth, directions by some degrees."""
    off = 0.005 * np.array([1.0, -1.0, 0.7])
    damping = np.array(TRUE.damping) * np.array([0.7, 1.35, 0.8])
    turned = np.array(TRUE.direction) + 0.1 * rng.standard_normal((3, 3))
    return ModalModel(np.array(TRUE.frequency) * (1.0 + off), damping, np.array(TRUE.stiffness) * 1.1, turned)


def measured(size, at, damping, entries=EVERY, noise=0.01, seed=0):
    """Three sets seen by sensors with gains and cross-talk of their own; one mode more, of a size over the rest."""
    rng, found = np.random.default_rng(seed), []
    whole = TRUE.matrix(F)
    compliance = size * np.abs(whole).max() * 2.0 * damping
    more = compliance * np.outer(ALONG, ALONG) / (1.0 - (F / at) ** 2 + 2j * damping * F / at)[:, None, None]
    for _ in range(3):
        sensor = np.diag(1.0 + 0.03 * rng.standard_normal(3)) @ (np.eye(3) + 0.03 * rng.standard_normal((3, 3)))
        phi = (sensor @ (whole + more)).reshape(F.size, 9)[:, [EVERY.index(e) for e in entries]]
        std = noise * np.sqrt(np.mean(np.abs(phi) ** 2, axis=0)) * np.ones((F.size, 1))
        white = rng.standard_normal((2, *phi.shape)) / np.sqrt(2.0)
        found.append((Excited(F, tuple(entries), std, "hammer", 1.0), phi + std * (white[0] + 1j * white[1])))
    return declared(rng), found, compliance


@pytest.mark.parametrize("at", [61.0, 104.0, 143.0, 210.0])
@pytest.mark.parametrize("taps", ["xyz", "xy"])
def test_a_mode_is_seen_whatever_gains_and_directions_are(at, taps):
    """Between the others and within the width of one; what was not tapped follows from a single mode."""
    model, seen, compliance = measured(0.4, at, 0.034, [e for e in EVERY if e[1] in taps])
    found = further_mode(model, seen)
    assert found["mode_frequency"] == pytest.approx(at, rel=0.02)
    assert 0.5 * compliance < found["mode_compliance"] < 2.0 * compliance
    a, e = found["mode_azimuth"], found["mode_elevation"]
    along = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    assert abs(along @ ALONG) > np.cos(np.radians(15.0))


def test_where_all_modes_are_declared_none_is_seen():
    model, seen, _ = measured(0.0, 100.0, 0.03, noise=0.03)
    assert further_mode(model, seen) == {}
    exact = measured(0.0, 100.0, 0.03, noise=0.001)[1]
    assert further_mode(TRUE, exact) == {}


def test_a_driving_point_that_a_mode_would_make_stiffer_is_no_mode():
    model, seen, _ = measured(0.4, 104.0, 0.034)
    whole = [(excited, TRUE.matrix(F).reshape(F.size, 9)) for excited, _ in seen]
    less = [(excited, 2.0 * w - phi) for (excited, phi), (_, w) in zip(seen, whole, strict=True)]
    direct = [(Excited(F, (("x", "x"),), x.std[:, :1], "hammer", 1.0), phi[:, :1]) for x, phi in less]
    found = further_mode(model, direct)
    assert abs(found.get("mode_frequency", 0.0) - 104.0) > 2.0


@pytest.mark.parametrize("seed", [*range(8), *(pytest.param(n, marks=pytest.mark.slow) for n in range(8, 40))])
def test_a_mode_of_any_machine_that_is_not_inside_another_is_seen(seed):
    """Two to six modes over any band, damping of 0.4 to 6 %, few or many lines, one measurement, poles half a % off."""
    rng = np.random.default_rng([seed, 7])

    def drawn(low, high, size=None):
        return np.exp(rng.uniform(np.log(low), np.log(high), size))

    low = drawn(15.0, 200.0)
    high = low * drawn(6.0, 60.0)
    count = int(rng.integers(2, 7))
    known, damping = np.sort(drawn(1.3 * low, 0.9 * high, count)), drawn(0.004, 0.06, count)
    true = ModalModel(known, damping, drawn(1e7, 2e8, count), rng.standard_normal((count, 3)))
    at, zeta = drawn(1.2 * low, 0.9 * high), drawn(0.004, 0.06)
    while np.any(np.abs(np.log(at / known)) < damping + zeta):
        at, zeta = drawn(1.2 * low, 0.9 * high), drawn(0.004, 0.06)
    # Two lines within the width of each mode at the least: what no line shows nobody sees.
    least = round((high - low) / min(zeta * at, float(np.min(damping * known))))
    f = np.linspace(low, high, max(int(rng.choice([200, 1500, 6000])), least))
    along = rng.standard_normal(3) / np.sqrt(3.0)
    size = rng.uniform(0.2, 0.5) * np.abs(true.matrix(f)).max() * 2.0 * zeta
    more = size * np.outer(along, along) / (1.0 - (f / at) ** 2 + 2j * zeta * f / at)[:, None, None]
    phi = (true.matrix(f) + more).reshape(f.size, 9)
    std = 0.02 * np.sqrt(np.mean(np.abs(phi) ** 2, axis=0)) * np.ones((f.size, 1))
    white = rng.standard_normal((2, *phi.shape)) / np.sqrt(2.0)
    said = ModalModel(
        known * (1.0 + 0.005 * rng.standard_normal(count)),
        damping * np.exp(0.2 * rng.standard_normal(count)),
        1.1 * np.array(true.stiffness),
        np.array(true.direction) + 0.05 * rng.standard_normal((count, 3)),
    )
    found = further_mode(said, [(Excited(f, EVERY, std, "hammer", 1.0), phi + std * (white[0] + 1j * white[1]))])
    assert found["mode_frequency"] == pytest.approx(at, rel=max(0.02, 2.0 * zeta))
