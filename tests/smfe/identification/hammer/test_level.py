"""The level of hits as the amplitude of a sine: on a machine that is integrated in time, hit and driven."""

import math

import numpy as np
import pytest
import xarray as xr
from truth import oscillator

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import make_compliance, make_record
from process.machine.modes import ModalModel
from smfe.campaign import Campaign, LobeRequest, Measurement
from smfe.identification.hammer.hammer import identify_hammer
from smfe.identification.hammer.level import impact_level
from smfe.limits.campaign_lobes import all_lobes
from smfe.progress import silent

MASS, FREQUENCY, DAMPING = 20.0, 61.0, 0.012
STIFFNESS = MASS * (2.0 * math.pi * FREQUENCY) ** 2
DASHPOT = 2.0 * DAMPING * math.sqrt(STIFFNESS * MASS)
LINEAR = {
    "mass": MASS, "stiffness": STIFFNESS, "damping": DASHPOT, "cubic_damping": 0.0, "cubic_stiffness": 0.0,
    "friction": 0.0,
}  # fmt: skip
STEP, PULSE = 2e-4, 4e-3


def hits_of(peak: float, **changed: float) -> xr.Dataset:
    f, phi, pulse = oscillator.hit(peak, PULSE, 5.0, STEP, **{**LINEAR, **changed})
    kept = (f > 20.0) & (f < 150.0)
    extra = {"force_spectrum": (("frequency", "excitation"), pulse[kept][:, None])}
    return make_compliance(f[kept], phi[kept][:, None, None], ("x",), ("x",), extra)


def test_the_level_of_hits_is_that_of_the_closed_form() -> None:
    w = 2.0 * math.pi * FREQUENCY
    pulse = 1000.0 * 2.0 * PULSE / math.pi * math.cos(0.5 * w * PULSE) / (1.0 - (w * PULSE / math.pi) ** 2)
    found = impact_level(hits_of(1000.0))
    assert found is not None
    assert found.force == pytest.approx(math.sqrt(2.0) * DAMPING * w * pulse, rel=0.01)
    assert found.force < 0.02 * 1000.0


@pytest.mark.parametrize(
    ("changed", "within"),
    [({"cubic_damping": DASHPOT / 0.048**2}, 0.06), ({"cubic_stiffness": -0.02 * STIFFNESS / 1.2e-4**2}, 0.06)],
    ids=["damping", "stiffness"],
)
@pytest.mark.parametrize("peak", [200.0, 600.0])
def test_a_sine_of_that_level_shows_what_the_hits_show(changed: dict[str, float], within: float, peak: float) -> None:
    compliance = hits_of(peak, **changed)
    level = impact_level(compliance)
    assert level is not None
    tried = level.frequency * np.linspace(0.99, 1.01, 5)
    by_hits = float(np.abs(compliance["compliance"]).max())
    sine, wrong = (oscillator.driven(f, tried, STEP, 120, **{**LINEAR, **changed}) for f in (level.force, peak))
    assert sine == pytest.approx(by_hits, rel=within)
    assert wrong < 0.2 * by_hits


def test_the_spectrum_of_the_hits_stands_beside_the_compliance() -> None:
    rate, rng = 4000.0, np.random.default_rng(5)
    t = np.arange(round(9.0 * rate)) / rate
    peaks = (300.0, 400.0, 500.0)
    force = sum(oscillator.half_sine(p, PULSE, t - 0.5 - 2.8 * i) for i, p in enumerate(peaks))
    moved = oscillator.motion(np.interp(np.arange(2 * t.size - 1) / 2.0, np.arange(t.size), force), 1 / rate, **LINEAR)
    noisy = {"force": {"x": force + 0.05 * rng.standard_normal(t.size)}, "displacement": {"x": moved}}
    found = identify_hammer("hammer", {"x": [make_record(t, noisy)]}).compliance
    spectrum = found["force_spectrum"].sel(excitation="x")
    w = 2.0 * math.pi * FREQUENCY
    shape = 2.0 * PULSE / math.pi * math.cos(0.5 * w * PULSE) / (1.0 - (w * PULSE / math.pi) ** 2)
    assert float(spectrum.interp(frequency=FREQUENCY)) == pytest.approx(
        np.sqrt(np.mean(np.square(peaks))) * shape, rel=0.01
    )
    assert spectrum.attrs["units"] == "N s"


