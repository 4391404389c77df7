"""Depths of cut as the force levels of a sweep: one compliance a depth, and whether they differ.

The machine is written as matrices and integrated by Runge and Kutta's fourth-order rule; a cubic spring makes it
stiffer the deeper it cuts. Forces are sums of three harmonics of a sweeping tooth passing, in another direction each
pass, and grow with the depth.
"""

from __future__ import annotations

import functools
import math
from pathlib import Path

import numba
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import make_compliance, make_record
from smfe import LocalPolynomial, SweepPass, compare, identify, lobes, modal, run
from smfe.campaign import load_campaign
from smfe.commands.diagnose import diagnose
from smfe.identification.errors.difference import difference_of
from smfe.identification.errors.intervals import interval
from smfe.identification.levels import levels_of, sweep_levels, with_levels
from smfe.identification.measurement import cached_identification
from smfe.planning.task import load_task
from smfe.records import write_record_netcdf
from smfe.results import read_groups

RATE, FINE = 400.0, 8
BAND = (22.0, 70.0)
CUTS = ("down", "up", "central")
DEPTHS = (1e-3, 1.5e-3, 2e-3)
WEIGHTS = np.array([200.0, 150.0, 300.0])
MASS = np.diag(WEIGHTS)
STIFFNESS = np.array([[20e6, 2e6, 3e6], [2e6, 9e6, 1e6], [3e6, 1e6, 11e6]])
DAMPING = 8.0 * MASS + 1.5e-4 * STIFFNESS
SPRING = np.array([0.3, 0.8, 0.52])
COARSE = LocalPolynomial(resolution=1.0)
QUICK = LocalPolynomial(2.0, (0.5, 1.0, 2.0), rational=False)


@numba.njit(cache=True)
def _slope(y, fx, fy, fz, at, mass, damping, stiffness, spring, cubic):
    """Write the derivatives of places y[:3] and velocities y[3:6] to `at`; the masses are diagonal."""
    stretch = spring[0] * y[0] + spring[1] * y[1] + spring[2] * y[2]
    pull = cubic * stretch**3
    for i in range(3):
        force = (fx if i == 0 else (fy if i == 1 else fz)) - pull * spring[i]
        for k in range(3):
            force -= damping[i, k] * y[3 + k] + stiffness[i, k] * y[k]
        at[i] = y[3 + i]
        at[3 + i] = force / mass[i]


