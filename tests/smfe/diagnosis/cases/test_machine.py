"""Claims: how far a blow leaves a slide aside is allowed for at rest, and not of a slide that moves."""

import numpy as np

from process.types import Real
from smfe.diagnosis.cases.machine import left_aside
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.machine.axes import DeclaredAxis, Side

MASS, CONTACT, STATIC = 380.0, 4e8, 950.0
AXIS = DeclaredAxis(MASS, {}, (Side(800.0, STATIC, 8e-3, 3e3),) * 2, CONTACT)
F = np.linspace(5.0, 40.0, 8)


def hit(impulse: float, feed: float = 0.0) -> Excited:
    entries = (("z", "x"), ("z", "z"))
    return Excited(
        F, entries, np.full((F.size, 2), 1e-10), "hammer", impulse, feed={"z": feed}, impulses={"z": impulse}
    )


def moved(impulse: float, duration: float = 4e-3, step: float = 2e-5) -> Real:
    """Displacement of a mass on bristles (LuGre) after a blow, in time."""
    x, v, z, out = 0.0, 0.0, 0.0, []
    for n in range(round(0.12 / step)):
        s = n * step / duration
        force = impulse / duration * 0.5 * np.pi * np.sin(np.pi * s) if s < 1.0 else 0.0
        rate = v - CONTACT * abs(v) / STATIC * z
        v += step * (force - CONTACT * z - 1e5 * rate) / MASS
        x, z = x + step * v, z + step * rate
        out.append(x)
    return np.array(out)


def test_a_blow_leaves_a_slide_aside_by_about_what_is_allowed_for() -> None:
    """A step, ``d/(j w)`` of the compliance, that grows with the square of the blow."""
    for impulse in (0.3, 1.0):
        allowed = left_aside(hit(impulse), "z", AXIS)[0, :, 1] * 2j * np.pi * F * impulse
        left = moved(impulse)[-1000:].mean()
        assert np.allclose(allowed, allowed[0])
        assert 1 / 3 < left / allowed[0].real < 3.0


def test_nothing_is_allowed_for_across_and_of_slides_that_move() -> None:
    assert not left_aside(hit(1.0), "z", AXIS)[0, :, 0].any()
    assert left_aside(hit(1.0, feed=3e-3), "z", AXIS).size == 0
    assert left_aside(hit(1.0), "x", AXIS).size == 0
