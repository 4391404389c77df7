"""The recommendation: the one cut that a campaign's lobes allow, computed once and said the same everywhere.

Rules, in this order, for each request of a campaign:

1. **Which source.** A measurement before a ``[[model]]``, which is taken only where nothing else is there. Then what
   the cutting tests confirm (outcomes known, none chattered where the source predicts a stable cut) before what no test
   has tried, and last what they contradict. Then what was measured while cutting (a sweep) before what was measured
   in motion (a feed) and at rest; then a limit whose uncertainty is known; then the larger share of tests predicted
   rightly, and the narrower band.
2. **Which depth.** The safe depth of the lobes, the smallest wherever the spindle may turn about its speed
   (`stability.best_pockets`), at most what `smfe.limits.ceilings` allows, rounded down to 0.1 mm; its removal rate is
   that of the rounded depth. Without a known uncertainty there is no safe depth: the limit is given, and no depth.
   So it is where a cutting test chattered at a depth that the source calls safe: its probability is refuted.
3. **Which speed.** That of the pocket with the largest removal rate; one at an end of the range of speeds only where
   there is no pocket inside.

Over all requests the recommendation is that with the largest removal rate among those that give a depth.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from process.errors import InputError
from process.notebook import html_table
from smfe.campaign import Campaign
from smfe.limits.campaign_lobes import LobeResult
from smfe.limits.ceilings import ceilings_of, deepest, fastest
from smfe.limits.cut_conditions import MODEL
from stability import best_pockets
from stability.tables.pockets import DEPTH_STEP, lowest_about, usable_depths
from stability.tables.presets import FORMAT, LIMIT_ONLY, NONE, RECOMMENDED, VERSION, check_presets, read_presets

PRESETS = "presets.json"
"""File of the recommendation."""

CONDITIONS = CUTTING, IN_MOTION, AT_REST = "while cutting", "in motion", "at rest"
"""Under what a source was measured: the nearest to the cut that is asked for first."""

APART = 0.05
"""Share of the limit by which two sources must differ before it is said that they do."""

UNEXPLAINED = 1.96
"""Difference of two limits over its standard deviation from which their uncertainties do not explain it (5 %)."""

_WIDTH_OF_BAND = 2.0 * 1.6448536269514722
"""From the 5 % to the 95 % quantile, in standard deviations."""


_SHOWN: dict[str, tuple[str, str, int]] = {
    "spindle_speed_rpm": ("spindle speed", "rpm", 0),
    "depth_of_cut_mm": ("depth of cut", "mm", 1),
    "limit_depth_mm": ("limit depth", "mm", 2),
    "width_of_cut_mm": ("width of cut", "mm", 1),
    "feed_mm_min": ("feed", "mm/min", 0),
    "feed_per_tooth_mm": ("feed per tooth", "mm", 3),
    "cutting_speed_m_min": ("cutting speed", "m/min", 0),
    "removal_rate_cm3_min": ("removal rate", "cm³/min", 1),
    "probability": ("stable with a probability of at least", "1", 2),
    "chatter_frequency_Hz": ("chatter frequency", "Hz", 1),
    "source": ("source", "", 0),
}
"""What a notebook shows: name, unit, decimals."""


@dataclass(frozen=True)
class Recommendation:
    """One cut: speed, depth and how sure it is, with units in the names; None where there is none or it is not known.

    Parameters
    ----------
    status : str
        "recommended"; "limit_only": a limit whose uncertainty is not known, so that no depth is given; "none".
    spindle_speed_rpm, speed_from_rpm, speed_to_rpm : float or None
        What to set, and the range of computed speeds about it in which the depth holds.
    depth_of_cut_mm : float or None
        Axial depth a_p, rounded down to 0.1 mm.
    limit_depth_mm, limit_depth_p05_mm, limit_depth_p95_mm : float or None
        Limit with its 5 % and 95 % quantile, at the speed within the accuracy of the spindle where it is lowest; None:
        no limit, or not known.
    width_of_cut_mm, feed_per_tooth_mm : float
        Of the request.
    feed_mm_min, cutting_speed_m_min : float or None
        ``f_z N n`` and ``pi D n``.
    removal_rate_cm3_min : float or None
        Depth times width times feed.
    probability : float or None
        With which the cut is stable, at least, as far as the uncertainty of compliance and coefficients goes.
    chatter_frequency_Hz : float or None
        Of the vibration that limits the depth.
    lobes, method, cut, source : str
        Request ("lobes_1"), stability method, kind of cut, and the measurement or model.
    reason : str
        Why this source, and what limits the depth.
    assumptions : tuple of str
        What was taken for granted, a sentence each.
    tool : mapping
        Name, diameter, teeth, approach angle, and where they are known pitch, helix and length of the edges.
    material, machine : str
        As the campaign calls them.
    limited_by : str
        What keeps the depth from being greater, "the power of the spindle: 9.8 of 10 kW"; empty without a depth.
    """

    status: str
    spindle_speed_rpm: float | None
    speed_from_rpm: float | None
    speed_to_rpm: float | None
    depth_of_cut_mm: float | None
    limit_depth_mm: float | None
    limit_depth_p05_mm: float | None
    limit_depth_p95_mm: float | None
    width_of_cut_mm: float
    feed_per_tooth_mm: float
    feed_mm_min: float | None
    cutting_speed_m_min: float | None
    removal_rate_cm3_min: float | None
    probability: float | None
    chatter_frequency_Hz: float | None
    lobes: str
    method: str
    cut: str
    source: str
    reason: str
    assumptions: tuple[str, ...]
    tool: Mapping[str, Any]
    material: str
    machine: str
    limited_by: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values under the same names, as every output writes it."""
        return {**asdict(self), "assumptions": list(self.assumptions), "tool": dict(self.tool)}

    def _repr_html_(self) -> str:
        """Return a table for a notebook."""
        rows = []
        for name, (title, unit, digits) in _SHOWN.items():
            value = getattr(self, name)
            if value is not None:
                rows.append((title, f"{value:.{digits}f}" if isinstance(value, float | int) else str(value), unit))
        title = {
            RECOMMENDED: "Recommended cut",
            LIMIT_ONLY: "Limit; its uncertainty is not known, so that no depth is given",
        }.get(self.status, "No cut is recommended")
        return html_table(title, rows, notes=(self.reason, *self.assumptions))


