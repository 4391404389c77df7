"""Stability limits: lobes against a second method and against integration in time; what is hidden is named."""

import math
from dataclasses import replace

import numpy as np
import pytest
from exam.limits import RATIO, SLOT, SPEEDS, family, known, worn
from truth.milling_limits import Found, Mill, limit

from process.cut.engagement import Engagement
from process.cut.force import CuttingCoefficients, ProcessDamping
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.modes import ModalModel
from smfe.diagnosis.cutting import converged
from smfe.diagnosis.cutting.converged import PeriodicCut
from smfe.diagnosis.cutting.limits import CuttingLimits, KnownLimit, Limit, Trial, bracketed, limit_family
from smfe.diagnosis.cutting.rules import RULES
from smfe.diagnosis.judgement.diagnose import diagnose
from stability.methods.dense_problem import Dense
from stability.methods.semi_discretization import limit_depth
from stability.methods.zero_order_scan import loop_of, modal_crossings
from stability.problem import Cut

RAM = ModalModel(
    [62.0, 85.0, 140.0], [0.03, 0.04, 0.03], [2e7, 3e7, 6e7], [[1.0, 0.2, 0.1], [-0.3, 1.0, 0.0], [0.1, 0.1, 1.0]]
)
STEEL = CuttingCoefficients(1.8e9, 0.7e9, 0.25e9)


def start(found: CuttingLimits) -> dict[str, float]:
    return {p.name: p.start for p in (*found.nuisances, *(p for c in found.causes for p in c.parameters))}


def as_machine(mill: Mill) -> ModalModel:
    m = mill.modes
    return ModalModel(m.frequency, m.damping, m.stiffness, [(*d, 0.0) for d in m.direction])


# --- the independent generator ----------------------------------------------------------------------------------------


CONVERGED = [
    (mill, speed) for mill in (Mill(), SLOT, Mill(entry=0.3 * math.pi)) for speed in (330.0, 220.0, 600.0, 850.0)
]


@pytest.mark.parametrize(
    ("mill", "speed"), [CONVERGED[0], *(pytest.param(*c, marks=pytest.mark.slow) for c in CONVERGED[1:])]
)
def test_integration_in_time_finds_the_converged_limit(mill: Mill, speed: float) -> None:
    tool, arc = Tool(mill.diameter, mill.teeth), Engagement(mill.entry, mill.leave)
    found = limit_depth(as_machine(mill), tool, arc, CuttingCoefficients(mill.kt, mill.kr, 0.0), speed)
    depth, frequency = limit(mill, speed)
    assert depth * 1e3 == pytest.approx(found.limit_depth_mm, rel=0.02)
    assert frequency == pytest.approx(found.chatter_frequency_Hz, rel=0.005)


@pytest.mark.slow
def test_integration_in_time_with_a_worn_flank() -> None:
    # A slot of four teeth has constant coefficients: zero order is exact, damping and all.
    machine, tool, arc = as_machine(SLOT), Tool(SLOT.diameter, 4), Engagement(0.0, math.pi)
    material = CuttingCoefficients(SLOT.kt, SLOT.kr, 0.0)
    for n in (150.0, 330.0):
        exact = modal_crossings(machine, loop_of(tool, arc, material, n, ProcessDamping(worn())))[0][0]
        assert limit(replace(SLOT, flank=worn()), n)[0] == pytest.approx(exact, rel=0.01)
    sharp, dull = limit(SLOT, 150.0)[0], limit(replace(SLOT, flank=worn()), 150.0)[0]
    assert dull / sharp == pytest.approx(1.2, abs=0.01)


# --- the family -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def plain() -> CuttingLimits:
    """Limits that the baseline itself predicts, with one arc that needs a correction."""
    found = [Found(n, 1e-4, 1e-3, 1.04e-3, 66.0) for n in SPEEDS[5:7]]
    return known(Mill(entry=0.3 * math.pi), found)


