"""What a diagnosis found, as it is kept in ``finding.json``.

*Before* is the simulation as the campaign declares it, nothing refitted. *Refitted* is the same model without any
cause, its parameters fitted to the data: from there the gain of a cause is counted. *After* is the best model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr

from process.notebook import html_table
from process.types import Real
from smfe.diagnosis.inference.cross_validation import Gain, HeldOut
from smfe.diagnosis.inference.fit import Fit, Target, residuals
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition, Values
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.thresholds import Detectable
from smfe.diagnosis.judgement.next_experiment import Proposal
from smfe.diagnosis.judgement.verdict import Verdict


@dataclass(frozen=True)
class Estimate:
    """A parameter of a cause with its 95 % interval, in the unit shown; infinite where no interval can be given."""

    name: str
    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class FoundCause:
    """A cause in the model that explains the data best."""

    id: str
    variant: str
    title: str
    kind: str
    parameters: tuple[Estimate, ...]  # fitted
    ratio: float  # likelihood ratio: what leaving it out costs
    gain_db: float | None  # what it is worth on held-out conditions; None where none could be held out
    gain_sd_db: float | None
    set: int | None = None  # causes with the same number stand for one: the data do not say which of them it is
    size: float | None = None
    """What it changes, relative [1]: the limit depth, or where no cut is given what is predicted."""


@dataclass(frozen=True)
class Remainder:
    """What the best model leaves, on conditions that it was not fitted to wherever some could be held out."""

    misfit_db: float
    """Squares of the residuals over those of noise [dB], the uncertainty of the prediction counted as noise."""
    p_value: float  # probability that noise alone looks as bad
    size: float  # relative to what was measured, where it matters, without noise [1]
    share: float | None  # share of the baseline's repeatable error that remains; None where nothing was held out
    carriers: tuple[str, ...]  # conditions that carry it; none where it looks like noise


@dataclass(frozen=True)
class SearchStep:
    """A step of the search: what was tried, what it gave, whether it was kept."""

    change: str
    ratio: float
    threshold: float
    gain_db: float | None
    gain_sd_db: float | None
    misfit_db: float
    accepted: bool
    reason: str
    words: str = ""  # the change for people: "with guideway friction"


@dataclass(frozen=True)
class ConditionMisfit:
    """Squares of the residuals of a condition over those of noise [dB], and the error of both models there."""

    name: str  # of the condition
    before_db: float | None  # of the simulation as declared; None where it predicts nothing there
    after_db: float | None  # of the best model
    held_out: bool  # whether no fit has seen it
    refitted_db: float | None = None  # of the refitted simulation
    error_before: float | None = None
    """Error of the simulation as declared, rms over rms of what was measured [1]; None where it is not known in the
    units of the measurement."""
    error_refitted: float | None = None
    """Of the refitted simulation, from a fit that has not seen the condition where `unseen` says so."""
    error_after: float | None = None  # of the best model, likewise
    unseen: bool = False  # whether the errors are those of fits that have not seen the condition


@dataclass(frozen=True)
class Prediction:
    """What a model predicts of a condition."""

    values: Values  # with these values (SI)
    whitened: Real = field(repr=False)  # in the form of the data of the condition


@dataclass(frozen=True)
class Compared:
    """A condition as it was compared in the end, and what each model makes of it."""

    condition: Condition
    held_out: bool  # whether no fit has seen it
    before: Prediction | None  # of the simulation as declared; None where it predicts nothing there
    refitted: Prediction | None  # of the refitted simulation
    after: Prediction | None  # of the best model
    unseen: tuple[tuple[Prediction, Prediction], ...] = ()
    """Of refitted and best model fitted without it, one for each way in which conditions were left out."""


@dataclass(frozen=True)
class ModelError:
    """Error of the models over some conditions: rms over rms of what was measured [1]."""

    of: str  # "measurements", "moves", "cuts" or "limits"
    count: int  # of them
    tested: str  # "set aside" (by the campaign), "left out in turn" or "fitted"
    before: float  # error of the simulation as declared
    after: float  # error of the extended model
    refitted: float | None = None  # error of the refitted simulation; None where it is not known

    @property
    def gain_db(self) -> float:
        """Error before over error after [dB]."""
        return 20.0 * math.log10(max(self.before, 1e-12) / max(self.after, 1e-12))


@dataclass(frozen=True)
class ForetoldCut:
    """A cutting test, and whether both models foretell it."""

    file: str  # of the record
    spindle_speed_rpm: float
    depth_of_cut_mm: float
    happened: str  # "stable" or "chatter"
    before_mm: float  # stable depth by the simulation; infinite: no limit
    after_mm: float  # by the extended model

    def foretold(self, limit: float) -> bool:
        """Whether a limit depth [mm] foretells what happened."""
        return (self.depth_of_cut_mm > limit) == (self.happened == "chatter")


@dataclass(frozen=True)
class Passage:
    """A sentence or two of a diagnosis, and what it is about."""

    about: str  # one of `smfe.diagnosis.story.sentences.ABOUT`
    text: str


@dataclass(frozen=True)
class StableDepth:
    """Limit depth of a cut with the machine as the campaign gives it and as the finding repairs it."""

    where: str  # lobes or cutting test that ask for it
    spindle_speed_rpm: float
    feed_mm_min: float
    before_mm: float
    after_mm: float  # infinite: no limit; zero: at this feed the axis vibrates without any cut
    at: str = ""  # where, when and how hard shaken the machine cuts, in words; empty where that changes nothing


@dataclass(frozen=True)
class Pocket:
    """Speed at which most is removed, by the machine as the campaign gives it and as the finding repairs it."""

    where: str  # lobes that ask for it
    before_rpm: float  # best speed by the simulation
    before_mm: float  # depth that the simulation allows there
    after_there_mm: float  # depth that the extended model allows there
    after_rpm: float  # best speed by the extended model
    after_mm: float  # depth that it allows there


@dataclass(frozen=True)
class ForceError:
    """Error of the drive force over the moves that were fitted, or held out: rms over rms of the force [1]."""

    held_out: bool
    before: float  # of the simulation as declared
    after: float  # of the extended model
    refitted: float  # of the refitted simulation


@dataclass(frozen=True)
class BaselineParameter:
    """A parameter of the baseline that the campaign gives, and what the fit makes of it, in the unit shown."""

    name: str
    given: float  # as the campaign has it (or the data sheet)
    fitted: float  # in the best model
    spread: float  # standard deviation with which `given` is trusted: within it the fit may move it
    unit: str

    @property
    def beyond_prior(self) -> bool:
        """Whether the data put it further away than is trusted."""
        return abs(self.fitted - self.given) > RULES.trusted * self.spread


@dataclass(frozen=True)
class GivenParameter:
    """A parameter that somebody declared, or that a workshop holds to, beside what the data say, in the unit shown."""

    name: str
    said: str  # what it is, for people
    cause: str  # id under which a value beyond what was declared is named
    given: float  # as declared
    spread: float  # standard deviation with which that is trusted
    found: float  # in the best model
    low: float  # 95 % interval of it
    high: float
    unit: str
    beyond: bool  # whether the data contradict what was declared, and that matters
    cost: float | None = None
    """Relative change between given and found [1]: of the limit depths, or of what is predicted where no cut is given;
    None of a sensor, and there where the data do not tell the one from the other."""
    cost_mm: float | None = None  # the same in millimetres


@dataclass(frozen=True)
class Finding:
    """A diagnosis: a verdict and what it rests on."""

    verdict: Verdict
    reason: str  # what it rests on
    causes: tuple[FoundCause, ...] = ()
    """Causes of the best model. Each has passed the calibrated threshold and gains on held-out conditions, whatever the
    verdict; the verdict says whether they are all ("named"), whether another could stand in for one of them
    ("ambiguous", see `alternatives`), or whether something else is left ("unknown", see `remainder`)."""
    alternatives: tuple[tuple[FoundCause, ...], ...] = ()
    """Sets that the data do not separate; each begins with the cause that fits best. Causes of the best model that are
    in none are certain."""
    search_steps: tuple[SearchStep, ...] = ()  # steps of the search
    misfit_before_db: float | None = None  # of the simulation as declared, over noise; 0 dB is noise alone
    misfit_refitted_db: float | None = None  # of the refitted simulation
    misfit_after_db: float | None = None  # of the best model
    gain: Gain | None = None  # of all causes together, on conditions held out in turn
    held_out_gain: Gain | None = None  # the same on the conditions that no fit used
    remainder: Remainder | None = None  # what the best model leaves; None where that is nothing but noise
    given: tuple[GivenParameter, ...] = ()  # whether what was declared is right
    immaterial: tuple[FoundCause, ...] = ()  # causes that the data show, but too small to matter
    material: float = 0.0  # relative size from which on something matters
    detectable: tuple[Detectable, ...] = ()
    """Size of each cause that would have been seen in the baseline's residual with 95 %."""
    inseparable: tuple[tuple[str, ...], ...] = ()
    """Causes that do nearly the same in these conditions: only strong effects are separated."""
    unconverged: tuple[tuple[str, str], ...] = ()  # hypothesis -> why its fit was not used
    next_experiment: Proposal | None = None  # what would settle what is open
    threshold: float | None = None  # of the likelihood ratio of the first cause, less two for each of its parameters
    conditions: tuple[ConditionMisfit, ...] = ()  # misfit of each condition before and after
    values: Mapping[str, float] = field(default_factory=dict)  # parameters of the best model (SI)
    values_before: Mapping[str, float] = field(default_factory=dict)  # of the simulation as declared
    values_refitted: Mapping[str, float] = field(default_factory=dict)  # of the same, fitted to the same data
    stable_depth: tuple[StableDepth, ...] = ()
    """Where the finding repairs the machine of a campaign that asks for stable depths."""
    pockets: tuple[Pocket, ...] = ()  # the best speed of each request, before and after
    force_error: tuple[ForceError, ...] = ()  # where it repairs the model of a drive
    baseline: tuple[BaselineParameter, ...] = ()
    """The baseline's own parameters, as given and as fitted: a verdict is about what is beyond them."""
    errors: tuple[ModelError, ...] = ()
    """Error before and after, in the units of the measurement: of what no fit has seen first."""
    tested_depth: tuple[ForetoldCut, ...] = ()  # cutting tests against the stable depths of both models
    no_depth: str = ""  # why no stable depth is given, a sentence
    to_do: tuple[str, ...] = ()  # what to do about each cause, in their order (`smfe.diagnosis.story.to_do`)
    passages: tuple[Passage, ...] = ()  # the finding in sentences (`smfe.diagnosis.story.sentences`)
    compared: tuple[Compared, ...] = field(default=(), repr=False, compare=False)  # conditions, not in the file
    curves: xr.Dataset | None = field(default=None, repr=False, compare=False)
    """Measured, simulation and extended model of each condition (`smfe.diagnosis.story.curves`): ``finding.nc``."""

    @property
    def sentences(self) -> tuple[str, ...]:
        """The finding in sentences, the verdict first; empty before it has been told."""
        return tuple(p.text for p in self.passages)

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for ``finding.json``; numbers that are not finite become None."""
        # Arrays are kept beside the file.
        found = asdict(replace(self, compared=(), curves=None), dict_factory=_with_keys)
        for name in ("compared", "curves"):
            del found[name]
        found["misfit_db"] = {which: found.pop(f"misfit_{which}_db") for which in ("before", "refitted", "after")}
        found["unconverged"] = dict(self.unconverged)
        plain: dict[str, Any] = _plain(found)
        return plain

    def _repr_html_(self) -> str:
        """Return a table for a notebook: each cause with its parameters; below it what is said of them."""
        rows: list[tuple[object, ...]] = []
        for cause in self.causes:
            gain = "not known" if cause.gain_db is None else f"{cause.gain_db:.2g}"
            rows.append((cause.title, "gain on conditions held out", gain, "", "", "dB"))
            rows += [("", p.name, *(f"{v:.4g}" for v in (p.value, p.low, p.high)), p.unit) for p in cause.parameters]
        head = ("cause", "parameter", "value", "95 % from", "to", "unit") if rows else ()
        return html_table(f"Diagnosis: {self.verdict.replace('_', ' ')}", rows, head, self.sentences or (self.reason,))


_KEYS = {
    "search_steps": "ladder",
    "held_out_gain": "opened",
    "detectable": "power",
    "p_value": "chance",
    "probability": "chance",
}
"""Field -> key of ``finding.json``, where that is another."""


def _with_keys(fields: list[tuple[str, Any]]) -> dict[str, Any]:
    return {_KEYS.get(name, name): value for name, value in fields}


def _plain(x: Any) -> Any:
    if isinstance(x, dict):
        return {key: _plain(value) for key, value in x.items()}
    if isinstance(x, list | tuple):
        return [_plain(value) for value in x]
    if isinstance(x, float):
        return x if math.isfinite(x) else None
    return x


def unit_of(unit: str) -> str:
    """Return a unit as it stands behind a number; a pure number has none."""
    return "" if unit == "1" else f" {unit}"


# --- What each model makes of each condition, those that were held out included.


def by_condition(
    model: Model,
    declared: Real,
    refitted: Fit,
    after: Fit,
    held_out: Mapping[int, Real],
    in_turn: Sequence[tuple[HeldOut, HeldOut]],
) -> tuple[tuple[ConditionMisfit, ...], tuple[Compared, ...]]:
    """Return the misfit and the predictions of each condition, in the order of the campaign.

    `declared` are the scaled values of the simulation as declared, `in_turn` the predictions of the refitted and of the
    best model from fits that left conditions out.
    """
    unseen = [residuals(model, Target(held_out, f.u), f.u) or {} for f in (refitted, after)]
    every = [{**f.residual, **more} for f, more in zip((refitted, after), unseen, strict=True)]
    misfits, compared = [], []
    for r in sorted({*refitted.residual, *held_out}):
        condition = model.conditions[r]
        before = _prediction(model, r, declared)
        fitted, best = (_prediction(model, r, f.u) for f in (refitted, after))
        blind = [[fitted, best]] if r in held_out else []
        for pair in in_turn:
            fits = zip(*(h.fitted.get(r, ()) for h in pair), strict=True)
            blind += [[_prediction(model, r, u) for u in us] for us in fits]
        off = None if before is None or condition.observed is None else before.whitened - condition.observed
        decibels = [_decibel(x) for x in (off, *(own.get(r) for own in every))]
        misfits.append(ConditionMisfit(condition.name, decibels[0], decibels[2], r in held_out, decibels[1]))
        known = tuple((a, b) for a, b in blind if a is not None and b is not None)
        compared.append(Compared(condition, r in held_out, before, fitted, best, known))
    return tuple(misfits), tuple(compared)


def _prediction(model: Model, row: int, u: Real) -> Prediction | None:
    found = model.predict(row, u)
    return None if found is None else Prediction(model.values(u), found)


def _decibel(residual: Real | None) -> float | None:
    return None if residual is None else 10.0 * math.log10(max(float(np.mean(residual**2)), 1e-300))
