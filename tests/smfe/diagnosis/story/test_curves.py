"""Claims: curves and errors are in the units of the measurement, of models that have not seen it if possible."""

import math

import numpy as np
import pytest

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.labels import make_compliance
from process.machine.modes import ModalModel
from smfe.diagnosis.cutting.limits import Limit, limit_family
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.frf.noise import condition_of, excitation_of
from smfe.diagnosis.inference.problem import Condition
from smfe.diagnosis.judgement.finding import Compared, ConditionMisfit, Finding, FoundCause, Prediction
from smfe.diagnosis.story.curves import with_curves
from smfe.diagnosis.story.experiments import instruction
from smfe.reporting.figures.compared import blocks
from smfe.reporting.figures.draw_diagnosis import draw_compared
from smfe.reporting.figures.plotly_diagnosis import compared_figure
from stability import zero_order

MODES = ModalModel(np.array([60.0, 90.0]), np.array([0.03, 0.04]), np.array([2e7, 3e7]), np.eye(3)[:2])
F = np.arange(20.0, 150.0, 2.0)
PARTS = (0.0, 0.5, 1.0)
CAUSE = FoundCause("modal_scale", "", "scale", "physics", (), 99.0, 3.0, 0.1)


def family(scale: float, count: int = 3) -> ModalFrfs:
    """A machine whose compliance is that of the modes over 1 + scale."""
    conditions = []
    for k in range(count):
        phi = MODES.matrix(F)[:, :2, :2] / (1.0 + scale)
        std = (("frequency", "response", "excitation"), np.full(phi.shape, 1e-4 * np.abs(phi).max()))
        data = make_compliance(F, phi, ("x", "y"), ("x", "y"), {"compliance_std": std})
        excited = excitation_of(data, "actuator", 50.0, (20.0, 150.0))
        conditions.append(condition_of(f"m{k}", data, excited, {"order": 0.0}))
    return ModalFrfs(MODES, tuple(conditions))


def finding(f: ModalFrfs, scale: float, held_out: int) -> Finding:
    """The simulation as declared has the scale wrong, refitted half of that, the extended model none."""
    start = {p.name: p.start for p in (*f.nuisances, *(p for c in f.causes for p in c.parameters))}
    each = [Prediction(v, f.predict(f.conditions[0], v)) for v in ({**start, "scale_error": x * scale} for x in PARTS)]
    compared = tuple(
        Compared(c, k < held_out, *each, ((each[1], each[2]),) if k < held_out else ())
        for k, c in enumerate(f.conditions)
    )
    misfits = tuple(ConditionMisfit(c.name, 10.0, 0.0, k < held_out, 5.0) for k, c in enumerate(f.conditions))
    return Finding("named", "it is", (CAUSE,), conditions=misfits, compared=compared)


def test_the_error_is_that_of_the_compliance_and_what_was_set_aside_comes_first() -> None:
    machine = family(0.25)
    found = with_curves(machine, finding(machine, 0.25, 1))
    assert [(e.tested, e.count) for e in found.errors] == [("set aside", 1), ("fitted", 2)]
    for e in found.errors:
        assert e.before == pytest.approx(0.25, rel=1e-6)  # |phi - phi/1.25| over |phi/1.25|
        assert e.after < 1e-6
        assert e.refitted == pytest.approx(1.25 / 1.125 - 1.0, rel=1e-6)
    assert found.curves is not None
    measured = found.curves["measured"].sel(condition="m0", entry="xx").values
    np.testing.assert_allclose(measured, MODES.matrix(F)[:, 0, 0] / 1.25, rtol=1e-5)
    np.testing.assert_allclose(found.curves["baseline"].sel(condition="m0", entry="yy"), MODES.matrix(F)[:, 1, 1], 1e-5)
    assert found.curves["held_out"].values.tolist() == [True, False, False]
    assert [c.error_before for c in found.conditions] == pytest.approx([0.25] * 3)
    refitted = found.curves["refitted"].sel(condition="m2", entry="xx").values
    np.testing.assert_allclose(refitted, MODES.matrix(F)[:, 0, 0] / 1.125, rtol=1e-5)
    assert [c.error_refitted for c in found.conditions] == pytest.approx([1.25 / 1.125 - 1.0] * 3)


