"""Claims about what a gain on held-out conditions proves."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from smfe.diagnosis.inference.cross_validation import HeldOut, _along, compare
from smfe.diagnosis.inference.misfit import Misfit, NoiseKnowledge


def predicted(squares: list[float], along: float) -> HeldOut:
    rows = dict(enumerate(squares))
    noise = Misfit(0.5, float(len(squares)), float(len(squares)), {})
    return HeldOut(rows, dict.fromkeys(rows, 0.5), dict.fromkeys(rows, 2.0), noise, True, {}, along)


@pytest.mark.parametrize(
    ("won", "along", "proven"),
    [(100.0, 1.0, True), (100.0, math.inf, False), (30.0, 1.0, False), (100.0, 10.0, False), (500.0, 10.0, True)],
)
def test_what_acts_in_one_condition_of_ten_is_proven_by_what_it_wins_there(
    won: float, along: float, proven: bool
) -> None:
    """A gain W of squares over white noise scatters by 2 sqrt(W) if all is measured once more: 100 by 20, 30 by 11.

    Conditions drawn again without the one in which it acts are other conditions; of noise that is not known to be white
    they are the only measure of its scatter. What a model may miss of all ten alike has ten times the variance.
    """
    without = predicted([2.0 + won, *[2.0] * 9], along)
    found = compare(without, predicted([2.0] * 10, along), np.random.default_rng(0))
    assert found.db > 1.0
    assert found.proven is proven


@pytest.mark.parametrize(
    ("bounded", "off", "along"), [(False, 0.0, math.inf), (True, 0.0, 1.0), (True, 0.01, math.inf)]
)
def test_noise_that_was_measured_is_known_where_more_than_it_is_allowed_for(
    bounded: bool, off: float, along: float
) -> None:
    """Six thousand values know a scatter within 2 %; errors of a prediction that nothing whitens are no noise."""
    noise = {"bounded_noise": bounded, "measured_noise": lambda c: None}
    family = SimpleNamespace(model_error=off, roughness=0.0, decisive=0.0, **noise)
    own = dict.fromkeys(range(7), 6048.0)
    model = SimpleNamespace(family=family, conditions=[None] * 7, noise_knowledge=NoiseKnowledge(math.inf, own))
    assert _along(model, list(range(7))) == along  # type: ignore[arg-type]
