"""What is said of three records is said once."""

from __future__ import annotations

from smfe.reporting.content.merging import merged, sentence

MOVED = "motion between the hits was removed: {} % of its power, 2 tones"


def test_three_records_one_sentence() -> None:
    said = merged([("hammer", f"excitation {a}: h_{a}.csv: {MOVED.format(85)}") for a in "xyz"])
    assert len(said) == 1
    assert said[0].where == ("hammer",)
    assert said[0].whole == f"M{MOVED.format(85)[1:]} (excitation x, y and z)."


def test_numbers_that_differ_become_a_range() -> None:
    said = merged([("hammer", f"h_{k}.csv: {MOVED.format(share)}") for k, share in enumerate((85, 7.5, 90))])
    assert [s.whole for s in said] == [f"M{MOVED.format('7.5 to 90')[1:]} (h_0.csv, h_1.csv and h_2.csv)."]


def test_names_that_differ_stay_apart() -> None:
    assert len(merged([("a", "controller K1 is unknown"), ("a", "controller K2 is unknown")])) == 2


def test_several_measurements_share_a_sentence() -> None:
    said = merged([(f"hit_{k}", "averaged by another program") for k in range(3)])
    assert said[0].where == ("hit_0", "hit_1", "hit_2")
    assert said[0].named == "hit 0, hit 1 and hit 2"


def test_channels_are_named_in_words() -> None:
    said = merged([("m", f"r.csv, force_{a}: it is cut off; look at the range") for a in "xy"])
    assert [s.whole for s in said] == ["It is cut off; look at the range (force x and force y, r.csv)."]


def test_a_sentence_begins_large_unless_it_begins_with_a_name() -> None:
    assert sentence("two hits were lost") == "Two hits were lost."
    assert sentence("x: the peak is high") == "Axis x: the peak is high."
    assert sentence("frf_2.nc is old.") == "frf_2.nc is old."