@dataclass(frozen=True)
class Answers:
    """What the lobes of a campaign allow.

    Parameters
    ----------
    best : Recommendation
        The one over all requests.
    each : tuple of Recommendation
        One a request.
    presets : tuple of Recommendation
        Every pocket that gives a depth: first the recommended one of a request, then the others of its source, then
        those of the other sources.
    pockets : pandas.DataFrame
        Rows of pockets.csv, the recommended one first; ``recommended`` is true in that row alone.
    """

    best: Recommendation
    each: tuple[Recommendation, ...]
    presets: tuple[Recommendation, ...]
    pockets: pd.DataFrame

    def document(self) -> dict[str, Any]:
        """Return the content of presets.json.

        Raises
        ------
        InputError
            When something in it is not of the form of `stability.PRESET_SCHEMA`.
        """
        return check_presets(
            {
                "format": FORMAT,
                "version": VERSION,
                "recommendation": self.best.as_dict(),
                "recommendations": [r.as_dict() for r in self.each],
                "presets": [r.as_dict() for r in self.presets],
            }
        )


def recommendation_of(folder: Path | str) -> Recommendation | None:
    """Return the recommendation in a folder of results; None where no lobes were asked for.

    Parameters
    ----------
    folder : path
        What `smfe run` has written.

    Raises
    ------
    InputError
        When there is no such folder, or its presets.json cannot be read.
    """
    path = Path(folder)
    if not path.is_dir():
        raise InputError(f"there is no folder '{path}'; `smfe run CAMPAIGN --out {path}` makes it")
    if not (path / PRESETS).is_file():
        return None
    found = read_presets(path / PRESETS)["recommendation"]
    return Recommendation(**{**found, "assumptions": tuple(found["assumptions"])})