def test_every_cause_at_its_null_value_leaves_the_baseline(plain: CuttingLimits) -> None:
    nuisances = {p.name: p.start for p in plain.nuisances}
    for condition in (*plain.conditions, *plain.proposals):
        expected = plain.predict(condition, nuisances)
        for cause in plain.causes:
            null = {p.name: p.start for p in cause.parameters}
            np.testing.assert_allclose(plain.predict(condition, nuisances | null), expected, rtol=1e-10)


def test_every_cause_changes_something_a_little_when_its_size_is_small(plain: CuttingLimits) -> None:
    values = start(plain)
    before = np.concatenate([plain.predict(c, values) for c in plain.conditions])
    for cause in plain.causes:
        for share in (1e-3, 1.0):
            p = cause.parameters[0]
            changed = values | {p.name: p.start + share * p.scale}
            after = np.concatenate([plain.predict(c, changed) for c in plain.conditions])
            change = float(np.abs(after - before).max())
            assert 1e-6 < change < 60.0 if share == 1.0 else change < 0.1, cause.key


def test_the_baseline_is_the_converged_limit(plain: CuttingLimits) -> None:
    mill = Mill(entry=0.3 * math.pi)
    tool, arc = Tool(mill.diameter, mill.teeth), Engagement(mill.entry, mill.leave)
    for condition in plain.conditions:
        found = limit_depth(
            plain.machine, tool, arc, plain.coefficients, float(condition.settings["spindle_speed"])
        ).limit_depth_mm
        ratio = plain.predict(condition, start(plain))[0] / condition.observed[0]
        assert ratio * math.log(math.sqrt(1.04) * 1e-3) == pytest.approx(math.log(found * 1e-3), rel=1e-9)


def test_a_limit_that_zero_order_does_not_describe_is_the_converged_one() -> None:
    """Two teeth at half immersion: the converged limit is half of that of zero order, at another chatter frequency."""
    mill = Mill(teeth=2)
    few = known(mill, [Found(1100.0, 1e-4, 1e-3, 1.04e-3, 66.0)], [])
    (condition,) = few.conditions
    assert condition.data.periodic
    assert few.roughly() == []
    assert condition.observed.size == 2
    tool, arc = Tool(mill.diameter, mill.teeth), Engagement(mill.entry, mill.leave)
    values = start(few) | {"frequency_1": 0.01, "stiffness_2": -0.1, "coefficients": 0.2, "process_damping": 2e4}
    worn_flank = ProcessDamping(2e4, RULES.flank_friction)
    found = limit_depth(
        few.changed(values, condition.data.limit), tool, arc, few.material(values), 1100.0, process_damping=worn_flank
    )
    assert few.depth(condition, values) * 1e3 == pytest.approx(found.limit_depth_mm, rel=1e-3)


def test_slopes_of_a_converged_limit_are_its_differences() -> None:
    few = known(Mill(teeth=2), [Found(n, 1e-4, 1e-3, 1.04e-3, 66.0) for n in (1100.0, 700.0)], [])
    parameters = [*few.nuisances, *(p for c in few.causes for p in c.parameters)]
    for worn_flank in (0.0, 2e4):
        values = start(few) | {"mode_compliance": 1e-9, "micro_slip_1": 0.05, "process_damping": worn_flank}
        slopes = few.slopes(few.conditions, values, parameters)
        assert slopes is not None
        for condition, found in zip(few.conditions, slopes, strict=True):
            for p, slope in zip(parameters, found.T, strict=True):
                h, least = 1e-3 * p.scale, -1e-3 * p.scale if values[p.name] > p.low else 0.0
                up, down = (few.predict(condition, values | {p.name: values[p.name] + x}) for x in (h, least))
                np.testing.assert_allclose(
                    slope, p.scale * (up - down) / (h - least), rtol=0.01, atol=1e-2, err_msg=p.name
                )


