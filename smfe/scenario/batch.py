"""Many independent jobs on all cores."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import TypeVar

from process.errors import InputError
from smfe.identification.errors.result import Progress, silent

J = TypeVar("J")
R = TypeVar("R")


def run_all(
    work: Callable[[J], R],
    jobs: Sequence[J],
    workers: int | None = None,
    progress: Progress = silent,
    label: Callable[[J], str] = str,
) -> list[R]:
    """Return ``[work(job) for job in jobs]``, several at a time; the first error ends it.

    Parameters
    ----------
    work : callable
        Must not depend on the order of the jobs: whatever is random comes from a seed in the job.
    jobs : sequence
        What to work on.
    workers : int, optional
        Jobs at a time; default: as many as there are cores.
    progress : callable, optional
        Called with (label of the job that is finished, done, of).
    label : callable, optional
        Names a job for the progress.
    """
    if workers is not None and workers < 1:
        raise InputError(f"{workers} workers; give at least 1, or none for all cores")
    results: dict[int, R] = {}
    progress("simulating", 0, len(jobs))
    with ThreadPoolExecutor(max_workers=workers or os.cpu_count()) as pool:
        futures = {pool.submit(work, job): i for i, job in enumerate(jobs)}
        try:
            for done, future in enumerate(as_completed(futures), 1):
                results[futures[future]] = future.result()
                progress(label(jobs[futures[future]]), done, len(jobs))
        finally:
            pool.shutdown(cancel_futures=True)
    return [results[i] for i in range(len(jobs))]
