"""The zero-order solution reproduces published and independently computed limits."""

import numpy as np
import pytest

from process.labels import make_compliance
from process.machine.modes import ModalModel
from stability import critical_depth, critical_depth_from_matrix, zero_order, zero_order_from_matrix


def test_textbook_two_axis_tool(textbook):
    # checked reference: a textbook's tool, solved by two programs
    speeds = [4000, 6000, 8000, 10000, 12000, 14000, 16000]
    expected = [1.0858, 1.6154, 1.1395, 1.4570, 0.9583, 4.6197, 1.0396]
    lobes = zero_order(textbook.compliance(0.25, 3000, 0.25), *textbook.cut, speeds)
    np.testing.assert_allclose(lobes.limit_depth, expected, rtol=1e-4)
    assert lobes.attrs["warnings"] == []


def test_textbook_orthogonal_turning():
    # checked reference: two modes at 30 and -45 deg to the chip thickness; K_f 1000 N/mm2
    angle = np.radians([30.0, -45.0])
    machine = ModalModel(
        [250, 150], [0.012, 0.01], [2.26e8, 2.13e8], np.stack([np.sin(angle), np.cos(angle), 0 * angle], 1)
    )
    compliance = machine.compliance(np.arange(0.25, 500, 0.25))
    turning = np.zeros((3, 3), dtype=complex)
    turning[1, 1] = -1e9
    smallest = critical_depth_from_matrix(compliance, turning)
    assert smallest.limit_depth_mm == pytest.approx(7.185, abs=5e-4)
    assert smallest.chatter_frequency_Hz == pytest.approx(252.98, abs=0.01)
    second = critical_depth_from_matrix(compliance.sel(frequency=slice(100, 200)), turning)
    assert second.limit_depth_mm == pytest.approx(9.458, abs=5e-4)
    assert second.chatter_frequency_Hz == pytest.approx(151.49, abs=0.01)
    # The lobe tip reaches that width at the speed where the phase fits, and nowhere less.
    lobes = zero_order_from_matrix(compliance, turning, 1, np.linspace(2000, 12000, 4001))
    assert float(lobes.limit_depth.min()) == pytest.approx(7.185, abs=1e-3)


def test_lab_slot_idle(lab_slot):
    # Reference: confirmed there by semi-discretisation and time simulation
    speeds = [800, 920, 1000, 1200, 1500, 1800, 2000, 2250, 2500, 3000]
    expected = [1.7516, 3.053, 0.2470, 0.1168, 0.1604, 0.3925, 0.7578, 1.4202, 2.2255, 4.1493]
    lobes = zero_order(lab_slot.compliance(0.25, 400, 0.25), *lab_slot.cut, speeds)
    np.testing.assert_allclose(lobes.limit_depth, expected, rtol=5e-4)
    frequency = lobes.chatter_frequency.sel(spindle_speed=[800, 1000, 1500, 2000, 3000])
    np.testing.assert_allclose(frequency, [80.7, 61.55, 63.07, 70.35, 101.5], atol=0.06)


def test_lab_slot_has_the_closed_form_smallest_limit(lab_slot):
    # a_min = -1/(2 K_rc min Re Phi), min Re Phi = -1/(4 k zeta (1 + zeta))
    k, zeta = lab_slot.machine.stiffness[0], lab_slot.machine.damping[0]
    closed_form = 4 * k * zeta * (1 + zeta) / (2 * 351e6) * 1e3
    found = critical_depth(lab_slot.compliance(0.25, 400, 0.25), *lab_slot.cut)
    assert closed_form == pytest.approx(0.11561, abs=1e-5)
    assert found.limit_depth_mm == pytest.approx(closed_form, rel=1e-5)
    assert found.chatter_frequency_Hz == pytest.approx(62.095, abs=0.005)


