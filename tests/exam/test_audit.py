"""The data audit warns of no healthy machine: ordinary imperfections, in all families of campaigns."""

import warnings
from pathlib import Path

import pytest
from truth.imperfect.families import FAMILIES, draw

from exam.campaigns import SEEDS
from smfe.campaign import load_campaign
from smfe.diagnosis.audit import audit

COUNT = 20
"""Healthy campaigns of each family."""


@pytest.mark.exam
@pytest.mark.parametrize("family", FAMILIES)
def test_no_warning_on_healthy_machines(family: str, tmp_path: Path) -> None:
    """Hits that lean, calibrations, hum, clocks, friction: none is a fault of the data, and none excludes any."""
    said = []
    for seed in range(SEEDS["null"], SEEDS["null"] + COUNT):
        draw(family, seed, "healthy", tmp_path / str(seed))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = audit(load_campaign(tmp_path / str(seed) / "campaign.toml"))
        said += [(seed, s.level, s.where, s.evidence) for s in found if s.level != "note"]
    assert said == []
