"""A mode with a joint: linear limits, the balance against integration in time, decays against integration in time."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from process.errors import InputError
from process.machine.jointed_mode import JointedMode
from process.machine.joints import CubicSpring, Iwan, PowerIwan

MASS, STUCK, VISCOUS = 2.0, 5e5, 3.0
"""kg, N/m of the whole mode at rest, N s/m: 80 Hz, damping 0.15 %."""

BOLTED = PowerIwan(1e5, 40.0, -0.3, 0.2, elements=200)
MODE = JointedMode(MASS, STUCK - BOLTED.stiffness, VISCOUS, BOLTED)
LINEAR = JointedMode(MASS, 0.0, VISCOUS, CubicSpring(STUCK, 0.0))


def integrated(mode: JointedMode, start: float, seconds: float, force: float = 0.0, hertz: float = 1.0, steps=200):
    """Displacement at `steps` instants a period, by central differences with the sliders one by one."""
    sliders, limit = mode.joint.packed()
    h = 1.0 / (80.0 * steps)
    n = int(seconds / h)
    out, slid = np.empty(n), np.zeros(sliders.size)
    before = now = start
    for i in range(n):
        stretched = np.clip(sliders * (now - slid), -limit, limit)
        slid = now - stretched / sliders
        push = force * math.cos(2.0 * math.pi * hertz * i * h) - mode.stiffness * now - stretched.sum()
        a, b = mode.mass / h**2, mode.damping / (2.0 * h)
        before, now = now, (push + 2.0 * a * now - (a - b) * before) / (a + b)
        out[i] = now
    return h * np.arange(1, n + 1), out


def fundamental(t: NDArray, x: NDArray, hertz: float, periods: int) -> complex:
    """Of the last periods."""
    n = round(periods / hertz / (t[1] - t[0]))
    basis = np.exp(-2j * np.pi * hertz * t[-n:])
    return complex(2.0 * np.mean(x[-n:] * basis))


def test_a_linear_mode_has_the_closed_forms_of_a_linear_oscillator() -> None:
    w0 = math.sqrt(STUCK / MASS)
    f, zeta = LINEAR.backbone([1e-6, 1e-3])
    np.testing.assert_allclose(f, w0 / (2 * math.pi))
    np.testing.assert_allclose(zeta, VISCOUS / (2 * MASS * w0))
    at = np.array([70.0, 79.5, 79.6, 90.0])
    w = 2 * np.pi * at
    expected = 5.0 / np.abs(STUCK - MASS * w**2 + 1j * VISCOUS * w)
    for found in LINEAR.response(5.0, at):
        np.testing.assert_allclose(found, expected, rtol=1e-9)
    t = np.linspace(0.0, 3.0, 7)
    amplitude, phase = LINEAR.decay(1e-3, t)
    np.testing.assert_allclose(amplitude, 1e-3 * np.exp(-VISCOUS / (2 * MASS) * t), rtol=1e-9)
    np.testing.assert_allclose(phase, w0 * t, rtol=1e-9)


def test_force_and_response_are_each_others_inverse() -> None:
    f = np.linspace(75.0, 81.0, 25)
    low, high = MODE.response(6.0, f)
    np.testing.assert_allclose(np.abs(MODE.force(low, f)), 6.0, rtol=1e-9)
    np.testing.assert_allclose(np.abs(MODE.force(high, f)), 6.0, rtol=1e-9)
    assert np.all(low <= high * (1 + 1e-9))


def test_the_phase_is_ninety_degrees_on_the_backbone_and_the_force_is_its_damping() -> None:
    x = np.geomspace(1e-6, 1e-3, 9)
    f, zeta = MODE.backbone(x)
    force = MODE.force(x, f)
    np.testing.assert_allclose(np.angle(force), 0.5 * np.pi, atol=1e-9)
    np.testing.assert_allclose(np.abs(force), 2.0 * zeta * MASS * (2 * np.pi * f) ** 2 * x, rtol=1e-9)


def test_a_hardening_mode_answers_with_two_amplitudes_where_it_jumps() -> None:
    duffing = JointedMode(1.0, 0.0, 1.0, CubicSpring(1e5, 4e11))
    low, high = duffing.response(0.5, [40.0, 60.0, 300.0])
    assert low[0] == pytest.approx(high[0], rel=1e-9)
    assert high[1] > 2.0 * low[1]
    assert low[2] == pytest.approx(high[2], rel=1e-9)


@pytest.mark.slow
def test_the_forced_response_is_that_of_an_integration_in_time() -> None:
    # Tens of periods from the balance on: what is left after 0.6 s is a transient of the small damping.
    for force, hertz in ((4.0, 78.0), (10.0, 77.5)):
        predicted = float(MODE.response(force, hertz)[0][0])
        t, x = integrated(MODE, predicted, 2.5, force, hertz, steps=100)
        assert abs(fundamental(t, x, hertz, 20)) == pytest.approx(predicted, rel=0.02)


def test_the_free_decay_is_that_of_an_integration_in_time() -> None:
    # The slow flow is the first order of averaging: its error is twice the damping ratio, 0.5 % at the start.
    t, x = integrated(MODE, 1e-4, 0.5, steps=100)
    peaks = 1 + np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] >= x[2:]))
    amplitude, phase = MODE.decay(1e-4, t[peaks])
    np.testing.assert_allclose(x[peaks], amplitude, rtol=0.012)
    turns = phase / (2 * np.pi)
    # The period is that of the slow flow: no turn is lost over forty.
    np.testing.assert_allclose(turns - np.round(turns), 0.0, atol=0.03)
    assert amplitude[-1] < 0.5 * amplitude[0]


def test_micro_slip_lowers_the_frequency_and_raises_the_damping() -> None:
    x = np.geomspace(1e-6, 3e-4, 40)
    for joint in (BOLTED, Iwan(1e5, 40.0)):
        f, zeta = JointedMode(MASS, STUCK - 1e5, VISCOUS, joint).backbone(x)
        assert np.all(np.diff(f) < 0.0)
        assert np.all(np.diff(zeta) > 0.0)


def test_what_is_not_possible_is_refused() -> None:
    with pytest.raises(InputError, match="the mass must be positive"):
        JointedMode(0.0, 1.0, 1.0, BOLTED)
    with pytest.raises(InputError, match="does not decay"):
        JointedMode(1.0, 1.0, 0.0, CubicSpring(1.0, 0.0)).decay(1.0, [1.0])
    with pytest.raises(InputError, match="both must be positive"):
        MODE.response(-1.0, [80.0])
    with pytest.raises(InputError, match="times >= 0"):
        MODE.decay(1e-3, [-1.0])
