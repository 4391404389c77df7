"""What conditions explain of the differences between measurements; p values and assurance figures."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from process.errors import InputError
from process.labels import make_compliance
from smfe.comparison.compare import compare, scale_factor
from smfe.comparison.explained import JOINT, Design, explain, holm, judge, tracks
from smfe.comparison.peaks import Peak, find_peaks

GRID = np.arange(15.0, 60.0, 0.25)


def measurement(natural, damping, level, seed, method="hammer", **conditions):
    """One mode, written out in mass, damping and stiffness, with noise of `level` of its peak."""
    w, wn = 2.0 * np.pi * GRID, 2.0 * np.pi * natural
    clean = 1.0 / (20e6 - 20e6 * (w / wn) ** 2 + 2j * damping * 20e6 * w / wn)
    s = level * np.abs(clean).max()
    rng = np.random.default_rng(seed)
    values = clean + s / np.sqrt(2.0) * (rng.standard_normal(GRID.size) + 1j * rng.standard_normal(GRID.size))
    std = (("frequency", "response", "excitation"), np.full((GRID.size, 1, 1), s))
    attrs = {"method": method, "conditions": json.dumps(conditions)}
    return make_compliance(GRID, values[:, None, None], "x", "x", {"compliance_std": std}, attrs)


def balanced(seed, by_feed=0.94, by_controller=1.03, level=0.01):
    """Feed and controller changed independently of each other: effects on frequency multiply."""
    out = {}
    for i, feed in enumerate(("0 mm/min", "500 mm/min")):
        for j, controller in enumerate(("K1", "K2")):
            for k in range(2):
                natural = 30.0 * by_feed**i * by_controller**j
                number = 100 * seed + 10 * i + 3 * j + k
                out[f"{i}{j}{k}"] = measurement(natural, 0.03, level, number, feed=feed, controller=controller)
    return out


def test_each_factor_is_given_what_it_does():
    """6 % by feed, 3 % by controller: both found, each with its size and an interval that holds it."""
    table = explain(balanced(1))
    found = table[table["quantity"] == "frequency"].set_index("factor")
    assert set(found.index) == {"feed", "controller", "controller x feed"}
    assert not found.loc["controller x feed", "significant"]
    for factor, truth in (("feed", 100.0 * (1.0 / 0.94 - 1.0)), ("controller", 3.0)):
        row = found.loc[factor]
        assert row["significant"]
        assert row["effect_percent"] == pytest.approx(truth, abs=0.15)
        assert row["effect_low_percent"] - 0.05 < truth < row["effect_high_percent"] + 0.05
    assert (found.loc["feed", "lowest"], found.loc["feed", "highest"]) == ("500 mm/min", "0 mm/min")
    # Balanced but for slightly different errors: the shares add up to nearly all.
    assert found["explained_percent"].sum() == pytest.approx(100.0, abs=1.5)
    assert found.loc["feed", "explained_percent"] == pytest.approx(
        100.0 * np.log(0.94) ** 2 / (np.log(0.94) ** 2 + np.log(1.03) ** 2), abs=1.5
    )


CAMPAIGNS = pytest.mark.parametrize("campaigns", [6, pytest.param(20, marks=pytest.mark.slow)])


@CAMPAIGNS
def test_what_does_nothing_is_not_significant(campaigns):
    """Damping and amplitude do not depend on the controller: over 20 campaigns no more than a few false alarms."""
    alarms, p = 0, []
    for seed in range(campaigns):
        table = explain(balanced(seed, by_feed=1.0, by_controller=1.0))
        alarms += int(table["significant"].sum())
        p += table["p"].tolist()
    assert alarms <= (3 if campaigns == 20 else 2)  # 5 % of the families, and their scatter
    assert stats.kstest(p, "uniform").pvalue > 0.001  # p values are what they claim


@CAMPAIGNS
def test_joint_tests_and_interactions_claim_no_more_than_they_should(campaigns):
    """Additive machines with effects of both factors: p of the interaction, and of what is tested jointly."""
    alone, jointly = [], []
    for seed in range(campaigns):
        table = explain(balanced(300 + seed))
        product = table[table["factor"] == "controller x feed"]
        assert len(product) == 4  # frequency, damping, amplitude, and all three
        alone += product.loc[product["quantity"] != JOINT, "p"].tolist()
        jointly += product.loc[product["quantity"] == JOINT, "p"].tolist()
        assert table.loc[(table["quantity"] == JOINT) & (table["factor"] == "feed"), "significant"].all()
    assert stats.kstest(alone, "uniform").pvalue > 0.001
    assert stats.kstest(jointly, "uniform").pvalue > 0.001
    assert np.median(jointly) > 0.2


@pytest.mark.parametrize("by", [0.94, 0.995])
def test_a_feed_that_acts_with_one_controller_only_is_found(by):
    """With K1 the feed does nothing, with K2 it takes 6 % (or 0.5 %) off the frequency: that is the interaction."""
    runs = {}
    for i, feed in enumerate(("0 mm/min", "500 mm/min")):
        for j, controller in enumerate(("K1", "K2")):
            for k in range(2):
                natural = 30.0 * (by if i and j else 1.0)
                runs[f"{i}{j}{k}"] = measurement(
                    natural, 0.03, 0.01, 40 + 10 * i + 3 * j + k, feed=feed, controller=controller
                )
    table = explain(runs)
    row = table[(table["quantity"] == "frequency") & (table["factor"] == "controller x feed")].iloc[0]
    assert row["significant"]
    assert row["p_family"] < 1e-3
    truth = 100.0 * (by - 1.0)
    assert row["effect_percent"] == pytest.approx(truth, abs=0.2)
    assert row["effect_low_percent"] - 0.1 < truth < row["effect_high_percent"] + 0.1
    assert (row["lowest"], row["highest"]) == ("controller at 0 mm/min", "controller at 500 mm/min")
    joint = table[(table["quantity"] == JOINT) & (table["factor"] == "controller x feed")].iloc[0]
    assert joint["significant"]


def test_without_every_combination_there_is_no_interaction_to_judge():
    """Three of four combinations: the product of both factors is not in the design."""
    design = Design({"feed": ("0", "5", "0"), "controller": ("a", "a", "b")})
    assert design.interactions() == []
    whole = Design({"feed": ("0", "5", "0", "5"), "controller": ("a", "a", "b", "b")})
    assert [product.name for product in whole.interactions()] == ["feed x controller"]


def test_the_joint_test_against_its_closed_form():
    """Two measurements, three quantities, correlated errors: d' (S_a + S_b)^-1 d, chi^2 with three degrees."""
    rng = np.random.default_rng(4)
    roots = rng.standard_normal((2, 3, 3))
    errors = roots @ roots.transpose(0, 2, 1)
    value = rng.standard_normal((2, 3))
    (row,) = judge(Design({"feed": ("0", "5")}), value, errors)
    d = value[1] - value[0]
    assert row["statistic"] == pytest.approx(d @ np.linalg.solve(errors.sum(axis=0), d))
    assert row["p"] == pytest.approx(stats.chi2.sf(row["statistic"], 3))
    assert row["degrees_of_freedom"] == 3