CONTROLLERS = {  # K_p N s/m, T_i ms, K_v 1/s (paper, Table 2)
    "K1": (3242, 21.2, 23.5),
    "K2": (6268, 10.9, 45.5),
    "K3": (10590, 6.5, 76.9),
    "K4": (18804, 3.6, 136.6),
}
IN_MOTION = [  # Reference: controller, sigma [N s/m], delay [ms], a_min, limits at the speeds below
    ("K1", 0, 0, 1.078, [1.561, 2.722, 3.700, 3.034, 1.129, 1.137, 1.328, 1.734, 2.332]),
    ("K2", 0, 0, 1.549, [1.922, 2.948, 3.858, 3.483, 1.646, 1.586, 1.760, 2.141, 2.693]),
    ("K3", 0, 0, 1.798, [2.267, 3.227, 4.078, 2.427, 1.816, 1.885, 2.092, 2.490, 3.035]),
    ("K4", 0, 0, 0.731, [2.331, 1.485, 0.925, 0.732, 0.962, 1.433, 1.840, 2.436, 3.125]),
    ("K2", 168, 0, 1.554, [1.933, 2.958, 3.866, 3.417, 1.647, 1.593, 1.769, 2.151, 2.704]),
    ("K2", -1528, 0, 1.453, [1.796, 2.845, 3.778, 4.118, 1.578, 1.480, 1.642, 2.014, 2.567]),
    ("K2", 0, 0.75, 1.922, [2.099, 2.976, 3.836, 5.300, 2.197, 1.924, 2.033, 2.353, 2.848]),
    ("K3", 0, 0.75, 2.301, [2.765, 3.074, 2.658, 2.345, 2.317, 2.479, 2.682, 3.043, 3.528]),
    ("K4", 0, 0.75, 0.396, [2.449, 0.653, 0.451, 0.412, 0.674, 1.222, 1.717, 2.447, 3.281]),
]


def axis_in_motion(controller: str, sigma: float, delay: float):
    """Compliance of the moving one-axis bench: Eq. (4) with the friction slope in the numerator, and a delay."""
    gain, integral, position = CONTROLLERS[controller]
    frequency = np.arange(5.0, 400.0, 0.25)
    s = 2j * np.pi * frequency
    servo = gain * (s + position) * (1 + 1 / (integral * 1e-3 * s)) * np.exp(-s * delay * 1e-3)
    joint = 104.0 * s + 1.68e6
    carriage = 23.1 * s**2 + sigma * s + joint + servo
    phi = carriage / ((11.3 * s**2 + joint) * carriage - joint**2)
    return make_compliance(frequency, phi[:, None, None], ["x"], ["x"])


@pytest.mark.parametrize(("controller", "sigma", "delay", "smallest", "expected"), IN_MOTION)
def test_lab_slot_in_motion(lab_slot, controller, sigma, delay, smallest, expected):
    compliance = axis_in_motion(controller, sigma, delay)
    speeds = [800, 920, 1000, 1200, 1500, 1800, 2000, 2250, 2500]
    lobes = zero_order(compliance, *lab_slot.cut, speeds)
    # The reference was computed with unrounded gains; Table 2 truncates them.
    np.testing.assert_allclose(lobes.limit_depth, expected, rtol=4e-3)
    assert critical_depth(compliance, *lab_slot.cut).limit_depth_mm == pytest.approx(smallest, rel=4e-3)


@pytest.mark.parametrize(
    ("directions", "immersion", "expected"),
    [  # reference values
        (2, 1.0, {9000: 0.3064, 12000: 0.0820, 15000: 0.1171, 18500: 0.0493}),
        (2, 0.5, {9000: 0.8461, 12000: 0.2339, 15000: 0.2879, 18500: 0.1327}),
        (2, 0.05, {12000: 6.30, 15000: 1.643}),
        (1, 0.05, {10000: 8.44, 15000: 14.5}),
    ],
)
def test_classical_milling_benchmark(make_case, directions, immersion, expected):
    case = make_case["benchmark"](directions, immersion)
    lobes = zero_order(case.compliance(1, 4000, 1.0), *case.cut, list(expected))
    np.testing.assert_allclose(lobes.limit_depth, list(expected.values()), rtol=5e-3)
