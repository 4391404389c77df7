"""Time simulation of milling: the compiled loop against the same loop in plain Python, in one run."""

import math
import time

import numpy as np
import pytest

from process import CuttingCoefficients, MillingCut, ModalModel, Spindle, Tool, _kernels, engagement, simulate_milling

MACHINE = ModalModel([33.37, 57.44, 58.61], [0.061, 0.0822, 0.0287], [45.5e6, 32.1e6, 36.7e6], np.eye(3))
CUT = MillingCut(
    Tool(0.08, 2, math.radians(45.0)),
    engagement("down", 0.04, 0.08),
    CuttingCoefficients(1889e6, 806e6, 291e6),
    2e-3,
    feed_per_tooth=1e-4,
)


def cut_for(duration: float) -> None:
    simulate_milling(MACHINE, CUT, Spindle(100.0), duration, 2000.0)


@pytest.mark.benchmark(group="milling")
def test_compiled_loop_against_plain_python(benchmark, monkeypatch) -> None:
    cut_for(0.1)
    benchmark(cut_for, 5.0)
    compiled = benchmark.stats.stats.min / 5.0
    compiled_names = [n for n, f in vars(_kernels).items() if hasattr(f, "py_func")]
    for name in compiled_names:
        monkeypatch.setattr(_kernels, name, getattr(_kernels, name).py_func)
    start = time.perf_counter()
    cut_for(0.25)
    plain = (time.perf_counter() - start) / 0.25
    benchmark.extra_info["times_faster_than_plain_python"] = round(plain / compiled)
    benchmark.extra_info["ns_a_step"] = round(compiled / 8000 * 1e9)
    print(f"\n{plain / compiled:.0f} times faster than plain Python; {compiled / 8000 * 1e9:.0f} ns a step")
