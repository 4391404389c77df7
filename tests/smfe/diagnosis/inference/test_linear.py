"""The parts of the diagnosis against closed forms, on a family that is linear but for one nuisance at most."""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
import pytest
from samples.isolability import isolability
from scipy import stats
from scipy.optimize import lsq_linear, nnls

from process.errors import InputError
from smfe.diagnosis.inference.cross_validation import HeldOut, compare, schemes
from smfe.diagnosis.inference.fit import Target, bounded_step, fit, nearest
from smfe.diagnosis.inference.misfit import Misfit, NoiseKnowledge, assess
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.signature import tangent, widened
from smfe.diagnosis.inference.thresholds import Score, noncentrality, threshold
from smfe.diagnosis.judgement.diagnose import deviations, diagnose, estimates
from smfe.diagnosis.judgement.finding import Estimate, Finding, FoundCause
from smfe.diagnosis.judgement.hypotheses import Bench
from smfe.diagnosis.judgement.next_experiment import discrimination, probability_to_settle
from smfe.diagnosis.judgement.search import search
from smfe.diagnosis.judgement.verdict import Judgement, changing, most_changing
from smfe.diagnosis.story.sentences import explain
from smfe.progress import silent

N = 24
X = np.linspace(0.0, 1.0, N)
BASIS = np.array([np.cos(k * np.pi * X) for k in range(8)])


def cause(name, count=1, **bounds):
    parameters = tuple(Parameter(f"{name}.{i}", "m", 0.0, 1.0, shown=1000.0, **bounds) for i in range(count))
    return Cause(name, name.capitalize(), parameters)


@dataclass(frozen=True)
class Linear(Abilities):
    """Each cause adds its own pattern over x, times its own dependence on the settings."""

    conditions: tuple
    causes: tuple
    effects: dict
    proposals: tuple = ()
    nuisances: tuple = (Parameter("offset", "m", 0.0, 1.0), Parameter("slope", "m", 0.0, 1.0, prior=2.0))

    def predict(self, condition, values):
        y = values["offset"] * BASIS[0] + values["slope"] * BASIS[1]
        for name, effect in self.effects.items():
            if name in values:
                y = y + values[name] * effect(condition.settings)
        return y


def grid(feeds=(1.0, 2.0, 3.0), directions=(-1.0, 1.0)):
    return tuple(
        Condition(f"feed {f:g} {d:+g}", {"feed": f, "direction": d, "order": k}, source="ab"[k % 2])
        for k, (f, d) in enumerate((f, d) for f in feeds for d in directions)
    )


def measured(family, truth, seed):
    values = {p.name: 0.0 for p in family.nuisances} | truth
    rng = np.random.default_rng(seed)
    return replace(
        family,
        conditions=tuple(
            replace(c, observed=family.predict(c, values) + rng.standard_normal(N)) for c in family.conditions
        ),
    )


def bench(family):
    model = Model(family, family.conditions)
    observed = {r: c.observed for r, c in enumerate(family.conditions) if c.observed is not None}
    return Bench(model, Target(observed, model.null()), 0, silent)


FRICTION, GAIN, BOTH = cause("friction", low=0.0), cause("gain"), cause("both", 2)
FAMILY = Linear(
    grid(),
    (FRICTION, GAIN, BOTH),
    {
        "friction.0": lambda s: np.exp(-s["feed"]) * BASIS[2],
        "gain.0": lambda s: s["direction"] * BASIS[3],
        "both.0": lambda s: s["feed"] * BASIS[4],
        "both.1": lambda s: (s["feed"] - 2.0) * BASIS[5],
    },
)


def test_a_bounded_step_is_the_bounded_least_squares_solution():
    rng = np.random.default_rng(0)
    for _ in range(50):
        a, b = rng.standard_normal((30, 4)), rng.standard_normal(30)
        low, high = -rng.uniform(0.0, 0.3, 4), rng.uniform(0.0, 0.3, 4)
        step, decrease = bounded_step(a, b, low, high)
        right = lsq_linear(a, -b, (low, high), tol=1e-12, method="bvls")
        assert step == pytest.approx(right.x, abs=1e-7)
        assert decrease == pytest.approx(b @ b - 2.0 * right.cost, abs=1e-9)


def test_the_gain_of_causes_that_only_go_up_is_that_of_non_negative_least_squares():
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((20, 3)) + 1.0
    score = Score(columns.T @ columns, np.full(3, True), np.full(3, False))
    noise = rng.standard_normal((40, 20))
    right = [y @ y - nnls(columns, y)[1] ** 2 for y in noise]
    assert score.gain(noise @ columns) == pytest.approx(right, abs=1e-9)


@pytest.mark.parametrize(("chosen", "sides", "parameters"), [(GAIN, 1.0, 1), (FRICTION, 2.0, 1), (BOTH, 1.0, 2)])
def test_the_threshold_of_a_lone_cause_is_the_quantile_of_its_chi_square_law(chosen, sides, parameters):
    b = bench(measured(replace(FAMILY, causes=(chosen,)), {}, 0))
    at = tangent(b.model, b.target, b.null())
    for rate in (0.05, 0.001):
        found = threshold(b.model, at, np.random.default_rng(0), rate) + RULES.penalty * parameters
        assert found == pytest.approx(stats.chi2.ppf(1.0 - sides * rate, parameters), rel=0.1)


@pytest.mark.parametrize("draws", [24, pytest.param(120, marks=pytest.mark.slow)])
def test_the_detectable_size_is_what_a_simulation_sees_in_95_of_100_cases(draws):
    b = bench(measured(FAMILY, {}, 0))
    limit = b.threshold(b.null())
    sizes = {p.parameter: p.size / 1000.0 for p in isolability(FAMILY).power}
    for name, k in (("friction.0", 0), ("gain.0", 1)):
        seen = 0
        for seed in range(draws):
            trial = bench(measured(FAMILY, {name: sizes[name]}, seed))
            null = trial.null()
            seen += null.chi2 - trial.extend(null, (k,)).chi2 - RULES.penalty > limit
        assert abs(seen / draws - 0.95) <= 3.0 * sqrt(0.95 * 0.05 / draws)


