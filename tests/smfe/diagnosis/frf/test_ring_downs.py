"""What bends frequency and damping of a free decay is named; decays are those of an integration in time."""

from functools import cache

import numpy as np
import pytest
from truth.decay import Oscillator, bolted, free_decay

from process.errors import InputError
from smfe.diagnosis.frf.ring_downs import RingDowns, ring_down_conditions
from smfe.diagnosis.judgement.diagnose import diagnose
from smfe.diagnosis.judgement.materiality import Worth
from smfe.modes.ring_down import ring_down

BAND = (40.0, 120.0)
HIDDEN = {
    "nothing": (Oscillator(), "consistent", ()),
    "bolted": (Oscillator(sliders=bolted(0.08, -0.4)), "named", ("joint_micro_slip",)),
    "cubic": (Oscillator(cubic=0.02), "named", ("joint_hardening",)),
    "gap": (Oscillator(gap=(0.05, 0.1)), "named", ("backlash",)),
    "dry": (Oscillator(dry=2e-4), "named", ("guideway_friction",)),
}


@cache
def recorded(oscillator: Oscillator, seed: int = 0) -> tuple[float, np.ndarray]:
    rate, x = free_decay(oscillator)
    return rate, x + 3e-4 * np.random.default_rng(seed).standard_normal(x.size)


def found(oscillator: Oscillator, **more):
    rate, x = recorded(oscillator)
    decay = ring_down(x, rate, BAND, hit=0.0)
    return diagnose(RingDowns(tuple(ring_down_conditions(decay)), **more), workers=1, worth=Worth(0.05))


@pytest.mark.parametrize("hidden", HIDDEN)
def test_what_bends_the_backbone_is_named(hidden: str) -> None:
    oscillator, verdict, causes = HIDDEN[hidden]
    finding = found(oscillator)
    assert (finding.verdict, tuple(c.id for c in finding.causes)) == (verdict, causes), finding.reason


def test_drag_is_in_no_catalogue_and_gets_no_name() -> None:
    finding = found(Oscillator(drag=2e-3))
    assert finding.verdict == "unknown", finding.reason


def test_micro_slip_left_out_of_the_catalogue_gets_no_other_name() -> None:
    finding = found(HIDDEN["bolted"][0], without=("joint_micro_slip",))
    assert finding.verdict == "unknown", finding.reason


def test_the_mode_that_was_found_decays_like_the_record() -> None:
    oscillator = HIDDEN["bolted"][0]
    rate, x = recorded(oscillator)
    family = RingDowns(tuple(ring_down_conditions(ring_down(x, rate, BAND, hit=0.0))))
    finding = diagnose(family, workers=1, worth=Worth(0.05))
    mode = family.mode(finding.values)
    t = np.linspace(0.2, 1.0, 5)
    amplitude, _ = mode.decay(1.0 / family.reference, t)
    period = int(rate / 80.0)
    measured = [np.abs(x[int(s * rate) - period : int(s * rate) + period]).max() for s in t]
    np.testing.assert_allclose(amplitude * family.reference, measured, rtol=0.05)


def test_conditions_of_another_kind_are_refused() -> None:
    from smfe.diagnosis.inference.problem import Condition

    with pytest.raises(InputError, match="not a free decay"):
        RingDowns((Condition("hammer", {}),))