@numba.njit(cache=True)
def _integrate(force, h, keep, mass, damping, stiffness, spring, cubic):
    """Acceleration at every `keep`-th step of 2 h; `force` has a column each half step."""
    steps = force.shape[1] // 2
    y, z, k, total = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    out = np.zeros((3, steps // keep))
    for i in range(steps - 1):
        for stage in range(4):
            at = 2 * i + (stage + 1) // 2
            reach = 0.0 if stage == 0 else (2.0 * h if stage == 3 else h)
            for n in range(6):
                z[n] = y[n] + reach * k[n]
            _slope(z, force[0, at], force[1, at], force[2, at], k, mass, damping, stiffness, spring, cubic)
            for n in range(6):
                total[n] = k[n] + (0.0 if stage == 0 else total[n]) + (k[n] if stage in (1, 2) else 0.0)
            if stage == 0 and i % keep == 0:
                for n in range(3):
                    out[n, i // keep] = k[3 + n]
        for n in range(6):
            y[n] += h / 3.0 * total[n]
    return out


@functools.cache
def clean(number: int, depth: float, cubic: float, seconds: float = 16.0) -> xr.Dataset:
    """Return a pass without noise: 0.5 s of air, the tooth passing from 20 to 45 Hz, 2 s of air."""
    total = seconds + 2.5
    t = np.arange(round(total * RATE) * FINE * 2) / (RATE * FINE * 2)
    into = np.clip(t - 0.5, 0.0, seconds)
    angle = 2.0 * np.pi * (20.0 * into + 0.5 * 25.0 / seconds * into**2)
    rng = np.random.default_rng(100 + number)
    edge = np.clip(into / 0.2, 0.0, 1.0) * np.clip((seconds - into) / 0.2, 0.0, 1.0)
    force = np.zeros((3, t.size))
    for h, share in ((1, 90e3), (2, 50e3), (3, 25e3)):
        force += share * rng.standard_normal((3, 1)) * np.cos(h * angle)
        force += share * rng.standard_normal((3, 1)) * np.sin(h * angle)
    force *= depth * np.sin(0.5 * np.pi * edge) ** 2
    motion = _integrate(force, 0.5 / (RATE * FINE), FINE, WEIGHTS, DAMPING, STIFFNESS, SPRING, float(cubic))
    seen = force[:, :: 2 * FINE]
    record = make_record(
        np.arange(motion.shape[1]) / RATE,
        {"force": dict(zip("xyz", seen, strict=True)), "acceleration": dict(zip("xyz", motion, strict=True))},
    )
    record["spindle_speed"] = (
        "time",
        30.0 * np.gradient(angle[:: 2 * FINE], 1.0 / RATE) / (2.0 * np.pi),
        {"units": "rpm"},
    )
    return record


def study(cubic: float, seed: int, depths: tuple[float, ...] = DEPTHS, noise: float = 3e-3) -> dict:
    """Return depth -> three passes with the noise of accelerometers and a dynamometer."""
    rng = np.random.default_rng(seed)
    out = {}
    for depth in depths:
        out[depth] = []
        for number, cut in enumerate(CUTS):
            record = clean(number, depth, cubic).copy()
            record["force"] = record["force"] + 0.3 * rng.standard_normal(record["force"].shape)
            record["acceleration"] = record["acceleration"] + noise * rng.standard_normal(record["force"].shape)
            out[depth].append(SweepPass(record, cut))
    return out


def linear(frequency: np.ndarray) -> np.ndarray:
    """Return the inverse of ``K + j w C - w^2 M``."""
    w = 2.0 * np.pi * frequency[:, None, None]
    return np.linalg.inv(STIFFNESS + 1j * w * DAMPING - w**2 * MASS)


@pytest.fixture(scope="module")
def straight():
    return sweep_levels("study", study(0.0, 1), BAND, QUICK)


def test_levels_of_a_linear_machine_agree_within_their_intervals(straight) -> None:
    whole = straight.compliance
    assert whole["compliance"].dims == ("depth_of_cut", "frequency", "response", "excitation")
    assert whole["depth_of_cut"].values.tolist() == [1.0, 1.5, 2.0]
    assert whole["depth_of_cut"].attrs["units"] == "mm"
    truth, bounds = linear(whole["frequency"].values), interval(whole)
    for part in ("real", "imag"):
        low, high = (getattr(bounds[n].values, part) for n in ("lower", "upper"))
        inside = (low <= getattr(truth, part)) & (getattr(truth, part) <= high)
        assert 0.88 < inside.mean() <= 1.0
    test = straight.tables["level_test"]
    assert len(test) == 3
    assert not test["differs"].any()
    assert (test["difference_percent"] < 1.0).all()
    assert not any("depends on the depth" in w for w in straight.warnings)


def test_levels_carry_the_force_that_they_were_made_with(straight) -> None:
    whole = straight.compliance
    rms, peak = whole["force_rms"].values, whole["force_peak"].values
    np.testing.assert_allclose(rms / rms[0], [1.0, 1.5, 2.0], rtol=0.01)
    record = study(0.0, 1, (1e-3,), 0.0)[1e-3]
    size = [np.sqrt((p.record["force"].values ** 2).sum(axis=0))[400:6500] for p in record]
    assert rms[0] == pytest.approx(math.sqrt(np.mean([np.mean(s**2) for s in size])), rel=0.01)
    assert peak[0] == pytest.approx(max(s.max() for s in size), rel=0.01)
    assert straight.tables["levels"]["passes"].tolist() == [3, 3, 3]
    assert (whole["compliance_std"].mean(("frequency", "response", "excitation")).diff("depth_of_cut") < 0.0).all()


def test_a_machine_that_stiffens_with_the_level_is_found_out() -> None:
    found = sweep_levels("study", study(8e13, 2), BAND, QUICK)
    test = found.tables["level_test"].set_index(["depth_a_mm", "depth_b_mm"])
    assert bool(test.loc[(1.0, 2.0), "differs"])
    assert test.loc[(1.0, 2.0), "difference_percent"] > test.loc[(1.0, 1.5), "difference_percent"]
    (text,) = [w for w in found.warnings if "depends on the depth of cut" in w]
    assert "2 mm and 1 mm" in text
    f = found.compliance["frequency"].values
    peak = np.abs(found.compliance["compliance"].sel(response="y", excitation="y").values).argmax(axis=1)
    assert f[peak[2]] >= f[peak[0]]


@pytest.mark.slow
def test_noise_alone_seldom_makes_levels_of_a_linear_machine_differ() -> None:
    p = [sweep_levels("s", study(0.0, k, (1e-3, 2e-3)), BAND, COARSE).tables["level_test"]["p"][0] for k in range(12)]
    # 5 % in 12, and their scatter; the level of the verdict is 1 %.
    assert np.sum(np.array(p) < 0.05) <= 2
    assert np.sum(np.array(p) < 0.01) <= 1


def known(value: np.ndarray, std: float, rng: np.random.Generator, degrees_of_freedom: float = np.inf) -> xr.Dataset:
    """A compliance with circular errors of known size, independent from line to line."""
    noise = rng.standard_normal((2, *value.shape))
    scatter = (
        math.sqrt(rng.chisquare(degrees_of_freedom) / degrees_of_freedom) if np.isfinite(degrees_of_freedom) else 1.0
    )
    dims = ("frequency", "response", "excitation")
    extra = {
        "compliance_std": (dims, np.full(value.shape, std * scatter)),
        "degrees_of_freedom": (dims, np.full(value.shape, degrees_of_freedom)),
    }
    return make_compliance(
        np.arange(float(len(value))) + 1.0, value + std * (noise[0] + 1j * noise[1]) / math.sqrt(2.0), "xy", "xy", extra
    )


# The standard deviations of the share and of the mean of so many p-values are sqrt(0.05 0.95/n) and sqrt(1/12 n).
@pytest.mark.parametrize("pairs", [80, pytest.param(400, marks=pytest.mark.slow)])
def test_the_p_value_of_a_difference_is_uniform_without_one_and_small_with_one(pairs: int) -> None:
    rng, share, mean = np.random.default_rng(3), 0.7 / math.sqrt(pairs), 1.2 / math.sqrt(pairs)
    value = np.full((20, 2, 2), 1e-6 + 0j)
    p = np.array([difference_of(*(known(value, 1e-8, rng) for _ in range(2))).p_value for _ in range(pairs)])
    assert abs(np.mean(p < 0.05) - 0.05) < share
    assert abs(p.mean() - 0.5) < mean
    # Rows that share all their noise: the same mean, twice the scatter.
    both = [known(value, 1e-8, rng) for _ in range(2 * pairs)]
    for c in both:
        c["compliance"][:, 1] = c["compliance"][:, 0]
        shared = np.einsum("jl,ik->ijkl", np.eye(2), np.ones((2, 2)))[None] * np.full((20, 1, 1, 1, 1), 1e-16 + 0j)
        c["entry_covariance"] = (("frequency", "response", "excitation", "other_response", "other_excitation"), shared)
    p = np.array([difference_of(*pair).p_value for pair in zip(both[::2], both[1::2], strict=True)])
    assert abs(np.mean(p < 0.05) - 0.05) < share
    other = difference_of(known(value, 1e-8, rng), known(1.02 * value, 1e-8, rng))
    assert other.p_value < 1e-6
    assert other.size == pytest.approx(0.02, rel=0.2)
    with pytest.raises(InputError, match="share no frequency"):
        difference_of(known(value, 1e-8, rng).isel(frequency=[0]), known(value, 1e-8, rng).isel(frequency=[1]))


# --- campaigns --------------------------------------------------------------------------------------------------------

HEAD = """
[campaign]
name = "levels"
[tool]
diameter = "80 mm"
teeth = 2
[material]
Ktc = "1800 N/mm^2"
Krc = "700 N/mm^2"
Kac = "250 N/mm^2"
[[measurement]]
name = "sweep"
method = "sweep"
frequency_range = ["24 Hz", "60 Hz"]
resolution = "1 Hz"
estimator = "bands"
"""


def campaign(folder: Path, depths: dict[str, list[str]], keys: str = "") -> Path:
    """Write a campaign whose passes are files named after cut and depth."""
    width = {"down": 24, "up": 40, "central": 68}
    rows = [
        f'    {{ file = "{cut}_{depth}.nc", cut = "{cut}", width_of_cut = "{width[cut]} mm", '
        f'depth_of_cut = "{depth}" }},'
        for depth, cuts in depths.items()
        for cut in cuts
    ]
    path = folder / "campaign.toml"
    path.write_text(HEAD + "records = [\n" + "\n".join(rows) + "\n]\n" + keys, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("levels")
    for depth, passes in study(8e13, 5, (1e-3, 2e-3)).items():
        for p in passes:
            write_record_netcdf(p.record, where / f"{p.label}_{1e3 * depth:g} mm.nc")
    return where


LOBE = """
[[lobes]]
measurements = ["sweep, 2 mm"]
method = "zero_order"
cut = "down"
width_of_cut = "60 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["800 rpm", "1200 rpm"]
"""


@pytest.mark.slow
def test_a_campaign_with_two_depths_gives_levels_by_default(folder: Path, tmp_path: Path) -> None:
    depths = {"1 mm": list(CUTS), "2 mm": list(CUTS)}
    path = campaign(folder, depths, LOBE)
    identify(path, tmp_path / "frf.nc")
    groups = read_groups(tmp_path / "frf.nc")
    assert set(groups) == {"sweep", "sweep, 1 mm", "sweep, 2 mm"}
    cube = read_groups(tmp_path / "conditions.nc")["sweep, by level"]
    assert cube["compliance"].sel(depth_of_cut=2.0).values == pytest.approx(
        groups["sweep, 2 mm"]["compliance"].values, nan_ok=True
    )
    assert cube["force_peak"].values[1] > 1.9 * cube["force_peak"].values[0]


@pytest.mark.slow
def test_comparison_and_lobes_name_the_levels(folder: Path, tmp_path: Path) -> None:
    path = campaign(folder, {"1 mm": list(CUTS), "2 mm": list(CUTS)}, LOBE)
    identify(path, tmp_path / "frf.nc")
    table = compare(tmp_path / "frf.nc", tmp_path / "comparison.csv")
    assert set(table["measurement_a"]) == {"sweep, 1 mm"}
    assert set(table["measurement_b"]) == {"sweep, 2 mm"}
    explained = pd.read_csv(tmp_path / "explained.csv")
    assert set(explained["factor"]) == {"level"}
    assert set(explained["categories"]) == {"1 mm, 2 mm"}
    assert explained[explained["quantity"] == "frequency"]["significant"].any()
    (result,) = lobes(path, tmp_path / "lobes.nc", frf=tmp_path / "frf.nc")
    assert result.source == "sweep, 2 mm"


def test_one_depth_stays_one_estimate_with_its_level(folder: Path, tmp_path: Path) -> None:
    identify(campaign(folder, {"2 mm": list(CUTS)}), tmp_path / "frf.nc")
    groups = read_groups(tmp_path / "frf.nc")
    assert set(groups) == {"sweep"}
    assert '"depth_of_cut": "2 mm"' in groups["sweep"].attrs["conditions"]
    assert not (tmp_path / "conditions.nc").exists()
    # Who asks for the measurement without its levels is given what was kept.
    loaded = load_campaign(folder / "campaign.toml")
    assert all(
        cached_identification(loaded, m, tmp_path / ".kept")[1]
        for m in (loaded.measurements[0], with_levels(loaded).measurements[0])
    )


def write_steady_cut(folder: Path) -> None:
    """Ten seconds of the tooth passing and a little noise, at 800 rpm."""
    t = np.arange(round(10.0 * RATE)) / RATE
    tooth = np.cos(2.0 * np.pi * 800.0 / 30.0 * t) + 1e-3 * np.random.default_rng(1).standard_normal(t.size)
    cut = make_record(t, {"acceleration": dict.fromkeys("xyz", tooth)})
    cut["spindle_speed"] = ("time", np.full(t.size, 800.0), {"units": "rpm"})
    write_record_netcdf(cut, folder / "cut.nc")


TEST = """
[[cutting_test]]
file = "cut.nc"
spindle_speed = "800 rpm"
depth_of_cut = "1 mm"
cut = "down"
width_of_cut = "24 mm"
feed_per_tooth = "0.1 mm"
observed = "stable"
"""


@pytest.mark.slow
def test_every_verb_knows_the_levels(folder: Path, tmp_path: Path) -> None:
    write_steady_cut(folder)
    depths, rest = {"1 mm": list(CUTS), "2 mm": list(CUTS)}, '[plan]\nmachine = "sweep, 2 mm"\n'
    path = campaign(folder, depths, '[baseline]\nlimits = "sweep, 2 mm"\n' + TEST + rest)
    assert load_task(path).estimate.name == "sweep, 2 mm"
    (found,) = modal(path, tmp_path / "modes.toml", "sweep, 2 mm").values()
    assert len(found.table()) >= 2
    # The level is asked for its modes first. A machine that stiffens hardly has any, and one stable cut bounds nothing.
    said = r"'sweep, 2 mm' does not give the modes|every cut was stable|no limit is bracketed"
    with pytest.raises(InputError, match=said):
        diagnose(path, tmp_path / "finding.json")


@pytest.mark.slow
def test_an_operating_point_over_the_depths_predicts_a_cutting_test(folder: Path, tmp_path: Path) -> None:
    lobe = LOBE.replace('["sweep, 2 mm"]', '["sweep, 1 mm", "sweep, 2 mm"]').replace("zero_order", "operating_point")
    write_steady_cut(folder)
    run(campaign(folder, {"1 mm": list(CUTS), "2 mm": list(CUTS)}, lobe + TEST), tmp_path)
    table = pd.read_csv(tmp_path / "chatter.csv")
    assert table["predicted_sweep, 1 mm + sweep, 2 mm"].isin(["stable", "chatter"]).all()


@pytest.mark.slow
def test_levels_of_an_earlier_run_do_not_stay(folder: Path, tmp_path: Path) -> None:
    depths = {"1 mm": list(CUTS), "2 mm": list(CUTS)}
    (tmp_path / "conditions.nc").write_bytes(b"of an earlier run")
    (tmp_path / "loops.nc").write_bytes(b"of an earlier run")
    identify(campaign(folder, depths, "split_levels = false\n"), tmp_path / "frf.nc")
    assert not (tmp_path / "conditions.nc").exists()
    assert not (tmp_path / "loops.nc").exists()


@pytest.mark.parametrize("name", ["conditions.nc", "loops.nc"])
def test_compliances_are_not_written_where_other_results_stand(folder: Path, tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=rf"{name} is what another file .* write to frf.nc"):
        identify(campaign(folder, {"2 mm": list(CUTS)}), tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_sweeps_are_stacked_at_the_depth_of_their_records(folder: Path, tmp_path: Path) -> None:
    """The measurement says 2 mm, and all its records 1 mm."""
    path = campaign(folder, {"1 mm": list(CUTS)}, 'depth_of_cut = "2 mm"\n')
    first = path.read_text(encoding="utf-8")
    second = campaign(folder, {"2 mm": list(CUTS)}).read_text(encoding="utf-8").split("[[measurement]]")[1]
    path.write_text(first + "[[measurement]]" + second.replace('"sweep"', '"deep"', 1), encoding="utf-8")
    identify(path, tmp_path / "frf.nc")
    cube = read_groups(tmp_path / "conditions.nc")["sweep, estimator bands"]
    assert cube["depth_of_cut"].values.tolist() == [1.0, 2.0]


def test_split_levels_false_keeps_one_estimate_of_all_passes(folder: Path) -> None:
    loaded = load_campaign(campaign(folder, {"1 mm": list(CUTS), "2 mm": ["down"]}, "split_levels = false\n"))
    assert levels_of(loaded.measurements[0]) == {}
    assert [m.name for m in with_levels(loaded).measurements] == ["sweep"]


@pytest.mark.parametrize(
    ("depths", "keys", "message"),
    [
        ({"1 mm": list(CUTS), "2 mm": ["down"]}, "", r"at a depth of cut of 2 mm there is only down 24 mm: 1 passes"),
        (
            {"1 mm": list(CUTS), "2 mm": ["down", "up"]},
            "",
            r"only down 24 mm and up 40 mm: .* add a pass with cut = 'c",
        ),
        ({"1 mm": list(CUTS)}, "split_levels = true\n", "its records do not state several; take it out"),
    ],
)
def test_a_level_that_lacks_passes_says_which(folder: Path, depths: dict, keys: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_campaign(campaign(folder, depths, keys))


def test_a_pass_of_unknown_level_among_others_is_refused(folder: Path) -> None:
    path = campaign(folder, {"1 mm": list(CUTS), "2 mm": list(CUTS)})
    text = path.read_text(encoding="utf-8").replace(', depth_of_cut = "2 mm" }', " }", 1)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"some passes state a depth of cut .* and others none"):
        load_campaign(path)
