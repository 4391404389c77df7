"""Engagement, force harmonics and directional matrices against quadrature and published conditioning."""

import math

import numpy as np
import pytest
from scipy.integrate import quad_vec

from process.cut.engagement import Engagement, engagement
from process.cut.force import CuttingCoefficients, chip_projection, directional_matrix, force_harmonics, gram_matrix
from process.cut.tool import Tool
from process.errors import InputError

MATERIAL = CuttingCoefficients(1800e6, 700e6, 250e6, 30e3, 45e3, 5e3)
FACE_MILL = Tool(0.125, 8, math.radians(45.0))


def tooth_force(phi: float, h: float, b: float, k: float, material: CuttingCoefficients) -> np.ndarray:
    """Force of one tooth straight from the definition, independent of the projections."""
    s, c = math.sin(phi), math.cos(phi)
    local = material.cutting * b * h + material.edge * b
    turn = np.array(
        [
            [-c, -math.sin(k) * s, -math.cos(k) * s],
            [s, -math.sin(k) * c, -math.cos(k) * c],
            [0.0, math.cos(k), -math.sin(k)],
        ]
    )
    return turn @ local


@pytest.mark.parametrize(("cut", "width"), [("down", 37.5e-3), ("up", 62.5e-3), ("central", 106e-3), ("up", 0.125)])
@pytest.mark.parametrize("tool", [FACE_MILL, Tool(0.125, 3, math.radians(90.0))])
def test_force_harmonics_equal_the_fourier_integral_of_the_tooth_force(cut: str, width: float, tool: Tool) -> None:
    arc, depth, feed, k = engagement(cut, width, tool.diameter), 2e-3, 2e-4, tool.approach_angle
    for h in (1, 2, 3):

        def integrand(phi: float, h: int = h) -> np.ndarray:
            force = tooth_force(phi, feed * math.sin(phi) * math.sin(k), depth / math.sin(k), k, MATERIAL)
            return force * np.exp(-1j * h * tool.teeth * phi)

        expected = tool.teeth / math.pi * quad_vec(integrand, arc.entry, arc.exit, epsabs=1e-10)[0]
        np.testing.assert_allclose(
            force_harmonics(tool, arc, MATERIAL, depth, feed, [h])[0], expected, rtol=1e-9, atol=1e-9
        )


@pytest.mark.parametrize("order", [0, 1, -2])
def test_directional_matrix_is_the_derivative_of_the_tooth_force(order: int) -> None:
    tool, arc = FACE_MILL, Engagement(0.4, 2.1)
    k = tool.approach_angle

    def derivative(phi: float) -> np.ndarray:
        normal = np.array([math.sin(phi) * math.sin(k), math.cos(phi) * math.sin(k), -math.cos(k)])
        pure = CuttingCoefficients(*MATERIAL.cutting)
        unit = tooth_force(phi, 1.0, 1.0 / math.sin(k), k, pure)
        return np.outer(unit, normal) * np.exp(-1j * order * tool.teeth * phi)

    expected = tool.teeth / (2 * math.pi) * quad_vec(derivative, arc.entry, arc.exit, epsabs=1e-6)[0]
    np.testing.assert_allclose(directional_matrix(tool, arc, MATERIAL, order), expected, rtol=1e-8)


@pytest.mark.parametrize(
    ("widths", "first", "three"),
    [((0.3, 0.5, 0.85), 7.7, 7.8), ((0.5, 0.5, 0.5), 27.7, 17.0), ((0.8, 0.8, 0.8), 8.2, 8.9)],
)
def test_conditioning_of_three_passes_is_the_published_one(
    widths: tuple[float, ...], first: float, three: float
) -> None:
    arcs = [engagement(c, w * 0.125, 0.125) for c, w in zip(("down", "up", "central"), widths, strict=True)]
    for orders, expected in (([1], first), ([1, 2, 3], three)):
        force = np.concatenate([force_harmonics(FACE_MILL, a, MATERIAL, 2e-3, 2e-4, orders) for a in arcs]).T
        assert np.linalg.cond(force) == pytest.approx(expected, rel=0.01)


def test_half_immersion_down_and_up_add_up_to_the_slot_at_every_harmonic() -> None:
    down, up, slot = (
        force_harmonics(FACE_MILL, engagement(c, w, 0.125), MATERIAL, 2e-3, 2e-4, np.arange(1, 12))
        for c, w in (("down", 0.0625), ("up", 0.0625), ("central", 0.125))
    )
    np.testing.assert_allclose(down + up, slot, atol=1e-9)


def test_without_edge_forces_an_even_slot_cutter_has_no_harmonic_in_the_plane() -> None:
    pure = CuttingCoefficients(*MATERIAL.cutting)
    force = force_harmonics(FACE_MILL, engagement("up", 0.125, 0.125), pure, 2e-3, 2e-4, [1, 2])
    assert np.abs(force[:, :2]).max() < 1e-9
    assert np.abs(force[0, 2]) > 10.0


def test_a_lab_slot_depends_on_the_radial_coefficient_alone() -> None:
    # Four teeth in a slot: the x direction coefficient is -K_rc at any angle (checked reference).
    bench = CuttingCoefficients(780e6, 351e6, 0.0)
    matrix = directional_matrix(Tool(0.0508, 4), engagement("up", 0.0508, 0.0508), bench)
    assert matrix[0, 0] == pytest.approx(-351e6, rel=1e-12)


