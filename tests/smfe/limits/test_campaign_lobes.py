"""Lobes of a campaign: every method and its band, through the campaign file."""

import numpy as np
import pytest

from process import ProcessDamping, engagement
from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.recommendation import recommend
from smfe.progress import silent
from stability import multi_frequency, semi_discretization, zero_order

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
{worn}
"""


def campaign(folder, method="zero_order", material="", model="", worn=""):
    path = folder / "campaign.toml"
    path.write_text(HEAD.format(method=method, material=material, model=model, worn=worn))
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


EXACT = "uncertainty = { frequency = 0, damping = 0, stiffness = 0 }"


@pytest.mark.parametrize("method", ["zero_order", "multi_frequency"])
@pytest.mark.parametrize(("material", "known"), [("", 0.1), ('uncertainty = "5 %"', 0.05), ("uncertainty = 0", 0.0)])
def test_uncertain_coefficients_move_every_limit_by_their_common_factor(tmp_path, method, material, known):
    # Of a machine that is known exactly the limit goes as one over the coefficients: quantiles of a log-normal.
    result = lobes_of(campaign(tmp_path, method, material, EXACT))[0]
    limit = result.lobes["limit_depth"].values
    for level, step in ((0.05, -1.6448536269514722), (0.5, 0.0), (0.95, 1.6448536269514722)):
        quantile = result.lobes["limit_depth_quantile"].sel(quantile=level).values
        np.testing.assert_allclose(quantile, limit * np.exp(known * step), rtol=1e-8)
    np.testing.assert_allclose(result.table["safe_depth_mm"], limit * np.exp(-1.6448536269514722 * known), rtol=1e-8)
    assert result.lobes.attrs["coefficient_uncertainty"] == known


def test_a_model_that_states_no_uncertainty_has_no_band_however_well_the_coefficients_are_known(tmp_path):
    for material in ("", 'uncertainty = "1 %"', "uncertainty = 0"):
        result = lobes_of(campaign(tmp_path, material=material))[0]
        assert "limit_depth_quantile" not in result.lobes
        assert result.table["safe_depth_mm"].isna().all()


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


@pytest.mark.parametrize(
    ("method", "limits_of"),
    [("zero_order", zero_order), ("multi_frequency", multi_frequency), ("semi_discretization", semi_discretization)],
)
def test_a_worn_flank_is_that_of_the_method_and_has_no_band(tmp_path, method, limits_of):
    worn = 'process_damping = "20 N/mm"\nflank_friction = 0.2'
    loaded = campaign(tmp_path, method, model=EXACT, worn=worn)
    result = lobes_of(loaded)[0]
    machine = loaded.models[0].modal
    if method == "zero_order":
        machine = machine.compliance(np.arange(200.0, 2500.0, 1.0))
    asked = loaded.lobes[0].spindle_speed
    cut = loaded.tool, engagement("down", 8e-3, 16e-3), loaded.coefficients, asked
    expected = limits_of(machine, *cut, process_damping=ProcessDamping(2e4, 0.2))["limit_depth"].values
    np.testing.assert_array_equal(result.lobes["limit_depth"], expected)
    assert np.abs(expected / limits_of(machine, *cut)["limit_depth"].values - 1.0).max() > 0.02
    assert "limit_depth_quantile" not in result.lobes
    assert "curve_limit_depth" not in result.lobes
    assert "without process_damping" in result.lobes.attrs["warnings"]
    assert result.lobes.attrs["process_damping_N_m"] == 2e4
    answer = recommend([result], loaded).best
    assert answer.status == "limit_only"
    assert "worn flank" in answer.reason
    assert "the flank is as worn at every speed as process_damping = 20 N/mm says" in answer.assumptions


@pytest.mark.parametrize(
    ("method", "worn", "expected"),
    [
        ("operating_point", 'process_damping = "20 N/mm"', "operating_point"),
        ("zero_order", "flank_friction = 0.2", "no process_damping"),
        ("zero_order", 'process_damping = "-20 N/mm"', "zero or more"),
        ("zero_order", 'process_damping = "20 N"', "process_damping"),
    ],
)
def test_a_flank_that_cannot_be_is_refused(tmp_path, method, worn, expected):
    with pytest.raises(InputError, match=expected):
        campaign(tmp_path, method, worn=worn)
