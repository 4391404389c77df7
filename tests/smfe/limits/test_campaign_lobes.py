"""Lobes of a campaign: every method and its band, through the campaign file."""

import numpy as np
import pytest

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.limits.campaign_lobes import all_lobes
from smfe.progress import silent
from stability import Cut

HEAD = """
[campaign]
name = "limits"
[tool]
diameter = "16 mm"
teeth = 2
[material]
name = "aluminium"
Ktc = "600 N/mm^2"
Krc = "200 N/mm^2"
Kac = "0 N/mm^2"
{material}
[spindle]
minimum = "4000 rpm"
maximum = "11000 rpm"
step = "100 rpm"
[[model]]
name = "classic"
modes = [{{ frequency = "922 Hz", damping = 0.011, stiffness = "1.34e6 N/m", direction = [1, 0, 0] }}]
{model}
[[lobes]]
measurements = ["classic"]
method = "{method}"
cut = "down"
width_of_cut = "8 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["4000 rpm", "12000 rpm", "800 rpm"]
maximum_depth = "20 mm"
"""


def campaign(folder, method="zero_order", material="", model=""):
    path = folder / "campaign.toml"
    path.write_text(HEAD.format(method=method, material=material, model=model))
    return load_campaign(path)


def lobes_of(loaded):
    found = {m.name: m.modal.compliance(np.arange(200.0, 2500.0, 1.0)) for m in loaded.models}
    return all_lobes(loaded, found, silent)


def limits(folder, method):
    return lobes_of(campaign(folder, method))[0].lobes["limit_depth"].values


def test_converged_methods_agree_with_each_other_and_differ_from_zero_order_where_the_cut_is_short(tmp_path):
    zero, multi, semi = (limits(tmp_path, m) for m in ("zero_order", "multi_frequency", "semi_discretization"))
    np.testing.assert_allclose(multi, semi, rtol=0.01)
    assert np.abs(zero / semi - 1.0).max() > 0.02


def test_uncertain_coefficients_move_a_single_mode_as_its_directional_factor(tmp_path):
    # One mode in x: the limit goes as 1/A_xx at every speed, and A_xx is linear in K_tc and K_rc.
    loaded = campaign(tmp_path, material='uncertainty = "10 %"')
    result = lobes_of(loaded)[0]
    arc = engagement("down", 8e-3, loaded.tool.diameter)
    alone, both = (
        Cut(loaded.tool, arc, CuttingCoefficients(1.0, k, 0.0)).directional_matrix()[0, 0].real for k in (0.0, 1.0)
    )
    per = [alone, both - alone, 0.0]
    drawn = np.array([600e6, 200e6, 0.0])[:, None] * np.exp(
        0.1 * np.random.default_rng(1).standard_normal((3, 100_000))
    )
    factor = np.dot(per, [600e6, 200e6, 0.0]) / np.dot(per, drawn)
    for level in (0.05, 0.95):
        ratio = result.lobes["limit_depth_quantile"].sel(quantile=level).values / result.lobes["limit_depth"].values
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)
        # 200 samples know their 5 % quantile to 0.15 standard deviations.
        assert abs(ratio[0] - np.quantile(factor, level)) < 0.5 * np.std(factor)
    assert np.all(result.table["safe_depth_mm"] <= result.table["limit_depth_mm"])


def test_semi_discretisation_takes_the_modes_that_fit_a_measured_compliance(tmp_path):
    loaded = campaign(tmp_path, "semi_discretization")
    measured = {"classic": loaded.models[0].modal.compliance(np.arange(200.0, 2500.0, 2.0))}
    without = type(loaded)(**{**vars(loaded), "models": ()})
    fitted, declared = all_lobes(without, measured, silent)[0].lobes, lobes_of(loaded)[0].lobes
    np.testing.assert_allclose(fitted["limit_depth"], declared["limit_depth"], rtol=1e-3)
    assert "modes fitted to the measured compliance (922 Hz" in fitted.attrs["warnings"]


def test_what_a_method_cannot_do_is_said(tmp_path):
    loaded = campaign(tmp_path, "semi_discretization")
    without = type(loaded)(**{**vars(loaded), "models": ()})
    short = {"classic": loaded.models[0].modal.compliance(np.arange(900.0, 905.0, 1.0))}
    with pytest.raises(
        InputError, match="needs modes, and none could be fitted to this compliance: the matrix is known"
    ):
        all_lobes(without, short, silent)
    with pytest.raises(InputError, match="is a model: it belongs to no feed"):
        lobes_of(campaign(tmp_path, "operating_point"))
    with pytest.raises(InputError, match="is no share of a value"):
        campaign(tmp_path, material="uncertainty = 1.5")