def test_a_helix_only_shortens_the_harmonics() -> None:
    straight = Tool(0.02, 4)
    twisted = Tool(0.02, 4, helix_angle=math.radians(30.0))
    arc = engagement("down", 0.01, 0.02)
    plain = force_harmonics(straight, arc, MATERIAL, 5e-3, 1e-4, [1, 2])
    helical = force_harmonics(twisted, arc, MATERIAL, 5e-3, 1e-4, [1, 2])
    turn = np.array([1, 2]) * 4 * 2 * 5e-3 * math.tan(math.radians(30.0)) / 0.02
    np.testing.assert_allclose(np.abs(helical) / np.abs(plain), np.abs(np.sinc(turn / 2 / np.pi))[:, None] * np.ones(3))
    np.testing.assert_allclose(directional_matrix(straight, arc, MATERIAL), directional_matrix(twisted, arc, MATERIAL))


def test_gram_matrix_is_hermitian_free_and_closed() -> None:
    arc = Engagement(0.2, 1.9)
    expected = quad_vec(
        lambda p: np.outer(*[np.array([math.sin(p), math.cos(p), 1.0])] * 2) * np.exp(-3j * p), arc.entry, arc.exit
    )[0]
    np.testing.assert_allclose(gram_matrix(arc, 3), expected, rtol=1e-10)
    assert chip_projection(math.pi / 2)[2, 2] == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("cut", ["down", "up", "central"])
def test_full_width_is_a_slot_whatever_the_cut_is_called(cut: str) -> None:
    arc = engagement(cut, 0.05, 0.05)
    assert (arc.entry, arc.exit) == pytest.approx((0.0, math.pi))


@pytest.mark.parametrize(
    ("cut", "width", "message"),
    [("side", 0.01, "none of"), ("down", 0.06, "at most the diameter"), ("down", 0.0, "above zero")],
)
def test_an_impossible_cut_is_refused(cut: str, width: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        engagement(cut, width, 0.05)


@pytest.mark.parametrize(
    ("geometry", "message"),
    [
        ({"diameter": 0.0}, "must be positive"),
        ({"diameter": math.inf}, "diameter is inf m"),
        ({"diameter": math.nan}, "diameter is nan m"),
        ({"runout": (0.0, math.nan)}, "runout is .*a finite number for each tooth"),
        ({"pitch_angles": (math.pi, math.nan)}, "pitch_angles is .*a finite number for each tooth"),
        ({"approach_angle": math.nan}, "approach angle"),
        ({"teeth": 0}, "at least one"),
        ({"approach_angle": 2.0}, "approach angle"),
        ({"pitch_angles": (1.0, 1.0)}, "add up to"),
        ({"runout": (1e-6,)}, "one a tooth"),
        ({"helix_angle": -0.1}, "helix"),
    ],
)
def test_an_impossible_tool_is_refused(geometry: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Tool(**{"diameter": 0.05, "teeth": 2, **geometry})  # type: ignore[arg-type]


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["Ktc", "Krc", "Kac", "Kte", "Kre", "Kae"])
def test_a_coefficient_is_a_finite_number(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"{name} is {value}"):
        CuttingCoefficients(**{"Ktc": 1e9, "Krc": 0.0, "Kac": 0.0, name: value})


UNEQUAL = Tool(0.05, 2, pitch_angles=(math.radians(170.0), math.radians(190.0)))
ECCENTRIC = Tool(0.05, 2, runout=(5e-6, -5e-6))
HELICAL = Tool(0.05, 2, helix_angle=0.5)


@pytest.mark.parametrize(
    ("tool", "message"), [(UNEQUAL, "unequal pitch .170, 190 deg"), (ECCENTRIC, "run-out of 5, -5")]
)
def test_force_harmonics_of_unequal_teeth_are_refused(tool: Tool, message: str) -> None:
    with pytest.raises(InputError, match=message):
        force_harmonics(tool, Engagement(0.4, 2.1), MATERIAL, 1e-3, 1e-4, [1])


def test_a_directional_matrix_that_the_formula_does_not_hold_for_is_refused() -> None:
    arc = Engagement(0.4, 2.1)
    for order in (0, 1):
        with pytest.raises(InputError, match="unequal pitch"):
            directional_matrix(UNEQUAL, arc, MATERIAL, order)
    with pytest.raises(InputError, match=r"helix of 28\.6479 deg; straight edges"):
        directional_matrix(HELICAL, arc, MATERIAL, 1)
    # Run-out and a helix leave the mean matrix as it is.
    plain = directional_matrix(Tool(0.05, 2), arc, MATERIAL)
    np.testing.assert_array_equal(directional_matrix(HELICAL, arc, MATERIAL), plain)
    np.testing.assert_array_equal(directional_matrix(ECCENTRIC, arc, MATERIAL), plain)


@pytest.mark.parametrize("degrees", [(51.43,) * 7, (51.4,) * 7, (51.43,) * 6 + (51.42,), (120.0, 120.0, 120.0)])
def test_a_pitch_that_is_equal_within_its_rounding_is_equal(degrees):
    tool = Tool(0.05, len(degrees), pitch_angles=tuple(map(math.radians, degrees)))
    assert tool.equal_pitch
    np.testing.assert_array_equal(tool.tooth_angles(), Tool(0.05, len(degrees)).tooth_angles())


@pytest.mark.parametrize("degrees", [(119.0, 121.0, 120.0), (119.97, 120.03, 120.0)])
def test_a_pitch_that_differs_by_more_than_its_rounding_is_unequal(degrees):
    assert not Tool(0.05, 3, pitch_angles=tuple(map(math.radians, degrees))).equal_pitch
