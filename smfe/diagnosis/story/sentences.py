"""A finding in sentences, in the order in which an engineer asks.

Whether what was given is right; what is wrong and what is gained; each cause with its numbers, and what to do about it;
the depth in millimetres; what to measure next; what would have been seen. The same sentences stand on the page, in the
terminal and in ``finding.json``.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.inference.thresholds import Detectable
from smfe.diagnosis.judgement.finding import (
    BaselineParameter,
    Finding,
    ForetoldCut,
    FoundCause,
    GivenParameter,
    ModelError,
    Passage,
    Pocket,
    StableDepth,
)
from smfe.diagnosis.judgement.next_experiment import Revealed
from smfe.diagnosis.story.causes import BESIDE, LEFT_OUT, MEASURED, WRONG, YES_OR_NO, Friction, numbers_of, row_of
from smfe.diagnosis.story.words import (
    count_words,
    in_words,
    listed,
    parameter_words,
    percent,
    rounded,
    unit_text,
    with_interval,
)

ABOUT = ("fault", "given", "verdict", "cause", "immaterial", "parameter", "do", "depth", "next", "power", "note")
"""What a passage of a finding may be about, in order."""

_MOST_POWERS = 5
_MOST_GIVEN = 6  # of what was declared rightly
_MOST_BETTER = 3  # of what the measurements know better
_REVEALED = 2
_AS_WELL = 0.5  # gain [dB] below which nobody sees it
_MOVED = 0.005  # relative change of the best speed that is said
_TELLING, _NORMAL = 0.9, 1.96  # an interval by how much narrower than the prior says something
_FAR = 4.0  # spreads of what was declared by which nobody moves it without a reason
_REPLACED = 0.5  # relative change of a dashpot that is said
_LITTLE = 0.005  # share of the repeatable error that a sentence calls little


@dataclass(frozen=True)
class Setting:
    """What the sentences need to know besides the finding."""

    friction: Friction | None = None  # what brakes the axis by the extended model
    faults: Sequence[Suspect] = ()  # that the data audit found
    about: str = "simulation"  # what is put to the test


def explain(finding: Finding) -> str:
    """Say a finding in plain sentences, one a line."""
    return "\n".join(finding.sentences or [p.text for p in told(finding)])


def told(finding: Finding, setting: Setting = Setting()) -> tuple[Passage, ...]:
    """Return the passages of a finding: faults of the data, whether what was given is right, then the verdict."""
    makers = (_faults, _given, _verdict, _causes, _immaterial, _own_parameters, _to_do, _depths, _next, _power, _notes)
    return tuple(
        Passage(about, in_words(text))
        for about, make in zip(ABOUT, makers, strict=True)
        for text in make(finding, setting)
        if text
    )


# --- Faults of the data, before anything is blamed.


def _faults(finding: Finding, setting: Setting) -> Iterator[str]:
    for s in setting.faults:
        done = "was left out" if s.excludes else "is compared as it is"
        where = s.where.replace("_", " ") if "." not in s.where else s.where
        what = f"A fault in the data, so that it {done}" if s.level == "fault" else "Of the data"
        yield f"{what}: {where}: {s.evidence}. {_capital(s.advice)}."


# --- Is what was given right?


def _given(finding: Finding, setting: Setting) -> Iterator[str]:
    wrong = [g for g in finding.given if g.beyond]
    told = [g for g in finding.given if not g.beyond and _is_told(g)]
    unsure = finding.verdict in ("unknown", "insufficient_data")
    if not finding.given:
        return
    if wrong:
        # Of a set that the data do not separate one is wrong, not all.
        sets = {c.id: c.set for c in finding.causes if c.set is not None}
        alike: dict[object, list[str]] = {}
        for g in wrong:
            alike.setdefault(sets.get(g.cause, g.name), []).append(given_words(g))
        sure = [names[0] for names in alike.values() if len(names) == 1]
        either = [f"either {listed(names, 'or')} is wrong" for names in alike.values() if len(names) > 1]
        said = [f"Not {listed(sure, 'and')}"] * bool(sure) + either
        yield f"Is what you gave right? {_capital('; '.join(said))}."
    elif moved := [g for g in told if unsure and abs(g.found - g.given) > _FAR * g.spread]:
        said = [
            f"{given_words(g)} from {rounded(g.given)} to {with_interval(g.found, g.low, g.high, g.unit)}"
            for g in moved
        ]
        yield (
            f"Is what you gave right? That is not known: the fit moves {listed(said)}, but what is not understood may "
            "be the reason."
        )
        told = [g for g in told if g not in moved]
    elif told and unsure:
        yield "Is what you gave right? Nothing contradicts it, but what is not understood may hide an error in it."
    elif told:
        yield "Is what you gave right? As far as these measurements tell, yes."
    else:
        yield "Is what you gave right? These measurements say nothing of it."
    # Of a set each has the value that it would have alone; the fit of another of them leaves it as it was given.
    alone = {(c.id, p.name): p for c in finding.causes if c.set is not None for p in c.parameters}
    for g in wrong:
        value, worth = with_interval(g.found, g.low, g.high, g.unit), _worth(g)
        given = f"{rounded(g.given)}{unit_text(g.unit)}"
        if len(alike[sets.get(g.cause, g.name)]) > 1:
            if p := alone.get((g.cause, g.name)):
                value, worth = with_interval(p.value, p.low, p.high, p.unit), worth if p.value == g.found else ""
            worth += ", if it is this one"
        yield f"{_capital(given_words(g))}: given {given}, found {value}{worth}."
    # What is within its tolerance is not wrong, and yet a better value may be known.
    better = [g for g in told if not (unsure or g.low <= g.given <= g.high) and _matters(g, finding.material)]
    if better:
        better.sort(key=lambda g: -abs(g.cost or 0.0))
        costs = [_worth(g).removeprefix("; ").replace(" (", ", ").rstrip(")") for g in better[:_MOST_BETTER]]
        said = [
            f"{given_words(g)} {with_interval(g.found, g.low, g.high, g.unit)} in place of {rounded(g.given)} ({what})"
            for g, what in zip(better, costs, strict=False)
        ]
        more = len(better) - len(said)
        also = [count_words(more, "more parameter")] if more else []
        yield (
            f"Within tolerance, but worth {percent(finding.material)} % or more, so take what was found: "
            f"{listed([*said, *also])}."
        )
        told = [g for g in told if g not in better]
    shown = sorted(told, key=lambda g: -abs(g.cost or 0.0))[:_MOST_GIVEN]
    if shown:
        said = [
            f"{given_words(g)} {rounded(g.given)} (found {_found(g)})"
            if g.given
            else f"{given_words(g)} (off by {_found(g)})"
            for g in shown
        ]
        more = len(told) - len(shown)
        also = [count_words(more, "more parameter")] if more else []
        yield f"As declared: {listed([*said, *also])}."


def _is_told(g: GivenParameter) -> bool:
    """Whether the data narrow down what was declared to less than it was trusted."""
    return g.high - g.low < _TELLING * 2.0 * _NORMAL * g.spread


def _matters(g: GivenParameter, material: float) -> bool:
    return g.cost is not None and 0.0 < material <= g.cost < math.inf


def given_words(g: GivenParameter) -> str:
    """Return what a declared parameter is called."""
    return g.said or parameter_words(g.name)


def _found(g: GivenParameter) -> str:
    return with_interval(g.found, g.low, g.high, g.unit).replace(" (", ", ").rstrip(")")


def _worth(g: GivenParameter) -> str:
    """Return what the difference between given and found is worth."""
    if g.cost_mm is not None and g.cost is not None:
        which = "more" if g.cost_mm > 0.0 else "less"
        return f"; with it the stable depth is {rounded(abs(g.cost_mm), 2)} mm {which} ({percent(g.cost)} %)"
    return "" if g.cost is None or not math.isfinite(g.cost) else f"; worth {percent(g.cost)} %"


# --- The verdict and the gain.


def _verdict(finding: Finding, setting: Setting) -> Iterator[str]:
    causes, reason = finding.causes, finding.reason
    if finding.verdict == "consistent":
        size, left = _error_now(finding), "no more than noise"
        if finding.immaterial or finding.remainder is not None:
            left = "noise, and what is too small to matter"
        yield f"The measurements bear the simulation out: what it leaves is {left}{size}."
    elif finding.verdict == "insufficient_data":
        yield f"The measurements do not suffice for a verdict: {reason}."
    elif not causes:
        yield f"The simulation is wrong, and no known cause explains it{_error_now(finding)}: {_short(reason)}."
    else:
        gain = _gain(finding)
        open_ = [listed([_title(c) for c in group], "or") for group in finding.alternatives]
        if finding.verdict == "ambiguous" and open_:
            first = (
                f"The simulation leaves something out, and these measurements do not tell which: {'; '.join(open_)}."
            )
            yield f"{first} {gain}".strip()
        else:
            yield f"{_opening(causes, setting)} {gain}{_part(finding)}".strip()


def _opening(causes: Sequence[FoundCause], setting: Setting) -> str:
    sets = sets_of(causes)
    certain = [group[0] for group in sets if len(group) == 1]
    groups = {how: [c for c in certain if row_of(c).how == how] for how in (LEFT_OUT, WRONG, MEASURED, BESIDE)}
    detail = ""
    # Of what was given wrongly the numbers stand first of all.
    if len(causes) == 1 and causes[0].variant != "declared":
        numbers = numbers_of(causes[0], False, setting.friction)
        detail = f": {numbers}" if numbers else ""
    parts = [f"{how} {listed([_name(c) for c in groups[how]])}" for how in (LEFT_OUT, WRONG) if groups[how]]
    faults = listed([_name(c) for c in groups[MEASURED]])
    said = []
    if parts:
        said.append(f"The {setting.about} {' and '.join(parts)}{detail}.")
    if faults:
        besides = "Besides, the measurement" if parts else "The measurement"
        said.append(f"{besides} is at fault: {faults}{'' if parts else detail}.")
    if beside := listed([_name(c) for c in groups[BESIDE]]):
        what = "the measurement" if said else "The measurement"
        said.append(f"{'Besides, ' if said else ''}{what} holds something else: {beside}{'' if said else detail}.")
    said += [f"Either {listed([_clause(c, setting) for c in group], 'or')}." for group in sets if len(group) > 1]
    return " ".join(said)


def _clause(cause: FoundCause, setting: Setting) -> str:
    """Return a cause as part of a sentence, of whichever kind it is, with its numbers."""
    row, numbers = row_of(cause), numbers_of(cause, False)
    more = f" ({numbers})" if numbers else ""
    return f"{row.name}{more}" if row.how in (MEASURED, BESIDE) else f"the {setting.about} {row.how} {row.name}{more}"


def _name(cause: FoundCause) -> str:
    return row_of(cause).name


def _gain(finding: Finding) -> str:
    """Return what the extended model gains, on what no fit has seen if possible."""
    them = "With it" if len(finding.causes) == 1 else "With them"
    if finding.errors:
        unseen = [e for e in finding.errors if e.tested != "fitted"]
        proof = "" if unseen else "; no measurement could be left out of the fit to prove it"
        return f"{them} {_fall((unseen or finding.errors)[0], len(finding.causes) == 1)}{proof}."
    gain = finding.held_out_gain or finding.gain
    if gain is not None:
        where = "set aside" if finding.held_out_gain is not None else "left out of the fit in turn"
        return f"{them} the error that repeats falls by {gain.db:.1f} dB on conditions {where}."
    return ""


def _fall(e: ModelError, alone: bool) -> str:
    """Say from where to where the error goes: from that of the simulation as declared."""
    one = e.of.removesuffix("s")
    the = f"the {one}" if e.count == 1 else f"the {count_words(e.count, one)}"
    some = count_words(e.count, one)
    where = {
        "set aside": f"{the} set aside",
        "left out in turn": f"{some} left out of the fit in turn",
        "fitted": f"{the} that {'was' if e.count == 1 else 'were'} fitted",
    }[e.tested]
    falls = "falls" if e.after < e.before else "rises"
    said = f"the error on {where} {falls} from {percent(e.before)} % as declared to {percent(e.after)} %"
    said += f" ({e.gain_db:.0f} dB)" if e.after < e.before else ""
    if e.refitted is None or not _apart(e.refitted, e.before):
        return said
    return f"{said}; refitted without {'it' if alone else 'them'} the simulation is {percent(e.refitted)} % wrong there"


def _apart(one: float, other: float) -> bool:
    """Whether two errors differ by more than a decibel."""
    return abs(20.0 * math.log10(max(one, 1e-12) / max(other, 1e-12))) > 1.0


def _error_now(finding: Finding) -> str:
    """Return the error of a simulation that no cause was added to, as declared and with its values fitted."""
    e = next(iter(finding.errors), None)
    if e is None:
        return ""
    if e.refitted is None or not _apart(e.refitted, e.before):
        return f" (error {percent(e.before)} %)"
    within = "within their tolerances" if finding.verdict == "consistent" else "to the data"
    return f" (error {percent(e.before)} % as declared, {percent(e.refitted)} % with its values fitted {within})"


def _part(finding: Finding) -> str:
    """Return what remains unexplained where it is more than noise."""
    left = finding.remainder
    if left is None:
        return ""
    if finding.verdict in ("unknown", "named") and left.share is not None and left.share >= _LITTLE:
        return f" Of the error that repeats, {percent(left.share)} % remain unexplained."
    if left.share is not None:
        return f" What remains is more than noise, but only {percent(left.share)} % of the error that repeats."
    return " A part of the error that is more than noise remains unexplained."


def _short(reason: str) -> str:
    return reason.removeprefix("the baseline is wrong, but ")


# --- Causes, parameters.


def _causes(finding: Finding, setting: Setting) -> Iterator[str]:
    held_out = finding.gain is not None and finding.gain.held_out == "conditions"
    where = "conditions" if held_out else "values"
    told = {g.cause for g in finding.given if g.beyond}
    for cause in finding.causes:
        if cause.variant == "declared" and cause.set is None and cause.id in told:
            continue  # it stands under what was given, with its numbers
        # The verdict has said what brakes the axis where that is all.
        friction = setting.friction if len(finding.causes) > 1 else None
        numbers, worth = numbers_of(cause, True, friction), f"; not proven on {where} that it was not fitted to"
        if cause.gain_db is not None:
            worth = f"; {_worth_of(cause, cause.gain_db, where)}"
        elif cause.variant == "declared" and finding.gain is not None and finding.gain.proven:
            worth = ""  # what all of them gain there has been said with the verdict
        yield f"{_capital(_name(cause))}{f': {numbers}' if numbers else ''}{worth}."
    for alike in sets_of(finding.causes):
        if len(alike) > 1:
            yield (
                f"These measurements do not tell which of them it is: {listed([_title(c) for c in alike], 'or')}. The "
                f"numbers of each are those that it would have alone.{_separated(finding)}"
            )
    for group in finding.alternatives:
        yield f"These measurements do not separate {listed([_title(c) for c in group], 'from')}."


def _worth_of(cause: FoundCause, gain_db: float, where: str) -> str:
    """Return what a cause is worth: by how much the error grows without it."""
    if gain_db < _AS_WELL:
        # What fits no better with it is named because the fit without it takes values that were not declared.
        rest = "and less well on all together" if cause.ratio > 0.0 else "but only with values that were not declared"
        return f"a fit without it does as well on {where} left out of the fit, {rest}"
    times = rounded(10.0 ** (gain_db / 20.0), 2)
    size = f"{times} times as large ({gain_db:.0f} dB)"
    return f"without it the error that repeats is {size}, on {where} left out of the fit"


def _separated(finding: Finding) -> str:
    """Say whether the next experiment tells which of a set it is."""
    n = finding.next_experiment
    return " The experiment proposed below separates them." if n is not None and n.between else ""


def sets_of(causes: Sequence[FoundCause]) -> list[list[FoundCause]]:
    """Return causes in sets that the data do not separate, in their order; most are alone."""
    found: dict[object, list[FoundCause]] = {}
    for k, cause in enumerate(causes):
        found.setdefault(("alone", k) if cause.set is None else cause.set, []).append(cause)
    return list(found.values())


def _immaterial(finding: Finding, setting: Setting) -> Iterator[str]:
    """Say what is there and does not matter."""
    if not finding.immaterial:
        return
    limit = f" (less than {percent(finding.material)} %)" if finding.material > 0.0 else ""
    small, large, known = list[str](), list[str](), list[str]()
    for cause in finding.immaterial:
        numbers = numbers_of(cause, False, setting.friction)
        size = "" if cause.size is None else f", which changes {percent(cause.size)} %"
        beyond = 0.0 < finding.material <= (cause.size or 0.0)
        as_known = beyond and cause.id == "cross_axis_coupling"
        (known if as_known else large if beyond else small).append(
            f"{_name(cause)}{f' ({numbers})' if numbers else ''}{size}"
        )
    if small:
        yield f"Seen, but too small to matter{limit}: {listed(small)}."
    if known:
        yield f"Seen, and no more than what is known of it ([tolerances] mode_direction): {listed(known)}."
    if large:
        # By itself it changes much; other values of what was declared do nearly the same without it.
        yield f"Seen, but what it does to the measurements other values do as well: {listed(large)}."


def _capital(text: str) -> str:
    """Return the beginning of a sentence; the name of an axis stays small."""
    return text if text[1:2] == " " and text[0] in "xyz" else text[:1].upper() + text[1:]


def _title(cause: FoundCause) -> str:
    title = cause.title
    return title if title[:2].isupper() else title[:1].lower() + title[1:]


def _own_parameters(finding: Finding, setting: Setting) -> Iterator[str]:
    told = {g.name for g in finding.given}
    moved = [p for p in finding.baseline if p.name not in told and (p.beyond_prior or _replaced(p))]
    if moved:
        said = [
            f"{parameter_words(p.name)} {rounded(p.fitted)}{unit_text(p.unit)} in place of {rounded(p.given)}"
            for p in moved
        ]
        yield f"The measurements ask for other values than the campaign gives: {listed(said)}."


def _replaced(p: BaselineParameter) -> bool:
    """Whether something that is declared with much doubt has become another number: viscous friction beside dry one."""
    return p.name in ("viscous", "damping") and p.given > 0.0 and abs(p.fitted / p.given - 1.0) > _REPLACED


def _to_do(finding: Finding, setting: Setting) -> Iterator[str]:
    for text in dict.fromkeys(finding.to_do):
        if text:
            yield f"{text}."


# --- Millimetres.


def _depths(finding: Finding, setting: Setting) -> Iterator[str]:
    tests = {t.file for t in finding.tested_depth}
    if finding.tested_depth:
        yield _tests(finding.tested_depth)
    for where in dict.fromkeys(row.where for row in finding.stable_depth if row.where not in tests):
        by_standing: dict[str, list[StableDepth]] = {}
        for row in finding.stable_depth:
            if row.where == where:
                by_standing.setdefault(row.at, []).append(row)
        # The worst is the headline: what is cut has to be stable over the stroke and the session.
        rows = min(by_standing.values(), key=lambda own: min(r.after_mm for r in own))
        yield _over_speeds(rows) if len(rows) > 1 else _at(rows[0])
        if len(by_standing) > 1:
            yield _by_standing(by_standing)
    for p in finding.pockets:
        yield _pocket(p, len(finding.pockets) > 1)
    if finding.no_depth:
        yield finding.no_depth


def _pocket(p: Pocket, several: bool) -> str:
    """Say what becomes of the best speed; a depth of zero is one at which the machine vibrates without any cut."""
    of = f" ({p.where.replace('_', ' ')})" if several else ""
    moved = abs(p.after_rpm / p.before_rpm - 1.0) > _MOVED
    before = f"The best speed{of} by the simulation is {p.before_rpm:.0f} rpm with {_depth(p.before_mm)}"
    there = f"; there the extended model allows {_depth(p.after_there_mm)}"
    if not moved:
        return f"{before}{there}, and no speed is better."
    return f"{before}{there}. Its own best is {p.after_rpm:.0f} rpm with {_depth(p.after_mm)}."


def _tests(tests: Sequence[ForetoldCut]) -> str:
    right = [sum(t.foretold(d) for t, d in zip(tests, depths, strict=True)) for depths in _both(tests)]
    of = f"Of {count_words(len(tests), 'cutting test')} the simulation foretells {_few(right[0])} rightly, "
    said = f"{of}the extended model {_few(right[1])}."
    mended = [t for t in tests if not t.foretold(t.before_mm) and t.foretold(t.after_mm)]
    if mended:
        t = max(mended, key=lambda t: abs(math.log(max(t.before_mm, 1e-6) / max(t.after_mm, 1e-6))))
        happened = "chattered" if t.happened == "chatter" else "was stable"
        said += (
            f" At {t.spindle_speed_rpm:.0f} rpm a cut of {t.depth_of_cut_mm:g} mm {happened}: the simulation allows "
            f"{_depth(t.before_mm)}, the extended model {_depth(t.after_mm)}."
        )
    return said


def _both(tests: Sequence[ForetoldCut]) -> tuple[list[float], list[float]]:
    return [t.before_mm for t in tests], [t.after_mm for t in tests]


def _few(count: int) -> str:
    return count_words(count, "test").split()[0]


def _depth(mm: float) -> str:
    if mm == 0.0:
        return "no depth, since the axis vibrates without any cut"
    return f"{rounded(mm, 3)} mm" if math.isfinite(mm) else "any depth"


def _over_speeds(rows: Sequence[StableDepth]) -> str:
    low, high = min(r.spindle_speed_rpm for r in rows), max(r.spindle_speed_rpm for r in rows)
    before, after = min(rows, key=lambda r: r.before_mm), min(rows, key=lambda r: r.after_mm)
    stands = f"{_capital(rows[0].at)}, from" if rows[0].at else "From"
    said = (
        f"{stands} {low:.0f} to {high:.0f} rpm the smallest stable depth is {_depth(after.after_mm)} (at "
        f"{after.spindle_speed_rpm:.0f} rpm) with the extended model, {_depth(before.before_mm)} (at "
        f"{before.spindle_speed_rpm:.0f} rpm) with the simulation."
    )
    known = [r for r in rows if 0.0 < r.before_mm < math.inf and 0.0 < r.after_mm < math.inf]
    if known:
        worst = max(known, key=lambda r: abs(math.log(r.after_mm / r.before_mm)))
        said += (
            f" The largest change is at {worst.spindle_speed_rpm:.0f} rpm: {_depth(worst.after_mm)} where the "
            f"simulation gives {_depth(worst.before_mm)}."
        )
    silent = [r.spindle_speed_rpm for r in rows if r.after_mm == 0.0]
    if silent:
        speeds = f"{min(silent):.0f} rpm" if len(silent) == 1 else f"{min(silent):.0f} to {max(silent):.0f} rpm"
        said += f" At the feed of {speeds} the axis vibrates without any cut."
    return said


def _by_standing(rows: Mapping[str, Sequence[StableDepth]]) -> str:
    """Say what the smallest depth is wherever, whenever and however hard shaken the machine cuts."""
    after = [f"{_depth(min(r.after_mm for r in own))} {at}" for at, own in rows.items()]
    before = {_depth(min(r.before_mm for r in own)): at for at, own in rows.items()}
    given = (
        [f"{depth} {at}" for depth, at in before.items()] if len(before) > 1 else [f"{next(iter(before))} throughout"]
    )
    return (
        f"The smallest stable depth with the extended model is {listed(after)}; the simulation gives {listed(given)}."
    )


def _at(row: StableDepth) -> str:
    speed = f"At {row.spindle_speed_rpm:.0f} rpm" + (f", {row.at}," if row.at else "")
    if row.after_mm == 0.0 < row.before_mm:
        return (
            f"{speed} the axis vibrates without any cut by the extended model; the simulation gives "
            f"{_depth(row.before_mm)}."
        )
    return (
        f"{speed} the stable depth is {_depth(row.after_mm)} with the extended model, {_depth(row.before_mm)} with the "
        "simulation."
    )


# --- What to measure next, and what would have been seen.


def _next(finding: Finding, setting: Setting) -> Iterator[str]:
    n = finding.next_experiment
    for alike in sets_of(finding.causes):
        if len(alike) > 1 and not (n is not None and n.between):
            them = listed([_title(c) for c in alike], "from")
            yield f"No experiment proposed here tells {them}: {_known_apart(alike)}."
    if n is None:
        if finding.verdict == "ambiguous":
            yield "None of the proposed experiments would settle it."
        return
    price = "" if n.minutes is None else f" (about {n.minutes:.0f} min)"
    do = n.do or n.name[:1].upper() + n.name[1:]
    if n.reveals:
        # Of several parameters of a cause the first: the others would read alike.
        each = {r.title: r for r in reversed(n.reveals)}
        shown = [
            f"{_revealed(r)} from {rounded(r.size, 2)}{unit_text(r.unit)} on"
            + (f" (so far from {rounded(r.so_far, 2)}{unit_text(r.unit)} on)" if math.isfinite(r.so_far) else "")
            for r in [r for r in n.reveals if each[r.title] is r][:_REVEALED]
        ]
        yield f"Next: {do}{price}. It would show what the measurements so far hide: {listed(shown)}."
    elif n.between:
        # Many values that each differ by a tenth of the noise differ by much together.
        apart = rounded(math.sqrt(n.discrimination), 2)
        yield (
            f"Next: {do}{price}. With it the predictions of {n.between} differ by {apart} standard deviations of the "
            f"noise; it settles the question with a probability of {100.0 * n.probability:.0f} %."
        )
    else:
        yield f"Next: {do}{price}; {n.expected}."


def _revealed(r: Revealed) -> str:
    """Return what would be seen; of a pure number what it is of."""
    return r.title if r.unit != "1" else f"{r.title} ({parameter_words(r.parameter)})"


def _known_apart(alike: Sequence[FoundCause]) -> str:
    """Return what tells causes apart that no further measurement of the machine does."""
    if any(c.id == "sensor_gain" for c in alike):
        return (
            "calibrate the sensor with a known weight or a known mass, put what it says into scale of [channels] and "
            "sensor_gain of [tolerances], and diagnose again"
        )
    return "find out one of them by itself, state it with its uncertainty in the campaign, and diagnose again"


def _power(finding: Finding, setting: Setting) -> Iterator[str]:
    if finding.verdict not in ("consistent", "named", "ambiguous"):
        return
    seen: dict[str, list[Detectable]] = {}
    # What is seen and by itself changes much would not have been seen: it was.
    large = (c for c in finding.immaterial if 0.0 < finding.material <= (c.size or 0.0))
    found = {c.id for c in (*finding.causes, *large)}
    # What the next experiment is to show has been said with it, beside the model that was found.
    said_before = {r.title for r in finding.next_experiment.reveals} if finding.next_experiment is not None else set()
    for p in finding.detectable:
        if p.cause.partition("/")[0] not in found and p.title not in said_before:
            seen.setdefault(p.cause, []).append(p)
    shown = {key: own for key, many in seen.items() if (own := [p for p in many if p.admissible])}
    if shown:
        said = [_size(own[0], len(seen[key])) for key, own in shown.items()]
        more = [f"{count_words(len(said) - _MOST_POWERS, 'other cause')}"] if len(said) > _MOST_POWERS else []
        yield f"Would have been seen with a probability of 95 %: {'; '.join([*said[:_MOST_POWERS], *more])}."
    hidden = dict.fromkeys(many[0].title for key, many in seen.items() if key not in shown)
    if hidden:
        yield f"Would not have been seen in these conditions: {'; '.join(hidden)}."


def _size(p: Detectable, of: int) -> str:
    """Return e.g. "micro-slip in a joint (share of the stiffness that slips) from 8.3 % on"."""
    if p.cause in YES_OR_NO:
        return p.title
    what = f" ({parameter_words(p.parameter)})" if of > 1 else ""
    return f"{p.title}{what} from {rounded(p.size, 2)}{unit_text(p.unit)} on"


def _notes(finding: Finding, setting: Setting) -> Iterator[str]:
    left = finding.remainder
    if left is not None and left.carriers:
        share = "" if left.share is None else f" ({percent(left.share)} % of the error that repeats)"
        yield f"The unknown remainder{share} is largest in {'; '.join(left.carriers)}."
        if finding.causes:
            yield "The intervals include its scatter; a cause that is not in the catalogue may still shift them."
    titles = {p.cause: p.title for p in finding.detectable}
    for name, why in finding.unconverged:
        words = " and ".join(titles.get(part, part) for part in name.split(" + "))
        yield f"Not used as evidence: {words}: {why}."
