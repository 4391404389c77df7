"""Claims: one record for two conditions is a fault, for two methods none."""

from smfe.diagnosis.checks.same_data import Seen, same_suspects


def test_one_record_for_two_conditions_is_a_fault_and_for_two_methods_is_none() -> None:
    one = Seen(("measurement", "a"), "x.csv", ("'K2'",), "1")
    assert not list(same_suspects([one, Seen(("measurement", "b"), "x.csv", ("'K2'",), "1")]))
    assert not list(same_suspects([one, Seen(("measurement", "b"), "x.csv", ("None",), "1")]))
    (copied,) = same_suspects([one, Seen(("measurement", "b"), "y.csv", ("'K2'",), "1")])
    assert (copied.level, copied.excludes) == ("warning", ())
    (wrong,) = same_suspects([one, Seen(("measurement", "b"), "x.csv", ("'K3'",), "1")])
    assert wrong.level == "fault"
    assert dict(wrong.excludes) == {"measurement": "b"}
    assert len(wrong.excludes) == 2
    assert not list(same_suspects([one, Seen(("measurement", "b"), "y.csv", ("'K3'",), "2")]))
