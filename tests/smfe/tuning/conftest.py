"""A search in a hurry, for what does not depend on how good its answer is."""

from dataclasses import replace

import pytest

from smfe.tuning import confirm, judge, plants, result, rules, search


@pytest.fixture
def hurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that hardly searches."""
    less = replace(
        rules.RULES,
        generations=10,
        population=20,
        clouds=8,
        cloud=20,
        fine_parts=1,
        coarse=350,
        fine=600,
        even_points=1200,
    )
    for module in (search, judge, result, plants):
        monkeypatch.setattr(module, "RULES", less)
    monkeypatch.setattr(result, "FRONTIER", 3)
    monkeypatch.setattr(confirm, "SPEEDS", 2)
