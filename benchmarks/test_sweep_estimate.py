"""Sweep identification: every estimator against the bare transforms of the same records, in one run, and its memory."""

import time
import tracemalloc

import numpy as np
import pytest
from samples.linear_machine import TOOL, sweep_passes
from scipy import fft

from process import engagement
from process.labels import make_record
from smfe import LocalPolynomial, Segments, SingleReference, SweepPass, identify_sweep
from smfe.identification.sweep.order_tracking import Orders


@pytest.fixture(scope="module")
def passes() -> list[SweepPass]:
    return [SweepPass(r, c, engagement(c, 0.012, TOOL.diameter)) for c, r in sweep_passes(1).items()]


def bare_transforms(passes: list[SweepPass]) -> float:
    """Seconds that the transforms of force and motion take, one channel at a time."""
    start = time.perf_counter()
    for p in passes:
        for name in ("force", "acceleration"):
            for row in p.record[name].values:
                fft.rfft(row, fft.next_fast_len(row.size, real=True))
    return time.perf_counter() - start


@pytest.mark.benchmark(group="sweep")
@pytest.mark.parametrize(
    "estimator",
    [LocalPolynomial(), LocalPolynomial(rational=False), Segments(), Orders(TOOL.teeth), SingleReference()],
    ids=["LocalPolynomial", "without_model", "Segments", "Orders", "SingleReference"],
)
def test_estimate_against_bare_transforms(benchmark, passes, estimator) -> None:
    benchmark(identify_sweep, "s", passes, (20.0, 80.0), estimator)
    ratio = benchmark.stats.stats.min / bare_transforms(passes)
    benchmark.extra_info["times_the_bare_transforms"] = round(ratio, 1)
    print(f"\n{type(estimator).__name__}: {ratio:.1f} times the bare transforms")


def long_passes(minutes: float, rate: float = 51200.0) -> list[SweepPass]:
    """Three passes that last so long together; forces that shake a mass on a spring of no dynamics, and noise."""
    n = round(20.0 * minutes * rate)
    rng = np.random.default_rng(0)
    out = []
    for cut in ("down", "up", "central"):
        force = rng.standard_normal((3, n), dtype=np.float32).astype(float)
        force[:, : n // 20] *= 1e-3
        force[:, -n // 20 :] *= 1e-3
        channels = {"force": dict(zip("xyz", force, strict=True)), "acceleration": dict(zip("xyz", force, strict=True))}
        speed = {"spindle_speed": np.linspace(600.0, 1500.0, n)}
        out.append(SweepPass(make_record(np.arange(n) / rate, channels, speed), cut, engagement(cut, 0.012, 0.08)))
    return out


@pytest.mark.benchmark(group="sweep, long records")
@pytest.mark.parametrize("minutes", [1, 10])
def test_long_records_at_51200_hz(benchmark, minutes) -> None:
    data = long_passes(minutes)
    held = sum(p.record.nbytes for p in data) / 1e6
    bare = bare_transforms(data)
    benchmark.pedantic(identify_sweep, ("s", data, (20.0, 80.0)), rounds=1)
    tracemalloc.start()
    identify_sweep("s", data, (20.0, 80.0), LocalPolynomial(rational=False))
    peak = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    ratio = benchmark.stats.stats.min / bare
    benchmark.extra_info.update(times_the_bare_transforms=round(ratio, 2), peak_MB=round(peak), records_MB=round(held))
    print(f"\n{minutes} min: {ratio:.2f} times the bare transforms; {peak:.0f} MB beyond the {held:.0f} MB of records")
