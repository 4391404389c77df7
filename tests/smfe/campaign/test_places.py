"""Every error of a campaign file says its line; what people write by habit is named as such, with the mended text."""

import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import CHECKOUT
from samples.campaigns import HAMMER

from process.errors import InputError
from process.units import parse
from smfe.campaign import load_campaign
from smfe.campaign.places import Loc, line_of, lines_of, place, syntax_advice

FILES = sorted((CHECKOUT / "datasets").rglob("*.toml"))


def leaves(value: object, where: Loc = ()) -> Iterator[tuple[Loc, object]]:
    """Yield every place of a file that `tomllib` has read, and what stands there."""
    if where:
        yield where, value
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from leaves(inner, (*where, key))
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from leaves(inner, (*where, i))


@pytest.mark.parametrize("file", FILES, ids=lambda p: p.name)
def test_every_place_of_our_own_files_has_the_line_on_which_it_stands(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    found, shown = lines_of(text), text.splitlines()
    for where, value in leaves(tomllib.loads(text)):
        line = shown[found[where] - 1]
        if isinstance(where[-1], str):
            assert where[-1] in line, where
        elif isinstance(value, str) and value:
            assert value[:20] in line or "\\" in line, where


TRICKY = '''\
# [not.a.table]
title = "a # b [c] = { d }"
"quoted key" . inner = 1
[tool]    # comment
long = """
[measurement]
x = "1"
"""
literal = \'\'\'
y = 2 \'\'\'
[[measurement]]
name = 'C:\\raw'
records = [ { file = "a.csv", excitation = "x" }, # first
    { file = "b.csv", with = [ { file = "c.csv" } ] },

    { file = "}],#", n = -1.5e3 },
]
[measurement.channels]
force_x = { column = "Fx", unit = "N" }
[[measurement]]
feed = { x = "1 mm/min" }
[[measurement.part]]
a.b = 1979-05-27T07:32:00Z
[[measurement.part]]
c = [ [1, 2],
      [3] ]
'''


@pytest.mark.parametrize(
    ("where", "line"),
    [
        (("title",), 2),
        (("quoted key", "inner"), 3),
        (("tool",), 4),
        (("tool", "long"), 5),
        (("tool", "literal"), 9),
        (("measurement", 0), 11),
        (("measurement", 0, "name"), 12),
        (("measurement", 0, "records", 0, "excitation"), 13),
        (("measurement", 0, "records", 1, "with", 0, "file"), 14),
        (("measurement", 0, "records", 2, "n"), 16),
        (("measurement", 0, "channels", "force_x", "unit"), 19),
        (("measurement", 1), 20),
        (("measurement", 1, "feed", "x"), 21),
        (("measurement", 1, "part", 0, "a", "b"), 23),
        (("measurement", 1, "part", 1), 24),
        (("measurement", 1, "part", 1, "c", 1, 0), 26),
    ],
)
def test_lines_of_what_toml_allows(where: Loc, line: int) -> None:
    assert set(dict(leaves(tomllib.loads(TRICKY)))) <= set(lines_of(TRICKY))
    assert lines_of(TRICKY)[where] == line


def test_what_is_missing_would_stand_in_its_table() -> None:
    lines = lines_of(TRICKY)
    assert line_of(lines, ("measurement", 0, "records", 1, "cut")) == 14
    assert line_of(lines, ("measurement", 1, "method")) == 20
    assert line_of(lines, ("material",)) is None
    assert line_of(lines, ()) is None


def test_a_place_is_called_by_the_name_of_its_table() -> None:
    raw = {"measurement": [{"name": "hammer"}, {}], "cutting_test": [{"file": "cut.csv"}], "lobes": [{}]}
    assert place(("measurement", 0, "records", 1, "file"), raw) == "measurement 'hammer', records[1].file"
    assert place(("measurement", 0), raw) == "measurement 'hammer'"
    assert place(("measurement", 1, "feed"), raw) == "measurement[1].feed"
    assert place(("cutting_test", 0, "interval"), raw) == "cutting test 'cut.csv', interval"
    assert place(("lobes", 0, "cut"), raw) == "lobes[0].cut"


def said(folder: Path, text: str) -> str:
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    (folder / "hit.csv").write_text("t,Fx,ax\n0,0,0\n1,0,0\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_campaign(folder / "campaign.toml")
    return str(caught.value)


HABITS = {
    "decimal comma in a quantity": (
        ('"80 mm"', '"80,5 mm"'),
        "campaign.toml, line 5: tool.diameter: '80,5 mm' has a decimal comma; write \"80.5 mm\"",
    ),
    "decimal comma without quotes": (
        ("teeth = 2", "approach_angle = 45,5"),
        "campaign.toml, line 6: 'approach_angle = 45,5' has a decimal comma: write approach_angle = 45.5",
    ),
    "backslash": (
        ("hit.csv", "C:\\Users\\hit.csv"),
        'line 19: a backslash in double quotes begins an escape: write "C:/Users/hit.csv"',
    ),
    "backslash that is an escape": (
        ("hit.csv", "records\\new\\hit.csv"),
        'line 19: a backslash in double quotes begins an escape: write "records/new/hit.csv"',
    ),
    "every backslash an escape": (
        ("hit.csv", "records\\new.csv"),
        "line 19: measurement 'hammer', records[0].file: no file 'records\\new.csv' in",
    ),
    "a name near": (("hit.csv", "hits.csv"), "(did you mean 'hit.csv'?)"),
    "missing key": (
        (', excitation = "x"', ""),
        "line 19: measurement 'hammer', records[0].excitation: is missing",
    ),
}


@pytest.mark.parametrize("habit", HABITS)
def test_what_people_write_by_habit_is_named_with_its_line_and_the_mended_text(habit: str, tmp_path: Path) -> None:
    (old, new), message = HABITS[habit]
    found = said(tmp_path, HAMMER.replace(old, new, 1))
    assert message in found
    assert "Traceback" not in found


def test_several_errors_stand_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = HAMMER.replace("hit.csv", "hat.csv").replace('"80 mm"', '"80 kg"').replace("teeth = 2", "tooth = 2")
    head, *lines = said(tmp_path, text).split("\n  ")
    assert head.startswith(f"campaign.toml: {len(lines)} errors")
    numbers = [int(line.partition(":")[0].removeprefix("line ")) for line in lines]
    assert numbers == sorted(numbers)
    assert len(numbers) >= 3


def test_the_nearest_name_of_a_campaign_file_is_offered(tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text(HAMMER, encoding="utf-8")
    with pytest.raises(InputError, match=r"did you mean 'campaign\.toml'"):
        load_campaign(tmp_path / "campain.toml")
    with pytest.raises(InputError, match="there is no folder"):
        load_campaign(tmp_path / "nowhere" / "campaign.toml")


def test_a_comma_before_three_digits_may_part_thousands() -> None:
    with pytest.raises(InputError, match=r'write "1\.500 rpm" or, if the comma parts thousands, "1500 rpm"'):
        parse("1,500 rpm", "rotation")
    with pytest.raises(InputError, match=r'decimal comma; write "0\.2 mm"$'):
        parse("0,2 mm", "length")


def test_a_syntax_error_without_a_line_is_passed_on() -> None:
    with pytest.raises(tomllib.TOMLDecodeError) as caught:
        tomllib.loads("a = [1,")
    line, advice = syntax_advice("a = [1,", caught.value)
    assert (line, advice.startswith("not TOML: ")) == (None, True)


def test_the_mark_that_some_editors_put_before_a_file_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "hit.csv").write_text("t,Fx,ax\n0,0,0\n")
    file = tmp_path / "campaign.toml"
    file.write_bytes(b"\xef\xbb\xbf" + HAMMER.lstrip().replace("\n", "\r\n").encode())
    assert load_campaign(file).name == "Small"
    file.write_bytes(file.read_bytes().replace(b"teeth", b"teeths"))
    with pytest.raises(InputError, match=r"campaign.toml: 2 errors[^$]*line 3: tool.teeth: is missing"):
        load_campaign(file)
