"""How cost grows: ``python benchmarks/scripts/growth.py campaigns 60 --jobs 1 2``, or ``one 8 16 32``.

``campaigns N``: N generated campaigns (one hammer measurement in x and y, two cutting tests, lobes at 91 speeds), run
by each number of jobs into an empty folder; seconds by the clock and of CPU, and the speed-up. On a machine that others
use the clock says little: the CPU seconds of the parent, which nothing shares, bound the speed-up from above,
``1/(p + (1 - p)/jobs)`` with p its share.

``disturbed N``: the same campaigns by two jobs, killed with all its processes after a third and after two thirds of
them and begun again, and by a cluster of two workers of which one is killed half way; whether the catalogues are that
of an undisturbed run of one job.

``one N...``: one campaign of N measurements and 4 N cutting tests for each N, run by a process of its own: CPU seconds,
largest resident memory, and the exponent of growth between the first and the last.

``speeds N...``: one campaign with lobes at N speeds. ``records SECONDS...``: hammer records of that length.
"""

import argparse
import json
import math
import os
import resource
import shutil
import signal
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

_CLUSTER = """
import os, signal, sys, threading, time
from pathlib import Path
import smfe
from distributed import Client, LocalCluster
def main():
    given, out, enough = sys.argv[1], sys.argv[2], int(sys.argv[3])
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as local:
        killed = []
        def kill():
            while sum(1 for _ in Path(out).glob("*/.kept/run.json")) < enough:
                time.sleep(1.0)
            with Client(local.scheduler_address, set_as_default=False) as client:
                killed.append(sorted(client.run(os.getpid).values())[0])
            os.kill(killed[0], signal.SIGKILL)
        threading.Thread(target=kill, daemon=True).start()
        smfe.run([given], out, draw=False, scheduler=local.scheduler_address)
        print(len(killed))
if __name__ == "__main__":
    main()
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


def finished(out: Path) -> int:
    """Return how many campaigns have their results in a folder."""
    return sum(1 for _ in out.glob("*/.kept/run.json"))


def disturbed(folder: Path, count: int) -> None:
    """Print whether runs that lose processes on the way end with the catalogue of one that does not."""
    if not (folder / "in").exists():
        write_archive(folder / "in", count, seconds=1.5, tests=2)
    if not (folder / "out_1" / "catalogue.parquet").exists():
        run(folder / "in", folder / "out_1", 1, True)
    right = (folder / "out_1" / "catalogue.parquet").read_bytes()

    out = folder / "killed"
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-W", "ignore", "-m", "smfe", "run", "in", "--out", out.name, "--jobs", "2"]
    seen = []
    for enough in (count // 3, 2 * count // 3):
        with subprocess.Popen(command, cwd=folder, stderr=subprocess.DEVNULL, start_new_session=True) as process:
            while finished(out) < enough and process.poll() is None:
                time.sleep(0.5)
            os.killpg(process.pid, signal.SIGKILL)
        seen.append(finished(out))
    done = subprocess.run([*command, "--json"], cwd=folder, check=True, capture_output=True, text=True)
    same = (out / "catalogue.parquet").read_bytes() == right
    print(
        f"{count} campaigns, killed when {seen[0]} and {seen[1]} were finished: {json.loads(done.stdout)['unchanged']} "
        f"taken over by the third run, catalogue {'the same' if same else 'DIFFERENT'}",
        flush=True,
    )

    out = folder / "cluster"
    shutil.rmtree(out, ignore_errors=True)
    script = folder / "cluster.py"
    script.write_text(_CLUSTER, encoding="utf-8")
    command = [sys.executable, "-W", "ignore", str(script), str(folder / "in"), str(out), str(count // 2)]
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True)
    same = (out / "catalogue.parquet").read_bytes() == right
    print(
        f"{count} campaigns by a cluster of two workers, {done.stdout.split()[-1]} killed half way: catalogue "
        f"{'the same' if same else 'DIFFERENT'}",
        flush=True,
    )


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
    parser.add_argument("what", choices=("campaigns", "disturbed", "one", "speeds", "records"))
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
    if given.what == "disturbed":
        disturbed(folder, int(given.sizes[0]))
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
