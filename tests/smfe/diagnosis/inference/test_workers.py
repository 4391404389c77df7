"""Processes that predict: the same answers as one process gives, in order, whatever becomes of them."""

import multiprocessing
import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from process.errors import InputError
from smfe.diagnosis.inference import model as model_module
from smfe.diagnosis.inference import workers as helpers_module
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.workers import Helpers, _parts, cores
from smfe.diagnosis.judgement.diagnose import diagnose

SEVERAL = pytest.mark.skipif(cores() < 2, reason="one core, or a system on which processes are not forked")
PLACES = np.linspace(-1.0, 1.0, 30)


@dataclass(frozen=True)
class Line(Abilities):
    """A straight line with noise 1, and a bend that may be in it; notes in which processes it was asked."""

    conditions: tuple
    seen: str = ""
    refused: bool = False
    causes: tuple = (
        Cause("bend", "Bend", (Parameter("bend.size", "1", 0.0, 1.0, 0.0, 50.0),)),
        Cause("step", "Step", (Parameter("step.size", "1", 0.0, 1.0, -50.0, 50.0),)),
    )
    proposals: tuple = ()
    nuisances: tuple = (Parameter("slope", "1", 1.0, 0.3, prior=5.0),)

    def predict(self, condition, values):
        if self.seen:
            with open(self.seen, "a") as file:
                print(os.getpid(), file=file)
        if values["slope"] > 5.0:
            raise InputError("too steep")
        if abs(values.get("step.size", 0.0)) > 0.0 and self.refused:
            raise InputError(f"no step at {condition.settings['feed']}")
        x = condition.settings["feed"] + PLACES
        bent = values.get("bend.size", 0.0) * x**2
        return values["slope"] * x + bent + values.get("step.size", 0.0) * (x > 0.0)


def measured(bend, seen=""):
    rng = np.random.default_rng(5)
    empty = [Condition(f"run {k}", {"feed": k - 2.0}) for k in range(5)]
    line, truth = Line(tuple(empty), seen), {"slope": 1.2, "bend.size": bend}
    return Line(
        tuple(Condition(c.name, c.settings, observed=line.predict(c, truth) + rng.standard_normal(30)) for c in empty),
        seen,
    )


@pytest.fixture
def eager(monkeypatch):
    """Ask helpers at once: a line is predicted in no time."""
    monkeypatch.setattr(model_module, "RULES", replace(RULES, worth_help=0.0, worth_a_start=0.0))


@SEVERAL
@pytest.mark.parametrize("bend", [0.0, 3.0])
def test_the_finding_is_the_same_to_the_last_digit(eager, tmp_path, bend):
    alone = diagnose(measured(bend), workers=1)
    helped = diagnose(measured(bend, str(tmp_path / "seen")), workers=2)
    assert repr(helped) == repr(alone)
    assert (alone.verdict, [c.id for c in alone.causes]) == (("named", ["bend"]) if bend else ("consistent", []))
    asked = (tmp_path / "seen").read_text().split()
    assert len(set(asked)) == 3
    assert asked.count(str(os.getpid())) < 0.5 * len(asked)


@SEVERAL
def test_why_nothing_is_predicted_comes_back(eager):
    family = measured(0.0)
    with Helpers(2) as helpers:
        model = Model(family, family.conditions, helpers)
        steep = model.null()
        steep[0] = 100.0
        model.prepare([(row, steep) for row in range(5)])
        assert model.predict(1, steep) is None
        assert model.trouble == "run 1: too steep"


@SEVERAL
def test_a_cause_that_cannot_be_predicted_is_reported_alike(eager):
    family = replace(measured(3.0), refused=True)
    alone, helped = (diagnose(family, workers=n) for n in (1, 2))
    assert "no step at" in str(alone.unconverged)
    assert repr(helped) == repr(alone)


@SEVERAL
def test_when_a_helper_is_killed_the_rest_is_done_alone(eager):
    family, here = measured(0.0), os.getpid()
    with Helpers(2) as helpers:

        def ask(row, u):
            if os.getpid() != here and row == 3:
                os._exit(9)
            return u * row, ""

        wanted = [(row, np.arange(3.0)) for row in range(5)]
        answers = helpers.answers(ask, wanted)
        assert helpers.count == 1
        assert [a.tolist() for a, _ in answers] == [(u * row).tolist() for row, u in wanted]
        assert Model(family, family.conditions, helpers).predict(0, np.zeros(3)).shape == (30,)


