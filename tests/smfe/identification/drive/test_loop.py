"""Drive loops: the response to a setpoint that repeats itself, and the trace that a Sinumerik control stores."""

import json
import os
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from places import CHECKOUT
from scipy import signal

import smfe
from process.errors import InputError
from process.labels import make_record
from smfe.commands.check import check
from smfe.identification.drive.loop import identify_loop
from smfe.identification.spectra.periods import find_period
from smfe.records import Channel, read_records
from smfe.records.formats.controls.sinumerik import DIGITS, numbers
from smfe.results import read_groups

REPOSITORY = CHECKOUT
SHARED = Path(os.environ.get("SMFE_DATA", REPOSITORY.parent / "shared" / "data")) / "sinumerik_speedloop"
RATE = 8000.0
TRACE = {"reference_speed_x": Channel("62", "m/s"), "encoder_speed_x": Channel("61", "m/s")}


@pytest.fixture
def trace() -> Path:
    if not (SHARED / "freq_trace.XML").is_file():
        pytest.skip("public data not here: sinumerik_speedloop (set SMFE_DATA)")
    return SHARED / "freq_trace.XML"


def prbs(order: int) -> np.ndarray:
    """One period of a binary sequence of maximum length: 2^order - 1 samples of -1 and 1."""
    return 2.0 * signal.max_len_seq(order)[0] - 1.0


def first_order(setpoint: np.ndarray, corner: float) -> tuple[np.ndarray, np.ndarray]:
    """A lag y_k = a y_k-1 + (1 - a) u_k with its exact response at 1, 2, ... lines of a period."""
    a = np.exp(-2.0 * np.pi * corner / RATE)
    z = np.exp(-2j * np.pi * np.arange(1, setpoint.size) / setpoint.size)
    return signal.lfilter([1.0 - a], [1.0, -a], np.tile(setpoint, 6)), (1.0 - a) / (1.0 - a * z)


def record(setpoint: np.ndarray, actual: np.ndarray):
    channels = {"reference_speed": {"x": setpoint}, "encoder_speed": {"x": actual}}
    return make_record(np.arange(setpoint.size) / RATE, channels, attrs={"source": "r.csv"})


def test_a_lag_is_found_as_it_is_written_down() -> None:
    """Without noise: the closed form at every line, its -3 dB frequency, its 45 degrees, the feed."""
    one = prbs(10)
    y, exact = first_order(0.01 + 0.002 * one, 40.0)
    found = identify_loop("lag", [record(np.tile(0.01 + 0.002 * one, 6), y)])
    t = found.response["loop_response"].values[0]
    np.testing.assert_allclose(t, exact[: t.size], atol=1e-6)  # the first period, where the lag settles, is dropped
    row = found.table.iloc[0]
    assert row["setpoint"] == "PRBS of order 10"
    assert row["periods"] == 5
    assert row["feed_mm_min"] == pytest.approx(600.0, rel=0.01)  # 1023 bits have one more 1 than -1
    assert row["setpoint_rms_mm_min"] == pytest.approx(120.0, rel=1e-3)
    # The corner of the sampled lag: |T| = 1/sqrt(2) where cos(w) = 1 - (1 - a)^2 / (2 a).
    a = np.exp(-2.0 * np.pi * 40.0 / RATE)
    corner = RATE / (2.0 * np.pi) * np.arccos(1.0 - (1.0 - a) ** 2 / (2.0 * a))
    assert row["bandwidth_Hz"] == pytest.approx(corner, rel=0.01)
    assert row["lag_ms"] == pytest.approx(1e3 / (2.0 * np.pi * 40.0), rel=0.07)  # curved between its two lines


def test_the_standard_deviation_is_the_error() -> None:
    """Noise of 5 % of the setpoint, 40 seeds: the error of T over its stated std has mean square one."""
    one = 0.002 * prbs(9)
    y, exact = first_order(one, 60.0)
    ratio = []
    for seed in range(40):
        noisy = y + 1e-4 * np.random.default_rng(seed).standard_normal(y.size)
        found = identify_loop("lag", [record(np.tile(one, 6), noisy)]).response
        error = found["loop_response"].values[0] - exact[: found.sizes["frequency"]]
        ratio.append(np.mean(np.abs(error) ** 2) / np.mean(found["loop_response_std"].values[0] ** 2))
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.03)