def pockets_of(result: LobeResult, campaign: Campaign) -> pd.DataFrame:
    """Return the best pockets of one result.

    Speeds without a limit count only where something else limits the depth.

    Parameters
    ----------
    result : LobeResult
        Lobes of one request and source.
    campaign : Campaign
        Spindle, and what tool and machine can do.
    """
    return best_pockets(**_rules(result, campaign))


def depths_of(result: LobeResult, campaign: Campaign) -> pd.DataFrame:
    """Return the depth that may be cut at each speed that can be set, by the rules of the recommendation.

    Parameters
    ----------
    result, campaign
        As of `pockets_of`.

    Returns
    -------
    pandas.DataFrame
        From `stability.tables.pockets.usable_depths`.
    """
    return usable_depths(**_rules(result, campaign))


def _rules(result: LobeResult, campaign: Campaign) -> dict[str, Any]:
    """Return the table of a result, and what limits its cut, as `best_pockets` takes them."""
    asked, table = result.asked, result.table if result.near is None else result.near
    ceilings, spindle = ceilings_of(campaign, asked, result.reach), fastest(campaign, asked)
    if spindle is None:
        table = table.iloc[:0]
    elif not ceilings:
        table = table[np.isfinite(table["limit_depth_mm"].to_numpy(float))]
    speeds = asked.spindle_speed if asked.listed else None
    return {
        "table": table,
        "spindle": spindle,
        "maximum_depth": lambda speed: deepest(ceilings, speed),
        "speeds": speeds,
    }


def recommend(results: Sequence[LobeResult], campaign: Campaign, tests: Sequence[Mapping[str, Any]] = ()) -> Answers:
    """Return the recommendation of a campaign and what stands beside it.

    Parameters
    ----------
    results : sequence of LobeResult
        At least one.
    campaign : Campaign
        Tool, work material, spindle, machine.
    tests : sequence of mapping, optional
        Rows of chatter.csv: outcome of each cutting test, and what each source predicts.
    """
    requests = list(dict.fromkeys(r.request for r in results))
    candidates = {q: _ranked([_Candidate(r, campaign, tests) for r in results if r.request == q]) for q in requests}
    each = {q: _chosen(ranked) for q, ranked in candidates.items()}
    best = max(each, key=lambda q: _merit(each[q]))
    order = [best, *(q for q in requests if q != best)]
    frames = [c.rows() for q in order for c in candidates[q]]
    pockets = pd.concat([f for f in frames if len(f)] or frames[:1], ignore_index=True)
    pockets.insert(0, "recommended", False)
    if each[best].status == RECOMMENDED:
        pockets.loc[0, "recommended"] = True
    presets = [p for q in order for c in candidates[q] for p in c.presets()]
    return Answers(each[best], tuple(each.values()), tuple(presets), pockets)


def _merit(answer: Recommendation) -> tuple[int, float]:
    rank = (NONE, LIMIT_ONLY, RECOMMENDED).index(answer.status)
    limit = (answer.limit_depth_mm or 0.0) * answer.width_of_cut_mm * (answer.feed_mm_min or 0.0)
    return rank, answer.removal_rate_cm3_min or limit


