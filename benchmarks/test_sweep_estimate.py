"""Sweep identification: every estimator against the bare transforms of the same records, in one run."""

import time

import pytest
from scipy import fft

from process import engagement
from smfe import LocalPolynomial, Segments, SingleReference, SweepPass, identify_sweep
from smfe.demo_campaign import TOOL, sweep_passes


@pytest.fixture(scope="module")
def passes() -> list[SweepPass]:
    return [SweepPass(r, c, engagement(c, 0.012, TOOL.diameter)) for c, r in sweep_passes(1).items()]


@pytest.mark.benchmark(group="sweep")
@pytest.mark.parametrize(
    "estimator", [LocalPolynomial(), Segments(), SingleReference()], ids=lambda e: type(e).__name__
)
def test_estimate_against_bare_transforms(benchmark, passes, estimator) -> None:
    benchmark(identify_sweep, "s", passes, (20.0, 80.0), estimator)
    start = time.perf_counter()
    for p in passes:
        for name in ("force", "acceleration"):
            fft.rfft(p.record[name].values, axis=1)
    bare = time.perf_counter() - start
    benchmark.extra_info["times_the_bare_transforms"] = round(benchmark.stats.stats.min / bare, 1)
    print(f"\n{type(estimator).__name__}: {benchmark.stats.stats.min / bare:.1f} times the bare transforms")
