"""Claims: one record for two conditions is a fault, for two methods none."""

import numpy as np

from process.labels import make_record
from smfe.diagnosis.checks.same_data import Seen, same_suspects, seen


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


def test_two_recordings_of_sound_alone_are_the_same_data_only_where_their_samples_are() -> None:
    time = np.arange(100) / 1000.0

    def heard(name: str, sound: np.ndarray) -> Seen:
        return seen(make_record(time, {}, {"sound": sound}), ("cutting test", name), (name,))

    calm, loud = np.sin(time), np.cos(time)
    assert not list(same_suspects([heard("calm.wav", calm), heard("loud.wav", loud)]))
    assert len(list(same_suspects([heard("calm.wav", calm), heard("copy.wav", calm)]))) == 1
