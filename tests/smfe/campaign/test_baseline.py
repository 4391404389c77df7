"""Claims about the baseline in a campaign file: the simulation that a diagnosis questions."""

import re
from pathlib import Path

import numpy as np
import pytest

from process.errors import InputError
from smfe.campaign import Campaign, RigidDrive, campaign_of_tables, load_campaign


class TestBaseline:
    """The simulation that a diagnosis questions."""

    AXIS = (
        "[baseline]\naxis = 'x'\nmoving_mass = '23.1 kg'\ntip_mass = '11.3 kg'\nstiffness = '1.68 N/um'\n"
        "damping = '104 N s/m'\nfriction = { law = 'viscous', sigma = '168 N s/m' }\n"
    )
    SERVO = "Kp = '6268 N s/m'\nTi = '10.9 ms'\nKv = '45.5 1/s'\n"

    def load(self, folder: Path, text: str) -> Campaign:
        (folder / "hit.csv").write_text("t,Fx,ax\n0,0,0\n", encoding="utf-8")
        path = folder / "campaign.toml"
        path.write_text(
            "[campaign]\nname = 'bench'\n[channels]\ntime = { column = 't', unit = 's' }\n"
            "force_x = { column = 'Fx', unit = 'N' }\nacceleration_x = { column = 'ax', unit = 'm/s^2' }\n"
            "[[measurement]]\nname = 'idle'\nmethod = 'hammer'\nrecords = [{ file = 'hit.csv', excitation = 'x' }]\n"
            + text,
            encoding="utf-8",
        )
        return load_campaign(path)

    def test_one_servo_comes_out_in_si(self, tmp_path: Path) -> None:
        baseline = self.load(tmp_path, self.AXIS + self.SERVO).baseline
        assert baseline is not None
        assert baseline.drive.stiffness == pytest.approx(1.68e6)
        assert baseline.servos[""].Ti == pytest.approx(0.0109)
        assert float(baseline.friction.force(0.01)) == pytest.approx(1.68)

    def test_several_controllers_by_name(self, tmp_path: Path) -> None:
        servos = (
            "controllers = { K2 = { Kp = '6268 N s/m', Ti = '10.9 ms', Kv = '45.5 1/s' }, "
            "K3 = { Kp = '10590 N s/m', Ti = '6.5 ms', Kv = '76.9 1/s', delay = '0.75 ms' } }\n"
        )
        baseline = self.load(tmp_path, self.AXIS + servos).baseline
        assert baseline is not None
        assert list(baseline.servos) == ["K2", "K3"]
        assert baseline.servos["K3"].delay == pytest.approx(7.5e-4)

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("", "needs Kp, Ti and Kv of its servo, or controllers"),
            ("Kp = '6268 N s/m'\n", "needs Kp, Ti and Kv of its servo, or controllers"),
            ("Kp = '-1 N s/m'\nTi = '10.9 ms'\nKv = '45.5 1/s'\n", "'-1 N s/m'"),
            (
                "Kp = '6268 N s/m'\nTi = '10.9 ms'\nKv = '45.5 1/s'\nperiod = '4 s'\n",
                "period of 4000 ms between samples of a control with Ti = 10.9 ms",
            ),
        ],
    )
    def test_a_servo_that_is_none(self, tmp_path: Path, text: str, said: str) -> None:
        with pytest.raises(InputError, match=re.escape(said)):
            self.load(tmp_path, self.AXIS + text)

    DRIVE = "[baseline]\ndrive = 'rigid'\naxis = 'x'\n"
    MOVED = "[[measurement]]\nname = 'moved'\nmethod = 'drive'\nrecords = [{ file = 'hit.csv' }]\n"

    def test_a_rigid_drive_in_si(self, tmp_path: Path) -> None:
        gains = "Kp = '8557 N s/m'\nKv = '160 1/s'\nmoving_mass = '95 kg'\n"
        assert self.load(tmp_path, self.MOVED + self.DRIVE + gains).baseline == RigidDrive("x", 95.0, 8557.0, 160.0)

    def test_what_is_held_out_is_marked(self, tmp_path: Path) -> None:
        again = self.MOVED.replace("'moved'", "'again'") + "held_out = true\n"
        found = self.load(tmp_path, self.MOVED + again + self.DRIVE).measurements
        assert [m.held_out for m in found] == [False, False, True]

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            (DRIVE.replace("rigid", "flexible") + MOVED, "baseline.drive: drive 'flexible' is not known"),
            (DRIVE + "Kp = '8557 N s/m'\n" + MOVED, "baseline: needs Kp and Kv for the control law, or neither"),
            (DRIVE + "Ti = '10 ms'\n" + MOVED, "baseline.Ti: this key is not known"),
            (DRIVE + MOVED + "held_out = true\n", "nothing to be compared with; all of them are held out"),
            (DRIVE + MOVED + "held_out = 'yes'\n", "measurement 'moved', held_out: 'yes': must be true or false"),
            ("[baseline]\nforces = 'mechanistic'\n", "a mechanistic force needs the table [material]; add it"),
            ("[baseline]\nforces = 'mechanistic'\n", "nothing to be compared with; add a [[cutting_test]]"),
        ],
    )
    def test_a_baseline_that_cannot_be_tested(self, tmp_path: Path, text: str, said: str) -> None:
        with pytest.raises(InputError, match=re.escape(said)):
            self.load(tmp_path, text)

    def test_friction_without_its_parameters(self, tmp_path: Path) -> None:
        text = self.AXIS.replace("law = 'viscous', sigma = '168 N s/m'", "law = 'andersson', coulomb = '40 N'")
        with pytest.raises(InputError, match=r"friction law 'andersson': .* missing"):
            self.load(tmp_path, text + self.SERVO)

    @pytest.mark.parametrize(
        ("text", "said"),
        [
            ("[baseline]\naxis = 'x'\n", 'for another simulation give drive = "rigid"'),
            ("[baseline]\nfrom = 'idle'\nmass = '3 kg'\n", "this key is not known; known here: from"),
        ],
    )
    def test_what_a_baseline_may_be_is_said_in_the_words_of_the_file(
        self, tmp_path: Path, text: str, said: str
    ) -> None:
        with pytest.raises(InputError, match=re.escape(said)):
            self.load(tmp_path, text)

    def test_a_key_of_a_second_recorder_that_is_not_known_is_refused(self, tmp_path: Path) -> None:
        """`with` is a word of Python, so its field has another name."""
        recorder = "[[measurement]]\nname = 'two'\nmethod = 'hammer'\n[[measurement.records]]\nfile = 'hit.csv'\n"
        recorder += "excitation = 'x'\n[[measurement.records.with]]\nfile = 'hit.csv'\nsharde = 'force_x'\n"
        with pytest.raises(
            InputError, match=re.escape("records[0].with[0].sharde: this key is not known (did you mean")
        ):
            self.load(tmp_path, recorder)


def test_tolerances_are_those_of_a_workshop_where_the_campaign_states_none(tmp_path):
    modes = [{"frequency": "40 Hz", "damping": "3 %", "stiffness": "20 N/um", "direction": [1, 0, 0]}]
    tables = {"model": [{"name": "m", "modes": modes}]}
    plain = campaign_of_tables(tables, "plain").tolerances
    assert (plain.sensor_gain, plain.material) == (0.01, 0.05)
    assert plain.setup_direction == pytest.approx(np.radians(1.5))
    tables |= {
        "tolerances": {"hit_direction": "2 deg", "clock": "0.1 ms"},
        "material": {"Ktc": "2000 N/mm2", "uncertainty": "7 %"},
    }
    stated = campaign_of_tables(tables, "stated").tolerances
    assert stated.hit_direction == pytest.approx(np.radians(2.0))
    assert (stated.clock, stated.coefficients, stated.setup_direction) == (1e-4, 0.07, plain.setup_direction)