@pytest.mark.parametrize(("seeds", "within"), [(60, 0.4), pytest.param(200, 0.15, marks=pytest.mark.slow)])
def test_errors_of_a_peak_are_related_as_they_scatter(seeds, within):
    """2 % noise: damping and amplitude err against each other, as strongly as the fit says.

    60 seeds know a correlation to 0.13, and three of these are allowed.
    """
    found = [
        find_peaks(GRID, d["compliance"].values.ravel(), d["compliance_std"].values.ravel())[0]
        for d in (measurement(30.0, 0.03, 0.02, 1000 + seed) for seed in range(seeds))
    ]
    columns = np.array([[p.frequency, p.damping, p.amplitude] for p in found])
    seen = np.corrcoef(columns.T)
    said = np.mean([p.correlation for p in found], axis=0)
    assert said == pytest.approx([seen[0, 1], seen[0, 2], seen[1, 2]], abs=within)
    assert said[2] < -0.5


def test_factors_that_change_together_are_one_term():
    """Method and level always change together: one row for both, with no effect ascribed to either."""
    runs = {
        "a": measurement(30.0, 0.03, 0.01, 1, "hammer", force_level="25 N", feed="0 mm/min"),
        "b": measurement(30.0, 0.03, 0.01, 2, "hammer", force_level="25 N", feed="500 mm/min"),
        "c": measurement(28.0, 0.03, 0.01, 3, "sweep", depth_of_cut="2 mm", feed="0 mm/min"),
        "d": measurement(28.0, 0.03, 0.01, 4, "sweep", depth_of_cut="2 mm", feed="500 mm/min"),
    }
    table = explain(runs)
    found = table[table["quantity"] == "frequency"].set_index("factor")
    assert set(found.index) == {"method + level", "feed", "method + level x feed"}
    assert not found.loc["method + level x feed", "significant"]
    assert found.loc["method + level", "aliased_with"] == "method + level"
    assert np.isnan(found.loc["method + level", "effect_percent"])
    assert found.loc["method + level", "significant"]
    assert not found.loc["feed", "significant"]


