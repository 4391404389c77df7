"""Converged limit curve of the classical milling benchmark: the library against plain NumPy, in one run.

The plain method is the textbook's: zero-order hold of state and delayed state over m steps with exact interval averages
of the directional factor, the m matrices multiplied out, eigenvalues of the product, bisection on the depth, and m
doubled until the limit moves by less than the same 0.1 %. It starts with a bracket around the known limit, which the
library has to find.
"""

import math
import time

import numpy as np
import pytest
from scipy.linalg import expm

from process import CuttingCoefficients, ModalModel, Tool, engagement
from process.cut.engagement import Engagement
from process.cut.force import chip_projection, force_projection, gram_matrix
from stability import floquet_multipliers, multi_frequency, semi_discretization

MATERIAL = CuttingCoefficients(6e8, 2e8, 0.0)
TOOL = Tool(10e-3, 2)
ARC = engagement("down", 5e-3, 10e-3)
SPEED = np.linspace(10000.0, 25000.0, 200)
PLAIN_SPEED = (16000.0,)


def machine(directions: int) -> ModalModel:
    ones = np.ones(directions)
    stiffness = 0.03993 * (2 * math.pi * 922.0) ** 2
    return ModalModel(922.0 * ones, 0.011 * ones, stiffness * ones, np.eye(3)[:directions])


def averages(steps: int) -> np.ndarray:
    """Mean directional matrix [N/m2] over each step of one tooth period, both teeth, shape (steps, 3, 3)."""
    projection, chip = force_projection(MATERIAL.cutting, TOOL.approach_angle), chip_projection(TOOL.approach_angle)
    out = np.zeros((steps, 3, 3))
    width = math.pi / steps
    for i in range(steps):
        low, high = max(i * width, ARC.entry), min((i + 1) * width, ARC.exit)
        if high - low > 1e-12:
            out[i] = (projection @ gram_matrix(Engagement(low, high)) @ chip).real / width
    return out


def plain_radius(model: ModalModel, factor: np.ndarray, depth: float, rpm: float) -> float:
    """Largest multiplier from the product of the step matrices of the state and all delayed displacements."""
    a, b, c = model.state_space()
    moving = np.flatnonzero(np.abs(c).max(axis=1) > 0.0)
    n, d, steps = a.shape[0], moving.size, factor.shape[0]
    step = 60.0 / (TOOL.teeth * rpm * steps)
    size = n + d * steps
    product = np.eye(size)
    for i in range(steps):
        cutting = depth * b @ factor[i]
        block = np.zeros((2 * n, 2 * n))
        block[:n, :n], block[:n, n:] = a + cutting @ c, np.eye(n)
        exact = expm(step * block)
        matrix = np.zeros((size, size))
        matrix[:n, :n] = exact[:n, :n]
        delayed = -exact[:n, n:] @ cutting[:, moving]
        matrix[:n, size - d :] += 0.5 * delayed
        matrix[:n, size - 2 * d : size - d] += 0.5 * delayed
        matrix[n : n + d, :n] = c[moving]
        matrix[n + d :, n : size - d] = np.eye(size - n - d)
        product = matrix @ product
    return float(np.abs(np.linalg.eigvals(product)).max())


def plain_limit(model: ModalModel, rpm: float, near: float) -> tuple[float, int]:
    """Limit [m] to 0.1 % and the steps it took, by bisection between 0.9 and 1.1 of a limit that is known."""
    old, steps = math.inf, 20
    while steps <= 320:
        factor, low, high = averages(steps), 0.9 * near, 1.1 * near
        while high - low > 2e-4 * near:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if plain_radius(model, factor, middle, rpm) < 1.0 else (low, middle)
        if abs(low / old - 1.0) < 1e-3:
            return low, steps
        old, steps = low, 2 * steps
    return old, steps // 2


@pytest.mark.benchmark(group="semi-discretisation")
@pytest.mark.parametrize("directions", [1, 2])
def test_limit_curve_against_plain_numpy(benchmark, directions: int) -> None:
    model = machine(directions)
    cut = (TOOL, ARC, MATERIAL)
    known = semi_discretization(model, *cut, PLAIN_SPEED)["limit_depth"].values * 1e-3
    found = benchmark.pedantic(semi_discretization, (model, *cut, SPEED), rounds=2)
    assert np.all(found["limit_depth_error"] <= 1e-3 * found["limit_depth"])
    start = time.process_time()
    semi_discretization(model, *cut, SPEED)
    spent = time.process_time() - start
    a_speed = benchmark.stats.stats.min / SPEED.size
    start = time.perf_counter()
    plain = [plain_limit(model, rpm, near) for rpm, near in zip(PLAIN_SPEED, known, strict=True)]
    seconds = (time.perf_counter() - start) / len(plain)
    np.testing.assert_allclose([depth for depth, _ in plain], known, rtol=2e-3)
    benchmark.extra_info["ms_a_speed"] = round(1e3 * a_speed, 1)
    benchmark.extra_info["times_faster_than_plain_numpy"] = round(seconds / a_speed)
    print(
        f"\n{SPEED.size} speeds to 0.1 %: {spent:.2f} s CPU, {1e3 * a_speed:.1f} ms a speed; "
        f"{seconds / a_speed:.0f} times faster than plain NumPy, "
        f"which takes {', '.join(str(steps) for _, steps in plain)} steps"
    )