def test_a_line_a_tooth_passing_beside_the_largest_may_be_the_one_observed() -> None:
    """Lines of a periodic cut lie a tooth passing apart: one of them that is nearly as large is no other limit."""
    mill = Mill(teeth=2)
    few = known(mill, [Found(1100.0, 1e-4, 1e-3, 1.04e-3, 66.0)], [])
    cut = PeriodicCut.of(few.machine, Cut(few.tool, few.arc, few.coefficients), 1100.0)
    at = cut.crossings(0.1)[0]
    turns, size = cut.lines(at, cut.chips(at))
    two = np.argsort(-size)[:2]
    assert abs(turns[two[0]] - turns[two[1]]) == pytest.approx(1.0)
    for n in two:
        assert cut.observed([at], abs(turns[n]) / cut.period) == (at, turns[n])


@pytest.mark.parametrize("helix", [0.0, math.radians(30.0)])
def test_with_a_helix_such_a_limit_counts_roughly(helix: float) -> None:
    tool, arc = Tool(0.08, 2, helix_angle=helix), Engagement(0.5 * math.pi, math.pi)
    found = limit_family([Limit(1100.0, 1e-3, frequency=66.0)], as_machine(Mill()), tool, arc, STEEL)
    assert [name for name, std in found.roughly() if std > RULES.roughly] == [c.name for c in found.conditions if helix]
    slot = known(SLOT, [Found(600.0, 1e-4, 1e-3, 1.04e-3, 66.0)], [])
    assert slot.roughly() == []
    assert slot.squared_size(slot.conditions[0], np.array([1.0, 0.0])) < 0.03**2


def test_a_chatter_of_another_mode_is_that_of_another_crossing() -> None:
    """A worn flank keeps one mode quiet: the model has its limit too low, and not its frequency 30 % off."""
    crossings = np.array([10.6e-3, 18.8e-3]), np.array([452.0, 320.0])
    seen, beside, first = (KnownLimit(Limit(1380.0, 16.7e-3, 0.01, f), 1.0, 1.0) for f in (316.0, 445.0, 452.0))
    std = seen.std()
    depth, frequency = (seen.predicted(*crossings) - seen.measured()) * std
    assert depth == pytest.approx(math.log(10.6 / 16.7))
    assert frequency == pytest.approx(4.0)
    assert (beside.predicted(*crossings) - beside.measured())[1] * beside.std()[1] == pytest.approx(7.0)
    assert (first.predicted(*crossings) - first.measured())[1] == pytest.approx(0.0)


def test_depth_goes_with_one_over_the_coefficients_and_nothing_else(plain: CuttingLimits) -> None:
    values = start(plain)
    for condition in plain.conditions:
        one = plain.limits_at(condition.data.limit, values)
        other = plain.limits_at(condition.data.limit, values | {"coefficients": 0.25})
        np.testing.assert_allclose(other[0] * 1.25, one[0], rtol=1e-9)
        np.testing.assert_allclose(other[1], one[1], rtol=1e-9)


def test_the_compliance_of_all_modes_and_the_coefficients_are_one_number(plain: CuttingLimits) -> None:
    """Limits go with one over coefficients times compliance: no speed, feed or frequency tells one from the other."""
    both = [p for p in plain.nuisances if p.name in ("scale_error", "coefficients")]
    slopes = plain.slopes(plain.conditions, start(plain), both)
    assert slopes is not None
    for condition, found in zip(plain.conditions, slopes, strict=True):
        scale, coefficients = (found / [p.scale for p in both]).T
        np.testing.assert_allclose(scale, -coefficients, rtol=1e-5, atol=1e-5)
        assert scale[0] * condition.data.std()[0] == pytest.approx(1.0, rel=1e-4)
    assert {p.given for p in both} == {"modal_scale", "force_coefficients"}
    assert not any(p.nameless for p in both)


@pytest.mark.parametrize("law", ["linear", "square"])
def test_bearings_that_soften_leave_the_mass_what_it_is(plain: CuttingLimits, law: str) -> None:
    values = start(plain) | {f"{law}_1": -0.1}
    fast, slow = (plain.changed(values, Limit(n)) for n in (SPEEDS[6], 1e-3))
    mass = [m.stiffness / m.frequency**2 for m in (fast, slow)]
    np.testing.assert_allclose(mass[0], mass[1], rtol=1e-9)
    assert fast.frequency[0] / slow.frequency[0] == pytest.approx(0.9, rel=1e-6)


