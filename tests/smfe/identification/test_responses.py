"""Frequency responses made elsewhere: whatever their form, they come back as the compliance that is in them."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy import io, stats
from truth.frf_files import averaged, draw, machine

from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.commands.files.look import look
from smfe.identification.errors.result import Identification
from smfe.identification.measurement import identify_measurement
from smfe.identification.responses import response_std, rising_phase
from smfe.modes.fit_modes import fit_modes
from smfe.records import Channel, read_frf

F = np.arange(1.0, 401.0)


def phi(seed: int = 1, response: int = 0, excitation: int = 0, f: np.ndarray = F) -> np.ndarray:
    return machine(np.random.default_rng(seed), 3, f)[:, response, excitation]


def identified(folder: Path, table: str) -> Identification:
    (folder / "c.toml").write_text('[campaign]\nname = "c"\n' + table)
    campaign = load_campaign(folder / "c.toml")
    return identify_measurement(campaign, campaign.measurements[0])


def table(channels: str, record: str = 'file = "h.csv", response = "x", excitation = "x"', keys: str = "") -> str:
    head = f'[[measurement]]\nname = "m"\nmethod = "frf"\n{keys}\nrecords = [{{ {record} }}]\n[measurement.channels]\n'
    return head + channels


def csv(path: Path, **columns: np.ndarray) -> Path:
    rows = [",".join(columns), *(",".join(f"{v:.12e}" for v in row) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(rows) + "\n")
    return path


class TestFilesDrawnAtRandom:
    @pytest.mark.parametrize("seed", range(12))
    def test_the_compliance_comes_back_or_a_sentence(self, tmp_path: Path, seed: int) -> None:
        """Kind, unit, form, format, spacing, naming and sign of time at random: the numbers to their digits."""
        file = draw(seed, tmp_path)
        found = identified(tmp_path, file.table)
        turned = [w for w in found.warnings if "conjugate = true" in w]
        assert bool(turned) == bool(file.says), (file.drawn, found.warnings)
        if file.says:
            return
        entry = found.compliance["compliance"]
        assert (entry["response"].item(), entry["excitation"].item()) == (file.response, file.excitation)
        f = entry["frequency"].values
        at = np.abs(file.frequency[:, None] - f).argmin(axis=0)
        assert f.size >= file.frequency.size - 1, "0 Hz alone may be lost"
        np.testing.assert_allclose(f, file.frequency[at], atol=1e-3 * file.frequency[1])
        np.testing.assert_allclose(entry.values[:, 0, 0], file.measured[at], rtol=30.0 * file.digits)
        assert ("compliance_std" in found.compliance) == bool(file.averages)


class TestForms:
    def test_a_complex_array_of_a_matlab_file(self, tmp_path: Path) -> None:
        values = phi()
        held = {"freq": F, "FRF": np.stack([np.stack([values, 2 * values], 1), np.stack([3 * values, values], 1)], 2)}
        io.savemat(tmp_path / "h.mat", held)
        channels = {"frequency": Channel("freq", "Hz"), "compliance": Channel("FRF(:,1,2)", "mm/N")}
        entry = read_frf(tmp_path / "h.mat", channels, "x", "x")
        np.testing.assert_allclose(entry["compliance"].values[:, 0, 0], 3e-3 * values)

    def test_cells_and_rows_of_a_wide_matrix(self, tmp_path: Path) -> None:
        cell = np.empty(2, dtype=object)
        cell[0], cell[1] = phi(), 2.0 * phi()
        io.savemat(tmp_path / "h.mat", {"f": F, "H": cell, "wide": np.stack([phi(), 5.0 * phi()])})
        for column, factor in (("H{2}", 2.0), ("wide(2,:)", 5.0)):
            channels = {"frequency": Channel("f", "Hz"), "compliance": Channel(column, "m/N")}
            entry = read_frf(tmp_path / "h.mat", channels, "x", "x")
            np.testing.assert_allclose(entry["compliance"].values[:, 0, 0], factor * phi())

    def test_decibels_need_what_zero_is(self, tmp_path: Path) -> None:
        path = csv(tmp_path / "h.csv", f=F, mag=20 * np.log10(np.abs(phi()) / 1e-6), ph=np.degrees(np.angle(phi())))
        channels = {"frequency": Channel("f", "Hz"), "compliance_phase": Channel("ph", "deg")}
        good = channels | {"compliance_magnitude": Channel("mag", "dB re 1 um/N")}
        np.testing.assert_allclose(read_frf(path, good, "x", "x")["compliance"].values[:, 0, 0], phi(), rtol=1e-9)
        with pytest.raises(InputError, match=r'"dB" says nothing without what 0 dB is; write unit = "dB re 1 m/N"'):
            read_frf(path, channels | {"compliance_magnitude": Channel("mag", "dB")}, "x", "x")
        with pytest.raises(InputError, match=r"compliance_magnitude is negative; a magnitude in decibels needs a unit"):
            read_frf(path, channels | {"compliance_magnitude": Channel("mag", "m/N")}, "x", "x")

    WRONG = (
        ({"mobility_real": Channel("re", "m/s/N")}, "declares mobility_real, but not mobility_imag; both parts"),
        ({}, "declares no response; declare one of compliance, mobility"),
        (
            {f"mobility_{p}": Channel(p, "g/N") for p in ("real", "imag")},
            "accelerance; call the channel accelerance_real",
        ),
        ({f"compliance_{p}": Channel(p, "N/um") for p in ("real", "imag")}, "call the channel dynamic_stiffness_real"),
        ({"accelerance": Channel(2, "g/N")}, 'accelerance is complex and needs the name of its array, column = "H"'),
        ({"accelerance_magnitude": Channel("real", "g/N")}, "but not accelerance_phase; both parts are needed"),
    )

    @pytest.mark.parametrize(("channels", "message"), WRONG)
    def test_a_wrong_declaration_is_a_sentence(
        self, tmp_path: Path, channels: dict[str, Channel], message: str
    ) -> None:
        path = csv(tmp_path / "h.csv", f=F, real=phi().real, imag=phi().imag)
        with pytest.raises(InputError, match=message):
            read_frf(path, channels | {"frequency": Channel("f", "Hz")}, "x", "x")

    def test_a_synonym_is_named(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="a receptance is called compliance here"):
            identified(tmp_path, table('receptance_real = { column = 2, unit = "m/N" }'))

    def test_lines_that_are_no_numbers_are_left_out_and_counted(self, tmp_path: Path) -> None:
        values = phi()
        values[[5, 9]] = np.nan
        csv(tmp_path / "h.csv", f=F, re=values.real, im=values.imag)
        channels = 'frequency = { column = "f", unit = "Hz" }\ncompliance_real = { column = "re", unit = "m/N" }\n'
        found = identified(tmp_path, table(channels + 'compliance_imag = { column = "im", unit = "m/N" }'))
        assert found.compliance.sizes["frequency"] == 398
        assert any("2 of 400 lines are empty" in w for w in found.warnings)


class TestPlaces:
    CHANNELS = 'frequency = { column = "f", unit = "Hz" }\ncompliance_real = { column = "re", unit = "m/N" }\n'
    CHANNELS += 'compliance_imag = { column = "im", unit = "m/N" }'

    def test_a_minus_before_a_direction_turns_the_sign(self, tmp_path: Path) -> None:
        csv(tmp_path / "h.csv", f=F, re=-phi().real, im=-phi().imag)
        found = identified(tmp_path, table(self.CHANNELS, 'file = "h.csv", response = "21:-X", excitation = "21:x"'))
        entry = found.compliance["compliance"].sel(response="21:x", excitation="21:x")
        np.testing.assert_allclose(entry, phi(), rtol=1e-9)
        assert not [w for w in found.warnings if "sign" in w]

    def test_lines_of_several_places_are_fitted_and_the_tool_alone_has_limits(self, tmp_path: Path) -> None:
        for k, name in enumerate(("h.csv", "g.csv")):
            values = phi(response=k)
            csv(tmp_path / name, f=F[k:], re=values.real[k:], im=values.imag[k:])
        records = (
            'file = "h.csv", response = "x", excitation = "x" }, { file = "g.csv", response = "7:x", excitation = "x"'
        )
        found = identified(tmp_path, table(self.CHANNELS, records))
        assert list(found.compliance["response"].values) == ["x", "7:x"]
        assert np.isnan(found.compliance["compliance"].values[0, 1, 0]), "a line that this file lacks"
        modes = fit_modes(found.compliance).table()
        assert {"direction_x", "direction_7:x"} <= set(modes.columns)

    def test_a_cross_response_of_a_universal_file_is_not_called_direct(self, tmp_path: Path) -> None:
        """Node 21 to node 1 was called xx, and its sign was to be turned."""
        drawn = (draw(seed, tmp_path, ("uff",)) for seed in range(400))
        file = next(d for d in drawn if d.response != d.excitation and not d.says)
        ends = re.search(r'response = "([^"]*)", excitation = "([^"]*)"', file.table)
        assert ends is not None
        wrong = file.table.replace(ends[0], 'response = "x", excitation = "x"')
        named = f'Name both ends: response = "{file.response}", excitation = "{file.excitation}"'
        with pytest.raises(InputError, match=named):
            identified(tmp_path, wrong)


class TestSignOfTime:
    @pytest.mark.parametrize("seed", range(8))
    def test_the_phase_rises_for_the_other_sign_of_time_whatever_the_sign_of_motion(self, seed: int) -> None:
        for response in (0, 2):
            for sign in (1.0, -1.0):
                values = sign * phi(seed, response)
                assert not rising_phase(F, values)
                assert rising_phase(F, values.conj())

    def test_noise_alone_says_nothing(self) -> None:
        rng = np.random.default_rng(3)
        noise = rng.standard_normal((200, 400)) + 1j * rng.standard_normal((200, 400))
        assert sum(rising_phase(F, row) for row in noise) <= 1


class TestCoherence:
    @pytest.mark.parametrize("averages", [3, 5, 20])
    @pytest.mark.parametrize("share", [0.03, 0.3, 1.0])
    def test_the_interval_of_each_part_holds_as_often_as_stated(self, averages: int, share: float) -> None:
        """95 % intervals with 2 (n - 1) degrees of freedom, 4000 draws, noise 3 to 100 % of the response."""
        rng = np.random.default_rng(averages)
        h = np.full(4000, 2.0 - 1.0j)
        found, coherence = averaged(rng, h, share * abs(h[0]), averages)
        std = response_std(found, coherence, averages)
        reach = stats.t.ppf(0.975, 2 * (averages - 1)) * std / np.sqrt(2.0)
        held = np.mean([np.abs((found - h).real) < reach, np.abs((found - h).imag) < reach])
        assert 0.94 < held < 0.96

    def test_it_is_bendat_and_piersol_for_many_averages(self) -> None:
        """``var |H|/|H|^2 = (1 - g2)/(2 g2 n)``: half of the power of the complex error."""
        std = response_std(np.array([1.0 + 0j]), np.array([0.9]), 1001)
        assert 0.5 * std[0] ** 2 == pytest.approx((1 - 0.9) / (2 * 0.9 * 1000))

    def test_a_rounded_coherence_is_no_certainty(self) -> None:
        std = response_std(np.ones(3, dtype=complex), np.array([1.0, 0.999, 0.99]), 5)
        assert std[0] == pytest.approx(np.sqrt(0.0005 / 4.0))

    def test_what_is_missing_for_an_uncertainty_is_said(self, tmp_path: Path) -> None:
        values, coherence = averaged(np.random.default_rng(1), phi(), 1e-9, 6)
        csv(tmp_path / "h.csv", f=F, re=values.real, im=values.imag, c=coherence)
        channels = TestPlaces.CHANNELS + '\ncoherence = { column = "c" }'
        found = identified(tmp_path, table(channels))
        assert any("give the measurement averages = 10" in w for w in found.warnings)
        assert "compliance_std" not in found.compliance
        found = identified(tmp_path, table(channels, keys="averages = 6"))
        assert not found.warnings
        assert float(found.compliance["degrees_of_freedom"].min()) == 10.0

    def test_a_line_with_an_impossible_coherence_is_left_out_and_said(self, tmp_path: Path) -> None:
        """1.0000001 is 1; 1.7 at one line of 400 costs that line, 1.7 at all of them the file."""
        values, coherence = averaged(np.random.default_rng(2), phi(), 1e-9, 6)
        coherence[7], coherence[100] = 1.7, 1.0000001
        csv(tmp_path / "h.csv", f=F, re=values.real, im=values.imag, c=coherence)
        channels = TestPlaces.CHANNELS + '\ncoherence = { column = "c" }'
        found = identified(tmp_path, table(channels, keys="averages = 6"))
        assert any("one line with a coherence outside 0 to 1" in w and "left out" in w for w in found.warnings)
        assert found.compliance["frequency"].values == pytest.approx(np.delete(F, 7))
        assert found.compliance["coherence"].values.max() == 1.0
        csv(tmp_path / "h.csv", f=F, re=values.real, im=values.imag, c=100.0 * coherence)
        with pytest.raises(InputError, match='per cent with unit = "%"'):
            identified(tmp_path, table(channels, keys="averages = 6"))


class TestComplexText:
    @pytest.mark.parametrize(
        ("form", "delimiter", "decimal"),
        [
            ("{re:.9e}{im:+.9e}j", ",", "."),
            ("{re:.9e} {sign} {size:.9e}i", ",", "."),
            ("({re:.9e}{im:+.9e}j)", ";", "."),
            ("{re:.9e} {sign} {size:.9e}i", "\t", "."),
            ("{re:.9e} {sign} {size:.9e}i", ";", ","),
            ("{re:.9e}{sign}i*{size:.9e}", ";", "."),
            ("{re:.9e}{im:+.9e}j", " ", "."),
        ],
    )
    def test_a_response_written_as_complex_numbers_comes_back(
        self, tmp_path: Path, form: str, delimiter: str, decimal: str
    ) -> None:
        h = phi()
        rows = [delimiter.join(("f", "H"))]
        for f, v in zip(F, h, strict=True):
            text = form.format(re=v.real, im=v.imag, sign="-" if v.imag < 0 else "+", size=abs(v.imag))
            rows.append(delimiter.join((f"{f:.1f}", text)).replace(".", decimal))
        (tmp_path / "h.csv").write_text("\n".join(rows) + "\n")
        channels = 'frequency = { column = "f", unit = "Hz" }\ncompliance = { column = "H", unit = "m/N" }'
        found = identified(tmp_path, table(channels)).compliance["compliance"].values[:, 0, 0]
        np.testing.assert_allclose(found, h, rtol=1e-8)

    def test_look_finds_both_parts(self, tmp_path: Path) -> None:
        rows = ["Frequency [Hz],H", *(f"{f:.1f},{v.real:.9e}{v.imag:+.9e}j" for f, v in zip(F, phi(), strict=True))]
        (tmp_path / "h.csv").write_text("\n".join(rows) + "\n")
        found = look(tmp_path / "h.csv")
        assert found.kind.name == "FRF"
        assert 'column = "H real"' in found.campaign

    def test_a_field_that_is_none_is_named(self, tmp_path: Path) -> None:
        rows = ["f,H", *(f"{f:.1f},{v.real:.9e}{v.imag:+.9e}j" for f, v in zip(F, phi(), strict=True))]
        rows[50] = "50.0,broken"
        (tmp_path / "h.csv").write_text("\n".join(rows) + "\n")
        channels = 'frequency = { column = "f", unit = "Hz" }\ncompliance = { column = "H", unit = "m/N" }'
        with pytest.raises(InputError, match="column 2 holds the text 'broken' in data row 50; complex numbers"):
            identified(tmp_path, table(channels))
