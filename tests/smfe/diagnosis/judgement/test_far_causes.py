"""Causes that act far from their null only: where their fits begin, and when one that was refused is tried again."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from smfe.diagnosis.inference.fit import Fit, Target, residuals
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter
from smfe.diagnosis.judgement import hypotheses
from smfe.diagnosis.judgement import search as module
from smfe.diagnosis.judgement.declared import Released
from smfe.diagnosis.judgement.diagnose import as_declared, deviations, diagnose
from smfe.diagnosis.judgement.hypotheses import Bench
from smfe.diagnosis.judgement.search import Step, search
from smfe.progress import silent

F = np.linspace(20.0, 120.0, 60)


@dataclass(frozen=True)
class Held(Abilities):
    """Compliance of a mass on a spring, of 50 Hz as declared; at rest friction may hold it by another spring."""

    conditions: tuple
    nuisances: tuple = (
        Parameter("mass", "1", 1.0, 0.1, 0.05, 20.0, 0.1),
        Parameter("stiffness", "1", 1.0, 0.1, 0.05, 20.0, 0.1),
        Parameter("damping", "1", 0.1, 0.01, 0.01, 5.0, 0.04),
        Parameter("gain", "1", 1.0, 0.05, 0.1, 10.0, 0.014, given="sensor_gain"),
    )
    causes: tuple = (
        Cause("held", "friction that holds", (Parameter("held", "1", 0.0, 0.05, 0.0, 50.0),), starts=((2.0,), (8.0,))),
    )
    proposals: tuple = ()

    def predict(self, condition, values):
        s, held = 1j * F / 50.0, values.get("held", 0.0) if condition.settings["feed"] == 0.0 else 0.0
        # A weak hold slips: it does next to nothing.
        held = held * np.exp(-1.0 / held) if held > 0.0 else 0.0
        dynamic = values["mass"] * s**2 + values["damping"] * s + values["stiffness"] + held
        phi = values["gain"] / dynamic * np.exp(-values.get("late", 0.0) * s)
        return np.concatenate([phi.real, phi.imag]) / 0.02


def bench(family):
    model = Model(family, family.conditions)
    return Bench(model, Target({r: c.observed for r, c in enumerate(family.conditions)}, model.null()), 0, silent)


def measured(held, gain=1.01):
    blank = Held(tuple(Condition(f"at {v:g}", {"feed": v}) for v in (0.0, 0.5, 1.0)))
    values = {"mass": 1.05, "stiffness": 0.97, "damping": 0.12, "gain": gain, "held": held}
    rng = np.random.default_rng(4)
    seen = tuple(
        replace(c, observed=blank.predict(c, values) + rng.standard_normal(2 * F.size)) for c in blank.conditions
    )
    return bench(replace(blank, conditions=seen))


@pytest.mark.parametrize("held", [1.5, 3.0, 6.0])
def test_a_fit_begins_at_what_was_declared_where_that_of_the_baseline_has_gone_astray(held):
    one = measured(held)
    found = one.extend(one.null(), (0,))
    assert found.converged
    assert one.model.values(found.u)["held"] == pytest.approx(held, rel=0.05)


def test_a_release_that_cannot_do_what_a_cause_does_is_not_followed_to_its_optimum():
    """Other masses, springs and gains do not hold an axis at rest; where nothing holds it they fit to the end."""
    for held, given_up in ((6.0, True), (0.0, False)):
        with_cause = measured(held)
        most = with_cause.extend(with_cause.null(), (0,)).chi2 + 6.0
        again = measured(held)
        again.known = {(): SimpleNamespace(u=again.model.null(), slope=None)}
        found = again.null(most)
        assert found.provisional == given_up
        assert (found.chi2 > most) == given_up


def test_what_was_declared_is_fitted_in_the_minimum_in_which_it_was_released():
    released = measured(3.0)
    released.model.weight[3] *= 0.02
    found = released.extend(released.null(), (0,))
    gain = Released(("sensor_gain",), 4.0, ({3: float(found.u[3])},), ({3: 0.1},))
    before, fixed = as_declared(released, found, [gain])
    assert fixed.converged
    assert 3 not in fixed.free
    assert before.model.values(fixed.u)["gain"] == 1.0
    assert before.model.values(fixed.u)["held"] == pytest.approx(3.0, rel=0.05)
    assert fixed.chi2 - found.chi2 < 20.0


@pytest.mark.parametrize(("alone", "end"), [(2900.0, (0,)), (105.0, ())])
def test_what_was_refused_alone_is_held_against_the_data_again_where_a_pair_finds_a_better_minimum(
    monkeypatch, alone, end
):
    def fitted(causes, chi2):
        return Fit(causes, np.zeros(0, dtype=np.int64), np.zeros(0), chi2, {}, {}, True)

    fits = {(): fitted((), 3000.0), (0,): fitted((0,), 100.0), (0, 1): fitted((0, 1), 100.0)}

    def step(one, at, steps):
        if at.causes:
            return None
        steps.append(Step((0,), "+ friction", 3000.0 - alone, 10.0, None, alone, False, "no gain"))
        steps.append(Step((0, 1), "+ friction + posture", 2900.0, 10.0, None, 100.0, True))
        return fits[0, 1]

    def passes(one, at, candidate, added, limit, steps):
        steps.append(Step((0,), "+ friction", 2900.0, 10.0, None, 100.0, True))
        return True

    monkeypatch.setattr(module, "_best_step", step)
    monkeypatch.setattr(module, "_drop_idle", lambda one, at, steps: fits[0,])
    monkeypatch.setattr(module, "_passes", passes)
    monkeypatch.setattr(module, "on_bound", lambda model, found, causes: "")
    stub = SimpleNamespace(
        model=None,
        fits=fits,
        null=lambda: fits[()],
        threshold=lambda at: 10.0,
        matters=lambda at, share: True,
        as_known=lambda at, k: False,
    )
    at, steps = search(stub)
    assert at.causes == end
    assert [s.accepted for s in steps] == ([False, False, True] if end else [False, False])


@pytest.mark.parametrize(("bad", "released", "end"), [(False, 80.0, ()), (False, 40.0, (0,)), (True, 80.0, (0,))])
def test_of_what_noise_could_be_nothing_is_a_cause_that_a_declared_value_explains_better(
    monkeypatch, bad, released, end
):
    def fitted(causes, chi2):
        return Fit(causes, np.zeros(0, dtype=np.int64), np.zeros(0), chi2, {}, {}, True)

    fits = {(): fitted((), 1000.0), (0,): fitted((0,), 940.0)}

    def step(one, at, steps):
        if not at.causes:
            steps.append(Step((0,), "+ joint", 60.0, 12.0, None, 940.0, True))
        return None if at.causes else fits[0,]

    monkeypatch.setattr(module, "_best_step", step)
    monkeypatch.setattr(module, "_drop_idle", lambda one, at, steps: at)
    monkeypatch.setattr(module, "_merit", lambda one, at, found: at.chi2 - found.chi2)
    monkeypatch.setattr(module, "on_bound", lambda model, found, causes: "")
    stub = SimpleNamespace(
        model=None,
        fits=fits,
        null=lambda: fits[()],
        bad=lambda at: bad,
        matters=lambda at, share: True,
        as_known=lambda at, k: False,
    )
    at, steps = search(stub, released=lambda at: released)
    assert at.causes == end
    assert steps[0].accepted == bool(end)


@pytest.mark.parametrize(("known", "end"), [(True, (0, 1)), (False, (0,))])
def test_what_is_known_within_its_tolerance_ends_no_search_though_little_is_left(monkeypatch, known, end):
    def fitted(causes, chi2):
        return Fit(causes, np.zeros(0, dtype=np.int64), np.zeros(0), chi2, {}, {}, True)

    fits = {(): fitted((), 1000.0), (0,): fitted((0,), 940.0), (0, 1): fitted((0, 1), 700.0)}

    def step(one, at, steps):
        steps.append(Step((*at.causes, len(at.causes)), "+", 60.0, 12.0, None, 940.0, True))
        return fits.get(steps[-1].causes)

    monkeypatch.setattr(module, "_best_step", step)
    monkeypatch.setattr(module, "_drop_idle", lambda one, at, steps: at)
    monkeypatch.setattr(module, "_hides", lambda one, at: False)
    monkeypatch.setattr(module, "on_bound", lambda model, found, causes: "")
    stub = SimpleNamespace(
        model=None,
        fits=fits,
        null=lambda: fits[()],
        matters=lambda at, share: False,
        as_known=lambda at, k: known and k == 0,
    )
    assert search(stub)[0].causes == end


@pytest.mark.parametrize(("share", "used"), [(1e-4, True), (1e-2, False)])
def test_what_creeps_and_promises_next_to_nothing_of_what_it_gained_has_ended(monkeypatch, share, used):
    """Fits with the elements of a joint creep along a valley of their travel: no answer came in 300 s."""
    one = measured(3.0)
    at = one.null()
    best = one.extend(at, (0,))
    left = replace(best, converged=False, reason="a step promises more", promised=share * (at.chi2 - best.chi2))
    again = measured(3.0)
    monkeypatch.setattr(again, "_extended", lambda *_: left)
    monkeypatch.setattr(hypotheses, "nearest", lambda model, target, found, added: found)
    assert again.extend(again.null(), (0,)).converged == used


def test_an_interval_is_wider_by_the_step_that_a_fit_has_not_taken():
    one = measured(3.0)
    found = one.extend(one.null(), (0,))
    place = int(np.flatnonzero(found.free == one.model.of_cause[0][0])[0])
    before = step = deviations(one, found, None)[place]
    u = found.u.copy()
    u[found.free[place]] += step
    left = residuals(one.model, one.target, u)
    short = replace(found, u=u, residual=left, slope=one.model.slopes(list(left), u, found.free))
    assert deviations(one, short, None)[place] == pytest.approx(np.hypot(before, step), rel=0.15)


@pytest.mark.parametrize("chi2", [{0: 100.0, 1: 2000.0}, {0: 2000.0, 1: 100.0}, {1: 100.0}])
def test_what_fitted_nearly_the_same_data_best_is_tried_first(chi2):
    one = measured(3.0)
    late = Cause("late", "a clock that is late", (Parameter("late", "1", 0.0, 0.05),), starts=((1.0,),))
    both = bench(replace(one.model.family, causes=(*one.model.family.causes, late)))
    start = both.null()
    both.known = {(k,): replace(start, causes=(k,), chi2=left) for k, left in chi2.items()}
    assert module._promising(both, start, [0, 1], 10.0) == sorted([0, 1], key=lambda k: chi2.get(k, np.inf))


@dataclass(frozen=True)
class Island(Abilities):
    """Limits that grow with speed by a cause; of the one at 2 an island takes 100 where the level passes an edge."""

    conditions: tuple
    edge: float = 2.7
    nuisances: tuple = (Parameter("level", "1", 0.0, 0.1, -10.0, 10.0, 1.0),)
    causes: tuple = (
        Cause(
            "stiffer", "what stiffens with speed", (Parameter("stiffer", "1", 0.0, 0.1, -5.0, 5.0),), starts=((0.5,),)
        ),
    )
    proposals: tuple = ()

    def predict(self, condition, values):
        speed = condition.settings["speed"]
        island = 100.0 if speed == 2.0 and values["level"] > self.edge else 0.0
        return np.full(3, 10.0 * values["level"] + 10.0 * values.get("stiffer", 0.0) * speed - island)


@pytest.mark.parametrize(("edge", "stiffer", "of_promised"), [(2.7, 1.0, (20.0, 21.0)), (0.75, 0.3, (6.5, 7.5))])
def test_a_baseline_that_cannot_be_fitted_to_the_end_for_a_jump_is_still_wrong(edge, stiffer, of_promised):
    """How bad the best fit is need not be known where thrice what its steps promise leaves far more than noise."""
    blank = Island(tuple(Condition(f"at {v:g}", {"speed": v}) for v in (1.0, 2.0, 3.0, 4.0, 5.0)), edge)
    values, rng = {"level": 0.02, "stiffer": stiffer}, np.random.default_rng(4)
    seen = tuple(replace(c, observed=blank.predict(c, values) + rng.standard_normal(3)) for c in blank.conditions)
    family = replace(blank, conditions=seen)
    null = bench(family).null()
    assert not null.converged
    assert bench(family).hopeless(null)
    more_than_noise = null.chi2 - bench(family).explained(null)
    assert of_promised[0] < more_than_noise / null.promised < of_promised[1]
    found = diagnose(family, workers=1)
    assert (found.verdict, [c.id for c in found.causes]) == ("named", ["stiffer"])
    assert found.values["stiffer"] == pytest.approx(stiffer, abs=0.05)


AROUND = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
SIZE = Parameter("wave", "1", 0.0, 1.0, 0.0, 100.0)
TURN = Parameter("wave_angle", "1", 0.5, 0.3, -7.0, 7.0, secondary=True)
PARTS = tuple(Parameter(f"part_{n}", "1", 0.0, 1.0) for n in range(3))


@dataclass(frozen=True)
class Waves(Abilities):
    """A wave of some size and angle, or three shapes that add up to any wave of that length and more."""

    conditions: tuple
    nuisances: tuple = (Parameter("mean", "1", 0.0, 1.0),)
    causes: tuple = (
        Cause("wave", "a wave", (SIZE, TURN), starts=tuple((2.0, a) for a in (-2.5, -1.0, 0.5, 2.0))),
        Cause("wave", "three shapes", PARTS, "shapes", starts=((2.0, 0.0, 0.0), (0.0, 2.0, 0.0))),
    )
    proposals: tuple = ()

    def predict(self, condition, values):
        shapes = np.array([np.cos(AROUND), -np.sin(AROUND), np.cos(3.0 * AROUND)])
        parts = values.get("wave", 0.0) * np.cos(AROUND + values.get("wave_angle", 0.5))
        return values["mean"] + condition.settings["grown"] * (
            parts + np.array([values.get(f"part_{n}", 0.0) for n in range(3)]) @ shapes
        )


def test_a_shape_that_does_nothing_at_the_null_of_its_size_is_fitted_before_a_richer_variant_wins():
    """With slopes from where the size is zero the angle stays at 0.5; nothing is left of the data but by that."""
    made = tuple(Condition(f"cut {k}", {"grown": 1.0 + 0.2 * k}) for k in range(4))
    family = Waves(made)
    exact = [family.predict(c, {"mean": 0.0, "wave": 5.0, "wave_angle": 0.6}) for c in made]
    family = Waves(tuple(replace(c, observed=x) for c, x in zip(made, exact, strict=True)))
    (cause,) = diagnose(family).causes
    assert (cause.id, cause.variant) == ("wave", "")
    assert [p.value for p in cause.parameters] == pytest.approx([5.0, 0.6], abs=0.02)