class _Candidate:
    """One source of a request: its pockets, and what the cutting tests say of it."""

    def __init__(self, result: LobeResult, campaign: Campaign, tests: Sequence[Mapping[str, Any]]) -> None:
        self.result, self.campaign = result, campaign
        self.counted = [
            t for t in tests if _outcome(t) and t.get(f"predicted_{result.source}") in ("stable", "chatter")
        ]

    @cached_property
    def pockets(self) -> pd.DataFrame:
        return pockets_of(self.result, self.campaign)

    @property
    def is_model(self) -> bool:
        return MODEL in self.result.kind

    @property
    def known(self) -> bool:
        """Whether the uncertainty of the limit is known somewhere."""
        return bool(self.result.table["limit_depth_p05_mm"].notna().any())

    @property
    def condition(self) -> str:
        """Under what it was measured."""
        if self.result.kind == "sweep":
            return CUTTING
        return IN_MOTION if self.result.in_motion else AT_REST

    @property
    def width_of_band(self) -> float:
        """Median ratio of the 95 % to the 5 % quantile of the limit; inf where it is not known."""
        table = self.result.table
        low, high = (table[f"limit_depth_{end}_mm"].to_numpy(float) for end in ("p05", "p95"))
        known = np.isfinite(high) & (low > 0.0)
        return float(np.median(high[known] / low[known])) if known.any() else math.inf

    @cached_property
    def right(self) -> int:
        """Tests predicted rightly."""
        return sum(_outcome(t) == t[f"predicted_{self.result.source}"] for t in self.counted)

    @cached_property
    def falsely_stable(self) -> int:
        """Tests that chattered where the limit promises a stable cut."""
        return sum(_outcome(t) == "chatter" and t[f"predicted_{self.result.source}"] == "stable" for t in self.counted)

    @cached_property
    def contradicted(self) -> int:
        """Tests that chattered at a depth that is called safe."""
        table = self.result.table
        share = (table["safe_depth_mm"] / table["limit_depth_mm"]).to_numpy(float)
        speed = table["spindle_speed_rpm"].to_numpy(float)
        count = 0
        for test in self.counted:
            at = share[int(np.abs(speed - float(test["spindle_speed_rpm"])).argmin())]
            safe = float(test[f"limit_{self.result.source}_mm"]) * (at if math.isfinite(at) else 1.0)
            count += _outcome(test) == "chatter" and float(test["depth_of_cut_mm"]) <= safe
        return count

    def limited_by(self, row: Mapping[Hashable, Any] | pd.Series) -> str:
        """Return what keeps a pocket from being deeper, and how much of what is allowed it takes."""
        at, depth = float(row["spindle_speed_rpm"]), float(row["depth_of_cut_mm"])
        given = depth if math.isfinite(depth) else float(row["limit_depth_mm"])
        least = (math.inf, "chatter")
        for ceiling in ceilings_of(self.campaign, self.result.asked, self.result.reach):
            allowed = 1e3 * float(ceiling.at(np.array([at]))[0])
            if allowed < given + DEPTH_STEP - 1e-9 and allowed < least[0]:
                least = (allowed, ceiling.said(1e-3 * min(given, allowed), at))
        return least[1]

    @property
    def status(self) -> str:
        """What the best pocket is good for."""
        if self.pockets.empty or self.pockets["depth_of_cut_mm"].iloc[0] == 0.0:
            return NONE
        return RECOMMENDED if self.known and not self.contradicted else LIMIT_ONLY

    def order(self) -> tuple[float, ...]:
        """Return what ranks the sources, smallest first."""
        tested = 0.0 if self.counted and not self.falsely_stable else 1.0 if not self.counted else 2.0
        wrong = 1.0 - self.right / len(self.counted) if self.counted else 0.0
        return (
            float(self.is_model),
            float(self.contradicted > 0),
            tested,
            float(CONDITIONS.index(self.condition)),
            float(not self.known),
            wrong,
            self.width_of_band,
        )

    def rows(self) -> pd.DataFrame:
        """Return the rows of pockets.csv."""
        asked = self.result.asked
        out = self.pockets.copy()
        out.insert(0, "lobes", self.result.request)
        out.insert(2, "kind", self.result.kind)
        out.insert(3, "method", asked.method)
        out.insert(4, "cut", asked.cut)
        out["limited_by"] = [self.limited_by(row) for row in self.pockets.to_dict("records")]
        if self.contradicted:
            # Nothing that a test has refuted is called safe, in any file.
            for name in ("depth_of_cut_mm", "safe_depth_mm", "removal_rate_cm3_min"):
                out[name] = math.nan
        return out

    def presets(self) -> list[Recommendation]:
        """Return every pocket that gives a depth."""
        if self.status != RECOMMENDED:
            return []
        rows = self.pockets[self.pockets["depth_of_cut_mm"] > 0.0]
        return [self.cut(row, RECOMMENDED, _depth_sentence(self, row)) for _, row in rows.iterrows()]

    def cut(self, row: pd.Series | None, status: str, reason: str) -> Recommendation:
        """Return one pocket, or none, as a recommendation."""
        result, campaign = self.result, self.campaign
        assert campaign.tool is not None
        given = {} if row is None else row.to_dict()
        number = {name: _known(given.get(name)) for name in _NUMBERS}
        if status != RECOMMENDED:
            number |= {"depth_of_cut_mm": None, "removal_rate_cm3_min": None}
        speed = number["spindle_speed_rpm"]
        return Recommendation(
            **number,
            status=status,
            width_of_cut_mm=_short(1e3 * result.asked.width_of_cut),
            feed_per_tooth_mm=_short(1e3 * result.asked.feed_per_tooth),
            cutting_speed_m_min=None if speed is None else _short(math.pi * campaign.tool.diameter * speed),
            probability=result.lobes.attrs.get("safe_probability") if status == RECOMMENDED else None,
            lobes=result.request,
            method=result.asked.method,
            cut=result.asked.cut,
            source=result.source,
            reason=reason,
            assumptions=assumptions_of(campaign, result),
            tool=tool_of(campaign),
            material=campaign.material or "work material",
            machine=campaign.machine or campaign.name,
            limited_by="" if row is None or status != RECOMMENDED else self.limited_by(row),
        )