def test_the_noncentrality_puts_95_percent_above_the_level():
    for count in (1, 2, 4):
        assert stats.ncx2.sf(15.0, count, noncentrality(15.0, count)) == pytest.approx(0.95, abs=1e-9)
    draws = np.maximum(np.random.default_rng(0).standard_normal(200_000) + sqrt(noncentrality(15.0, 1, True)), 0.0)
    assert np.mean(draws**2 > 15.0) == pytest.approx(0.95, abs=0.002)


def test_every_hypothesis_nests_the_baseline():
    b = bench(measured(FAMILY, {"gain.0": 0.2}, 3))
    null = b.null()
    for k in range(3):
        assert b.extend(null, (k,)).chi2 <= null.chi2 + 1e-9
    assert b.reduce(b.extend(null, (1,)), 1).chi2 == pytest.approx(null.chi2, abs=1e-6)
    data = np.append(np.concatenate([*b.target.observed.values()]), 0.0)
    exact = np.linalg.lstsq(np.vstack([np.tile(BASIS[:2].T, (6, 1)), [0.0, 0.5]]), data)[1]
    assert null.chi2 == pytest.approx(float(exact[0]), abs=1e-9)


# Bounds: two standard deviations of the share of so many intervals.
@pytest.mark.parametrize(
    ("draws", "low", "high"), [(50, 0.90, 1.0), pytest.param(250, 0.93, 0.97, marks=pytest.mark.slow)]
)
def test_intervals_cover_the_truth_in_95_of_100_cases(draws, low, high):
    truth = {"both.0": 0.4, "both.1": -0.7}
    inside = []
    for seed in range(draws):
        b = bench(measured(FAMILY, truth, 1000 + seed))
        found = b.confirmed(b.extend(b.null(), (2,)))
        for e in estimates(b, found, 2, Judgement("named", "")):
            inside.append(e.low <= 1000.0 * truth[e.name] <= e.high)
    assert low <= np.mean(inside) <= high


def test_the_interval_of_a_parameter_on_its_bound_reaches_as_far_as_the_data_allow():
    """Against the normal law cut at the bound: all but 2.5 % of the intervals hold."""
    truth, inside, on_bound = {"both.0": 0.4, "both.1": 0.05}, [], []
    upward = replace(FAMILY, causes=(cause("both", 2, low=0.0),))
    for seed in range(60):
        b = bench(measured(upward, truth, 1000 + seed))
        e = estimates(b, b.confirmed(b.extend(b.null(), (0,))), 0, Judgement("named", ""))[1]
        inside.append(e.low <= 1000.0 * truth[e.name] <= e.high)
        on_bound.append(e.value == 0.0)
    deviation = 1.0 / sqrt(4.0 * BASIS[5] @ BASIS[5])  # of both.1, which no other effect resembles
    assert np.mean(on_bound) == pytest.approx(stats.norm.cdf(-0.05 / deviation), abs=0.13)
    assert np.mean(inside) > 0.92


class Off(Linear):
    """The same by a simulation that is wrong by a third, and knows of conditions no more than the keys of `knows`."""

    model_error = 0.3
    knows = ("feed", "direction")

    def relative(self, condition, predicted, slopes):
        return slopes[0::2] + 1j * slopes[1::2]

    def alike(self, conditions):
        keys = [tuple(c.settings[k] for k in self.knows) for c in conditions]
        return [keys.index(k) for k in keys]


def test_a_simulation_is_not_wrong_about_a_contrast_that_it_does_not_know():
    """It may be wrong about a parameter of its own, and alike forth and back where it knows of no direction."""

    class Blind(Off):
        knows = ("feed",)

    effects = {"turns.0": lambda s: s["direction"] * BASIS[3], "own.0": lambda s: BASIS[4]}
    sds = {}
    for kind in (Linear, Off, Blind):
        family = measured(kind(grid(), (cause("turns"), cause("own")), effects), {"turns.0": 1.0, "own.0": 1.0}, 3)
        b = bench(family)
        sds[kind] = deviations(b, b.confirmed(b.extend(b.null(), (0, 1))), None)[-2:]
    assert np.all(sds[Off] > 1.5 * sds[Linear])
    assert sds[Blind][0] == pytest.approx(sds[Linear][0], rel=1e-9)
    assert sds[Blind][1] > 1.5 * sds[Linear][1]


@pytest.mark.parametrize(
    ("draws", "low", "high"), [(30, 0.88, 1.0), pytest.param(150, 0.92, 0.98, marks=pytest.mark.slow)]
)
def test_intervals_hold_where_the_model_is_off_by_what_looks_like_its_parameters(draws, low, high):
    """White errors, as far as the parameters can follow them; their size is a third of the prediction."""
    truth, off = {"both.0": 0.4, "both.1": -0.7}, Off(FAMILY.conditions, FAMILY.causes, FAMILY.effects)
    model = Model(off, off.conditions)
    slope = np.concatenate([*model.slopes(range(6), model.null(), model.free((2,))).values()])
    inside = {True: [], False: []}
    for seed in range(draws):
        data = measured(off, truth, 2000 + seed)
        white = np.random.default_rng(seed).standard_normal(len(slope)) / sqrt(2.0)
        wrong = 0.3 * sqrt(len(slope) / slope.shape[1]) * slope @ np.linalg.lstsq(slope, white)[0]
        pushed = [replace(c, observed=c.observed + d) for c, d in zip(data.conditions, np.split(wrong, 6), strict=True)]
        for allowed in inside:
            b = bench(replace(data if allowed else FAMILY, conditions=tuple(pushed)))
            found = b.confirmed(b.extend(b.null(), (2,)))
            for e in estimates(b, found, 2, Judgement("named", "")):
                inside[allowed].append(e.low <= 1000.0 * truth[e.name] <= e.high)
    assert low <= np.mean(inside[True]) <= high
    assert np.mean(inside[False]) < 0.85


