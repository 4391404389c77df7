"""Operating points of the bench at 100 speeds, both limits and the map included: CPU seconds."""

import time

import numpy as np
import pytest

from process import Andersson, CuttingCoefficients, Drive, Machine, Servo, Tool, engagement
from stability import operating_point

MM_MIN = 1.0 / 6e4
SERVOS = {
    "K1": Servo(3242.0, 21.2e-3, 23.5),
    "K2": Servo(6268.0, 10.9e-3, 45.5),
    "K3": Servo(10590.0, 6.5e-3, 76.9),
    "K4": Servo(18804.0, 3.6e-3, 136.6),
}
FRICTION = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)
CUT = Tool(50.8e-3, 4), engagement("down", 50.8e-3, 50.8e-3), CuttingCoefficients(780e6, 351e6, 0.0)


@pytest.mark.parametrize(
    ("controller", "feed"),
    [("K1", None), ("K2", None), ("K3", None), ("K4", None), ("K3", 25.0), ("K3", 100.0), ("K3", 250.0)],
)
def test_a_hundred_speeds_within_ten_seconds(controller: str, feed: float | None) -> None:
    machine = Machine.of_axis(Drive(23.1, 11.3, 1.68e6, 104.0, SERVOS[controller]), FRICTION)
    given = None if feed is None else feed * MM_MIN
    operating_point(machine, *CUT, [1500.0], 2e-4, feed=given)
    start = time.process_time()
    found = operating_point(machine, *CUT, np.linspace(800.0, 2500.0, 100), 2e-4, feed=given)
    spent = time.process_time() - start
    print(f"\n{controller}, feed {feed or 'of the chip'}: 100 speeds in {spent:.1f} s of CPU")
    assert np.isfinite(found["lower_limit_depth"]).all()
    assert spent < 10.0