def test_a_position_loop_is_the_same_ratio() -> None:
    """Speeds summed up to positions on a ramp: differenced, they are what they were."""
    one = 0.01 + 0.002 * prbs(8)
    y, exact = first_order(one, 100.0)
    u = np.tile(one, 6)
    positions = {"reference_position": {"y": np.cumsum(u) / RATE}, "encoder_position": {"y": np.cumsum(y) / RATE}}
    found = identify_loop("p", [make_record(np.arange(u.size) / RATE, positions)])
    assert (found.response.attrs["loop"], found.response.attrs["axis"]) == ("position", "y")
    t = found.response["loop_response"].values[0]
    np.testing.assert_allclose(t, exact[: t.size], atol=1e-5)


@pytest.mark.parametrize("order", [5, 8, 11])
def test_the_period_of_a_setpoint_is_found(order: int) -> None:
    one = prbs(order)
    for count in (1, 2, 3):
        found = find_period(0.3 + 0.1 * np.tile(one, count), 1e-3)
        assert (found.samples, found.kind) == (one.size, f"PRBS of order {order}")
    held = np.tile(np.repeat(one, 3), 2)  # each bit three samples long
    assert find_period(held, 1e-3).samples == 3 * one.size
    slow = np.sin(2.0 * np.pi * np.arange(700) / 175.0)
    assert (find_period(slow, 1e-3).samples, find_period(slow, 1e-3).kind) == (175, "periodic")


def test_a_resonance_far_above_the_bandwidth_is_named() -> None:
    """A lag of 40 Hz, and beside it a mode at 2000 Hz of 0.2 % damping with a gain of 0.5; without it, silence."""
    one = 0.002 * prbs(11)
    y, _ = first_order(one, 40.0)
    pole = np.exp(2.0 * np.pi * 2000.0 / RATE * (-0.002 + 1j))
    a = np.poly([pole, np.conj(pole)])
    top = abs(signal.freqz([1.0, -1.0], a, [2000.0], fs=RATE)[1][0])
    more = 0.5 / top * signal.lfilter([1.0, -1.0], a, np.tile(one, 6))
    for extra, said in ((more, True), (0.0, False)):
        row = identify_loop("r", [record(np.tile(one, 6), y + extra)]).table.iloc[0]
        assert np.isfinite(row["resonance_Hz"]) == said
    row = identify_loop("r", [record(np.tile(one, 6), y + more)]).table.iloc[0]
    assert row["resonance_Hz"] == pytest.approx(2000.0, abs=5.0)
    assert row["resonance_dB"] == pytest.approx(-6.0, abs=1.0)
    assert row["bandwidth_Hz"] == pytest.approx(40.0, rel=0.05)


def test_what_does_not_repeat_itself_is_refused() -> None:
    random = np.random.default_rng(1).standard_normal(2047)
    for setpoint in (random, np.sign(random), prbs(11)[:-1]):
        with pytest.raises(InputError, match="does not repeat itself"):
            find_period(setpoint, 1e-3)
    with pytest.raises(InputError, match="does not change"):
        find_period(np.ones(100), 1e-3)
    with pytest.raises(InputError, match="no setpoint with its actual value"):
        identify_loop("x", [make_record(np.arange(9.0), {"encoder_speed": {"x": np.arange(9.0)}})])
    with pytest.raises(InputError, match=r"a period of 0\.10005 s is 800\.4 of the 2047 samples"):
        identify_loop("x", [record(random, random)], period=0.10005)


def test_friction_of_one_direction_shows_against_noise() -> None:
    """A lag that is slower in one direction: the difference is found, and without it noise is named."""
    one = 0.002 * prbs(9)
    for corner, said in ((60.0, "nothing distinguishes them"), (54.0, "friction or play")):
        runs = []
        for seed, sign, own in ((1, 1.0, 60.0), (2, -1.0, corner)):
            y, _ = first_order(sign * (0.01 + one), own)
            noisy = y + 1e-5 * np.random.default_rng(seed).standard_normal(y.size)
            runs.append(record(np.tile(sign * (0.01 + one), 6), noisy))
        assert said in identify_loop("both", runs).notes[-1]


# --- the trace of a control ----------------------------------------------------------------------------------------


