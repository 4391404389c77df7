"""From a campaign to the diagnosis of cutting forces: its cutting tests as a family."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from process.cut.engagement import engagement
from process.errors import InputError
from smfe.campaign import Campaign, CuttingTest
from smfe.diagnosis.campaign_case import Case
from smfe.diagnosis.cutting_forces import CuttingForces, cutting_family
from smfe.diagnosis.cutting_orders import SteadyCut
from smfe.records import read_records

MINUTES = 3.0
"""What a further cut takes."""


def cutting_case(campaign: Campaign) -> Case:
    """Return the case of the cutting tests of a campaign: the forces of ``[tool]`` and ``[material]`` against theirs.

    Raises
    ------
    InputError
        When a record lacks a force or is too short.
    """
    tool, material = campaign.tool, campaign.coefficients
    if tool is None or material is None:
        raise InputError("a mechanistic force needs the tables [tool] and [material]; add them")
    cuts = [_setting(test, tool.diameter) for test in campaign.cutting_tests]
    names = _names(campaign.cutting_tests, cuts)
    records = [read_records(test.file, test.channels)[0] for test in campaign.cutting_tests]
    family = cutting_family(
        dict(zip(names, zip(records, cuts, strict=True), strict=True)),
        tool,
        (material.Ktc, material.Krc, material.Kac),
        {_words(cut): cut for cut in _further(cuts)},
        edge=(material.Kte, material.Kre, material.Kae),
    )
    groups: dict[str, tuple[str, ...]] = {}
    for test, name in zip(campaign.cutting_tests, names, strict=True):
        groups[test.file.name] = (*groups.get(test.file.name, ()), name)
    held_out = tuple(dict.fromkeys(test.file.name for test in campaign.cutting_tests if test.held_out))
    return Case(_priced(family), groups, held_out, family.suspects)


def _setting(test: CuttingTest, diameter: float) -> SteadyCut:
    arc = engagement(test.cut, test.width_of_cut, diameter)
    return SteadyCut(test.spindle_speed * math.pi / 30.0, test.stated_feed_per_tooth, test.depth_of_cut, arc)


def _words(cut: SteadyCut) -> str:
    speed = f"{cut.rotation * 30.0 / math.pi:.6g} rpm"
    if cut.depth == 0.0:
        return f"spindle in air at {speed}"
    return f"cut at {speed}, {cut.feed_per_tooth * 1e3:.4g} mm per tooth, {cut.depth * 1e3:.4g} mm deep"


def _names(tests: Sequence[CuttingTest], cuts: Sequence[SteadyCut]) -> list[str]:
    """Name each cut by its setting, and by its file where another has the same."""
    words = [_words(cut) for cut in cuts]
    return [f"{w}, {t.file.name}" if words.count(w) > 1 else w for w, t in zip(words, tests, strict=True)]


def _further(cuts: Sequence[SteadyCut]) -> Iterable[SteadyCut]:
    """Cuts that could be made next: more and less feed, half the speed, and none at all."""
    real = [c for c in cuts if c.depth > 0.0]
    if not real:
        return
    least, most = (f(real, key=lambda c: c.feed_per_tooth) for f in (min, max))
    yield replace(most, feed_per_tooth=2.0 * most.feed_per_tooth)
    yield replace(least, feed_per_tooth=0.5 * least.feed_per_tooth)
    yield replace(most, rotation=0.5 * min(c.rotation for c in real))
    if all(c.depth > 0.0 for c in cuts):
        yield replace(most, depth=0.0)


def _priced(family: CuttingForces) -> CuttingForces:
    proposals = tuple(replace(p, settings={**p.settings, "minutes": MINUTES}) for p in family.proposals)
    return replace(family, proposals=proposals)