def grid_seconds(model: ModalModel, cut: tuple, columns: int = 2, depths: int = 50, steps: int = 40) -> float:
    """CPU seconds of a stability chart of 100 speeds by 50 depths, from a few of its columns.

    The published program of semi-discretisation (Insperger and Stepan 2011): fixed steps, at each point of the grid the
    product of the step matrices, each with its matrix exponential, and the eigenvalues of the product.
    """
    tool, arc, material = cut
    a, b, c = model.state_space()
    moving = np.flatnonzero(np.abs(c).max(axis=1) > 0.0)
    n, d = a.shape[0], moving.size
    projection, chip = force_projection(material.cutting, tool.approach_angle), chip_projection(tool.approach_angle)
    width, factor = math.pi / steps, np.zeros((steps, 3, 3))
    for i in range(steps):
        low, high = max(i * width, arc.entry), min((i + 1) * width, arc.exit)
        if high - low > 1e-12:
            factor[i] = (projection @ gram_matrix(Engagement(low, high)) @ chip).real / width
    start = time.process_time()
    for rpm in np.linspace(5000.0, 25000.0, columns):
        step = 60.0 / (tool.teeth * rpm * steps)
        for depth in np.linspace(1e-5, 4e-3, depths):
            product = np.eye(n + d * steps)
            for i in range(steps):
                cutting = depth * b @ factor[i]
                inside = a + cutting @ c
                one = expm(step * inside)
                matrix = np.eye(n + d * steps, k=-d)
                matrix[:n] = 0.0
                matrix[:n, :n] = one
                matrix[n : n + d] = 0.0
                matrix[n : n + d, :n] = c[moving]
                delayed = np.linalg.solve(inside, one - np.eye(n)) @ -cutting[:, moving]
                matrix[:n, -d:] += 0.5 * delayed
                matrix[:n, -2 * d : -d] += 0.5 * delayed
                product = matrix @ product
            np.abs(np.linalg.eigvals(product)).max()
    return (time.process_time() - start) * 100.0 / columns


def test_limit_curves_against_a_grid() -> None:
    """Print CPU seconds of 200 speeds from 5000 to 25000 rpm to 0.1 %, and of the grid that does not converge."""
    print("\nimmersion  directions  semi-discretisation s  multi-frequency s  grid s  ratios")
    speeds = np.linspace(5000.0, 25000.0, 200)
    for immersion in (1.0, 0.25):
        for directions in (1, 2):
            model, cut = machine(directions), (TOOL, engagement("down", immersion * 10e-3, 10e-3), MATERIAL)
            spent, limits = [], []
            for method in (semi_discretization, multi_frequency):
                method(model, *cut, speeds[:3], tolerance=1e-3)
                each = []
                for _ in range(3):
                    start = time.process_time()
                    limits.append(method(model, *cut, speeds, tolerance=1e-3)["limit_depth"].values)
                    each.append(time.process_time() - start)
                spent.append(min(each))
            grid = grid_seconds(model, cut)
            print(
                f"{immersion:9g}  {directions:10d}  {spent[0]:21.2f}  {spent[1]:17.2f}  {grid:6.1f}  "
                f"{grid / spent[0]:.0f}, {grid / spent[1]:.0f}"
            )
            np.testing.assert_allclose(limits[0], limits[-1], rtol=2e-3)
            assert grid > 10.0 * spent[0]


def test_growth_with_steps_and_modes() -> None:
    """Print the cost of the largest multiplier over steps and modes: nearly in proportion to either."""
    print("\nmodes  steps  ms CPU")
    cost = {}
    for modes, steps in ((2, 100), (2, 200), (2, 400), (2, 800), (8, 400), (32, 400)):
        model = ModalModel(
            np.geomspace(300.0, 3000.0, modes),
            np.full(modes, 0.02),
            np.full(modes, 5e7),
            np.stack([np.cos(np.arange(modes)), np.sin(np.arange(modes)), np.zeros(modes)], axis=1),
        )
        arguments = (model, TOOL, ARC, MATERIAL, 1e-4, 6000.0, steps)
        floquet_multipliers(*arguments)
        start = time.process_time()
        floquet_multipliers(*arguments)
        cost[modes, steps] = time.process_time() - start
        print(f"{modes:5d}  {steps:5d}  {1e3 * cost[modes, steps]:6.1f}")
    assert cost[2, 800] < 6.0 * cost[2, 200]
    assert cost[32, 400] < 40.0 * cost[2, 400]