# --- in the operating point of a campaign ----------------------------------------------------------------------------


def lobes(tmp_path, *parts):
    """Return the operating point of (measurement, compliance) pairs."""
    request = LobeRequest(tuple(m.name for m, _ in parts), "operating_point", "down", 0.05, 1e-4, np.array([900.0]))
    loaded = Campaign(
        tmp_path / "campaign.toml", "levels", Tool(0.1, 4), CuttingCoefficients(1.9e9, 5e8, 0.0),
        measurements=tuple(m for m, _ in parts), lobes=(request,),
    )  # fmt: skip
    return all_lobes(loaded, {m.name: c for m, c in parts}, silent)[0].lobes


def tap(name, method, level=None, **more):
    return Measurement(name=name, method=method, records=(), channels={}, force_level=level, **more)


def machine(damping=0.05):
    return ModalModel([FREQUENCY], [damping], [STIFFNESS], [[1.0, 0.0, 0.0]]).compliance(np.arange(20.0, 150.0, 0.5))


def hit_with(compliance, pulse):
    ones = np.full((compliance.sizes["frequency"], 3), pulse)
    return compliance.assign(force_spectrum=(("frequency", "excitation"), ones))


def test_hits_and_sines_stand_on_one_scale(tmp_path):
    # 1000 N of a hammer (2.5 N s) are a sine of 68 N here: between sines of 10 and 1000 N, not beside the latter.
    soft, stiff = machine(0.05), machine(0.2)
    hammer = hit_with(machine(0.05), 2.5)
    found = lobes(tmp_path, (tap("hits", "hammer", 1000.0), hammer), (tap("sine", "actuator", 1000.0), stiff))
    level = math.sqrt(2.0) * 0.05 * 2.0 * math.pi * FREQUENCY * 2.5
    assert f"the hits of 1000 N of 'hits' count as a sine of {level:.3g} N" in found.attrs["warnings"]
    same = lobes(tmp_path, (tap("low", "actuator", round(level, 1)), soft), (tap("sine", "actuator", 1000.0), stiff))
    np.testing.assert_allclose(found["limit_depth"], same["limit_depth"], rtol=2e-3)


def test_levels_that_are_none_of_a_sine_are_not_compared(tmp_path):
    sine = (tap("sine", "actuator", 100.0), machine())
    with pytest.raises(InputError, match="'noise' is excited at all frequencies at once"):
        lobes(tmp_path, sine, (tap("noise", "actuator", 50.0, period=2.0), machine()))
    with pytest.raises(InputError, match="'noise' is excited at all frequencies at once"):
        lobes(tmp_path, sine, (tap("noise", "actuator", 50.0), machine().assign_attrs(broadband="yes")))
    with pytest.raises(InputError, match="'hits' holds no spectrum of its hits"):
        lobes(tmp_path, sine, (tap("hits", "hammer", 50.0), machine()))
    with pytest.raises(InputError, match="'other' states no force_level"):
        lobes(tmp_path, sine, (tap("other", "actuator"), machine()))
    # With one level a feed nothing is interpolated over it, and what is assumed is said.
    moving = tap("hits", "hammer", 50.0, feed={"x": 0.01, "y": 0.0, "z": 0.0})
    rest = tap("sine", "actuator", 100.0, feed={"x": 0.0, "y": 0.0, "z": 0.0})
    found = lobes(tmp_path, (rest, machine()), (moving, machine()))
    assert "the compliance of each feed is taken at any force of the cut" in found.attrs["warnings"]
    assert "force_level" not in found


def test_each_feed_may_have_levels_of_its_own(tmp_path):
    def sine(name, level, feed):
        return tap(name, "actuator", level, feed={"x": feed / 6e4, "y": 0.0, "z": 0.0})

    parts = [
        (sine("a", 10.0, 0), machine(0.05)),
        (sine("b", 4000.0, 0), machine(0.1)),
        (sine("c", 60.0, 360), machine()),
    ]
    found = lobes(tmp_path, *parts)
    # At 900 rpm the feed is that of c alone: its level is that of a small disturbance, and the only one.
    assert "one of 10 to 60 N, the lowest level that was measured at a feed" in found.attrs["warnings"]
    np.testing.assert_allclose(found["limit_depth"], lobes(tmp_path, parts[2])["limit_depth"], rtol=1e-9)
    np.testing.assert_array_equal(found["lower_limit_depth"], found["limit_depth"])
