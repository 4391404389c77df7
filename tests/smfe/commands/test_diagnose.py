"""Claims: a finding is kept as long as its files are the same, is written with its curves, and shows itself."""

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.commands import diagnose as command
from smfe.commands.diagnose import Diagnosis, diagnose, finding_of, write_finding
from smfe.diagnosis.judgement.finding import Passage

CURVES = xr.Dataset(
    {
        name: (("condition", "point", "entry"), np.full((1, 2, 1), value, dtype=np.float32))
        for name, value in (("measured", 1.0), ("baseline", 2.0))
    }
    | {"spindle_speed": (("condition", "point"), np.array([[500.0, np.nan]])), "error_baseline": ("condition", [1.0])},
    coords={"condition": ["a"], "entry": ["depth"], "held_out": ("condition", [False])},
    attrs={"kind": "limit_depth", "over": "spindle_speed"},
)

CAMPAIGN = """
[campaign]
name = "bench"
[[model]]
name = "idle"
modes = [ { frequency = "61.4 Hz", damping = 0.012, stiffness = "1.68 N/um", direction = [1, 0, 0] } ]
"""


def test_a_finding_is_read_back_until_a_file_or_a_verdict_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def tested(campaign: object, case: object, *more: object) -> tuple[Diagnosis, dict[str, object]]:
        asked.append(str(case))
        return Diagnosis("consistent", "it is", curves=CURVES), {"verdict": "consistent", "number": len(asked)}

    monkeypatch.setattr(command, "_tested", tested)
    monkeypatch.setattr(command, "case_of", lambda *a: "case")
    path = tmp_path / "campaign.toml"
    path.write_text(CAMPAIGN, encoding="utf-8")

    def found(happened: dict[str, str]) -> int:
        content, curves = finding_of(load_campaign(path), {}, [], kept=tmp_path / "kept", happened=happened)
        assert curves is not None
        np.testing.assert_array_equal(curves["measured"].values, CURVES["measured"].values)
        return int(content["number"])

    assert [found({}), found({}), found({"cut.csv": "chatter"}), found({"cut.csv": "chatter"})] == [1, 1, 2, 2]
    assert len(list((tmp_path / "kept").iterdir())) == 2
    path.write_text(CAMPAIGN.replace("bench", "ram"), encoding="utf-8")
    assert found({"cut.csv": "chatter"}) == 3
    next((tmp_path / "kept").glob("*.json")).write_text("{broken", encoding="utf-8")
    assert found({"cut.csv": "chatter"}) == 4


def test_curves_lie_beside_the_finding_and_those_of_another_are_removed(tmp_path: Path) -> None:
    path = tmp_path / "finding.json"
    write_finding(path, {"verdict": "named"}, CURVES)
    assert (tmp_path / "finding.nc").is_file()
    write_finding(path, {"verdict": "consistent"}, None)
    assert json.loads(path.read_text(encoding="utf-8")) == {"verdict": "consistent"}
    assert not (tmp_path / "finding.nc").exists()


def test_a_diagnosis_shows_its_sentences_and_its_figure() -> None:
    passages = (Passage("verdict", "It is <A> & B."), Passage("next", "Hit it."), Passage("note", "By the way."))
    found = Diagnosis("named", "it is", curves=CURVES, passages=passages)
    assert found.sentences == ("It is <A> & B.", "Hit it.", "By the way.")
    assert found._repr_html_() == "<p><strong>It is &lt;A&gt; &amp; B.</strong></p><p>Hit it.</p>"
    assert len(found.plot().axes) == 2


def test_a_diagnosis_that_has_nothing_left_says_why_records_were_left_out(tmp_path: Path) -> None:
    more = """
[baseline]
from = "idle"
[channels]
time = { column = "t", unit = "s" }
force_x = { column = "f", unit = "N" }
acceleration_x = { column = "a", unit = "m/s^2" }
[[measurement]]
name = "hits"
method = "hammer"
records = [{ file = "hits.csv", excitation = "x" }]
"""
    (tmp_path / "hits.csv").write_text("t,f,a\n" + "".join(f"{1e-3 * n},0,0\n" for n in range(2000)), encoding="utf-8")
    path = tmp_path / "campaign.toml"
    path.write_text(CAMPAIGN + more, encoding="utf-8")
    with pytest.raises(InputError, match=r"three hits or more.*; left out were hits: .*force"):
        diagnose(path)