def test_slopes_of_a_crossing_are_the_differences_of_its_limits(plain: CuttingLimits) -> None:
    parameters = [*plain.nuisances, *(p for c in plain.causes for p in c.parameters)]
    values = start(plain) | {"mode_compliance": 1e-9, "process_damping": 2e4, "micro_slip_1": 0.05, "coefficients": 0.1}
    slopes = plain.slopes(plain.conditions, values, parameters)
    assert slopes is not None
    for condition, found in zip(plain.conditions, slopes, strict=True):
        for p, slope in zip(parameters, found.T, strict=True):
            h, least = 0.01 * p.scale, -0.01 * p.scale if values[p.name] > p.low else 0.0
            up, down = (plain.predict(condition, values | {p.name: values[p.name] + x}) for x in (h, least))
            np.testing.assert_allclose(slope, p.scale * (up - down) / (h - least), rtol=0.01, atol=1e-2, err_msg=p.name)


def test_what_is_not_physics_is_refused(plain: CuttingLimits) -> None:
    bounds = {p.name: (p.low, p.high) for c in plain.causes for p in c.parameters}
    assert bounds["process_damping"][0] == 0.0
    assert bounds["mode_compliance"][0] == 0.0
    assert bounds["mode_damping"][0] > 0.0
    assert bounds["micro_slip_1"] == (0.0, 0.8)
    assert all(p.low > -1.0 for p in plain.nuisances)


def test_brackets_become_limits_and_the_rest_is_said() -> None:
    trials = [
        Trial(300.0, 1.0e-3, False),
        Trial(300.0, 1.1e-3, True, 66.0),
        Trial(300.0, 1.3e-3, True, 67.0),
        Trial(400.0, 2.0e-3, False),
        Trial(500.0, 1.0e-3, True, 80.0),
        Trial(600.0, 2.0e-3, False),
        Trial(600.0, 1.0e-3, True),
    ]
    limits, notes = bracketed(trials)
    assert [v.spindle_speed for v in limits] == [300.0]
    assert limits[0].depth == pytest.approx(math.sqrt(1.1) * 1e-3)
    assert limits[0].depth_std == pytest.approx(math.log(1.1) / math.sqrt(12.0))
    assert limits[0].frequency == 66.0
    read = [Trial(300.0, 1.0e-3, False), Trial(300.0, 1.1e-3, True, 66.0, 0.07)]
    assert bracketed(read)[0][0].frequency_std == 0.07
    assert "400 rpm every cut was stable" in notes[0]
    assert "500 rpm every cut chattered" in notes[1]
    assert "no limit there" in notes[2]
    with pytest.raises(InputError, match="not positive"):
        bracketed([Trial(300.0, 0.0, True)])


