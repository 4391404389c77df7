"""What one measurement cannot prove: the tool asks for the experiment that does, and then names the single truth."""

from dataclasses import replace

import pytest
from exam.records import condition_of, family
from truth.axis import Truth
from truth.campaign import Condition as Plan
from truth.campaign import Design, measure
from truth.chain import Chain
from truth.effects import EFFECTS, apply

from smfe.diagnosis.judgement.diagnose import diagnose

pytestmark = pytest.mark.exam

MOVING = Plan(feed=500.0)
SEPARATING = {"delay": {"hammer idle, 100 N, K2, 0 m", "hammer +500 mm/min, 100 N, K1, 0 m"}}
SEPARATING["skew"] = {"hammer idle, 100 N, K2, 0 m"}
"""A dead time of the loop acts in motion only and with the bandwidth of the servo, a skew of the clock at rest too."""

FURTHER = (Plan(), Plan(feed=500.0, controller="K1"), Plan(feed=-500.0), Plan(feed=1000.0))


def records(machine, chain, *plans):
    last = max(len(plans) - 1, 1)
    return measure(machine, Design("pair", tuple(replace(p, order=i / last) for i, p in enumerate(plans))), 1, chain)


@pytest.mark.parametrize(("effect", "cause"), [("delay", "loop_delay"), ("skew", "time_skew")])
def test_a_dead_time_or_a_skewed_clock_in_one_measurement_is_settled_by_the_next(effect, cause):
    machine, chain = apply({effect: EFFECTS[effect].size}, Truth(), Chain())
    further = records(Truth(), Chain(), *FURTHER)
    proposals = tuple(replace(condition_of(r), observed=None) for r in further)
    first = diagnose(family(records(machine, chain, MOVING), proposals=proposals))
    assert first.verdict == "insufficient_data"
    assert first.next_experiment.name in SEPARATING[effect]
    assert first.next_experiment.probability > 0.9
    chosen = FURTHER[[p.name for p in proposals].index(first.next_experiment.name)]
    settled = diagnose(family(records(machine, chain, MOVING, chosen)))
    assert settled.verdict == "named"
    assert [c.id for c in settled.causes] == [cause]
