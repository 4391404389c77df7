"""Measuring methods ranked by what they predict: method x controller x spindle speed, with intervals and differences.

A prediction of one cutting test is right, falsely stable (it chattered), falsely unstable (it did not), or the test was
undecided. Of k right ones among n decided the share has the exact interval of the binomial (Clopper and Pearson 1934)::

    low = Beta^-1(alpha/2; k, n - k + 1),   high = Beta^-1(1 - alpha/2; k + 1, n - k)

Two methods are compared on the tests that both predicted: of b tests that only the one had right and c that only the
other had, the difference is chance with the p-value of the exact test of McNemar (1947), two-sided:
``p = min(1, 2 P(B <= min(b, c)))``, B binomial of b + c with 1/2. All pairs of methods together are held to 5 % by Holm
(1979); those under one controller, again, for themselves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from smfe.campaign import Campaign, CuttingTest, LobeRequest
from smfe.limits.cut_conditions import MODEL, Source, feed_of, in_motion, kind_of, sources_of
from smfe.results import write_csv

RANKING, DIFFERENCES = "ranking.csv", "ranking_differences.csv"

CONFIDENCE = 0.95
"""Of the intervals; 1 less it is the error that all differences under one controller, or over all, are held to."""

RIGHT, FALSELY_STABLE, FALSELY_UNSTABLE, UNDECIDED = "right", "falsely_stable", "falsely_unstable", "undecided"
OUTCOMES = (RIGHT, FALSELY_STABLE, FALSELY_UNSTABLE, UNDECIDED)

ALL = "all"
"""Controller of a row that counts the tests of all controllers."""


@dataclass(frozen=True)
class Ranking:
    """Methods by the share of cutting tests that they predict rightly.

    Parameters
    ----------
    table : pandas.DataFrame
        The best method first; a row a method, controller and spindle speed, one a method and controller (no speed), and
        one a method (controller "all"): ``right``, ``falsely_stable``, ``falsely_unstable``, ``undecided`` count tests,
        ``share_right`` with ``share_low`` and ``share_high`` is of the decided ones [1].
    differences : pandas.DataFrame
        A row a pair of methods and controller: ``only_a_right`` and ``only_b_right`` of ``tests`` decided ones that
        both predicted, ``p_value``, that of all pairs together (``p_value_of_all``) and whether it is ``significant``.
    """

    table: pd.DataFrame
    differences: pd.DataFrame


def ranked(campaign: Campaign, rows: Sequence[Mapping[str, Any]]) -> Ranking:
    """Rank the methods of a campaign by what they predicted for its cutting tests.

    Parameters
    ----------
    campaign : Campaign
        With its ``[[lobes]]`` and ``[[cutting_test]]``.
    rows : sequence of mapping
        Rows of chatter.csv, one a cutting test, in the order of the campaign.

    Returns
    -------
    Ranking
        Empty where no source predicted a test.

    Notes
    -----
    A method is how a compliance was measured (hammer, actuator, sweep, or the name of a model), at rest or in motion,
    whatever the controller, so that hammer tests under two controllers are one method. Where two of one kind predict
    the same test they are told apart by feed, by level, and last by their names.
    """
    tests = pd.DataFrame(
        [
            {"method": method, "controller": controller, "speed": speed, "test": i, "outcome": outcome}
            for i, (test, row) in enumerate(zip(campaign.cutting_tests, rows, strict=True))
            for method, controller, speed, outcome in _predicted(campaign, test, row)
        ],
        columns=["method", "controller", "speed", "test", "outcome"],
    )
    # A test that states no controller, predicted under two: which of them was the method's is not known.
    tests = tests[~tests.duplicated(["method", "test"], keep=False)]
    return Ranking(_counted(tests), _compared(tests))


def write_ranking(folder: Path, found: Ranking) -> None:
    """Write ranking.csv and ranking_differences.csv, or remove those of an earlier run where nothing was predicted."""
    for name, frame in ((RANKING, found.table), (DIFFERENCES, found.differences)):
        if frame.empty:
            (folder / name).unlink(missing_ok=True)
        else:
            write_csv(folder / name, frame)


def _predicted(campaign: Campaign, test: CuttingTest, row: Mapping[str, Any]) -> Iterator[tuple[str, str, float, str]]:
    """Yield method, controller, speed and outcome of each source that has predicted a test."""
    happened = str(row.get("observed") or row["verdict"])
    names = method_names(campaign)
    for label, (source, name) in names.items():
        predicted = row.get(f"predicted_{label}")
        if predicted not in ("stable", "chatter"):
            continue
        if happened not in ("stable", "chatter"):
            outcome = UNDECIDED
        elif happened == predicted:
            outcome = RIGHT
        else:
            outcome = FALSELY_STABLE if predicted == "stable" else FALSELY_UNSTABLE
        controller = test.controller or source.controller or ""
        # A controller that is called "all" is no sum.
        yield name, f"{ALL} (controller)" if controller == ALL else controller, round(test.spindle_speed, 6), outcome


def method_names(campaign: Campaign) -> dict[str, tuple[Source, str]]:
    """Return what each source of lobes is called among the methods: label -> (source, method).

    Parameters
    ----------
    campaign : Campaign
        With its ``[[lobes]]``.
    """
    found: dict[str, tuple[Source, LobeRequest]] = {}
    for request in campaign.lobes:
        for source in sources_of(campaign, request):
            found.setdefault(source.label, (source, request))
    parts: tuple[Callable[[Source], str], ...] = (
        lambda s: _feed_text(campaign, s),
        lambda s: _level_text(campaign, s),
        lambda s: f"({s.label})",
    )
    names = {label: _kind(campaign, source, request) for label, (source, request) in found.items()}
    for part in parts:
        clashing = {
            names[a] for a, b in combinations(names, 2) if names[a] == names[b] and _meet(found[a][0], found[b][0])
        }
        names = {
            label: " ".join(filter(None, [name, part(found[label][0])])) if name in clashing else name
            for label, name in names.items()
        }
    return {label: (found[label][0], name) for label, name in names.items()}


def _meet(a: Source, b: Source) -> bool:
    """Return whether one cutting test may be predicted by both: nothing that is stated differs."""
    pairs = ((a.controller, b.controller), (a.position, b.position))
    return all(x is None or y is None or x == y for x, y in pairs)


def _kind(campaign: Campaign, source: Source, request: LobeRequest) -> str:
    kind = kind_of(campaign, source)
    if kind == MODEL:
        return source.label
    if request.method == "operating_point":
        return f"{kind} at the operating point"
    measured = [m for m in campaign.measurements if m.name in source.names]
    if all(m.feed is None and all(entry.feed is None for entry in m.records) for m in measured):
        return kind
    if any(m.method == "sweep" for m in measured):
        return kind
    return f"{kind} in motion" if in_motion(campaign, source) else f"{kind} at rest"


def _feed_text(campaign: Campaign, source: Source) -> str:
    feeds = [feed_of(m.feed) for m in campaign.measurements if m.name in source.names and m.feed]
    speeds = sorted({round(6e4 * feed.speed, 6) for feed in feeds if feed is not None and feed.speed > 0.0})
    return f"at {' and '.join(f'{v:g}' for v in speeds)} mm/min" if speeds else ""


def _level_text(campaign: Campaign, source: Source) -> str:
    measured = [m for m in campaign.measurements if m.name in source.names]
    depths = sorted({1e3 * m.depth_of_cut for m in measured if m.depth_of_cut is not None})
    forces = sorted({m.force_level for m in measured if m.force_level is not None})
    if depths:
        return f"at {' and '.join(f'{v:.6g}' for v in depths)} mm"
    return f"at {' and '.join(f'{v:.6g}' for v in forces)} N" if forces else ""


def share_interval(right: int, of: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the exact interval of a share of right predictions [1] (Clopper and Pearson).

    Parameters
    ----------
    right, of : int
        Right predictions among decided tests.
    confidence : float, optional
        Probability that the interval holds the share, at least.

    Returns
    -------
    low, high : float
        0 and 1 where there is no test.
    """
    tail = 0.5 * (1.0 - confidence)
    low = float(stats.beta.ppf(tail, right, of - right + 1)) if right > 0 else 0.0
    high = float(stats.beta.ppf(1.0 - tail, right + 1, of - right)) if right < of else 1.0
    return low, high


