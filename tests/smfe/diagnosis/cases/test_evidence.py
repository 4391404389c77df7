"""One axis explains its hits, its drive record and its cutting tests, which an independent simulation has made."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from truth.imperfect import evidence

from process.errors import InputError
from smfe.campaign import Campaign, load_campaign
from smfe.diagnosis.audit import audited
from smfe.diagnosis.cases.case import Case
from smfe.diagnosis.cases.compliances import case_of
from smfe.diagnosis.inference.fit import Fit, Target, fit
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.story.millimetres import depths_of, stable_depths
from smfe.progress import silent


@dataclass(frozen=True)
class Explained:
    """A campaign with hidden friction, its case, and the fit of that friction to some evidence."""

    written: evidence.Written
    campaign: Campaign
    case: Case
    model: Model
    fit: Fit

    def estimate(self, name: str) -> tuple[float, float]:
        """Return a parameter and its standard deviation from noise and priors (SI)."""
        slope = np.concatenate(list(self.fit.slope.values()))
        information = slope.T @ slope + np.diag(self.model.weight[self.fit.free] ** 2)
        j = self.model.names.index(name)
        sd = math.sqrt(np.linalg.pinv(information)[(place := self.fit.free.tolist().index(j)), place])
        p = self.model.parameters[j]
        return p.start + p.scale * float(self.fit.u[j]), sd * p.scale


def explained(written: evidence.Written, kinds: tuple[str, ...]) -> Explained:
    """Fit the hidden friction to compliances and further evidence; hits are made to mean hits of what is found."""
    campaign = load_campaign(written.file, None)
    assert campaign.baseline is not None
    campaign = replace(campaign, baseline=replace(campaign.baseline, evidence=kinds))
    case = case_of(campaign, audited(campaign, silent, None).identified)
    conditions, u = case.family.conditions, None
    for _ in range(2):
        model = Model(case.family, conditions)
        target = Target({r: np.asarray(c.observed) for r, c in enumerate(conditions)}, model.null())
        cause = [c.key for c in model.causes].index("guideway_friction/stribeck")
        begin = model.scaled({"stribeck_coulomb": 30.0, "static_rise": 30.0, "stribeck_speed": 6e-3})
        found = fit(model, target, (cause,), begin if u is None else u)
        conditions, u = case.family.as_found(model.values(found.u)), found.u
    return Explained(written, campaign, case, model, found)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> evidence.Written:
    return evidence.campaign(tmp_path_factory.mktemp("evidence"), 1, "friction")


@pytest.fixture(scope="module")
def whole(written: evidence.Written) -> Explained:
    return explained(written, ("drive", "limits"))


@pytest.mark.slow
def test_one_set_of_parameters_explains_hits_moves_and_limits_down_to_noise(whole: Explained):
    sizes = {whole.model.conditions[r].name: float(np.mean(x**2)) for r, x in whole.fit.residual.items()}
    assert len(sizes) == 6 + 2 + 6
    assert all(square < 2.0 for name, square in sizes.items() if not name.startswith("limit"))
    limits = [square for name, square in sizes.items() if name.startswith("limit")]
    assert np.mean(limits) < 2.0


@pytest.mark.exam
def test_all_evidence_knows_sliding_friction_better_than_compliances_alone(whole: Explained):
    alone = explained(whole.written, ())
    truth = whole.written.truth.friction
    (found, sd), (_, wide) = whole.estimate("stribeck_coulomb"), alone.estimate("stribeck_coulomb")
    assert sd < 0.5 * wide
    assert found == pytest.approx(truth.coulomb[0], rel=0.02)
    assert whole.estimate("viscous")[0] == pytest.approx(truth.viscous[0], rel=0.03)


@pytest.mark.slow
def test_the_extended_axis_foretells_the_twelve_cutting_tests_that_the_declared_one_gets_wrong(whole: Explained):
    depths, why = depths_of(whole.campaign, whole.case.family)
    assert depths is not None, why
    rows = {r.where: r for r in stable_depths(whole.campaign, depths, whole.model.values(whole.fit.u))}
    right = {"before_mm": 0, "after_mm": 0}
    for test in whole.campaign.cutting_tests:
        for model in right:
            chatters = 1e3 * test.depth_of_cut > getattr(rows[test.file.name], model)
            right[model] += chatters == (test.observed == "chatter")
    assert right["after_mm"] >= 11
    assert right["before_mm"] <= 9


def test_limits_are_no_evidence_without_a_tool(tmp_path: Path):
    file = tmp_path / "campaign.toml"
    file.write_text(
        '[campaign]\nname = "a"\n[baseline]\naxis = "x"\nevidence = ["limits"]\nmoving_mass = "20 kg"\n'
        'tip_mass = "10 kg"\nstiffness = "1 N/um"\ndamping = "100 N s/m"\nKp = "6000 N s/m"\nTi = "11 ms"\n'
        'Kv = "45 1/s"\nfriction = { law = "viscous", sigma = "160 N s/m" }\n',
        encoding="utf-8",
    )
    with pytest.raises(InputError, match="a limit depth needs"):
        load_campaign(file, None)


def test_evidence_that_is_not_known_is_refused(tmp_path: Path):
    file = tmp_path / "campaign.toml"
    file.write_text('[campaign]\nname = "a"\n[baseline]\naxis = "x"\nevidence = ["forces"]\n', encoding="utf-8")
    with pytest.raises(InputError, match="evidence"):
        load_campaign(file, None)