@SEVERAL
@pytest.mark.parametrize("problem", [BlockingIOError("no more processes"), BrokenProcessPool("killed")])
def test_where_no_process_starts_all_is_done_alone(monkeypatch, problem):
    class Refused:
        def __init__(self, *_):
            raise problem

    monkeypatch.setattr(helpers_module, "ProcessPoolExecutor", Refused)
    with Helpers(2) as helpers:
        (answer,) = helpers.answers(lambda row, u: (u + row, ""), [(1, np.zeros(2))])
        assert answer[0].tolist() == [1.0, 1.0]
        assert helpers.count == 1


@SEVERAL
def test_what_started_ends_when_another_does_not_start(monkeypatch):
    context, started = multiprocessing.get_context("fork"), []
    begin = context.Process.start

    def start(self):
        if started:
            raise BlockingIOError("no more processes")
        begin(self)
        started.append(self)

    monkeypatch.setattr(context.Process, "start", start)
    with Helpers(2) as helpers:
        assert helpers.answers(lambda row, u: (u, ""), [(1, np.zeros(2))])[0][0].size == 2
    assert [p.is_alive() for p in started] == [False]


@pytest.mark.skipif(sys.platform != "linux", reason="only there processes are forked")
def test_helpers_end_with_who_started_them_however_it_ends():
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    running = context.Process(target=_start_two_and_wait, args=(there,))
    running.start()
    there.close()  # a child that fails ends the pipe
    children = here.recv()
    assert len(children) == 2
    assert all(os.path.exists(f"/proc/{n}") for n in children)
    running.kill()
    running.join()
    deadline = time.monotonic() + 20.0
    while any(_runs(n) for n in children) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(_runs(n) for n in children)


def _start_two_and_wait(parent):
    helpers_module.cores = lambda: 2  # a process that was started by another has no helpers of its own
    with Helpers(2) as two:
        two.answers(lambda row, u: (u, ""), [(0, np.zeros(1)), (1, np.ones(1))])
        parent.send([p.pid for p in two._pool._processes.values()])
        time.sleep(60.0)


def _runs(pid):
    """Whether a process is there and not a zombie that was not collected."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


@dataclass(frozen=True)
class Counting(Line):
    """Notes how many threads the linear algebra has."""

    threads: tuple = (set(),)

    def predict(self, condition, values):
        self.threads[0].update(lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas")
        return super().predict(condition, values)


@pytest.mark.skipif(cores() < 2, reason="one core has one thread")
def test_linear_algebra_has_one_thread_while_something_is_diagnosed_and_its_own_again_afterwards():
    family = Counting(measured(0.0).conditions)
    with threadpool_limits(2, "blas"):
        diagnose(family, workers=1)
        assert family.threads[0] == {1}
        assert {lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"} == {2}


def test_nothing_is_forked_beside_the_main_thread_or_in_a_daemonic_process():
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(cores).result() == 1
    if sys.platform == "linux":
        with multiprocessing.get_context("fork").Pool(1) as daemons:
            assert daemons.apply(cores) == 1


def test_no_more_help_than_cores_and_none_where_forks_are_not_safe(monkeypatch):
    assert Helpers(10_000).count == cores()
    assert Helpers().count == min(RULES.most_workers, cores())
    with pytest.raises(InputError, match="give at least 1"):
        Helpers(0)
    monkeypatch.setattr(sys, "platform", "darwin")
    assert Helpers(4).count == 1


@pytest.mark.parametrize("count", [2, 3, 8])
@pytest.mark.parametrize("values", [1, 2, 7])
def test_everything_wanted_is_in_one_part_in_its_order_and_no_part_mixes_values(count, values):
    wanted = [(row, np.full(2, float(v))) for v in range(values) for row in range(24)]
    parts = _parts(wanted, count)
    assert [w for part in parts for w in part] == wanted
    assert all(len({u.tobytes() for _, u in part}) == 1 for part in parts)
    assert len(parts) >= min(count, len(wanted))
