"""How cost grows: ``python benchmarks/scripts/growth.py campaigns 60 --jobs 1 2``, or ``one 8 16 32``.

``campaigns N``: N generated campaigns (one hammer measurement in x and y, two cutting tests, lobes at 91 speeds), run
by each number of jobs into an empty folder; seconds by the clock and of CPU, and the speed-up. On a machine that others
use the clock says little: the CPU seconds of the parent, which nothing shares, bound the speed-up from above,
``1/(p + (1 - p)/jobs)`` with p its share.

``one N...``: one campaign of N measurements and 4 N cutting tests for each N, run by a process of its own: CPU seconds,
largest resident memory, and the exponent of growth between the first and the last.

``speeds N...``: one campaign with lobes at N speeds. ``records SECONDS...``: hammer records of that length.
"""

import argparse
import json
import math
import resource
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))

from truth.archive import visits, write_archive, write_campaign

_RUN = """
import json, resource, sys, time
import smfe
def seconds(who):
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime
def peak():
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
if __name__ == "__main__":
    given, out, jobs, many = sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4] == "many"
    from smfe.commands.many.tasks import work  # imported before the clock runs
    before, start = seconds(resource.RUSAGE_SELF), time.perf_counter()
    smfe.run([given] if many else given, out, draw=False, jobs=jobs)
    print(json.dumps({
        "clock": time.perf_counter() - start,
        "parent": seconds(resource.RUSAGE_SELF) - before,
        "memory": peak() / 1024,
    }))
"""


def run(given: Path, out: Path, jobs: int, many: bool) -> dict[str, float]:
    """Run campaigns in a process of their own; return seconds and MB, CPU of all processes among them."""
    shutil.rmtree(out, ignore_errors=True)
    script = out.with_suffix(".py")
    script.write_text(_RUN, encoding="utf-8")
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-W", "ignore", str(script), str(given), str(out), str(jobs), "many" if many else "one"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    found["cpu"] = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return found


def campaigns(folder: Path, count: int, jobs: list[int]) -> None:
    """Print what the same campaigns take with each number of jobs."""
    write_archive(folder / "in", count, seconds=1.5, tests=2)
    found = {n: run(folder / "in", folder / f"out_{n}", n, True) for n in jobs}
    tables = {(folder / f"out_{n}" / "catalogue.parquet").read_bytes() for n in jobs}
    for n, one in found.items():
        print(
            f"{count} campaigns, {n} jobs: {one['clock']:.1f} s, parent {one['parent']:.1f} s of CPU, "
            f"speed-up {found[jobs[0]]['clock'] / one['clock']:.2f}",
            flush=True,
        )
    print(f"catalogues of all: {'the same' if len(tables) == 1 else 'DIFFERENT'}")


def sizes(folder: Path, kind: str, counts: list[float]) -> Iterator[tuple[float, dict[str, float]]]:
    """Yield what one campaign takes, for each size."""
    visit = visits(1)[0]
    for n in counts:
        place = folder / f"{kind}_{n:g}"
        if kind == "one":
            names = tuple(f"hammer_{i + 1:03d}" for i in range(int(n)))
            given = write_campaign(place, visit, (1, int(n)), names, hits=2, tests=4 * int(n), lobes=4, step=50)
        elif kind == "speeds":
            given = write_campaign(place, visit, (1,), tests=0, step=900.0 / n)
        else:
            given = write_campaign(place, visit, (1,), hits=max(round(n / 1.5), 1), tests=0)
        yield n, run(given, folder / f"{kind}_{n:g}_out", 1, False)
        shutil.rmtree(place)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("campaigns", "one", "speeds", "records"))
    parser.add_argument("sizes", type=float, nargs="+")
    parser.add_argument("--jobs", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--folder", type=Path, default=Path("growth"))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    folder = given.folder.absolute()
    start = time.perf_counter()
    if given.what == "campaigns":
        for size in given.sizes:
            campaigns(folder, int(size), given.jobs)
        return
    rows = []
    for n, one in sizes(folder, given.what, given.sizes):
        rows.append((n, one))
        print(f"{given.what} {n:g}: {one['parent']:.2f} s of CPU, {one['memory']:.0f} MB", flush=True)
    if len(rows) > 1:
        (a, first), (b, last) = rows[0], rows[-1]
        print(f"exponent {math.log(last['parent'] / first['parent']) / math.log(b / a):.2f}")
    print(f"all in {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
