"""Claims: the audit names a planted measurement fault and where it is, and finds nothing in clean data."""

import os

import pytest
from places import DATASETS

from smfe.campaign import load_campaign
from smfe.diagnosis.audit import audit
from smfe.diagnosis.checks.suspect import suspect_table


@pytest.mark.skipif("SMFE_DATA" not in os.environ, reason="needs the public data sets (SMFE_DATA)")
class TestPublicData:
    @pytest.mark.slow
    def test_overloaded_and_double_hit_are_named_with_the_harm_they_would_have_done(self) -> None:
        table = suspect_table(audit(load_campaign(DATASETS / "pyfrf_hammer.toml")))
        assert not (table["level"] == "fault").any()  # the hits were left out, and no fault remains
        faults = table[table["level"] == "warning"].set_index("cause")
        assert list(faults.index) == ["saturation", "double_hit"]
        assert "segment 0" in faults.loc["saturation", "where"]
        assert "segment 2" in faults.loc["double_hit", "where"]
        low, high = faults.loc["saturation", "evidence"].split("would have given ")[1].split(" times")[0].split(" to ")
        # Upstream: biased low by 4 to 11 times.
        assert 1.0 / 20.0 < float(low) < 1.0 / 4.0
        assert 1.0 / 11.0 < float(high) < 1.0 / 3.0

    def test_a_force_window_of_exact_zeros_is_noticed(self) -> None:
        table = suspect_table(audit(load_campaign(DATASETS / "toolpoint_hammer_ubc.toml")))
        assert list(table["cause"]) == ["windowed_channel"]