_NUMBERS = (
    "spindle_speed_rpm",
    "speed_from_rpm",
    "speed_to_rpm",
    "depth_of_cut_mm",
    "limit_depth_mm",
    "limit_depth_p05_mm",
    "limit_depth_p95_mm",
    "feed_mm_min",
    "removal_rate_cm3_min",
    "chatter_frequency_Hz",
)


def _known(value: Any) -> float | None:
    return None if value is None or not math.isfinite(value) else _short(float(value))


def _short(value: float) -> float:
    """Return a number with six digits: more is not known."""
    return float(f"{value:.6g}")


def _outcome(test: Mapping[str, Any]) -> str:
    """Return what happened in a cutting test, as observed or else as judged; empty where that is open."""
    known = ("stable", "chatter")
    return str(next((v for v in (test.get("observed"), test.get("verdict")) if v in known), ""))


def _ranked(candidates: Sequence[_Candidate]) -> list[_Candidate]:
    return sorted(candidates, key=_Candidate.order)


def _chosen(ranked: Sequence[_Candidate]) -> Recommendation:
    """Return the recommendation of one request from its sources, best first."""
    source = ranked[0]
    status = source.status
    sentences = [_source_sentence(source, ranked)]
    if status == NONE:
        return source.cut(None, NONE, " ".join([*sentences, _no_pocket(source)]))
    row = source.pockets.iloc[0]
    if status == LIMIT_ONLY:
        sentences.append(_no_depth(source))
    else:
        sentences.append(_depth_sentence(source, row))
    if row["at_edge"]:
        sentences.append(
            "The speed is an end of the range that can be set, and no pocket lies inside: ask for a wider range."
        )
    sentences += _disagreements(source, ranked[1:], row)
    return source.cut(row, status, " ".join(sentences))


def _source_sentence(source: _Candidate, ranked: Sequence[_Candidate]) -> str:
    """Say why this source."""
    if source.is_model:
        what = f"{_spoken(source)}, a model: no measurement is asked for beside it"
    else:
        what = f"{_spoken(source)}, measured {source.condition}"
    total = len(source.counted)
    if total and not source.falsely_stable:
        what += f"; it predicts {source.right} of {total} cutting {'test' if total == 1 else 'tests'} rightly"
    elif total:
        what += f"; {_tests(source.falsely_stable)} chattered where it predicts a stable cut"
    aside = [c for c in ranked[1:] if _set_aside(c, source)]
    if aside:
        what += f"; {_aside(aside)}"
    return f"From {what}."


