"""A published example with helix and worn flank: the time loop of a textbook, rebuilt, about our limits.

T. L. Schmitz & K. S. Smith, Machining Dynamics, 2nd ed., Springer 2019, Section 4.8: an end mill of 19 mm with three
teeth and a helix of 30 degrees, half immersed, up; one mode of 900 Hz, 3 % and 9 N/um in x and y alike; K_s = 2000
N/mm2 at 70 degrees; process damping C = 20 N/mm, a force ``C b/v`` times the speed along the chip normal. The book
gives its limits as pictures; what can be checked to the percent is its loop. It is linear here: the chip may be
negative, so that no vibration is too large for it.
"""

import math

import numpy as np
import pytest
from numba import njit

from process import CuttingCoefficients, ModalModel, ProcessDamping, Tool, engagement
from stability import limit_depth, multi_frequency

STIFFNESS, FREQUENCY, DAMPING = 9e6, 900.0, 0.03
DIAMETER, TEETH, HELIX = 19e-3, 3, math.radians(30.0)
TANGENTIAL, NORMAL = 2e9 * math.sin(math.radians(70.0)), 2e9 * math.cos(math.radians(70.0))
FLANK = 2e4


@njit(nogil=True)
def loop(slices, steps, turns, rotation):
    """Return the largest deflection of each turn; an edge is a row of slices, each a step behind the one below."""
    omega = 2.0 * math.pi * FREQUENCY
    mass, dt = STIFFNESS / omega**2, 2.0 * math.pi / steps / rotation
    friction, speed = 2.0 * DAMPING * omega * mass, 0.5 * DIAMETER * rotation
    width = DIAMETER * math.pi / steps / math.tan(HELIX)
    sine = np.sin(2.0 * math.pi * np.arange(steps) / steps)
    cosine = np.cos(2.0 * math.pi * np.arange(steps) / steps)
    surface, largest = np.zeros((slices, steps)), np.zeros(turns)
    x, y, vx, vy = 1e-6, 0.0, 0.0, 0.0
    for i in range(steps * turns):
        fx = fy = 0.0
        for tooth in range(TEETH):
            for a in range(slices):
                at = (i + tooth * steps // TEETH - a) % steps
                if 4 * at > steps:
                    continue
                s, c = sine[at], cosine[at]
                n = x * s - y * c
                chip = surface[a, at] - n
                surface[a, at] = n
                ft = TANGENTIAL * width * chip
                fn = NORMAL * width * chip - FLANK * width / speed * (vx * s - vy * c)
                fx += ft * c + fn * s
                fy += ft * s - fn * c
        vx += dt * (fx - friction * vx - STIFFNESS * x) / mass
        vy += dt * (fy - friction * vy - STIFFNESS * y) / mass
        x += dt * vx
        y += dt * vy
        largest[i // steps] = max(largest[i // steps], math.hypot(x, y))
    return largest


def limit_of_the_loop(near: float, speed: float, per_period: int) -> float:
    """Return the depth [m] at which a vibration neither grows nor decays, between 5 % below and above one near it."""
    rotation = 2.0 * math.pi * speed / 60.0
    steps = 12 * math.ceil(max(per_period * FREQUENCY * 60.0 / speed, 12.0 * per_period) / 12)
    slice_depth = math.pi * DIAMETER / steps / math.tan(HELIX)
    turns = max(40, math.ceil(speed / 15.0))
    depth, growth = [], []
    for slices in (math.floor(0.95 * near / slice_depth), math.ceil(1.05 * near / slice_depth)):
        largest = np.log(loop(slices, steps, turns, rotation))
        depth.append(slices * slice_depth)
        growth.append(np.polyfit(np.arange(turns // 2), largest[turns - turns // 2 :], 1)[0])
    assert growth[0] < 0.0 < growth[1]
    return float(np.interp(0.0, growth, depth))


MACHINE = ModalModel([FREQUENCY] * 2, [DAMPING] * 2, [STIFFNESS] * 2, np.eye(3)[:2])
CUT = engagement("up", DIAMETER / 2.0, DIAMETER), CuttingCoefficients(TANGENTIAL, NORMAL, 0.0)


def limit(speed: float, tool: Tool, flank: float) -> float:
    """Return the limiting depth of cut [m] by semi-discretisation."""
    worn = ProcessDamping(flank, friction=0.0)
    return 1e-3 * limit_depth(MACHINE, tool, *CUT, speed, process_damping=worn).limit_depth_mm


HELICAL = Tool(DIAMETER, TEETH, helix_angle=HELIX)


@pytest.mark.parametrize(
    ("speed", "per_period"),
    [pytest.param(500.0, 60, marks=pytest.mark.slow), (1500.0, 100), (8500.0, 100), (18000.0, 100)],
)
@pytest.mark.slow
def test_the_loop_of_a_textbook_has_our_limit(speed, per_period):
    """Within 1 %, as its steps vanish: Euler's method errs in proportion to them."""
    ours = limit(speed, HELICAL, FLANK)
    coarse, fine = (limit_of_the_loop(ours, speed, n) for n in (per_period, 2 * per_period))
    lines = multi_frequency(MACHINE, HELICAL, *CUT, [speed], process_damping=ProcessDamping(FLANK, friction=0.0))
    assert float(lines["limit_depth"][0]) == pytest.approx(1e3 * ours, rel=2e-3)
    assert 2.0 * fine - coarse == pytest.approx(ours, rel=0.01)


@pytest.mark.slow
def test_the_example_tells_a_worn_flank_and_a_helix():
    """At 1000 rpm the flank raises the limit by 6 %; at 18,000 rpm the helix lowers it by 2 %."""
    assert limit(1000.0, HELICAL, FLANK) / limit(1000.0, HELICAL, 0.0) == pytest.approx(1.064, abs=0.003)
    straight = limit(18000.0, Tool(DIAMETER, TEETH), FLANK)
    assert limit(18000.0, HELICAL, FLANK) / straight == pytest.approx(0.98, abs=0.003)