def test_a_full_design_is_one_term_and_one_repeat_separates_it():
    """Two measurements, two factors: one term. Aliased sets are the smallest that hold each other."""
    both = Design({"feed": ("0", "5"), "controller": ("a", "b")})
    assert both.terms() == [("feed", "controller")]
    more = Design({"feed": ("0", "5", "0"), "controller": ("a", "b", "b"), "method": ("h", "h", "s")})
    # feed = 1 - ... the three columns and the mean have rank three: each is held by the other two.
    assert more.terms() == [("feed", "controller", "method")]
    third = Design({"feed": ("0", "5", "0", "5"), "controller": ("a", "a", "b", "b"), "method": ("h", "h", "s", "s")})
    assert third.terms() == [("feed",), ("controller", "method")]


def test_an_f_test_against_its_closed_form():
    """One factor, two categories, equal errors that are too small: F is the square of the t of two samples."""
    rng = np.random.default_rng(2)
    value = np.concatenate([rng.normal(0.0, 0.1, 6), rng.normal(0.15, 0.1, 6)])
    design = Design({"feed": ("0",) * 6 + ("5",) * 6})
    (row,) = judge(design, value, np.full(12, 1e-3))
    t = stats.ttest_ind(value[:6], value[6:])
    assert row["test"] == "F"
    assert row["statistic"] == pytest.approx(t.statistic**2)
    assert row["p"] == pytest.approx(t.pvalue)
    (known,) = judge(design, value, np.full(12, 10.0))
    assert known["test"] == "chi2"
    assert known["statistic"] == pytest.approx((value[:6].mean() - value[6:].mean()) ** 2 * 3.0 / 100.0)


def test_renaming_categories_and_reordering_measurements_change_nothing():
    runs = balanced(3)
    first = explain(runs)
    back = explain(dict(reversed(runs.items())))
    columns = ["factor", "quantity", "statistic", "effect_percent", "p"]
    pd.testing.assert_frame_equal(
        first[columns].sort_values(["quantity", "factor"], ignore_index=True),
        back[columns].sort_values(["quantity", "factor"], ignore_index=True),
    )
    for dataset in runs.values():
        conditions = json.loads(dataset.attrs["conditions"])
        conditions["controller"] = {"K1": "zeta", "K2": "alpha"}[conditions["controller"]]
        dataset.attrs["conditions"] = json.dumps(conditions)
    renamed = explain(runs)
    np.testing.assert_allclose(renamed["statistic"], first["statistic"], rtol=1e-7)


def test_peaks_are_followed_through_measurements():
    def peak(frequency):
        return Peak(frequency, 0.01, 0.03, 0.001, 1e-6, 1e-8, 1.0)

    found = tracks({"a": [peak(24.0), peak(34.0)], "b": [peak(25.0)], "c": [peak(33.0), peak(24.5), peak(80.0)]})
    assert [sorted(t) for t in found] == [["a", "b", "c"], ["a", "c"], ["c"]]


def test_nothing_varies_nothing_is_explained():
    one = measurement(30.0, 0.03, 0.01, 1, feed="0 mm/min")
    assert explain({"a": one}).empty
    assert explain({"a": one, "b": one}).empty
    assert "p_family" in explain({}).columns


def test_conditions_that_cannot_be_read_are_refused() -> None:
    broken = measurement(30.0, 0.03, 0.01, 1).assign_attrs(conditions="K2")
    with pytest.raises(InputError, match="no JSON object"):
        explain({"a": broken})


def test_holm_against_its_definition():
    p = np.array([0.01, 0.04, np.nan, 0.03, 0.005])
    assert holm(p)[[4, 0, 3, 1]].tolist() == pytest.approx([0.02, 0.03, 0.06, 0.06])
    assert np.isnan(holm(p)[2])
    assert holm(np.array([])).size == 0


def test_differences_carry_p_values_of_their_family():
    table = compare({"a": measurement(30.0, 0.03, 0.01, 1), "b": measurement(30.3, 0.03, 0.01, 2)})
    row = table.iloc[0]
    z = row["frequency_difference_percent"] / row["frequency_difference_std_percent"]
    assert row["frequency_p"] == pytest.approx(2.0 * stats.norm.sf(abs(z)))
    assert row["frequency_p_family"] == pytest.approx(3.0 * row["frequency_p"])
    assert row["frequency_interval_low_percent"] < 1.0 < row["frequency_interval_high_percent"]
    assert row["damping_p_family"] >= row["damping_p"]
    same = compare({"a": measurement(30.0, 0.03, 0.01, 1), "b": measurement(30.0, 0.03, 0.01, 1)}).iloc[0]
    assert same["frequency_p"] == 1.0


@pytest.mark.parametrize("factor", [0.5, 1.0, 3.0])
def test_the_scale_factor_sees_what_frac_does_not(factor):
    h = measurement(30.0, 0.03, 0.0, 1)["compliance"].values.ravel()
    assert scale_factor(GRID, h, GRID, factor * h) == pytest.approx(2.0 * factor / (1.0 + factor**2))