def _aside(sources: Sequence[_Candidate]) -> str:
    """Say which sources the cutting tests speak against."""
    names, counts = _listed([_spoken(c) for c in sources]), _listed([str(c.falsely_stable) for c in sources])
    if len(sources) > 1:
        return f"{names} are set aside: {counts} cuts that they call stable chattered"
    return f"{names} is set aside: {counts} {'cut' if counts == '1' else 'cuts'} that it calls stable chattered"


def _set_aside(other: _Candidate, source: _Candidate) -> bool:
    """Whether the cutting tests speak against another source, and not against this one."""
    return other.falsely_stable > 0 and not source.falsely_stable


def _spoken(source: _Candidate) -> str:
    """Return the name of a source as it stands in a sentence."""
    return source.result.source.replace("_", " ")


def _listed(parts: Sequence[str]) -> str:
    return f"{', '.join(parts[:-1])} and {parts[-1]}" if len(parts) > 1 else parts[0]


def _tests(count: int) -> str:
    return "a cutting test" if count == 1 else f"{count} cutting tests"


def _depth_sentence(source: _Candidate, row: pd.Series) -> str:
    """Say what limits the depth."""
    return f"The depth is limited by {source.limited_by(row)}."


def _no_depth(source: _Candidate) -> str:
    """Say why no depth is given with a limit."""
    if source.contradicted:
        return (
            f"{_tests(source.contradicted).capitalize()} chattered at a depth that it calls safe, so no "
            f"depth is recommended; {_correction(source)}."
        )
    if source.result.asked.process_damping.coefficient > 0.0:
        return (
            "This is the limit with a worn flank, and how well process_damping is known is not said: no depth is "
            "called safe; ask for the same lobes without it as well, those of a sharp edge."
        )
    what = (
        "a model whose uncertainty is not stated" if source.is_model else "a compliance whose uncertainty is not known"
    )
    return f"This is the limit of {what}: no depth is called safe; {_remedy(source)}."


def _correction(source: _Candidate) -> str:
    """Say what to do about a source that a cutting test has refuted."""
    if source.is_model:
        return "correct the model, or measure"
    if source.condition == AT_REST:
        return "measure in motion"
    return "look at what the diagram shows there, or measure again in the state in which the test was cut"


def _remedy(source: _Candidate) -> str:
    if source.is_model:
        return 'say uncertainty = { frequency = "1 %", damping = "20 %", stiffness = "5 %" } in its [[model]]'
    if source.result.asked.method == "operating_point":
        return "an operating point has no band yet; ask for the lobes of one measurement as well"
    return "hit at least three times, or give the coherence and the number of averages"


def _no_pocket(source: _Candidate) -> str:
    """Say why there is no cut at all."""
    pockets = source.pockets
    if pockets.empty and fastest(source.campaign, source.result.asked) is None:
        return "No speed of the spindle is slow enough for the feed of the machine; take a smaller feed_per_tooth."
    if np.isinf(source.result.table["limit_depth_mm"].to_numpy(float)).all():
        return "No limit was found at any speed; say maximum_depth in [[lobes]] or edge_length in [tool]."
    if pockets.empty:
        return "None of its speeds can be set with a depth; ask for speeds that the spindle reaches, or measure again."
    speed, safe = pockets["spindle_speed_rpm"].iloc[0], pockets["safe_depth_mm"].iloc[0]
    return (
        f"At the best speed, {speed:g} rpm, {safe:.2g} mm are safe, less than the {DEPTH_STEP:g} mm to which depths "
        "are rounded down."
    )


