"""Claims about campaigns that were written to do harm: one sentence, and soon."""

from pathlib import Path

import pytest
from samples.campaigns import HAMMER

from process.errors import InputError
from smfe.campaign import load_campaign

MODE = """
[[model]]
name = "m"
[[model.modes]]
frequency = "100 Hz"
damping = {}
stiffness = "10 N/um"
direction = [1, 0, 0]
"""

HOSTILE = {
    "a list in a list in a list": (HAMMER + f"x = {20_000 * '['}{20_000 * ']'}", r"stand within one another too often"),
    "a table in a table in a table": (
        HAMMER + f"x = {3000 * '{a='}1{3000 * '}'}",
        r"stand within one another too often",
    ),
    "five thousand digits": (
        HAMMER.replace("teeth = 2", f"teeth = {5000 * '9'}"),
        r"cannot be read \(Exceeds the limit",
    ),
    "four hundred digits": (HAMMER.replace("teeth = 2", f"teeth = {400 * '9'}"), r"a whole number of 400 digits; TOML"),
    "a billion teeth": (HAMMER.replace("teeth = 2", "teeth = 1000000000"), r"the tool has 1e\+09 teeth, more than any"),
    "a mode without damping": (HAMMER + MODE.format(1e-12), r"1e-12 is the damping ratio of no structure"),
    "a NUL in a name": (HAMMER.replace('"hit.csv"', '"hit\\u0000.csv"'), r"'hit\\x00\.csv' is not the name of a file"),
    "the folder itself": (HAMMER.replace('"hit.csv"', '"."'), r"no file '\.' in"),
    "everything above": (HAMMER.replace('"hit.csv"', '"**/../../**"'), r"'\.\.' behind '\*\*' leads out of the folder"),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_hostile_campaign_is_one_sentence(tmp_path: Path, what: str) -> None:
    text, said = HOSTILE[what]
    (tmp_path / "hit.csv").write_text("t,Fx,ax\n0,1,2\n1,2,3\n")
    (tmp_path / "campaign.toml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        load_campaign(tmp_path / "campaign.toml")


def test_a_byte_order_mark_is_no_part_of_a_campaign(tmp_path: Path) -> None:
    (tmp_path / "hit.csv").write_text("t,Fx,ax\n0,1,2\n1,2,3\n")
    (tmp_path / "campaign.toml").write_text(HAMMER, encoding="utf-8-sig")
    assert load_campaign(tmp_path / "campaign.toml").name == "Small"