def test_of_two_parameters_that_are_seen_only_as_their_sum_neither_has_an_interval():
    """The pseudo-inverse gives the direction that no value depends on no variance at all."""
    truth = {"both.0": 0.4, "both.1": -0.7}
    together = replace(FAMILY, effects=FAMILY.effects | {"both.1": FAMILY.effects["both.0"]})
    for family, known in ((FAMILY, True), (together, False)):
        b = bench(measured(family, truth, 7))
        half = [e.high - e.low for e in estimates(b, b.confirmed(b.extend(b.null(), (2,))), 2, Judgement("named", ""))]
        assert np.isfinite(half).tolist() == [known, known]
    found = FoundCause("a", "", "A", "physics", (Estimate("a.x", 0.4, -np.inf, np.inf, "N"),), 9.0, 3.0, 0.1)
    text = explain(Finding("named", "it is", (found,)))
    assert "0.400 N (not separable from others in these data)" in text


@pytest.mark.parametrize(("draws", "most"), [(100, 0.12), pytest.param(400, 0.08, marks=pytest.mark.slow)])
def test_noise_has_uniform_p_values_in_the_misfit_test_and_a_smooth_remainder_has_none(draws, most):
    rng = np.random.default_rng(5)
    load = {k: np.linalg.qr(rng.standard_normal((200, 4)))[0] / sqrt(5.0) for k in range(5)}
    joined = np.concatenate(list(load.values()))
    p_values = []
    for _ in range(draws):
        z = rng.standard_normal(1000)
        z -= joined @ (joined.T @ z)
        p_values.append(assess([(dict(enumerate(np.split(z, 5))), load)], shrinks=True).p_value)
    assert np.mean(np.array(p_values) < 0.05) <= most
    # Nine of every ten parts of this remainder are invisible in the sum of all squares.
    z = rng.standard_normal(1000) + 0.35 * np.tile(np.cos(np.pi * np.linspace(0.0, 1.0, 200)), 5)
    assert assess([(dict(enumerate(np.split(z, 5))), load)], shrinks=True).p_value < 1e-3


def test_what_is_missed_of_one_kind_of_values_shows_among_many_that_are_nearer_than_they_need_be():
    """40 kinds of 6 values in 7 conditions, all but one of them 0.3 of the noise that they are held to."""
    rng, kinds = np.random.default_rng(3), {k: np.tile(np.arange(40), 6) for k in range(7)}
    load = dict.fromkeys(range(7), np.zeros((240, 0)))
    near = {k: 0.3 * rng.standard_normal(240) for k in range(7)}
    off = {k: x + 3.0 * (kinds[k] == 1) for k, x in near.items()}
    assert assess([(off, load)], shrinks=True).p_value > 0.5
    assert assess([(off, load)], shrinks=True, kinds=kinds).p_value < 1e-6
    alone = [assess([({0: rng.standard_normal(240)}, load)], True, kinds=kinds).p_value for _ in range(200)]
    assert np.mean(np.array(alone) < 0.05) <= 0.08


@pytest.mark.parametrize(("draws", "most"), [(600, 0.03), pytest.param(2000, 0.025, marks=pytest.mark.slow)])
def test_noise_that_is_itself_estimated_makes_a_misfit_of_one_condition_an_f_law(draws, most):
    """40 values, their standard deviation from 60 others: uniform p-values; alarms without allowing for it."""
    rng, plain, allowed = np.random.default_rng(0), [], []
    for _ in range(draws):
        sigma = sqrt(rng.chisquare(60) / 60.0)
        residual = ({0: rng.standard_normal(40) / sigma}, {0: np.zeros((40, 0))})
        plain.append(assess([residual], shrinks=True).by_condition[0] < 0.02)
        allowed.append(assess([residual], True, NoiseKnowledge(60.0)).by_condition[0] < 0.02)
    assert np.mean(allowed) < most <= 0.03 < np.mean(plain)


@pytest.mark.parametrize(("draws", "most"), [(100, 0.05), pytest.param(600, 0.02, marks=pytest.mark.slow)])
def test_noise_that_each_condition_measured_itself_is_known_better_over_all_of_them(draws, most):
    """24 conditions of 40 values, each with a standard deviation of its own from 60: one in a hundred is refused."""
    rng, plain, allowed = np.random.default_rng(2), [], []
    known = NoiseKnowledge(own=dict.fromkeys(range(24), 60.0))
    assert known.together(dict.fromkeys(range(24), 40)) == pytest.approx(24 * 60.0)
    assert known.together({0: 10, 99: 10}) == pytest.approx(4 * 60.0)
    for _ in range(draws):
        sigma = np.sqrt(rng.chisquare(60, 24) / 60.0)
        residual = (
            {k: rng.standard_normal(40) / sigma[k] for k in range(24)},
            dict.fromkeys(range(24), np.zeros((40, 0))),
        )
        plain.append(assess([residual], shrinks=True).p_value < 0.01)
        allowed.append(assess([residual], True, known).p_value < 0.01)
    assert np.mean(allowed) <= most < 0.1 < np.mean(plain)


@dataclass(frozen=True)
class Sawn(Linear):
    """The same, with a fine saw on the weak parameter, one standard deviation of all values together."""

    roughness: float = 0.0

    def predict(self, condition, values):
        saw = (values["weak.0"] / 0.03) % 1.0 - 0.5
        return super().predict(condition, values) + saw * BASIS[5] / np.linalg.norm(BASIS[5])