def _disagreements(source: _Candidate, others: Sequence[_Candidate], row: pd.Series) -> list[str]:
    """Say which other measurements give another limit at this speed than the uncertainties explain.

    Those that the cutting tests have set aside are named before.
    """
    speed = float(row["spindle_speed_rpm"])
    own = _limit_about(source, speed)
    said: dict[bool, list[str]] = {True: [], False: []}
    for other in others:
        found = None if other.is_model or _set_aside(other, source) else _limit_about(other, speed)
        if own is None or found is None:
            continue
        difference = math.log(found[0] / own[0])
        spread = math.hypot(own[1], found[1])
        if abs(difference) > math.log1p(APART) and not abs(difference) <= UNEXPLAINED * spread:
            share = f"{100.0 * abs(math.expm1(difference)):.0f} % {'higher' if difference > 0.0 else 'lower'}"
            said[math.isfinite(spread)].append(f"{_spoken(other)} {share}")
    out = []
    if said[True]:
        out.append(f"Limits that differ at this speed by more than the uncertainties explain: {_listed(said[True])}.")
    if said[False]:
        out.append(f"Limits of unknown uncertainty that differ at this speed: {_listed(said[False])}.")
    return out


def _limit_about(source: _Candidate, speed: float) -> tuple[float, float] | None:
    """Return the smallest limit [mm] within the accuracy of the spindle about a speed and its relative deviation.

    The standard deviation is that without the coefficients, which are the same for all sources: what they add explains
    no difference.
    """
    table = source.result.table if source.result.near is None else source.result.near
    row = lowest_about(table, "limit_depth_mm", speed, source.campaign.spindle.accuracy)
    limit = float(row["limit_depth_mm"])
    if not (math.isfinite(limit) and limit > 0.0):
        return None
    low, high = float(row["limit_depth_p05_mm"]), float(row["limit_depth_p95_mm"])
    if not (0.0 < low <= high < math.inf):
        return limit, math.nan
    whole = math.log(high / low) / _WIDTH_OF_BAND
    return limit, math.sqrt(max(whole**2 - source.campaign.coefficients_known_within**2, 0.0))


def assumptions_of(campaign: Campaign, result: LobeResult) -> tuple[str, ...]:
    """Return what a recommendation takes for granted, a sentence each."""
    out = [coefficients_assumption(campaign)]
    if accuracy := campaign.spindle.accuracy:
        out.append(f"the spindle keeps its speed within {100.0 * accuracy:g} %: the lowest depth and limit there count")
    if campaign.missing_coefficients:
        names = " and ".join(campaign.missing_coefficients)
        out.append(f"[material] gives no {names}: taken as zero")
    if (worn := result.asked.process_damping.coefficient) > 0.0:
        out.append(f"the flank is as worn at every speed as process_damping = {1e-3 * worn:g} N/mm says")
    if result.asked.maximum_depth is None and campaign.machine_limits.edge_length is None:
        out.append("the cutting edges are taken to be long enough; say edge_length in [tool]")
    return tuple(out)


def coefficients_assumption(campaign: Campaign) -> str:
    """Return how well the cutting coefficients are taken to be known, as a sentence."""
    known, what = (
        campaign.coefficients_known_within,
        f"the cutting coefficients of {campaign.material or 'the material'}",
    )
    if known == 0.0:
        return f"{what} are taken as exact, as [material] says with uncertainty = 0"
    stated = campaign.coefficient_spread is not None
    said = "one standard deviation" if stated else "one standard deviation, a default: say uncertainty in [material]"
    return f"{what} are taken as known within {100.0 * known:.3g} % ({said})"


def tool_of(campaign: Campaign) -> dict[str, Any]:
    """Return the tool of a campaign with units in the names."""
    tool = campaign.tool
    assert tool is not None
    out: dict[str, Any] = {
        "name": campaign.tool_name or f"{1e3 * tool.diameter:g} mm, {tool.teeth} teeth",
        "diameter_mm": _short(1e3 * tool.diameter),
        "teeth": tool.teeth,
        "approach_angle_deg": _short(math.degrees(tool.approach_angle)),
    }
    if not tool.equal_pitch:
        out["pitch_angles_deg"] = [_short(math.degrees(p)) for p in tool.pitch_angles or ()]
    if tool.helix_angle > 0.0:
        out["helix_angle_deg"] = _short(math.degrees(tool.helix_angle))
    if campaign.machine_limits.edge_length is not None:
        out["edge_length_mm"] = _short(1e3 * campaign.machine_limits.edge_length)
    return out