def _counted(tests: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of ranking.csv, the method with the highest share of right predictions first."""
    if tests.empty:
        return pd.DataFrame()
    whole = {name: _row(of, name, ALL, math.nan) for name, of in tests.groupby("method", sort=False)}
    order = sorted(whole, key=lambda n: (-np.nan_to_num(whole[n]["share_right"]), whole[n][FALSELY_STABLE], n))
    rows = []
    for name in order:
        own = tests[tests["method"] == name]
        controllers = sorted(own["controller"].unique())
        rows.append(whole[name])
        for controller in controllers:
            under = own[own["controller"] == controller]
            if controllers != [""]:
                rows.append(_row(under, name, controller, math.nan))
            rows += [_row(at, name, controller, float(str(speed))) for speed, at in under.groupby("speed")]
    return pd.DataFrame(rows)


def _row(tests: pd.DataFrame, method: object, controller: str, speed: float) -> dict[str, Any]:
    counts = {outcome: int((tests["outcome"] == outcome).sum()) for outcome in OUTCOMES}
    decided = len(tests) - counts[UNDECIDED]
    low, high = share_interval(counts[RIGHT], decided)
    return {
        "method": method,
        "controller": controller,
        "spindle_speed_rpm": speed,
        "tests": len(tests),
        **counts,
        "share_right": counts[RIGHT] / decided if decided else math.nan,
        "share_low": low,
        "share_high": high,
    }


def _compared(tests: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of ranking_differences.csv: every pair of methods, over all controllers and under each."""
    decided = tests[tests["outcome"] != UNDECIDED]
    rows = []
    controllers = sorted(decided["controller"].unique())
    for controller in [ALL, *(controllers if len(controllers) > 1 else [])]:
        under = decided if controller == ALL else decided[decided["controller"] == controller]
        right = under.assign(right=under["outcome"] == RIGHT).pivot_table(
            index="test", columns="method", values="right", aggfunc="first"
        )
        pairs = []
        for a, b in combinations(map(str, right.columns), 2):
            both = right[[a, b]].dropna().astype(bool)
            only_a, only_b = int((both[a] & ~both[b]).sum()), int((both[b] & ~both[a]).sum())
            if len(both):
                better, other, more, fewer = (a, b, only_a, only_b) if only_a >= only_b else (b, a, only_b, only_a)
                p = min(1.0, 2.0 * float(stats.binom.cdf(fewer, more + fewer, 0.5)))
                pairs.append((better, other, len(both), more, fewer, p))
        adjusted = _holm([pair[-1] for pair in pairs])
        rows += [
            {
                "method_a": a,
                "method_b": b,
                "controller": controller,
                "tests": n,
                "only_a_right": more,
                "only_b_right": fewer,
                "p_value": p,
                "p_value_of_all": held,
                "significant": held < 1.0 - CONFIDENCE,
            }
            for (a, b, n, more, fewer, p), held in zip(pairs, adjusted, strict=True)
        ]
    return pd.DataFrame(rows)


def _holm(p_values: Sequence[float]) -> list[float]:
    """Return the p-values of pairs that are looked at together (Holm): the k-th smallest times the pairs left."""
    order = np.argsort(p_values, kind="stable")
    out, largest = [0.0] * len(p_values), 0.0
    for k, i in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - k) * p_values[i]))
        out[i] = largest
    return out
