"""Hammer: how often the 95 % interval of a compliance holds the truth, part by part, for few hits and many."""

import numpy as np
import pytest
import xarray as xr
from scipy import signal

from process.errors import InputError
from process.labels import make_compliance, make_record
from smfe.identification.errors.intervals import component_std, interval, student_quantile
from smfe.identification.hammer.hammer import Averaging, identify_hammer

# Two coupled modes seen in x and y: closed form, and exact motion under a force that is linear between samples.
FREQUENCY, DAMPING, STIFFNESS = np.array([45.0, 80.0]), np.array([0.03, 0.04]), np.array([2e6, 5e6])
SHAPE = np.array([[1.0, 0.5], [-0.4, 1.0]])  # mode, axis
RATE, SPACING, PULSE = 1000.0, 1.2, 5e-3
BAND = (30.0, 110.0)


def exact(frequency: np.ndarray, excitation: int = 0) -> np.ndarray:
    """Compliance (f, 2); a force that is linear between samples has sinc^2 of the transform of its samples."""
    r = frequency[:, None] / FREQUENCY
    modes = 1.0 / (STIFFNESS * (1.0 - r**2 + 2j * DAMPING * r))
    return (modes * SHAPE[:, excitation]) @ SHAPE * np.sinc(frequency / RATE)[:, None] ** 2


def response(force: np.ndarray, excitation: int = 0) -> np.ndarray:
    out = np.zeros((2, force.size))
    for f, zeta, k, shape in zip(FREQUENCY, DAMPING, STIFFNESS, SHAPE, strict=True):
        w = 2.0 * np.pi * f
        system = [w**2 / k], [1.0, 2.0 * zeta * w, w**2]
        b, a, _ = signal.cont2discrete(system, 1.0 / RATE, method="foh")
        q = signal.lfilter(b.ravel(), a, shape[excitation] * force)
        out += np.outer(shape, q)
    return out