def test_slopes_of_rough_predictions_are_taken_over_steps_that_see_more_than_the_saw():
    true = np.array([2.0 * BASIS[3], 0.0 * X])
    found = {}
    for roughness in (0.0, 1.0):
        sawn = Sawn(grid()[:1], (cause("weak"),), {"weak.0": lambda s: true[0]}, roughness=roughness)
        model = Model(sawn, sawn.conditions)
        slope = model.slopes([0], model.null(), np.arange(3))[0]
        assert slope[:, 0] == pytest.approx(BASIS[0], rel=1e-9)
        found[roughness] = np.linalg.norm(slope[:, 2] - true[0]) / np.linalg.norm(true[0])
    assert found[1.0] < 0.4 < 1.0 < found[0.0]


@pytest.mark.parametrize("left", [30.0, 60.0, 120.0])
def test_a_fit_converges_where_strong_rough_columns_cancel_and_much_is_left_that_no_parameter_explains(left):
    """Stiffness and mass in proportion: over the steps of either the saw is more than what is left of both together.

    Against a large residual such slopes promise a lower misfit that no step brings.
    """

    class Cancelling(Linear):
        roughness = 1.0

        def predict(self, condition, values):
            one, two = values["strong.0"], values["strong.1"]
            saw = (one / 0.013) % 1.0 + (two / 0.017) % 1.0 - 1.0
            seen = 800.0 * (one + two) * BASIS[2] + 2.0 * (one - two) * BASIS[3]
            return super().predict(condition, values) + seen + saw * unit

    unit = BASIS[5] / np.linalg.norm(BASIS[5]) / sqrt(len(grid()))
    family = Cancelling(grid(), (cause("strong", 2),), {})
    model = Model(family, family.conditions)
    target = Target(dict.fromkeys(range(len(grid())), left * unit), model.null())
    for one in (0.003, 0.1, 0.7):
        start = model.null()
        start[model.of_cause[0]] = one, -one
        found = fit(model, target, (0,), start)
        assert found.converged, found.reason
        assert found.chi2 == pytest.approx(left**2, abs=3.0 * left)


def test_a_step_that_has_grown_where_a_parameter_did_little_is_not_kept_where_it_does_much():
    """A cube does little near zero; far from it a central difference over half a scale is 8 % off."""

    class Cubed(Linear):
        roughness = 0.05

        def predict(self, condition, values):
            return super().predict(condition, values) + 5.0 * values["weak.0"] ** 3 * BASIS[3]

    cubed = Cubed(grid()[:1], (cause("weak"),), {})
    model, at = Model(cubed, cubed.conditions), np.array([0.0, 0.0, 1.0])
    model.slopes([0], np.array([0.0, 0.0, 0.01]), np.arange(3))
    assert model._step[2] > 0.1
    assert model.slopes([0], at, np.arange(3))[0][:, 2] == pytest.approx(15.0 * BASIS[3], rel=1e-2)


@dataclass(frozen=True)
class Exchangeable(Linear):
    """Two gains, 2 and 1 as recorded, of which the sum and the product are seen."""

    def predict(self, condition, values):
        one, two = 2.0 + values.get("gains.0", 0.0), 1.0 + values.get("gains.1", 0.0)
        return (
            super().predict(condition, values) + 9.0 * (one + two - 3.0) * BASIS[3] + 9.0 * (one * two - 2.0) * BASIS[4]
        )


@pytest.mark.parametrize("seed", range(3))
def test_of_two_values_that_fit_alike_the_nearer_to_what_was_recorded_is_taken(seed):
    gains = replace(cause("gains", 2), equivalent=lambda v: (v["gains.1"] - 1.0, v["gains.0"] + 1.0))
    b = bench(measured(Exchangeable(grid(), (gains,), {}), {"gains.0": 0.3}, seed))
    farther = fit(b.model, b.target, (0,), np.array([0.0, 0.0, -1.0, 1.3]))
    assert b.model.values(farther.u)["gains.1"] == pytest.approx(1.3, abs=0.2)
    chosen = nearest(b.model, b.target, farther, (0,))
    assert chosen.chi2 == pytest.approx(farther.chi2, abs=0.1)
    assert b.model.values(chosen.u)["gains.0"] == pytest.approx(0.3, abs=0.2)


def test_folds_leave_out_what_contrasts_and_else_each_condition():
    found = schemes(FAMILY.conditions, range(6))
    assert ((0, 2, 4), (1, 3, 5)) in found
    assert ((0, 1), (2, 3), (4, 5)) in found
    assert found[-1] == tuple((r,) for r in range(6))
    assert len(found) == 3


ALIKE = Linear(
    tuple(replace(c, source="") for c in grid()),
    (cause("delay"), cause("skew"), cause("gain")),
    {
        "delay.0": lambda s: X * (s["feed"] > 0.0),
        "skew.0": lambda s: X,
        "gain.0": lambda s: s["direction"] * BASIS[3],
    },
    proposals=(
        Condition("feed 4 +1", {"feed": 4.0, "direction": 1.0, "order": 7}),
        Condition("at rest", {"feed": 0.0, "direction": 1.0, "order": 8}),
    ),
    nuisances=(Parameter("offset", "m", 0.0, 1.0), Parameter("slope", "m", 0.0, 1.0, prior=0.01)),
)