def test_the_first_crossing_is_found_where_all_are_far_deeper_than_what_was_measured(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a machine ten times as stiff limits are ten times as deep: no search over all angles is needed for that."""
    mill = Mill(teeth=2)
    cut = Cut(Tool(mill.diameter, mill.teeth), Engagement(mill.entry, mill.leave), CuttingCoefficients(1.9e9, 0.8e9, 0))
    machine = as_machine(mill)
    here = PeriodicCut.of(machine, cut, 1100.0)
    first = here.crossings(0.1)[0]
    stiff = PeriodicCut.of(replace(machine, stiffness=10.0 * machine.stiffness), cut, 1100.0)
    monkeypatch.setattr(converged, "find_crossings", lambda *_: pytest.fail("searched over all angles"))
    found = stiff.crossings(2.0 * first.depth)[0]
    assert found.depth == pytest.approx(10.0 * first.depth, rel=1e-6)


def test_a_crossing_just_below_the_one_that_is_followed_is_not_overlooked() -> None:
    """Where two lobes meet the first is 0.7 % below the other: a fit that jumped between them would not end."""
    mill = Mill(teeth=2)
    cut = Cut(Tool(mill.diameter, mill.teeth), Engagement(mill.entry, mill.leave), CuttingCoefficients(1.9e9, 0.8e9, 0))
    here = PeriodicCut.of(as_machine(mill), cut, 646.0)
    first, other = here.crossings(0.1)[:2]
    assert 1.004 < other.depth / first.depth < 1.012
    assert here.crossings(0.1, [other])[0].depth == pytest.approx(first.depth, rel=1e-6)


def test_the_vibration_of_a_crossing_that_is_followed_is_known_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Newton's method ends with ``M x = x/depth``; crossings twice as deep as the first are not followed at all."""
    mill = Mill(teeth=2)
    cut = Cut(Tool(mill.diameter, mill.teeth), Engagement(mill.entry, mill.leave), CuttingCoefficients(1.9e9, 0.8e9, 0))
    near = PeriodicCut.of(as_machine(mill), cut, 1100.0).crossings(0.1)
    assert near[-1].depth > 2.0 * near[0].depth
    softer = PeriodicCut.of(replace(as_machine(mill), stiffness=0.95 * as_machine(mill).stiffness), cut, 1100.0)
    monkeypatch.setattr(Dense, "chips", lambda *_: pytest.fail("solved for once more"))
    found = softer.crossings(0.1, near)
    assert len(found) < len(near)
    for at in found:
        x = softer.chips(at)
        np.testing.assert_allclose(
            softer.applied(at.angle, x), x / at.depth, rtol=0, atol=1e-6 * np.abs(x).max() / at.depth
        )


@pytest.mark.parametrize("law", ["linear", "square"])
def test_bearings_are_looked_for_where_they_soften_or_stiffen_all_modes(plain: CuttingLimits, law: str) -> None:
    """Where an island of instability opens below a limit its depth jumps: no slope leads over that."""
    (bearings,) = (c for c in plain.causes if c.key == f"spindle_speed_dynamics/{law}")
    assert sorted(np.sign(bearings.starts).tolist()) == [[-1.0] * plain.machine.frequency.size, [1.0] * 2]


def test_coupled_axes_are_looked_for_at_a_turn_of_each_mode(plain: CuttingLimits) -> None:
    """Beyond a kink of the limits, where another lobe governs, no slope leads from no turn to one of 25 degrees."""
    (coupled,) = (c for c in plain.causes if c.id == "cross_axis_coupling")
    turned = np.array(coupled.starts)
    count = plain.machine.frequency.size
    assert turned.shape == (2 * count, count)
    assert set(map(tuple, np.sign(turned))) == set(map(tuple, np.vstack([np.eye(count), -np.eye(count)])))


def test_a_missing_mode_is_looked_for_within_its_width_of_wherever_it_may_be(plain: CuttingLimits) -> None:
    """Over more than twice its damping, 4 %, a mode does nothing: between two known ones at least one start is near."""
    (missing,) = (c for c in plain.causes if c.id == "missing_mode")
    places = np.unique([start[1] for start in missing.starts])
    f, z = plain.machine.frequency, plain.machine.damping
    for place in np.geomspace(0.85 * f.min(), 1.3 * f.max(), 50):
        assert np.abs(places / place - 1.0).min() < 0.08 + z.max()
    assert not any(np.any(np.abs(p / f - 1.0) < z) for p in places)


def test_a_bracket_says_most_of_what_a_limit_is_known_within() -> None:
    """In steps of 5 % a limit scatters by 1.4 %: what it is trusted to beside that adds a quarter at the most."""
    step = math.log(1.05) / math.sqrt(12.0)
    found = KnownLimit(Limit(300.0, 10e-3, step, 100.0, 0.07), 1.0, 1.0)
    depth, frequency = found.std()
    assert step < depth < 1.25 * step
    assert frequency == pytest.approx(0.003 * 100.0, rel=0.05)


def test_no_mode_is_missing_inside_the_peak_of_one_that_is_known(plain: CuttingLimits) -> None:
    """A hammer cannot tell the two apart: it is a compliance of that mode that is wrong."""
    (missing,) = (c for c in plain.causes if c.id == "missing_mode")
    f, z, (x, y, _) = plain.machine.frequency[0], plain.machine.damping[0], plain.machine.direction[0]
    here = {"mode_compliance": 1e-9, "mode_frequency": f, "mode_damping": 0.04, "mode_azimuth": math.atan2(y, x)}
    assert missing.beyond is not None
    assert "peak of mode 1" in missing.beyond(here)
    assert missing.beyond(here | {"mode_frequency": f * (1.0 + 1.5 * z)}) == ""
    assert missing.beyond(here | {"mode_azimuth": here["mode_azimuth"] + 0.5 * math.pi}) == ""
    assert missing.beyond(here | {"mode_compliance": 0.0}) == ""


def test_bad_limits_are_one_sentence() -> None:
    tool, arc = Tool(0.05, 4), Engagement(0.0, math.pi)
    with pytest.raises(InputError, match="no limit to diagnose"):
        limit_family([], RAM, tool, arc, STEEL)
    with pytest.raises(InputError, match="known and positive"):
        limit_family([Limit(300.0)], RAM, tool, arc, STEEL)
    along_z = ModalModel([60.0], [0.03], [2e7], [[0.0, 0.0, 1.0]])
    stiff = limit_family([Limit(300.0, 1e-3)], along_z, tool, arc, STEEL)
    with pytest.raises(InputError, match="does not chatter"):
        stiff.predict(stiff.conditions[0], start(stiff))


# --- blind ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_nothing_hidden_nothing_named() -> None:
    found = diagnose(family(None, 0)[0])
    assert found.verdict == "consistent"


@pytest.mark.exam
def test_a_worn_flank_is_named_against_the_coefficients() -> None:
    # 20 % of the depth at the lowest speed.
    problem, expected = family("process_damping", 0)
    found = diagnose(problem)
    assert (found.verdict, [c.id for c in found.causes]) == ("named", [expected])
    estimate = found.causes[0].parameters[0]
    assert estimate.low < 1e-3 * worn() < estimate.high


@pytest.mark.slow
@pytest.mark.parametrize("effect", ["coefficients", "bearings", "micro_slip"])
def test_what_is_hidden_is_named_or_among_what_remains_open(effect: str) -> None:
    problem, expected = family(effect, 0)
    found = diagnose(problem)
    assert found.verdict != "consistent"
    named = {c.id: c.set for c in found.causes}
    # Depth goes with compliance over coefficients: what limits do not separate stands in one set with the truth.
    one_set = expected in named and (len(named) == 1 or set(named.values()) == {1})
    assert one_set or any(expected in [c.id for c in s] for s in found.alternatives)


@pytest.mark.exam
def test_one_speed_leaves_a_set_and_other_speeds_settle_it() -> None:
    # Deeper than predicted at one low speed, no chatter frequency: a worn flank or a softer material.
    mill = replace(SLOT, flank=worn(0.8))
    depth = limit(mill, 150.0)[0]
    found = [at_depth(150.0, depth, feed) for feed in np.linspace(0.5e-4, 2e-4, 8)]
    few = diagnose(known(SLOT, found, [Limit(600.0), Limit(850.0)]))
    assert few.verdict == "ambiguous"
    remaining = {c.id for s in few.alternatives for c in s}
    assert {"process_damping", "force_coefficients"} <= remaining
    assert few.next_experiment is not None
    more = diagnose(known(SLOT, [*found, *(at_depth(n, limit(mill, n)[0]) for n in (330.0, 600.0, 850.0))], []))
    assert [c.id for c in more.causes] == ["process_damping"]


def at_depth(speed: float, depth: float, feed: float = 1e-4) -> Found:
    return Found(speed, feed, depth / math.sqrt(RATIO), depth * math.sqrt(RATIO), None)
