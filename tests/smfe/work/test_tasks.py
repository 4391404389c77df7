"""Tasks: what fails from outside is tried again, alone, and nothing that fails stops the rest."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from smfe.work.processes import processes
from smfe.work.tasks import DONE, LOST, OUTSIDE, REFUSED, TRIES, Begun, Here, Outcome, carry_out


class Fleet:
    """A pool of two whose tasks end in pairs, by a function of the task and its try."""

    count = 2

    def __init__(self, function: Callable[[str, int], Outcome]) -> None:
        self.function = function
        self.flying: list[Begun[str]] = []
        self.together: list[list[str]] = []

    def begin(self, begun: Begun[str]) -> None:
        self.flying.append(begun)

    def ended(self) -> list[tuple[Begun[str], Outcome]]:
        self.together.append([b.task for b in self.flying])
        out = [(b, self.function(b.task, b.tries)) for b in self.flying]
        self.flying = []
        return out


def test_what_fails_from_outside_is_begun_again_alone_when_all_else_is_done() -> None:
    pool = Fleet(lambda task, tries: Outcome(OUTSIDE) if task == "b" and tries == 0 else Outcome(DONE))
    seen: list[tuple[str, str]] = []
    carry_out(pool, "abcd", lambda task, outcome: seen.append((task, outcome.state)) or ())
    assert pool.together == [["a", "b"], ["c", "d"], ["b"]]
    assert sorted(seen) == [(t, DONE) for t in "abcd"]


def test_it_is_given_up_after_so_many_tries_and_wrong_input_at_once() -> None:
    pool = Fleet(lambda task, _tries: Outcome(OUTSIDE if task == "a" else REFUSED, (task,)))
    seen: dict[str, Outcome] = {}
    carry_out(pool, "ab", lambda task, outcome: seen.update({task: outcome}) or ())
    assert [t for together in pool.together for t in together].count("a") == TRIES
    assert [t for together in pool.together for t in together].count("b") == 1
    assert {t: o.state for t, o in seen.items()} == {"a": OUTSIDE, "b": REFUSED}


def test_tasks_that_follow_from_others_are_carried_out() -> None:
    order: list[str] = []
    follow = {"share 1": (), "share 2": ("rest",)}
    carry_out(
        Here(lambda task: order.append(task) or Outcome(DONE)), ["share 1", "share 2"], lambda t, _o: follow.get(t, ())
    )
    assert order == ["share 1", "share 2", "rest"]


def end_itself_once(path: str) -> Outcome:
    """Be killed from outside on the first try."""
    mark = Path(path)
    if mark.name.startswith("killed") and not mark.exists():
        mark.write_text("begun")
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return Outcome(DONE, (mark.name,))


@pytest.mark.slow
def test_a_process_that_is_killed_costs_nothing(tmp_path: Path) -> None:
    names = ["one", "killed_1", "two", "three", "killed_2", "four"]
    seen: dict[str, Outcome] = {}
    with processes(end_itself_once, 2) as pool:
        tasks = [str(tmp_path / name) for name in names]
        carry_out(pool, tasks, lambda task, outcome: seen.update({Path(task).name: outcome}) or ())
    assert {n: o.reasons for n, o in seen.items()} == {n: (n,) for n in names}


@pytest.mark.slow
def test_one_that_is_killed_again_and_again_is_told_and_not_its_neighbour(tmp_path: Path) -> None:
    seen: dict[str, Outcome] = {}
    with processes(always_killed, 2) as pool:
        carry_out(pool, ["bad", "good", "fine"], lambda task, outcome: seen.update({task: outcome}) or ())
    assert seen["bad"] == LOST
    assert {seen["good"].state, seen["fine"].state} == {DONE}


def always_killed(name: str) -> Outcome:
    if name == "bad":
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.2)
    return Outcome(DONE)


@pytest.mark.skipif(sys.platform != "linux", reason="sends a signal to a group of processes")
def test_processes_that_are_still_importing_say_nothing_of_an_interrupt(tmp_path: Path) -> None:
    """What they import takes seconds; Ctrl-C reaches all of them meanwhile."""
    mark = tmp_path / "imported"
    (tmp_path / "slow_one.py").write_text(
        "import pathlib, time\n"
        f"pathlib.Path({str(mark)!r}).touch()\n"
        "time.sleep(1.0)\n"
        "def work(task):\n    return task\n"
    )
    (tmp_path / "start.py").write_text(
        "import importlib, sys\n"
        "from types import FunctionType\n"
        "from smfe.work.processes import processes\n"
        "from smfe.work.tasks import Begun\n"
        "def work(task):\n    return task\n"
        "work.__module__ = 'slow_one'\n"
        "if __name__ == '__main__':\n"
        "    try:\n"
        "        with processes(work, 1) as pool:\n"
        "            pool.begin(Begun(1))\n"
        "            pool.ended()\n"
        "    except KeyboardInterrupt:\n"
        "        sys.exit(130)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    own = subprocess.Popen(
        [sys.executable, "start.py"], cwd=tmp_path, env=environment, stderr=subprocess.PIPE, start_new_session=True
    )
    for _ in range(200):
        if mark.exists():
            break
        time.sleep(0.05)
    os.killpg(own.pid, signal.SIGINT)
    _, said = own.communicate(timeout=30)
    assert mark.exists()
    assert b"Traceback" not in said, said.decode()
