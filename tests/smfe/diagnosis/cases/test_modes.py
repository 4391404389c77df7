"""Claims: the modes of a measurement are a baseline like those of a model, and what is no compliance is refused."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from truth.imperfect.families import draw
from truth.modal_machine import Hidden, Setting, at_tool, modes, nominal

import smfe
from process.errors import InputError
from process.labels import AXES, make_compliance
from process.machine.modes import ModalModel
from smfe.campaign import Campaign, Measurement, Model, ModesOf, load_campaign
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.cases.case import NamedModes, modes_named
from smfe.diagnosis.cases.compliances import case_of, left_by_fit
from smfe.diagnosis.frf.modes import SPREAD, FittedModes, ModalFrfs
from smfe.diagnosis.frf.noise import Excited, excitation_of
from smfe.diagnosis.inference.fit import Target, fit
from smfe.diagnosis.inference.model import Model as Predicted
from smfe.diagnosis.inference.problem import Condition
from smfe.diagnosis.judgement.declared import strained
from smfe.diagnosis.judgement.diagnose import diagnose
from smfe.identification.errors.result import Identification
from smfe.identification.measurement import identify_measurement
from stability import Spread

F = np.arange(14.0, 150.0, 0.5)
NOISE = 0.01
"""Of the rms of each entry."""


def measured(name: str, seed: int, level: float = 100.0) -> Identification:
    ram = nominal(3, np.random.default_rng(5))
    h = at_tool(ram, Hidden(), Setting(level=level), F)
    size = NOISE * np.sqrt(np.mean(np.abs(h) ** 2, axis=0))
    rng = np.random.default_rng(seed)
    noise = (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape)) / np.sqrt(2.0)
    three = ("frequency", "response", "excitation")
    std = np.broadcast_to(size, h.shape)
    compliance = make_compliance(F, h + size * noise, extra={"compliance_std": (three, std)})
    steps = pd.DataFrame({"excitation": list(AXES), "force_N": [level] * 3})
    return Identification(name, "actuator", compliance, {"steps": steps})


def campaign(found: dict[str, Identification], source: str) -> Campaign:
    each = tuple(Measurement(name=n, method="actuator", records=(), channels={}) for n in found)
    return Campaign(Path("campaign.toml"), "ram", measurements=each, baseline=ModesOf(source))


@pytest.fixture(scope="module")
def found() -> dict[str, Identification]:
    return {"first": measured("first", 1)}


@pytest.fixture(scope="module")
def named(found: dict[str, Identification]) -> NamedModes:
    return modes_named(campaign(found, "first"), "first", found, whole=True)


def family_of(named: NamedModes, found: dict[str, Identification]) -> ModalFrfs:
    """Of modes that a fit has found already."""
    plain = replace(campaign(found, "plain"), models=(Model("plain", named.modal),))
    family = case_of(plain, found).family
    assert isinstance(family, ModalFrfs)
    return replace(family, fitted=named.fitted)


def test_the_modes_of_a_measurement_are_those_of_the_machine(named: NamedModes) -> None:
    frequency = modes(nominal(3, np.random.default_rng(5)))[0]
    fitted = named.modal.frequency[(named.modal.frequency > 14.0) & (named.modal.frequency < 150.0)]
    # The cable that hangs on the tool shifts the modes of the bare ram by some per cent.
    assert [float(np.min(np.abs(fitted / f - 1.0))) < 0.05 for f in frequency] == [True] * frequency.size
    assert named.band[1] <= 150.0


@pytest.mark.slow
def test_a_measurement_like_the_one_that_gave_the_modes_is_consistent_with_them() -> None:
    alike = {name: measured(name, k, level=level) for k, (name, level) in enumerate((("a", 100.0), ("b", 50.0)), 1)}
    assert diagnose(case_of(campaign(alike, "a"), alike).family).verdict == "consistent"


def test_a_model_is_trusted_as_far_as_it_says(named: NamedModes, found: dict[str, Identification]) -> None:
    """Without an uncertainty of its own a mode has that of the house; both are priors of the fit."""
    bare = named.modal
    declared = replace(
        campaign(found, "sure"), models=(Model("sure", bare, Spread(frequency=0.004)), Model("plain", bare))
    )
    priors = {}
    for name in ("sure", "plain"):
        family = case_of(replace(declared, baseline=ModesOf(name)), found).family
        priors[name] = {p.name: p.prior / p.start for p in family.nuisances if p.start}
    assert priors["sure"]["frequency_1"] == pytest.approx(0.004, rel=0.01)
    assert priors["plain"]["frequency_1"] == pytest.approx(SPREAD["frequency"])
    wide = replace(declared, models=(Model("wide", bare, Spread(damping=0.2)),), baseline=ModesOf("wide"))
    of = {p.name: p.prior / p.start for p in case_of(wide, found).family.nuisances if p.start}
    # Of what is 40 % too low 67 % are missing, and of what is 40 % too high 29 %: two standard deviations, on the mean.
    assert 2.0 * of["damping_1"] == pytest.approx(0.5 * (1.0 / 0.6 - 1.0 + 1.0 - 1.0 / 1.4), rel=0.05)
    assert priors["sure"]["damping_1"] == priors["plain"]["damping_1"] == pytest.approx(SPREAD["damping"])


def test_what_a_fit_found_nobody_declared(named: NamedModes, found: dict[str, Identification]) -> None:
    """No cause is that a mode was declared wrong, and its direction is looked for again."""
    of_fit = family_of(named, found)
    of_model = replace(of_fit, fitted=None)
    assert not any(p.given.startswith("modal_") for p in of_fit.nuisances)
    assert not {c.id for c in of_fit.causes} & {"modal_mass", "cross_axis_coupling"}
    assert any(p.given == "modal_stiffness" for p in of_model.nuisances)
    assert {c.id for c in of_model.causes} >= {"modal_mass", "cross_axis_coupling"}
    # Hits and sensors leaned when the modes were measured: their directions are as sure as that, and as the fit.
    lean = math.hypot(of_fit.tolerances.setup_direction, of_fit.tolerances.mounting_angle)
    turns = [p for p in of_fit.nuisances if p.name.startswith("turn_")]
    assert named.fitted is not None
    each = [math.hypot(lean, d) for d in named.fitted.doubt[named.fitted.of_band, 3]]
    assert [p.prior for p in turns] == pytest.approx([*each, *each])
    assert all(0.0 < d < 0.01 for d in named.fitted.doubt[named.fitted.of_band, 3])
    own = named.fitted.of_band
    assert own.sum() >= 3
    # One per cent of noise leaves a stiffness unsure by less, and a stand-in nothing but its size.
    assert np.all(named.fitted.doubt[own][:3] < 0.1)
    assert all(row.tolist() == [0.0, 0.0, 1.0, 0.0] for row in named.fitted.doubt[~own])


def test_what_only_stands_for_something_has_a_size_and_no_fate_of_its_own(
    named: NamedModes, found: dict[str, Identification]
) -> None:
    """A second mode in the noise, and the masses and stiffer modes that a compliance needs, besides a mode."""
    model = ModalModel([40.0, 60.0, 1.0, 900.0], [0.02] * 4, [2e7, 4e9, 5e6, 6e9], [[1.0, 0.0, 0.0]] * 4)
    doubt = np.array([[1e-4, 0.01, 0.02, 0.1], [0.01, 0.5, 0.4, 0.9], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1.0, 0.0]])
    known = FittedModes(doubt, np.array([True, True, False, False]))
    family = replace(family_of(named, found), model=model, fitted=known)
    own = {p.name: p for p in family.nuisances if p.name.rpartition("_")[2].isdigit()}
    assert [n for n in own if not n.startswith("turn")] == [
        "frequency_1", "damping_1", "stiffness_1", "filling_2", "filling_3", "filling_4"
    ]  # fmt: skip
    assert own["stiffness_1"].prior == pytest.approx(math.hypot(SPREAD["stiffness"], 0.02) * 2e7)
    lean = math.hypot(family.tolerances.setup_direction, family.tolerances.mounting_angle)
    assert own["turn_a_1"].prior == pytest.approx(math.hypot(lean, 0.1))
    assert own["filling_3"].prior == 1.0
    drift = next(c for c in family.causes if c.id == "drift")
    assert [p.name for p in drift.parameters] == ["drift_11"]
    values = {p.name: p.start for p in family.nuisances} | {"drift_11": 0.1, "joint_hardening": 0.02}
    changed = family.changed(Condition("late", {"order": 1.0}), values)
    np.testing.assert_array_equal(np.reshape(changed.springs, (4, 4)), np.diag([0.1, 0.0, 0.0, 0.0]))
    assert changed.hardening == (0.02, 1.0, 0.0, 0.0, 0.0)
    assert changed.stiffness == tuple(model.stiffness)
    halved = family.changed(Condition("late", {}), values | {"filling_2": -0.5})
    assert halved.stiffness == (2e7, 8e9, 5e6, 6e9)


def test_what_filled_up_one_measurement_and_is_in_no_other_convicts_nothing(
    named: NamedModes, found: dict[str, Identification]
) -> None:
    """A fit takes the errors of its hits for a mode of 3 % of the compliance, which the machine does not have."""
    family = family_of(named, found)
    assert family.fitted is not None
    own = np.isin(np.arange(family.model.frequency.size), family._own)
    real, largest = family.model.stiffness[own].min(), 1.0 / 0.03
    model = ModalModel(
        [*family.model.frequency, 70.0], [*family.model.damping, 0.5], [*family.model.stiffness, real * largest],
        [*family.model.direction, [1.0, 0.0, 0.0]],
    )  # fmt: skip
    doubt = np.vstack([family.fitted.doubt, [0.02, 0.4, 0.3, 0.0]])
    filled = replace(family, model=model, fitted=FittedModes(doubt, np.append(family.fitted.of_band, False)))
    predicted = Predicted(filled, filled.conditions)
    target = Target({0: np.asarray(filled.conditions[0].observed)}, predicted.null())
    at = fit(predicted, target, (), predicted.null())
    last = predicted.values(at.u)[f"filling_{model.frequency.size}"]
    assert last == pytest.approx(-1.0, abs=0.1)
    assert strained(predicted, target, at, lambda *_: 1.0, 0.05) is None


def test_damping_that_is_another_at_one_place_is_no_evidence_and_a_stiffness_is() -> None:
    """4 % more damping, 4 % more stiffness at 0.3 m with lines of 0.3 % noise; at home neither is allowed for."""
    model, exact = ModalModel([40.0], [0.03], [2e7], [[1.0, 0.0, 0.0]]), dict.fromkeys(vars(Tolerances()), 0.0)
    home = model.matrix(F)[:, 0, :1]
    std = np.full(home.shape, 3e-3 * np.abs(home).max())
    left = {}
    for what, f, zeta, k in (("damping", 40.0, 0.0312, 2e7), ("stiffness", 40.0 * math.sqrt(1.04), 0.03, 2.08e7)):
        seen = ModalModel([f], [zeta], [k], [[1.0, 0.0, 0.0]]).matrix(F)[:, 0, :1]
        for place in (0.0, 0.3):
            x = Excited(F, (("x", "x"),), std, "hammer", 1.0)
            at = [
                Condition(n, {"position": p}, x.whitened(phi), n, x)
                for n, p, phi in (("home", 0.0, home), ("there", place, seen))
            ]
            family = ModalFrfs(model, tuple(at), tolerances=Tolerances(**exact)).with_errors()
            whole = Predicted(family, family.conditions)
            data = Target({n: c.observed for n, c in enumerate(family.conditions)}, whole.null())
            left[what, place] = fit(whole, data, (), whole.null()).chi2
    assert left["damping", 0.3] < 0.1 * left["damping", 0.0] < left["stiffness", 0.3]
    assert left["stiffness", 0.3] > 0.5 * left["stiffness", 0.0]


def test_what_has_no_modes_is_refused_with_what_to_do() -> None:
    silent = {"first": measured("first", 1)}
    with pytest.raises(InputError, match="'air' is no compliance, so it has no modes"):
        modes_named(campaign(silent, "air"), "air", silent)
    first = silent["first"]
    few = first.compliance.isel(frequency=slice(0, 6))
    with pytest.raises(
        InputError, match=r"'first' does not give the modes of a simulation .* declare them as a \[\[model\]\]"
    ):
        modes_named(campaign(silent, "first"), "first", {"first": Identification("first", "actuator", few, {})})


def test_what_the_fit_of_a_baseline_leaves_of_its_own_source_convicts_no_other_measurement() -> None:
    """A misfit ten times the noise, smooth over frequency, in both measurements alike."""
    model = ModalModel([40.0], [0.02], [2e7], [[1.0, 0.0, 0.0]])
    away = 1e-8 * np.exp(2j * np.pi * F / 60.0)
    direct = {n: measured(n, 1).compliance.sel(response=["x"], excitation=["x"]) for n in ("first", "second")}
    for compliance in direct.values():
        compliance["compliance"].values[:, 0, 0] = model.matrix(F)[:, 0, 0] + away
    excited = excitation_of(direct["second"], "actuator", 100.0, (14.0, 150.0))
    row = left_by_fit(model, direct["first"], excited)
    np.testing.assert_allclose(row[0, :, 0], np.interp(excited.frequency, F, away.real) + 1j * away_at(excited, away))
    seen = np.interp(excited.frequency, F, 1.3 * away.real) + 1.3j * away_at(excited, away)
    bare, shared = (x.whitened(seen[:, None]) for x in (excited, replace(excited, shared=row)))
    assert bare @ bare > 20.0 * bare.size
    # What is left is the factor itself, 1.3 of unit variance.
    assert shared @ shared == pytest.approx(1.3**2, rel=0.01)


def away_at(excited, away):
    return np.interp(excited.frequency, F, away.imag)


@pytest.mark.exam
@pytest.mark.parametrize(
    ("what", "seed", "causes"),
    [("healthy", 17_410_001, []), ("drift", 17_410_003, ["drift"]), ("posture", 17_450_007, ["posture"])],
)
def test_measurements_without_a_time_show_a_drift_and_no_other_effect_as_one(tmp_path, what, seed, causes) -> None:
    """Of half of the campaigns the generator says when each was made: here nobody says it."""
    draw("modal", seed, what, tmp_path / "ram", 1.0)
    campaign = tmp_path / "ram" / "campaign.toml"
    lines = campaign.read_text(encoding="utf-8").splitlines()
    untimed = [line for line in lines if not line.startswith("started")]
    campaign.write_text("\n".join(untimed), encoding="utf-8")
    found = smfe.diagnose(campaign)
    assert (found.verdict, [c.id for c in found.causes]) == ("named" if causes else "consistent", causes)


@pytest.mark.slow
def test_what_balances_a_remainder_that_no_mode_has_is_not_taken_for_modes(tmp_path: Path) -> None:
    """Four poles above the band, of 7 um/N, and a remainder of -7 um/N: without it they were 20 times the tool."""
    draw("modal", 19_001_035, "healthy", tmp_path / "ram", 1.0)
    whole = load_campaign(tmp_path / "ram" / "campaign.toml")
    (idle,) = (m for m in whole.measurements if m.name == "hammer_idle")
    found = {"hammer_idle": identify_measurement(whole, idle)}
    modal = modes_named(whole, "hammer_idle", found, whole=True).modal
    phi = found["hammer_idle"].compliance.sel(frequency=slice(35.0, 150.0))
    left = np.abs(modal.matrix(phi["frequency"].values) - phi["compliance"].values) ** 2
    size = np.abs(phi["compliance"].values) ** 2
    assert np.sqrt(left.sum(axis=0) / size.sum(axis=0)).max() < 0.35