def test_both_renderers_draw_what_is_kept_and_mark_what_was_set_aside() -> None:
    machine = family(0.25, 9)
    curves = with_curves(machine, finding(machine, 0.25, 2)).curves
    shown = blocks(curves)
    assert len(shown) == 6
    assert [b.title for b in shown[:2]] == ["m0", "m1"]
    assert shown[0].note.startswith("set aside, error 25 %")
    figure = compared_figure(shown[0])
    looks = {t["name"]: (t["line"]["color"], t["line"]["dash"]) for t in figure["data"]}
    assert set(looks) == {"measured", "simulation as declared", "extended model"}
    assert len({dash for _, dash in looks.values()}) == len({colour for colour, _ in looks.values()}) == 3
    assert sum(t["showlegend"] for t in figure["data"]) == 3
    assert curves is not None
    assert len(draw_compared(curves).axes) == 6 * 3


def test_the_machine_in_the_cut_has_the_limits_of_its_modes() -> None:
    """The same limits from the compliance of the family as from the modes themselves, which choose their own grid."""
    machine = family(0.0, 1)
    start = {p.name: p.start for p in (*machine.nuisances, *(p for c in machine.causes for p in c.parameters))}
    tool, arc, steel = Tool(0.08, 4), engagement("down", 0.04, 0.08), CuttingCoefficients(2e9, 8e8, 3e8)
    f = machine.fine_frequency()
    for rpm in (500.0, 900.0):
        phi = make_compliance(f, machine.in_the_cut(start, rpm, f))
        depths = [float(zero_order(m, tool, arc, steel, [rpm])["limit_depth"].values[0]) for m in (phi, MODES)]
        assert depths[0] == pytest.approx(depths[1], rel=5e-3)


def test_limits_are_drawn_over_the_speed() -> None:
    tool, arc, steel = Tool(0.08, 4), engagement("down", 0.04, 0.08), CuttingCoefficients(2e9, 8e8, 3e8)
    cuts = limit_family([Limit(700.0, 2e-3), Limit(500.0, 1e-3)], MODES, tool, arc, steel, proposals=())
    both = [Prediction({}, np.zeros(0)), Prediction({"coefficients": 1.0}, np.zeros(0))]
    compared = tuple(Compared(c, False, both[0], *both) for c in cuts.conditions)
    misfits = tuple(ConditionMisfit(c.name, 1.0, 0.0, False) for c in cuts.conditions)
    found = with_curves(cuts, Finding("named", "it is", (CAUSE,), conditions=misfits, compared=compared))
    (block,) = blocks(found.curves)
    measured, simulation, extended = block.panels[0].lines
    assert measured.x.tolist() == [500.0, 700.0]
    assert measured.y == pytest.approx([1.0, 2.0])
    assert extended.y / simulation.y == pytest.approx([0.5, 0.5], rel=1e-5)  # twice the force, half the depth


def test_an_experiment_is_something_to_do() -> None:
    machine = family(0.0, 1)
    excited = machine.conditions[0].data
    for name, settings, said in (
        ("level 25", {}, "Repeat m0 at 50 N"),
        (
            "position 0.75 m, at the end",
            {"position": 0.75},
            "Repeat m0 at 750 mm of the stroke, at the end of the session",
        ),
        ("a turning spindle", {"spindle_speed": 300.0}, "Repeat m0 with the spindle turning at 2865 rpm"),
        (
            "cut at 600 rpm, 0.1 mm per tooth, 3 mm deep",
            {},
            "Make a cut at 600 rpm, 0.1 mm per tooth, 3 mm deep",
        ),
        (
            "limit at 350 rpm, 0.1 mm per tooth",
            {},
            "Find the limit at 350 rpm and 0.1 mm per tooth: cut deeper by 4 to 6 % at a time",
        ),
    ):
        assert instruction(machine, Condition(name, settings, None, "m0", excited)) == said
    assert math.isfinite(machine.fine_frequency()[0])
