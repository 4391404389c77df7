"""Records of a scenario: all cores against one, in one run, with the same numbers."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from smfe.commands.simulate import simulate

SCENARIO = Path(__file__).resolve().parents[1] / "datasets" / "scenarios" / "ram_axis.toml"


def seconds(job: Callable[[], object]) -> float:
    start = time.perf_counter()
    job()
    return time.perf_counter() - start


def records(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (folder / "records").iterdir()}


@pytest.mark.benchmark(group="batch")
def test_two_workers_against_one(benchmark, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    simulate(SCENARIO, tmp_path / "warm")
    benchmark.pedantic(partial(simulate, SCENARIO, tmp_path / "two", workers=2), rounds=3)
    two = benchmark.stats.stats.min
    one = min(seconds(partial(simulate, SCENARIO, tmp_path / "one", workers=1)) for _ in range(3))
    assert records(tmp_path / "one") == records(tmp_path / "two")
    benchmark.extra_info.update(speed_up=round(one / two, 2), seconds_with_one=round(one, 2))
    print(f"\n{one / two:.2f} times faster with two workers than with one ({one:.1f} s)")
