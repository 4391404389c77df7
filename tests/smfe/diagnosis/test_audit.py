"""Claims: the audit names a planted measurement fault and where it is, and finds nothing in clean data."""

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from places import DATASETS

from process.labels import make_compliance, make_record
from smfe.campaign import Campaign, load_campaign
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.audit import _compliance_suspects, audit
from smfe.diagnosis.checks.suspect import suspect_table
from smfe.records import write_record_netcdf


@pytest.mark.parametrize("moves", [False, True])
def test_a_drive_that_answers_late_gives_out_energy_and_is_no_clock_that_is_late(moves: bool) -> None:
    """A slide of 380 kg under a servo of 24 Hz with 2 ms of dead time: from 60 Hz on its loop feeds the vibration."""
    f = np.linspace(5.0, 200.0, 200)
    w, delay, kp = 2.0 * np.pi * f, 2e-3, 2.0 * np.pi * 24.0 * 380.0
    servo = kp * (1.0 + 1.0 / (17e-3 * 1j * w)) * (1j * w + 29.0) * np.exp(-1j * w * delay)
    phi = np.zeros((f.size, 3, 3), dtype=complex)
    phi[:, range(3), range(3)] = (1.0 / (servo + 2000.0j * w - 380.0 * w**2))[:, None]
    campaign = SimpleNamespace(lobes=(), baseline=None, tolerances=Tolerances())
    found = {s.cause for s in _compliance_suspects(campaign, "m", make_compliance(f, phi), moves)}  # type: ignore[arg-type]
    assert ("time_skew" in found) is not moves


def cut_of_orders(folder: Path, teeth: int, sizes: dict[int, float], observed: str = "") -> Campaign:
    """Campaign of one cut at 800 rpm whose acceleration has some orders of the spindle."""
    t = np.arange(24000) / 2000.0
    motion = sum(a * np.cos(2.0 * np.pi * 800.0 / 60.0 * n * t + n) for n, a in sizes.items())
    write_record_netcdf(make_record(t, {"acceleration": {"x": motion}}), folder / "cut.nc")
    (folder / "campaign.toml").write_text(
        "[campaign]\nname = 'order'\n"
        f"[tool]\ndiameter = '100 mm'\nteeth = {teeth}\napproach_angle = '90 deg'\n"
        "[[cutting_test]]\nfile = 'cut.nc'\nspindle_speed = '800 rpm'\ndepth_of_cut = '2 mm'\n"
        "cut = 'down'\nwidth_of_cut = '30 mm'\nfeed_per_tooth = '0.1 mm'\n"
        + (f"observed = '{observed}'\n" if observed else "")
    )
    return load_campaign(folder / "campaign.toml")


@pytest.mark.parametrize(("observed", "said"), [("chatter", False), ("stable", True)])
def test_chatter_on_an_order_of_the_spindle_is_no_number_of_teeth(tmp_path: Path, observed: str, said: bool) -> None:
    """800 rpm, four teeth: chatter at 133.3 Hz lies on order 10, ten times as large as what the teeth make."""
    sizes = {4: 1.0, 8: 0.7, 12: 0.5, 10: 15.0, 20: 1.0, 30: 1.0}
    campaign = cut_of_orders(tmp_path, 4, sizes, observed)
    found = audit(campaign)
    assert ("tooth_number" in {s.cause for s in found}) == said


@pytest.mark.parametrize("order", [3, 5, 7])
def test_two_teeth_have_no_orders_beside_their_own_that_side_lines_could_exceed(tmp_path: Path, order: int) -> None:
    sizes = {2: 1.0, 4: 0.7, 6: 0.5, order: 15.0, 3 * order: 1.0}
    campaign = cut_of_orders(tmp_path, 2, sizes)
    assert "tooth_number" in {s.cause for s in audit(campaign)}


def test_side_lines_of_a_chatter_are_none_of_another_number_of_teeth(tmp_path: Path) -> None:
    """What chatters on order 5 of three teeth is modulated by them: orders 2 and 8, and it has harmonics, too."""
    sizes = {3: 1.0, 6: 0.6, 9: 0.4, 5: 9.0, 2: 1.3, 8: 1.3, 10: 0.2}
    campaign = cut_of_orders(tmp_path, 3, sizes)
    assert "tooth_number" not in {s.cause for s in audit(campaign)}


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
