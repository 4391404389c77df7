"""Fits that begin many half-power widths from where they end."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from process.errors import InputError
from process.types import Real
from smfe.diagnosis.inference.fit import Fit, Target, fit, part, plausibly, roughly
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter

LINES = np.linspace(20.0, 120.0, 60)


def _of_mode(k: int, f: float) -> tuple[Parameter, ...]:
    return (
        Parameter(f"f{k}", "Hz", f, 0.5, 10.0, 200.0),
        Parameter(f"zeta{k}", "1", 0.03, 0.003, 0.001, 0.5),
        Parameter(f"size{k}", "1", 1.0, 0.05, 0.0, 50.0),
    )


@dataclass(frozen=True)
class Resonances(Abilities):
    """Three resonances, real and imaginary parts, 30 times the noise at rest."""

    conditions: tuple[Condition, ...]
    proposals: tuple[Condition, ...] = ()
    causes: tuple[Cause, ...] = ()
    nuisances: tuple[Parameter, ...] = tuple(p for k, f in enumerate((45.0, 70.0, 90.0)) for p in _of_mode(k, f))

    def predict(self, condition: Condition, values: Mapping[str, float]) -> Real:
        """Return real and imaginary parts."""
        y = np.zeros(LINES.size, dtype=complex)
        for k in range(3):
            r = LINES / values[f"f{k}"]
            y += 30.0 * values[f"size{k}"] / (1.0 - r**2 + 2j * values[f"zeta{k}"] * r)
        return np.concatenate([y.real, y.imag])


def ends(seed: int) -> bool:
    """Whether a fit from frequencies up to 25 % off, of resonances 3 % wide, ends in an optimum, be it another one."""
    rng = np.random.default_rng(seed)
    family = Resonances((Condition("hits", {}, None),))
    off = {"f": 0.25, "z": 0.5, "s": 0.5}
    true = {p.name: p.start * (1.0 + off[p.name[0]] * rng.uniform(-1.0, 1.0)) for p in family.nuisances}
    seen = family.predict(family.conditions[0], true) + rng.standard_normal(2 * LINES.size)
    model = Model(family, (Condition("hits", {}, seen),))
    return fit(model, Target({0: seen}, model.null()), (), model.null()).converged


def test_fits_that_damped_steps_brought_near_an_optimum_end_there() -> None:
    """Without plain steps after it five of the twenty did not."""
    assert sum(ends(seed) for seed in range(20)) >= 18


def test_a_fit_that_cannot_come_as_low_as_another_is_given_up() -> None:
    """It is no evidence: provisional, above what it had to come below, and after fewer predictions than to its end."""
    rough = Resonances((Condition("hits", {}, None),))
    seen = rough.predict(rough.conditions[0], {p.name: p.start for p in rough.nuisances})
    seen[::2] += 20.0
    predicted = 0

    class Counted(Resonances):
        def predict(self, condition: Condition, values: Mapping[str, float]) -> Real:
            nonlocal predicted
            predicted += 1
            return super().predict(condition, values)

    def fitted(most: float) -> tuple[Fit, int]:
        nonlocal predicted
        predicted = 0
        model = Model(Counted((Condition("hits", {}, seen),)), (Condition("hits", {}, seen),))
        start = model.scaled({"f0": 50.0, "f1": 66.0, "f2": 99.0, "size1": 1.5})
        return fit(model, Target({0: seen}, model.null()), (), start, most=most), predicted

    whole, all_of_it = fitted(np.inf)
    lost, some = fitted(0.01 * whole.chi2)
    assert (whole.converged, whole.provisional, lost.provisional) == (True, False, True)
    assert lost.chi2 > whole.chi2
    assert some < all_of_it
    # What can still come below it is followed to its end.
    near, _ = fitted(1.01 * whole.chi2)
    assert not near.provisional
    assert abs(near.chi2 - whole.chi2) < 1e-3 * whole.chi2


def test_what_a_part_of_the_conditions_leads_to_predicts_the_others_too() -> None:
    """Of nine conditions three are fitted first; under the control of another the values that they lead to are none."""
    names = [f"hits {n}" for n in range(9)]

    class Unstable(Resonances):
        def predict(self, condition: Condition, values: Mapping[str, float]) -> Real:
            if condition.name == "hits 7" and values["size0"] > 1.2:
                raise InputError("the machine is unstable with its servos")
            return super().predict(condition, values)

    plain = Resonances(tuple(Condition(n, {}) for n in names))
    start = {p.name: p.start for p in plain.nuisances}
    right = [plain.predict(c, start) for c in plain.conditions]
    off = plain.predict(plain.conditions[0], start | {"size0": 1.3})
    seen = [off if n % 4 == 0 else y for n, y in enumerate(right)]
    family = Unstable(tuple(Condition(n, {}, y) for n, y in zip(names, seen, strict=True)))
    model = Model(family, family.conditions)
    u = roughly(model, Target(dict(enumerate(seen)), model.null()))
    assert model.values(u)["size0"] < 1.2
    assert model.predict(7, u) is not None


def test_of_many_conditions_those_are_fitted_first_that_have_every_setting() -> None:
    """Here every fourth is at rest: what drives do would be open until all are fitted."""
    conditions = tuple(
        Condition(f"{n}", {"feed": 0.0 if n % 4 == 0 else 500.0, "controller": "K3" if n == 6 else "K2"}, np.zeros(120))
        for n in range(9)
    )
    model = Model(Resonances(conditions), conditions)
    chosen = [conditions[r] for r in part(model, Target({r: np.zeros(120) for r in range(9)}, model.null())).observed]
    assert len(chosen) == 3
    assert {c.settings["feed"] for c in chosen} == {0.0, 500.0}
    assert {c.settings["controller"] for c in chosen} == {"K2", "K3"}


def test_what_is_hidden_does_not_move_beyond_belief_what_data_are_prepared_with() -> None:
    """A mode that the model lacks, 200 times the noise: the best fit has the frequencies 20 and more tolerances off."""
    known = tuple(replace(p, prior=0.02 * p.start) for p in Resonances(()).nuisances)
    family = Resonances((Condition("hits", {}, None),), nuisances=known)
    r = LINES / 62.0
    more = 200.0 / (1.0 - r**2 + 0.2j * r)
    seen = family.predict(family.conditions[0], {p.name: p.start for p in known})
    seen = seen + np.concatenate([more.real, more.imag])
    model = Model(family, (Condition("hits", {}, seen),))
    target = Target({0: seen}, model.null())
    best, plausible = (np.abs(u * model.weight).max() for u in (roughly(model, target), plausibly(model, target)))
    assert best > 20.0
    assert plausible < 0.3 * best


@dataclass(frozen=True)
class Bent(Abilities):
    """The valley ``y = x^2``, as narrow as `steep` makes it, whose floor falls towards x = 1 (Rosenbrock 1960)."""

    steep: float
    conditions: tuple[Condition, ...] = (Condition("one", {}, np.zeros(2)),)
    proposals: tuple[Condition, ...] = ()
    causes: tuple[Cause, ...] = ()
    nuisances: tuple[Parameter, ...] = (
        Parameter("x", "1", -1.2, 0.1, -50.0, 50.0),
        Parameter("y", "1", 1.0, 0.1, -500.0, 500.0),
    )

    def predict(self, condition: Condition, values: Mapping[str, float]) -> Real:
        """Return what is off across and along the valley."""
        return np.array([self.steep * (values["y"] - values["x"] ** 2), 100.0 * (1.0 - values["x"])])


def test_a_fit_follows_a_bent_valley_to_its_end() -> None:
    """With a trust region of straight steps it came to rest on its floor at a misfit that still promised 3.8."""
    for steep in (1e3, 1e4):
        family = Bent(steep)
        model = Model(family, family.conditions)
        found = fit(model, Target({0: np.zeros(2)}, model.null()), (), model.null())
        assert found.converged
        assert found.chi2 < 0.1
