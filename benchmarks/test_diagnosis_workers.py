"""A diagnosis of a feed axis from 24 measured compliances: by one process, and by one a core, in one run."""

import os
import runpy
import time
from pathlib import Path

import pytest

from smfe.diagnosis.inference.workers import cores
from smfe.diagnosis.judgement.diagnose import diagnose
from smfe.diagnosis.judgement.finding import Finding

# Truth of the tests: nothing of the packages is in it.
runpy.run_path(str(Path(__file__).parents[1] / "tests" / "diagnosis" / "conftest.py"))


def timed(hidden: tuple[str, ...], seed: int, workers: int) -> tuple[Finding, float, float]:
    """Finding, time by the clock and time of all processes [s]; nothing is kept from an earlier diagnosis."""
    from exam.subjects import SUBJECTS

    family = SUBJECTS["axis"].hide(hidden, seed, 40.0, 1.0)
    begin, busy = time.perf_counter(), sum(os.times()[:4])
    found = diagnose(family, workers=workers)
    return found, time.perf_counter() - begin, sum(os.times()[:4]) - busy


@pytest.mark.benchmark(group="diagnosis")
@pytest.mark.skipif(cores() < 2, reason="one core, or a system on which processes are not forked")
@pytest.mark.parametrize(("hidden", "seed"), [((), 810_300), (("posture",), 720_500)])
def test_a_process_a_core(benchmark, hidden, seed):  # type: ignore[no-untyped-def]
    alone, slow, spent = timed(hidden, seed, 1)  # builds the family, which compiles the kernels, before it is timed
    helped, fast, more = benchmark.pedantic(timed, (hidden, seed, cores()), rounds=1)
    assert repr(helped) == repr(alone)
    benchmark.extra_info.update(ratio=slow / fast)
    print(
        f"\n{alone.verdict}: one process {slow:.1f} s ({spent:.1f} s of CPU), {cores()} processes {fast:.1f} s "
        f"({more:.1f} s of CPU): {slow / fast:.2f} times as fast"
    )