@pytest.mark.parametrize(("draws", "least"), [(2, 2), pytest.param(12, 11, marks=pytest.mark.slow)])
def test_causes_that_the_conditions_cannot_separate_are_a_set_until_the_proposed_experiment_is_made(draws, least):
    truth = {"delay.0": 3.0}
    structure = isolability(ALIKE)
    assert structure.groups == (("delay", "skew"),)
    assert structure.cosine[0, 1] == pytest.approx(1.0, abs=1e-9)
    assert isolability(ALIKE, (*ALIKE.conditions, ALIKE.proposals[1])).groups == ()
    right = 0
    for seed in range(draws):
        before = diagnose(measured(ALIKE, truth, seed))
        assert before.verdict == "ambiguous"
        assert {c.id for c in before.alternatives[0]} == {"delay", "skew"}
        assert before.next_experiment.name == "at rest"
        assert before.next_experiment.probability > 0.95
        assert "Next: At rest" in explain(before)
        more = replace(ALIKE, conditions=(*ALIKE.conditions, ALIKE.proposals[1]))
        after = diagnose(measured(more, truth, seed))
        right += after.verdict == "named" and after.causes[0].id == "delay"
    assert right >= least


NEARLY = replace(
    ALIKE,
    causes=(cause("slack"), cause("twist")),
    effects={"slack.0": lambda s: BASIS[4], "twist.0": lambda s: BASIS[4] + 0.2 * BASIS[5]},
)