def encoded(values: np.ndarray) -> str:
    """Doubles to the base 85 as the control writes them, digit by digit."""
    out = ""
    for word in np.asarray(values).astype(">f8").view(">u4").tolist():
        digits = [word // 85**k % 85 for k in range(4, -1, -1)]
        out += "".join(DIGITS[d] for d in digits) if word else "."
    return out


def test_base_85_gives_back_every_bit() -> None:
    rng = np.random.default_rng(3)
    values = np.concatenate([rng.standard_normal(50), [0.0, 1.0, -2.0, 1e300, 5e-324, np.pi]])
    np.testing.assert_array_equal(numbers("\n ".join(encoded([v]) for v in values)), values)
    for wrong, why in (("0" * 9, "whole number"), ("~~~~~" * 2, "larger than 32 bits"), ("0000\x7f" * 2, "no digit")):
        with pytest.raises(ValueError, match=why):
            numbers(wrong)


def test_the_trace_decodes_to_the_samples_that_others_decoded(trace: Path) -> None:
    known = np.load(SHARED / "decoded_u_setpoint_y_actual.npz")
    found = read_records(trace, TRACE)
    assert len(found) == 2
    for k, run in enumerate(found):
        np.testing.assert_array_equal(run["reference_speed"].values[0], known["u"][k])
        np.testing.assert_array_equal(run["encoder_speed"].values[0], known["y"][k])
        assert float(run["time"][1]) == 1.0 / 8000.0


def test_the_response_is_that_of_the_spectra_which_the_control_stored(trace: Path) -> None:
    """A second method: cross over auto spectrum as the control averaged them over both directions."""
    spectra = {}
    for info in ET.parse(trace).getroot().iter("SigNodeCrossSpectrumInfo"):
        kind = info.attrib["name"], info.findtext("unsigned_int[@name='m_uSignodeId']")
        spectra[kind] = numbers(info.findtext(".//raw") or "").view(complex)
    stored = spectra[("m_crossSpecInfoList_el", "62")] / spectra[("m_autospectrumInfo", "62")]
    responses = identify_loop("loop", read_records(trace, TRACE)).response["loop_response"].values
    # Line 0 is the mean. The control stores U conj(Y); equal power of U in both directions makes it their mean.
    np.testing.assert_allclose(responses.mean(axis=0)[: stored.size - 1], stored[1:].conj(), rtol=1e-9)


def test_what_is_known_of_the_speed_loop_is_found_through_its_campaign(trace: Path, tmp_path: Path) -> None:
    campaign = REPOSITORY / "datasets" / "sinumerik_speedloop.toml"
    if not campaign.is_file():
        pytest.skip("the campaign files of the public data sets are not beside the tests")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SMFE_DATA", str(SHARED.parent))
        smfe.run(campaign, tmp_path / "results")
        smfe.identify(campaign, tmp_path / "frf.nc")
        audit = check(campaign)
    table = json.loads(read_groups(tmp_path / "results" / "loops.nc")["speed_loop"].attrs["summary"])
    assert len(table) == 2
    groups = read_groups(tmp_path / "loops.nc")
    t = groups["speed_loop"]["loop_response"]
    assert list(t["feed"].values) == [-40.0, 40.0]  # 0.41888 rad/s on a lead of 10 mm
    assert np.abs(t.isel(frequency=slice(0, 5))).values == pytest.approx(1.0, abs=0.05)
    text = "\n".join(audit["evidence"])
    assert "PRBS of order 11, period 0.255875 s" in text  # 2047 samples of 0.125 ms
    assert "bandwidth 46." in text
    for feed in (-40.0, 40.0):  # a resonance that both directions show, where nothing should pass
        top = 180 + int(np.argmax(np.abs(t.sel(feed=feed).values[180:])))
        assert 2230.0 < float(t["frequency"][top]) < 2250.0
    assert text.count("dB far above it, at 223") == 2
    assert "-30.7 dB" in text  # the difference of the directions
    assert "one period a record" in text
    assert not (audit["level"] == "fault").any()
    page = (tmp_path / "results" / "report.html").read_text(encoding="utf-8")
    assert "speed loop of x at 40 mm/min: bandwidth 46." in page
    assert 'id="plot-loop-1"' in page
    assert (tmp_path / "results" / "figures" / "loop_1.png").stat().st_size > 10_000


def test_a_truncated_trace_ends_with_a_sentence(trace: Path, tmp_path: Path) -> None:
    content = trace.read_bytes()
    (tmp_path / "t.xml").write_bytes(content[: len(content) // 2])
    with pytest.raises(InputError, match=r"t\.xml: cannot be read as a frequency-response measurement"):
        read_records(tmp_path / "t.xml", TRACE)
    (tmp_path / "t.xml").write_bytes(content.replace(b'"m_length">2047<', b'"m_length">2048<'))
    with pytest.raises(InputError, match="2047 of the 2048 samples"):
        read_records(tmp_path / "t.xml", TRACE)
    (tmp_path / "t.xml").write_bytes(b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>')
    with pytest.raises(InputError, match="declarations of its own"):
        read_records(tmp_path / "t.xml", TRACE)
    (tmp_path / "t.xml").write_bytes(b"<a><b/></a>")
    with pytest.raises(InputError, match="without time series"):
        read_records(tmp_path / "t.xml", TRACE)
