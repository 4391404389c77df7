"""Claims: whatever a catalogue can name, somebody is told what to do about it, with the numbers that were found."""

import numpy as np
import pytest

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.labels import make_record
from process.machine.modes import ModalModel
from smfe.diagnosis.cutting.forces import cutting_family
from smfe.diagnosis.cutting.limits import Limit, limit_family
from smfe.diagnosis.cutting.orders import SteadyCut
from smfe.diagnosis.drive import terms
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.frf.causes import modal_causes, sensor_causes
from smfe.diagnosis.inference.problem import Cause
from smfe.diagnosis.judgement.finding import Estimate, FoundCause
from smfe.diagnosis.story.causes import ROWS as TOLD
from smfe.diagnosis.story.facts import facts_of
from smfe.diagnosis.story.to_do import ROWS, action

ARC = engagement("down", 0.0125, 0.025)
AXIS = AxisBaseline(Drive(23.1, 11.3, 1.68e6, 104.0, sigma=168.0), {"K2": Servo(6268.0, 10.9e-3, 45.5)})


def forces():
    rng = np.random.default_rng(1)
    record = make_record(np.arange(40000) * 1e-4, {"force": {a: rng.standard_normal(40000) for a in "xyz"}})
    return cutting_family({"cut": (record, SteadyCut(600.0, 1e-4, 2e-3, ARC))}, Tool(0.025, 4), (2e9, 6e8, 3e8))


def limits():
    modes = ModalModel(np.array([70.0]), np.array([0.04]), np.array([2e7]), np.array([[1.0, 1.0, 0.0]]))
    return limit_family(
        [Limit(500.0, 2e-3, frequency=72.0)], modes, Tool(0.125, 8), ARC, CuttingCoefficients(2e9, 6e8, 0.0)
    )


def catalogues() -> list[Cause]:
    plain = AxisBaseline(Drive(23.1, 11.3, 1.68e6, 104.0, sigma=168.0), {"K2": Servo(6268.0, 10.9e-3, 45.5)})
    known = AxisBaseline(plain.drive, plain.servos, known={"coulomb": 40.0, "static": 60.0, "stribeck_speed": 6e-3})
    drive = [
        t.cause for t in (*terms.always(0.0, 0.2, 95.0, 0.2), terms.ripple(0.0025, 0.0, True), terms.tone(50.0, 20.0))
    ]
    drive += [terms.hidden_force([(0.0, 1.0, 1.0)]).cause, terms.saturation(900.0, 700.0)]
    drive += [terms.HIDDEN_COMMAND]
    return [
        *(c for b in (plain, known) for c in b.causes()),
        *sensor_causes((10.0, 150.0)),
        *modal_causes((1, 2, 3), (10.0, 150.0), 1e-7, 1.0, 5),
        *drive,
        *forces().causes,
        *limits().causes,
    ]


def found(cause: Cause, *values: float) -> FoundCause:
    shown = values or tuple(p.start * p.shown + 1.0 for p in cause.parameters)
    estimates = tuple(Estimate(p.name, v, v, v, p.unit) for p, v in zip(cause.parameters, shown, strict=True))
    return FoundCause(cause.id, cause.variant, cause.title, cause.kind, estimates, 9.0, None, None)


def declared(id_: str, name: str, value: float) -> FoundCause:
    estimate = Estimate(name, value, value, value, "ms" if "delay" in name else "%")
    return FoundCause(id_, "declared", "", "declared", (estimate,), 9.0, None, None)


def test_every_cause_of_every_catalogue_has_something_to_do() -> None:
    for cause in catalogues():
        said = action(found(cause))
        assert len(said) > 20, cause.key
        assert "{" not in said, said
        assert not said.endswith("."), said
        assert cause.id in {key.partition("/")[0] for key in TOLD}, cause.key
    assert {key.partition("/")[0] for key in ROWS} >= {c.id for c in catalogues()}


def test_gains_are_told_as_the_control_has_them_beside_what_the_campaign_says() -> None:
    family = MachineFrfs(AXIS, ())
    start = {p.name: p.start for p in (*AXIS.nuisances(), *(p for c in AXIS.causes() for p in c.parameters))}
    values = start | {"Kp_error": 0.3, "extra_delay": 0.4e-3}
    said = action(declared("servo_gains", "Kp_error", 30.0), facts_of(family, values))
    assert "Kp 8150 N s/m in place of 6270" in said
    assert "Ti" not in said
    delay = declared("loop_delay", "extra_delay", 0.4)
    assert 'Set delay to "0.4 ms" in the campaign' in action(delay, facts_of(family, values))


def test_gains_are_told_as_they_are_set_not_as_samples_make_them_act() -> None:
    late = AxisBaseline(AXIS.drive, {"K2": Servo(6268.0, 10.9e-3, 45.5, 0.75e-3)})
    start = {p.name: p.start for p in (*late.nuisances(), *(p for c in late.causes() for p in c.parameters))}
    sampled = start | {"period": 0.4e-3}
    assert late.effective(sampled, {}, 0.0).servos[0].Kp > 1.01 * 6268.0
    assert "gains" not in facts_of(MachineFrfs(late, ()), sampled)


def test_coefficients_are_told_in_newtons_per_square_millimetre() -> None:
    family = forces()
    values = {p.name: p.start for p in family.nuisances} | {"Ktc": 2.7e9}
    said = facts_of(family, values)["coefficients_found"]
    assert said == "Ktc 2700 N/mm² in place of 2000"
    values = {p.name: p.start for p in limits().nuisances} | {"coefficients": 0.35, "radial": 0.0}
    assert facts_of(limits(), values)["coefficients_found"].startswith("Ktc 2700 N/mm² in place of 2000")


@pytest.mark.parametrize(
    ("id_", "name", "value", "said"),
    [
        ("sensor_gain", "gain_x", -200.0, "Turn the sensor's sign: sign = -1 on the sensor along x"),
        ("sensor_gain", "reversed_x", 1.0, "Turn the sensor's sign: sign = -1 on the sensor along x"),
        ("sensor_gain", "gain_x", 880.665, 'the factor is that of "g" (of gravity)'),
        ("sensor_gain", "gain_force", -13.0, "scale = 1.149 on the force"),
        ("sensor_axis", "exchanged_xy", 1.0, "Exchange the columns of acceleration_x and acceleration_y in [channels]"),
        ("sensor_axis", "quarter_xy", -1.0, "in [channels], and then set sign = -1 on acceleration_y"),
        ("sensor_axis", "exchange", 1.0, "Exchange the columns of force_x and force_y in [channels]"),
        ("time_skew", "skew", 50.0, "the motion comes 50 µs late"),
    ],
)
def test_the_advice_fits_the_fault(id_: str, name: str, value: float, said: str) -> None:
    cause = FoundCause(id_, "", "", "measurement", (Estimate(name, value, value, value, _unit(name)),), 9.0, None, None)
    advice = action(cause)
    assert said in advice
    assert ("sign = -1" in advice) == (value == -200.0 or name in ("reversed_x", "quarter_xy"))


def _unit(name: str) -> str:
    return {"skew": "us", "exchange": "1", "exchanged_xy": "0/1", "quarter_xy": "0/1", "reversed_x": "0/1"}.get(
        name, "%"
    )