@pytest.mark.parametrize("draws", [2, pytest.param(8, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("size", "lead", "verdict"), [(5.0, 69.0, "named"), (1.0, 2.8, "ambiguous")])
def test_a_strong_effect_is_separated_from_what_is_nearly_alike_and_a_weak_one_is_not(size, lead, verdict, draws):
    # 72 size^2 of evidence, of which 1 - cos^2 = 1/26 separates the two.
    assert isolability(NEARLY).cosine[0, 1] == pytest.approx(sqrt(1.0 / 1.04), abs=1e-3)
    assert 72.0 * size**2 / 26.0 == pytest.approx(lead, rel=0.02)
    found = [diagnose(measured(NEARLY, {"slack.0": size}, seed)) for seed in range(draws)]
    assert sum(f.verdict == verdict for f in found) >= min(draws, 7)
    assert all({c.id for c in f.alternatives[0]} == {"slack", "twist"} for f in found if f.verdict == "ambiguous")


def test_one_strange_condition_does_not_decide_between_two_causes():
    # It adds what only the wrong cause can imitate: a lead of 60, against it in the five others.
    family = measured(NEARLY, {"slack.0": 3.0}, 1)
    strange = replace(family.conditions[2], observed=family.conditions[2].observed + 6.0 * BASIS[5])
    found = diagnose(replace(family, conditions=(*family.conditions[:2], strange, *family.conditions[3:])))
    assert found.verdict == "unknown"
    assert found.causes[0].id == "twist"
    assert {c.id for c in found.alternatives[0]} == {"slack", "twist"}
    assert found.remainder is not None
    assert found.remainder.carriers[0] == strange.name
    text = explain(found)
    assert text.startswith("The simulation leaves out twist")
    assert "% remain unexplained" in text.splitlines()[0]
    assert f"% of the error that repeats) is largest in {strange.name}" in text


def held_out(squares, p_value):
    rows = range(len(squares))
    values = dict.fromkeys(rows, 100.0)
    return HeldOut(dict(enumerate(squares)), dict.fromkeys(rows, 0.5), values, Misfit(p_value, 0.0, 1.0, {}), True)


def test_a_gain_that_ends_near_the_noise_is_proven_if_the_conditions_share_it():
    # What is left scatters around noise: some draws of the conditions leave nothing, and their decibels are endless.
    left = 100.0 + 25.0 * np.tile([1.0, -1.0, 0.4], 5)
    before, after = held_out(left + 70.0, 1e-6), held_out(left, 1e-6)
    gain = compare(before, after, np.random.default_rng(0))
    assert gain.proven
    assert gain.low > 5.0
    assert gain.share == pytest.approx(70.0 / (70.0 + 10.0 / 3.0), rel=1e-9)
    # The same sum, won in half of the conditions and lost in the others.
    other = held_out(left + 70.0 + 250.0 * np.sign(np.arange(15) % 2 - 0.5), 1e-6)
    assert not compare(other, after, np.random.default_rng(0)).proven
    # No gain beyond what the uncertain parameters leave.
    clean = compare(held_out(np.full(15, 170.0), 1e-6), held_out(np.full(15, 90.0), 1e-6), np.random.default_rng(0))
    assert clean.db == pytest.approx(10.0 * np.log10(1.0 + 80.0 / 0.5))


@pytest.mark.parametrize(("draws", "low"), [(25, 0.8), pytest.param(120, 0.88, marks=pytest.mark.slow)])
def test_intervals_cover_what_scatters_from_condition_to_condition(draws, low):
    # The gain differs by 0.5 between conditions: noise alone would give intervals four times too short.
    inside, plain = [], []
    family = replace(FAMILY, conditions=grid(tuple(np.linspace(1.0, 3.0, 12))), causes=(GAIN,))
    for seed in range(draws):
        own = 1.0 + 0.5 * np.random.default_rng([9, seed]).standard_normal(24)
        made = measured(family, {}, seed)
        pushed = tuple(
            replace(c, observed=c.observed + g * c.settings["direction"] * BASIS[3])
            for c, g in zip(made.conditions, own, strict=True)
        )
        b = bench(replace(made, conditions=pushed))
        at = b.confirmed(b.extend(b.null(), (0,)))
        place = int(np.flatnonzero(at.free == b.model.of_cause[0][0])[0])
        for p_value, found in ((0.0, inside), (1.0, plain)):
            sd = deviations(b, at, Misfit(p_value, 1.0, 1.0, {}))[place]
            found.append(abs(at.u[b.model.of_cause[0][0]] - 1.0) < 1.96 * sd)
    assert low <= np.mean(inside) <= (0.99 if draws > 100 else 1.0)
    assert np.mean(plain) < 0.8


def test_no_experiment_is_advised_that_would_not_settle_it():
    found = diagnose(measured(replace(ALIKE, proposals=ALIKE.proposals[:1]), {"delay.0": 2.0}, 0))
    assert found.verdict == "ambiguous"
    assert found.next_experiment is None


def test_where_all_that_is_wrong_has_a_name_the_next_experiment_shows_what_else_could_be_hidden():
    """Not another form of what was found: that the gain has another size is no news."""
    other = replace(cause("gain.as_square"), id="gain", variant="square")
    family = replace(
        FAMILY,
        conditions=grid((6.0, 7.0)),
        causes=(FRICTION, GAIN, other),
        effects=FAMILY.effects | {"gain.as_square.0": lambda s: (s["feed"] < 1.0) * BASIS[6]},
        proposals=tuple(Condition(f"feed {f:g}", {"feed": f, "direction": 1.0, "order": 9.0}) for f in (0.5, 8.0)),
    )
    found = diagnose(measured(family, {"gain.0": 2.0}, 1))
    assert (found.verdict, [c.id for c in found.causes]) == ("named", ["gain"])
    assert found.next_experiment.name == "feed 0.5"
    assert [r.title for r in found.next_experiment.reveals] == ["Friction"]


def test_where_nothing_is_wrong_the_next_experiment_is_the_one_that_shows_what_is_hidden():
    fast = replace(FAMILY, conditions=grid((6.0, 7.0)), causes=(FRICTION, GAIN))
    slow, faster = (Condition(f"feed {f:g}", {"feed": f, "direction": 1.0, "order": 9.0}) for f in (0.5, 8.0))
    found = diagnose(measured(replace(fast, proposals=(faster, slow)), {}, 0))
    assert found.verdict == "consistent"
    assert found.next_experiment.name == "feed 0.5"
    # One-sided; the nuisances are known from the other conditions and take next to nothing away.
    level = found.threshold + RULES.penalty
    g = (2 * np.exp(-12.0) + 2 * np.exp(-14.0) + np.exp(-1.0)) * float(BASIS[2] @ BASIS[2])
    size = 1e3 * sqrt(noncentrality(level, 1, True) / g)
    assert found.next_experiment.expected.endswith(f"Friction (friction.0) of {size:.2g} m")
    assert diagnose(measured(replace(fast, proposals=(faster,)), {}, 0)).next_experiment is None
    shown = diagnose(measured(replace(FAMILY, causes=(GAIN,), proposals=(faster, slow)), {}, 0))
    assert shown.verdict == "consistent"
    assert shown.next_experiment is None


def test_a_tangent_with_one_condition_more_is_that_of_all_of_them():
    """What a cause does only in the new one is found too; slopes in the others are not taken again."""
    late = replace(cause("late"), id="late")
    effects = FAMILY.effects | {"late.0": lambda s: (s["feed"] > 5.0) * BASIS[6]}
    family = measured(replace(FAMILY, causes=(*FAMILY.causes, late), effects=effects), {"gain.0": 1.0}, 3)
    new = Condition("feed 8 +1", {"feed": 8.0, "direction": 1.0, "order": 9.0})
    model = Model(family, (*family.conditions, new))
    few = Target({r: c.observed for r, c in enumerate(family.conditions)}, model.null())
    at, row = fit(model, few, (), model.null()), len(family.conditions)
    wider = Target({**few.observed, row: model.predict(row, at.u)}, model.null())
    slope = model.slopes([row], at.u, at.free)
    more = replace(at, residual={**at.residual, row: np.zeros(N)}, slope={**at.slope, **slope})
    direct = tangent(model, wider, more)
    found = widened(model, wider, more, tangent(model, few, at), row, range(4))
    assert [s.cause for s in found.signatures] == [s.cause for s in direct.signatures] == [0, 1, 2, 3]
    for one, other in zip(found.signatures, direct.signatures, strict=True):
        assert one.columns == pytest.approx(other.columns, abs=1e-9)


def test_what_never_acts_is_linearised_once_however_many_parameters_it_has():
    """A spindle that never turned has hundreds of springs: a column of every value for each held gigabytes."""
    still = Cause("still", "a spindle that stands", tuple(Parameter(f"still.{n}", "1", 0.0, 1.0) for n in range(50)))
    effects = FAMILY.effects | {p.name: lambda s: 0.0 * BASIS[0] for p in still.parameters}
    family = measured(replace(FAMILY, causes=(*FAMILY.causes, still), effects=effects), {}, 3)
    model = Model(family, family.conditions)
    target = Target({r: c.observed for r, c in enumerate(family.conditions)}, model.null())
    (one,) = tangent(model, target, fit(model, target, (), model.null()), [len(FAMILY.causes)]).signatures
    assert one.free.size == 50
    assert not np.any(one.columns)


def test_effects_that_undo_each_other_in_equal_steps_are_not_nothing():
    """Two parameters without slopes at their null, of which each shows what the other hides where both are as large."""

    @dataclass(frozen=True)
    class Opposed(Linear):
        def predict(self, condition, values):
            one, other = (values.get(f"two.{n}", 0.0) for n in (0, 1))
            return Linear.predict(self, condition, values) + (one**2 - other**2) * BASIS[4]

    family = measured(Opposed(FAMILY.conditions, (cause("two", 2),), {}), {}, 3)
    model = Model(family, family.conditions)
    target = Target({r: c.observed for r, c in enumerate(family.conditions)}, model.null())
    found = tangent(model, target, fit(model, target, (), model.null()), [0]).signatures
    assert any(np.any(s.columns) for s in found)


def test_the_misfit_is_that_of_the_whole_covariance():
    """Squares over ``I +- L L^T`` by its eigenvalues alone, with more rows than columns and with fewer."""
    rng = np.random.default_rng(1)
    for rows, columns in ((60, 9), (8, 30)):
        load = rng.standard_normal((rows, columns))
        load *= 0.9 / np.linalg.norm(load, 2)
        r = rng.standard_normal(rows)
        for sign, shrinks in ((-1.0, True), (1.0, False)):
            whole = np.eye(rows) + sign * load @ load.T
            found = assess([({0: r}, {0: load})], shrinks)
            assert found.chi2 == pytest.approx(r @ np.linalg.solve(whole, r), rel=1e-9)


def test_of_many_proposals_the_one_that_shows_what_is_hidden_is_found():
    fast = replace(FAMILY, conditions=grid((6.0, 7.0)), causes=(FRICTION, GAIN))
    feeds = (8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 0.5, 14.0)
    many = tuple(Condition(f"feed {f:g}", {"feed": f, "direction": 1.0, "order": 9.0}) for f in feeds)
    found = diagnose(measured(replace(fast, proposals=many), {}, 0))
    assert len(many) > RULES.proposals_tried
    assert found.next_experiment.name == "feed 0.5"


def test_the_probability_to_settle_is_what_a_simulation_finds():
    rng = np.random.default_rng(2)
    for d in (5.0, 12.0, 30.0):
        apart = np.zeros(40)
        apart[0] = sqrt(d)
        z = rng.standard_normal((20_000, 40))
        lead = np.sum((z + apart) ** 2, axis=1) - np.sum(z**2, axis=1)
        assert np.mean(lead > stats.chi2.ppf(0.99, 1)) == pytest.approx(probability_to_settle(d), abs=0.01)


@pytest.mark.parametrize("slopes", [True, False])
@pytest.mark.parametrize("size", [0.2, 1.0, 30.0])
def test_what_separates_two_hypotheses_is_what_least_squares_leave_of_one_in_the_other(size, slopes):
    """Of predictions with the new condition, priors centred on the truth; also where the rival was never linearised."""
    family = measured(NEARLY, {"slack.0": size}, 1)
    new = Condition("more", {"feed": 3.0, "direction": -1.0, "order": 5.0})
    model, row = Model(family, (*family.conditions, new)), len(family.conditions)
    target = Target({r: c.observed for r, c in enumerate(family.conditions)}, model.null())
    truth, rival = (fit(model, target, (k,), model.null()) for k in (0, 1))
    found = discrimination(model, target, truth, rival if slopes else replace(rival, slope={}), [row])
    by_rival = model.slopes(range(row + 1), truth.u, rival.free)
    a = np.concatenate([*by_rival.values(), np.diag(model.weight[rival.free])])
    start = np.where(np.isin(rival.free, truth.free), truth.u[rival.free], 0.0)
    zero = np.zeros(truth.u.size)
    seen = np.concatenate(
        [*(model.predict(r, truth.u) - model.predict(r, zero) for r in by_rival), model.weight[rival.free] * start]
    )
    left = seen - a @ np.linalg.lstsq(a, seen)[0]
    assert found.converged
    assert found.chi2 == pytest.approx(float(left @ left), abs=RULES.tolerance)
    new_alone = float(np.sum(left[row * N : (row + 1) * N] ** 2))
    assert float(np.sum(found.residual[row] ** 2)) == pytest.approx(new_alone, rel=1e-3, abs=0.5 * RULES.tolerance)


@pytest.mark.parametrize(("draws", "least"), [(2, 2), pytest.param(10, 9, marks=pytest.mark.slow)])
def test_effects_that_mask_each_other_are_both_found(draws, least):
    # Friction and feed-through nearly cancel: each alone explains next to nothing.
    near = replace(
        FAMILY,
        causes=(cause("friction"), cause("opposite"), GAIN),
        effects={
            "friction.0": lambda s: s["feed"] * BASIS[4],
            "opposite.0": lambda s: s["feed"] * BASIS[4] + 0.3 * s["direction"] * BASIS[5],
            "gain.0": FAMILY.effects["gain.0"],
        },
    )
    found = 0
    for seed in range(draws):
        b = bench(measured(near, {"friction.0": -2.5, "opposite.0": 2.5}, seed))
        assert b.null().chi2 - b.extend(b.null(), (0,)).chi2 < 15.0
        finding = diagnose(measured(near, {"friction.0": -2.5, "opposite.0": 2.5}, seed))
        found += {c.id for c in finding.causes} == {"friction", "opposite"}
    assert found >= least


@pytest.mark.parametrize("draws", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_permuted_labels_give_no_gain(draws):
    gains = []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        family = measured(FAMILY, {"both.0": 1.0}, seed)
        labels = rng.permutation(6)
        family = replace(
            family,
            conditions=tuple(
                replace(c, settings=family.conditions[j].settings)
                for c, j in zip(family.conditions, labels, strict=True)
            ),
            nuisances=tuple(replace(p, prior=np.inf) for p in FAMILY.nuisances),
        )
        # What is left to the labels: the mean over the conditions is taken away.
        mean = np.mean([c.observed for c in family.conditions], axis=0)
        centred = {k: (lambda s, e=e: e(s) - e({"feed": 2.0, "direction": 0.0})) for k, e in FAMILY.effects.items()}
        conditions = tuple(replace(c, observed=c.observed - mean) for c in family.conditions)
        b = bench(replace(family, conditions=conditions, effects=centred))
        gains.append(b.gain(b.null(), b.extend(b.null(), (2,))).db)
    assert np.median(gains) <= 0.3


def test_parameters_that_differ_between_sources_name_nothing():
    family = replace(FAMILY, effects=FAMILY.effects | {"gain.0": lambda s: BASIS[3]})
    same, other = measured(family, {"gain.0": 1.0}, 0), measured(family, {"gain.0": 3.0}, 1)
    mixed = tuple(a if a.source == "a" else b for a, b in zip(same.conditions, other.conditions, strict=True))
    assert diagnose(same).verdict == "named"
    assert diagnose(replace(family, conditions=mixed)).verdict == "unknown"


def test_what_contradicts_itself_is_refused():
    family = measured(FAMILY, {}, 0)
    with pytest.raises(InputError, match="cannot be held out"):
        diagnose(family, held_out=("never measured",))
    with pytest.raises(InputError, match="same cause name 'gain'"):
        diagnose(replace(family, causes=(GAIN, replace(GAIN, parameters=(Parameter("b", "", 0.0, 1.0),)))))
    with pytest.raises(InputError, match="in the form of its data"):
        diagnose(replace(family, conditions=(replace(family.conditions[0], observed=np.zeros(3)),)))
    with pytest.raises(InputError, match="not finite"):
        diagnose(replace(family, conditions=(replace(family.conditions[0], observed=np.full(N, np.nan)),)))
    assert diagnose(replace(family, conditions=())).verdict == "insufficient_data"


def test_a_cause_that_is_never_held_out_is_not_named():
    one = replace(FAMILY, conditions=FAMILY.conditions[:1])
    found = diagnose(measured(one, {"both.0": 5.0}, 0))
    assert found.verdict == "insufficient_data"
    assert "no condition can be held out" in found.reason


CREEPING = replace(
    FAMILY,
    conditions=tuple(
        Condition(f"run {k}", {"feed": 1.0 + k % 3, "direction": (-1.0) ** (k // 3), "order": k}) for k in range(24)
    ),
    effects=FAMILY.effects | {"creep": lambda s: (s["order"] - 11.5) * BASIS[0]},
)
"""What the catalogue does not have: an offset that creeps in time."""


@pytest.mark.parametrize("draws", [30, pytest.param(150, marks=pytest.mark.slow)])
@pytest.mark.parametrize("alarms", [0.05, 0.2])
def test_noise_alone_is_beyond_the_threshold_as_often_as_it_should(alarms, draws):
    seen = 0
    for seed in range(draws):
        b = bench(measured(FAMILY, {}, 1000 + seed))
        seen += most_changing(b.model, b.tangent(b.null()), np.random.default_rng(0), alarms).certain
    assert abs(seen / draws - alarms) < 3.0 * sqrt(alarms * (1.0 - alarms) / draws)


def test_an_offset_that_creeps_is_unknown_though_no_condition_shows_it():
    family = measured(CREEPING, {"creep": 0.04}, 3)
    b = bench(family)
    assert b.misfit(b.null()).p_value > 0.002
    found = changing(b, b.null())
    assert (found.parameter, found.setting) == ("offset", "order")
    # 0.04^2 times 24 values times the sum of (order - 11.5)^2, which nothing else imitates.
    size = 0.04 * sqrt(N * 1150.0)
    assert (size - 3.0) ** 2 < found.ratio < (size + 3.0) ** 2
    finding = diagnose(family)
    assert finding.verdict == "unknown"
    assert finding.reason.startswith("offset changes with order")


def test_what_creeps_beyond_all_noise_is_still_said_to_creep():
    """Ten times as much appears in the misfit alone, which says that something is wrong, but not what."""
    finding = diagnose(measured(CREEPING, {"creep": 0.4}, 3))
    assert finding.verdict == "unknown"
    assert finding.remainder is not None
    assert finding.reason.endswith("what differs most between the conditions is offset, with order")


def test_the_catalogue_goes_first():
    assert diagnose(measured(CREEPING, {"gain.0": 0.8}, 3)).verdict == "named"


def test_words_are_told_apart_and_one_value_contrasts_nothing():
    named = replace(
        FAMILY,
        conditions=tuple(
            replace(c, settings={"controller": "hard" if c.settings["direction"] > 0 else "soft", "feed": 1.0})
            for c in FAMILY.conditions
        ),
        causes=(),
        effects={"softer": lambda s: (s["controller"] == "soft") * BASIS[1]},
    )
    b = bench(measured(named, {"softer": 3.0}, 0))
    found = changing(b, b.null())
    assert (found.parameter, found.setting, found.certain) == ("slope", "controller", True)
    alone = replace(named, conditions=tuple(replace(c, settings={"feed": 1.0}) for c in named.conditions))
    b = bench(measured(replace(alone, effects={}), {}, 0))
    assert changing(b, b.null()) is None


def test_a_cause_on_its_limit_gives_way_to_another_that_does_as_much_within():
    """Both have the same pattern, 1.6 times of which the data have; one of them is physical up to 1.5 only."""

    def pattern(settings):
        return settings["feed"] * BASIS[3]

    causes, effects = (cause("bound", high=1.5), cause("free")), {"bound.0": pattern, "free.0": pattern}
    found = bench(measured(Linear(grid(), causes, effects), {"free.0": 1.6}, 1))
    assert found.extend(found.null(), (0,)).u[found.model.of_cause[0]] == 1.5
    at, steps = search(found, begin=(0,))
    assert at.causes == (1,)
    assert [s.change for s in steps] == ["- bound", "+ free"]
    assert "limit of what is physical" in steps[0].reason


def test_a_misfit_is_the_same_where_divide_and_conquer_gives_up(monkeypatch):
    rng = np.random.default_rng(8)
    load = {r: x for r, x in enumerate(np.split(np.linalg.qr(rng.standard_normal((100, 4)))[0], 2))}
    residual = dict(enumerate(rng.standard_normal((2, 50))))
    expected = assess([(residual, load)], shrinks=True)

    def gives_up(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(np.linalg, "svd", gives_up)
    found = assess([(residual, load)], shrinks=True)
    assert found.chi2 == pytest.approx(expected.chi2, rel=1e-9)
    assert found.p_value == pytest.approx(expected.p_value, rel=1e-6)