def clean_hits(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Force and displacement of each hit alone, shapes (count, n) and (count, 2, n); levels differ by a third."""
    n = round(SPACING * RATE)
    t = np.arange(n) / RATE - 0.03
    pulse = np.where((t >= 0.0) & (t <= PULSE), np.sin(np.pi * t / PULSE), 0.0)
    levels = 100.0 * (1.0 + 0.3 * np.linspace(-1.0, 1.0, count))
    moved = response(pulse)
    return levels[:, None] * pulse, levels[:, None, None] * moved


def noisy(
    clean: tuple[np.ndarray, np.ndarray], seed: int, force: float = 0.0, motion: float = 0.0, scatter: float = 0.0
) -> xr.Dataset:
    """One record; noise as share of the peak force and of the rms motion, hits that differ by a gain each."""
    rng = np.random.default_rng(seed)
    f, x = clean
    gain = 1.0 + scatter * rng.standard_normal(f.shape[0])
    displacement = np.concatenate(list(x * gain[:, None, None]), axis=1)
    displacement = displacement + motion * x.std() * rng.standard_normal(displacement.shape)
    total = f.ravel() + force * f.max() * rng.standard_normal(f.size)
    channels = {"force": {"x": total}, "displacement": {"x": displacement[0], "y": displacement[1]}}
    return make_record(np.arange(total.size) / RATE, channels)


def coverage(
    count: int, seeds: int, averaging: Averaging | None = None, gate: bool = False, **noise: float
) -> np.ndarray:
    """Share of seeds and lines in which the real and the imaginary part are inside their interval, (response, part)."""
    clean = clean_hits(count)
    inside = []
    for seed in range(seeds):
        record = noisy(clean, seed, **noise)
        found = identify_hammer(
            "hits", {"x": [record]}, frequency_range=BAND, averaging=averaging, gate_force=gate, exclude=()
        ).compliance
        bounds = interval(found)
        truth = exact(found["frequency"].values)
        low, high = bounds["lower"].values[:, :, 0], bounds["upper"].values[:, :, 0]
        real = (low.real <= truth.real) & (truth.real <= high.real)
        imaginary = (low.imag <= truth.imag) & (truth.imag <= high.imag)
        inside.append(np.stack([real.mean(axis=0), imaginary.mean(axis=0)], axis=1))
    return 100.0 * np.mean(inside, axis=0)


CASES = {
    "response noise, 3 hits": (3, {"motion": 0.3}, None, False),
    "response noise, 10 hits": (10, {"motion": 0.3}, None, False),
    "hits that differ by 3 %, 3 hits": (3, {"motion": 0.02, "scatter": 0.03}, None, False),
    "hits that differ by 3 %, 5 hits": (5, {"motion": 0.02, "scatter": 0.03}, None, False),
    "force noise and all, H1": (5, {"force": 0.001, "motion": 0.2, "scatter": 0.01}, None, False),
    "force noise and all, force window": (5, {"force": 0.02, "motion": 0.2, "scatter": 0.01}, None, True),
    "force noise and all, Hv": (5, {"force": 0.01, "motion": 0.2, "scatter": 0.01}, Averaging("Hv"), False),
    "hits that differ by 1 %, exponential window": (
        5,
        {"motion": 0.05, "scatter": 0.01},
        Averaging(exponential_window=0.3),
        False,
    ),
}


@pytest.mark.parametrize(
    "seeds", [pytest.param(n, marks=m) for n, m in ((100, pytest.mark.slow), (200, pytest.mark.exam))]
)
@pytest.mark.parametrize("case", CASES, ids=list(CASES))
def test_intervals_hold_the_truth_as_often_as_they_say(case: str, seeds: int) -> None:
    """95 % intervals over 200 seeds: 92 to 98 % for each response and part."""
    count, noise, averaging, gate = CASES[case]
    found = coverage(count, seeds, averaging, gate, **noise)
    assert found.min() > 92.0
    assert found.max() < 98.0


# --- what an interval is -------------------------------------------------------------------------------------------


def test_quantiles_are_those_of_the_tables() -> None:
    """Student's two-sided 95 % for 1, 2, 4, 9 and many degrees of freedom."""
    table = [12.706, 4.303, 2.776, 2.262, 1.960]
    assert student_quantile(np.array([1.0, 2.0, 4.0, 9.0, np.inf]), 0.95) == pytest.approx(table, abs=1e-3)
    assert np.isnan(student_quantile(np.array([0.0, np.nan]), 0.95)).all()


def small(std: float, relation: complex | None = None, freedom: float | None = None) -> xr.Dataset:
    dims = ("frequency", "response", "excitation")
    extra = {"compliance_std": (dims, np.full((1, 1, 1), std))}
    if relation is not None:
        extra["compliance_relation"] = (dims, np.full((1, 1, 1), relation))
    if freedom is not None:
        extra["degrees_of_freedom"] = (dims, np.full((1, 1, 1), freedom))
    return make_compliance([50.0], np.full((1, 1, 1), 2.0 - 3.0j), ["x"], ["x"], extra)


def test_an_interval_by_hand() -> None:
    """Circular errors: each part has std/sqrt 2. A relation of std^2 puts all of it into the real part."""
    bounds = interval(small(0.2))
    assert bounds["upper"].item() == pytest.approx(2.0 - 3.0j + (1 + 1j) * 1.95996 * 0.2 / np.sqrt(2.0))
    assert bounds["lower"].item() == pytest.approx(2.0 - 3.0j - (1 + 1j) * 1.95996 * 0.2 / np.sqrt(2.0))
    bounds = interval(small(0.2, 0.04, 2.0), 0.95)
    assert bounds["upper"].item() == pytest.approx(2.0 - 3.0j + 4.3027 * 0.2, rel=1e-4)
    assert bounds.attrs["probability"] == 0.95


def test_conditions_do_not_disturb_an_interval() -> None:
    both = xr.concat([small(0.2), small(0.4)], dim="force_level")
    assert interval(both)["upper"].dims == both["compliance"].dims
    real, imaginary = component_std(both)
    assert real.values.ravel() == pytest.approx([0.2 / np.sqrt(2.0), 0.4 / np.sqrt(2.0)])
    assert imaginary.values.ravel() == pytest.approx(real.values.ravel())


@pytest.mark.parametrize("probability", [0.0, 1.0, 95.0])
def test_a_probability_that_is_none(probability: float) -> None:
    with pytest.raises(InputError, match="give one above 0 and below 1"):
        interval(small(0.2), probability)


def test_no_interval_without_a_standard_deviation() -> None:
    with pytest.raises(InputError, match="no compliance_std, so no interval can be given"):
        interval(small(0.2).drop_vars("compliance_std"))


# --- what the hits have in common ----------------------------------------------------------------------------------


def test_a_gain_that_changes_from_hit_to_hit_is_an_error_along_the_compliance() -> None:
    """d = e H: relation H^2/|H|^2 std^2, and full correlation between responses and over the whole band."""
    record = noisy(clean_hits(6), seed=3, motion=1e-5, scatter=0.05)
    found = identify_hammer("gain", {"x": [record]}, frequency_range=BAND).compliance
    h, std = found["compliance"].values, found["compliance_std"].values
    expected = (h / np.abs(h)) ** 2 * std**2
    strong = np.abs(h) > 0.3 * np.abs(h).max()
    assert found["compliance_relation"].values[strong] == pytest.approx(
        expected[strong], rel=0.05, abs=0.05 * std.max() ** 2
    )
    here = found["deviation"].sel(excitation="x")
    one, other = (here.sel(response=r).sel(frequency=f, method="nearest").values for f, r in ((45.0, "x"), (78.0, "y")))
    shared, alone = abs(np.vdot(other, one)), np.linalg.norm(one) * np.linalg.norm(other)
    assert shared == pytest.approx(alone, rel=0.02)


def test_noise_of_the_response_is_an_error_of_one_response_and_one_line() -> None:
    """Over 60 lines and 30 hits the correlations average out to a few per cent, and so does the relation."""
    record = noisy(clean_hits(30), seed=4, motion=0.2)
    found = identify_hammer("noise", {"x": [record]}, frequency_range=BAND).compliance
    d = found["deviation"].values[:30, :, :, 0]
    size = np.sqrt(np.sum(np.abs(d) ** 2, axis=0))
    between = np.sum(d[:, :, 0] * d[:, :, 1].conj(), axis=0) / (size[:, 0] * size[:, 1])
    beside = np.sum(d[:, 1:, 0] * d[:, :-1, 0].conj(), axis=0) / (size[1:, 0] * size[:-1, 0])
    assert abs(between.mean()) < 0.08
    assert abs(beside.mean()) < 0.08
    assert abs(np.mean(found["compliance_relation"].values / found["compliance_std"].values ** 2)) < 0.08


def test_the_covariance_has_the_form_of_that_of_a_sweep() -> None:
    found = identify_hammer("form", {"x": [noisy(clean_hits(4), 1, motion=0.1)]}, frequency_range=BAND).compliance
    covariance = found["compliance_covariance"]
    assert covariance.dims == ("frequency", "response", "excitation", "other_excitation")
    own = covariance.values[:, :, 0, 0]
    assert own.real == pytest.approx(found["compliance_std"].values[:, :, 0] ** 2)
    # Four hits whose forces differ by up to 1.9 carry less than four equal ones, which have 3.
    assert found["degrees_of_freedom"].values == pytest.approx(2.45, abs=0.05)


# --- what changes nothing but itself -------------------------------------------------------------------------------


def pair() -> dict[str, list[xr.Dataset]]:
    record = noisy(clean_hits(4), seed=7, motion=0.05, force=1e-4, scatter=0.01)
    return {"x": [record.isel(time=slice(0, 2400)), record.isel(time=slice(2400, None))]}


@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv"])
def test_the_order_of_records_does_not_matter(estimator: str) -> None:
    how = {"frequency_range": BAND, "averaging": Averaging(estimator)}
    one = identify_hammer("a", pair(), **how).compliance
    two = identify_hammer("a", {"x": pair()["x"][::-1]}, **how).compliance
    for name in ("compliance", "compliance_std", "compliance_relation", "degrees_of_freedom", "coherence"):
        assert two[name].values == pytest.approx(one[name].values, rel=1e-6, abs=0.0, nan_ok=True)


@pytest.mark.parametrize("estimator", ["H1", "H2", "Hv"])
def test_units_and_signs_scale_the_compliance_and_nothing_else(estimator: str) -> None:
    """Force in kN, displacement in mm, force turned round: H times -1e6 with its standard deviation."""
    how = {"frequency_range": BAND, "averaging": Averaging(estimator)}
    one = identify_hammer("a", pair(), **how).compliance
    changed = {"x": [r.assign(force=-1e-3 * r["force"], displacement=1e3 * r["displacement"]) for r in pair()["x"]]}
    two = identify_hammer("a", changed, **how).compliance
    assert two["compliance"].values == pytest.approx(-1e6 * one["compliance"].values, rel=1e-6)
    assert two["compliance_std"].values == pytest.approx(1e6 * one["compliance_std"].values, rel=1e-6)
    assert two["coherence"].values == pytest.approx(one["coherence"].values, rel=1e-9)


@pytest.mark.parametrize("labels", ["yx", "zy", "xz"])
def test_names_of_axes_are_names(labels: str) -> None:
    """x and y called otherwise: the same numbers under the other names."""
    one = identify_hammer("a", pair(), frequency_range=BAND).compliance
    renamed = []
    for r in pair()["x"]:
        force, moved = r["force"].sel(axis="x").values, r["displacement"].values
        channels = {"force": {labels[0]: force}, "displacement": {labels[0]: moved[0], labels[1]: moved[1]}}
        renamed.append(make_record(r["time"].values, channels))
    two = identify_hammer("a", {labels[0]: renamed}, frequency_range=BAND).compliance
    for old, new in zip("xy", labels, strict=True):
        a = one["compliance"].sel(response=old, excitation="x").values
        b = two["compliance"].sel(response=new, excitation=labels[0]).values
        assert b == pytest.approx(a, rel=1e-9)
