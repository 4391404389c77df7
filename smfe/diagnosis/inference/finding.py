"""What a diagnosis found, as it is kept in ``finding.json`` and as it is said in sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from process.types import Real
from smfe.diagnosis.inference.cross_validation import Gain
from smfe.diagnosis.inference.fit import Fit, Target, residuals
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.next_experiment import Proposal
from smfe.diagnosis.inference.rules import RULES
from smfe.diagnosis.inference.thresholds import Detectable
from smfe.diagnosis.inference.verdict import Verdict


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


@dataclass(frozen=True)
class Remainder:
    """What the best model leaves, on conditions that it was not fitted to wherever some could be held out."""

    misfit_db: float
    """Squares of the residuals over those of noise [dB], the uncertainty of the prediction counted as noise."""
    p_value: float  # probability that noise alone looks as bad
    beyond_noise: bool  # whether it is more than noise (99 %)
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


@dataclass(frozen=True)
class StableDepth:
    """Limit depth of a cut with the machine as the campaign gives it and as the finding repairs it."""

    where: str  # lobes or cutting test that ask for it
    spindle_speed_rpm: float
    feed_mm_min: float
    before_mm: float
    after_mm: float  # infinite: no limit; zero: at this feed the axis vibrates without any cut


@dataclass(frozen=True)
class ForceError:
    """Error of the drive force over the moves that were fitted, or held out: rms over rms of the force [1]."""

    held_out: bool
    before: float
    after: float


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
    misfit_before_db: float | None = None  # of the baseline, over noise; 0 dB is noise alone
    misfit_after_db: float | None = None  # of the best model
    gain: Gain | None = None  # of all causes together, on conditions held out in turn
    held_out_gain: Gain | None = None  # the same on the conditions that no fit used
    remainder: Remainder | None = None  # what the best model leaves
    detectable: tuple[Detectable, ...] = ()
    """Size of each cause that would have been seen in the baseline's residual with 95 %."""
    inseparable: tuple[tuple[str, ...], ...] = ()
    """Causes that do nearly the same in these conditions: only strong effects are separated."""
    unconverged: tuple[tuple[str, str], ...] = ()  # hypothesis -> why its fit was not used
    next_experiment: Proposal | None = None  # what would settle what is open
    threshold: float | None = None  # of the likelihood ratio of the first cause, less two for each of its parameters
    conditions: tuple[ConditionMisfit, ...] = ()  # misfit of each condition before and after
    values: Mapping[str, float] = field(default_factory=dict)  # parameters of the best model (SI)
    values_before: Mapping[str, float] = field(default_factory=dict)  # of the baseline, fitted to the same data
    stable_depth: tuple[StableDepth, ...] = ()
    """Where the finding repairs the machine of a campaign that asks for stable depths."""
    force_error: tuple[ForceError, ...] = ()  # where it repairs the model of a drive
    baseline: tuple[BaselineParameter, ...] = ()
    """The baseline's own parameters, as given and as fitted: a verdict is about what is beyond them."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for ``finding.json``; numbers that are not finite become None."""
        found = asdict(self, dict_factory=_with_keys)
        found["misfit_db"] = {"before": found.pop("misfit_before_db"), "after": found.pop("misfit_after_db")}
        found["unconverged"] = dict(self.unconverged)
        plain: dict[str, Any] = _plain(found)
        return plain


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


_OPENING = {
    "consistent": "The data are consistent with the baseline",
    "named": "The baseline leaves something out",
    "ambiguous": "The baseline leaves something out, and it remains open what",
    "unknown": "The baseline is wrong for a reason that the catalogue does not hold",
    "insufficient_data": "The data do not suffice for a verdict",
    "part": "Part of what the baseline leaves out is found, part of it remains unknown",
}


def explain(finding: Finding) -> str:
    """Say a finding in plain sentences, one a line."""
    opening = _OPENING["part" if finding.verdict == "unknown" and finding.causes else finding.verdict]
    said = [f"{opening}: {finding.reason}."]
    if finding.misfit_before_db is not None:
        more = finding.causes and finding.misfit_after_db is not None
        extended = f", the extended model's {finding.misfit_after_db:.2f} dB" if more else ""
        said.append(f"The baseline's misfit is {finding.misfit_before_db:.2f} dB over noise{extended}.")
    moved = [p for p in finding.baseline if p.beyond_prior]
    if moved:
        values = "; ".join(f"{p.name} {p.fitted:.4g}{unit_of(p.unit)} in place of {p.given:.4g}" for p in moved)
        said.append(f"These data give the baseline other values than the campaign does: {values}.")
    said += [_cause(c) for c in finding.causes]
    said += [f"The data do not separate: {', '.join(c.title for c in s)}." for s in finding.alternatives]
    for gain, where in ((finding.gain, "held out in turn"), (finding.held_out_gain, "held out beforehand")):
        if gain is not None and finding.causes:
            said.append(
                f"On conditions {where} the extension explains {100.0 * gain.share:.3g} % of the repeatable error "
                f"({gain.db:.1f} dB, sd {gain.sd:.1f} dB; the error with its noise falls by {gain.error_db:.2f} dB)."
            )
    for e in finding.force_error:
        where = "moves held out beforehand" if e.held_out else "the moves that were fitted"
        said.append(f"Force error over {where}: {100.0 * e.before:.1f} % before, {100.0 * e.after:.1f} % after.")
    for where in dict.fromkeys(row.where for row in finding.stable_depth):
        said += _stable_depth([row for row in finding.stable_depth if row.where == where])
    left = finding.remainder
    if left is not None and left.beyond_noise and left.carriers:
        share = "" if left.share is None else f", {100.0 * left.share:.2g} % of the repeatable error of the baseline"
        where = "; ".join(left.carriers)
        said.append(f"Unknown remainder: {left.misfit_db:.2f} dB over noise{share}, carried by {where}.")
        if finding.causes:
            said.append("The intervals include its scatter; a cause that is not in the catalogue may still shift them.")
    if finding.next_experiment is not None:
        n = finding.next_experiment
        price = "" if n.minutes is None else f" (about {n.minutes:.0f} min)"
        said.append(f"Measure next: {n.name}{price}; {n.expected}.")
    elif finding.verdict == "ambiguous":
        said.append("None of the proposed experiments would settle it.")
    if finding.verdict == "consistent":
        said += [
            f"{p.title} above {p.size:.2g}{unit_of(p.unit)} ({p.parameter}) would have been seen with 95 %."
            for p in finding.detectable
            if p.admissible
        ]
        hidden = dict.fromkeys(f"{p.title} ({p.parameter})" for p in finding.detectable if not p.admissible)
        said += [f"Would not have been seen in these conditions: {'; '.join(hidden)}."] if hidden else []
    return "\n".join([*said, *(f"Not used as evidence: {name}: {why}." for name, why in finding.unconverged)])


def _cause(cause: FoundCause) -> str:
    said = []
    for e in cause.parameters:
        known = math.isfinite(e.high - e.low)
        interval = f"{e.low:.4g} to {e.high:.4g}" if known else "not separable from others in these data"
        said.append(f"{e.name} {e.value:.4g}{unit_of(e.unit)} ({interval})")
    values, proof = "; ".join(said), f"likelihood ratio {cause.ratio:.0f}"
    if cause.gain_db is None:
        return f"Not proven on conditions it was not fitted to: {cause.title}: {values} ({proof})."
    gain = f"worth {cause.gain_db:.1f} dB there"
    return f"Accepted on conditions it was not fitted to: {cause.title}: {values}; {gain} ({proof})."


def unit_of(unit: str) -> str:
    """Return a unit as it stands behind a number; a pure number has none."""
    return "" if unit == "1" else f" {unit}"


def _stable_depth(rows: Sequence[StableDepth]) -> list[str]:
    where, out = f"Stable depth ({rows[0].where})", []
    known = [r for r in rows if 0.0 < r.before_mm < math.inf and 0.0 < r.after_mm < math.inf]
    if known:
        worst = max(known, key=lambda r: abs(math.log(r.after_mm / r.before_mm)))
        most = "" if len(known) == 1 else "the largest change is "
        out.append(
            f"{where}: {most}at {worst.spindle_speed_rpm:g} rpm, {worst.after_mm:.3g} mm with the extended model, "
            f"{worst.before_mm:.3g} mm with the baseline."
        )
    silent = [r.spindle_speed_rpm for r in rows if r.after_mm == 0.0]
    if silent:
        speeds = f"{min(silent):g} rpm" if len(silent) == 1 else f"{min(silent):g} to {max(silent):g} rpm"
        out.append(f"{where}: at the feed of {speeds} the axis of the extended model vibrates without any cut.")
    return out


# --- What the baseline and the best model leave of each condition, those that were held out included.


@dataclass(frozen=True)
class ConditionMisfit:
    """Squares of the residuals of a condition over those of noise [dB]."""

    name: str  # of the condition
    before_db: float | None  # of the baseline; None where it predicts nothing there
    after_db: float | None  # of the best model
    held_out: bool  # whether no fit has seen it


def by_condition(model: Model, before: Fit, after: Fit, held_out: Mapping[int, Real]) -> tuple[ConditionMisfit, ...]:
    """Return the misfit of each condition, in the order of the campaign."""
    unseen = [residuals(model, Target(held_out, f.u), f.u) or {} for f in (before, after)]
    every = [{**f.residual, **more} for f, more in zip((before, after), unseen, strict=True)]
    return tuple(
        ConditionMisfit(model.conditions[r].name, _decibel(every[0].get(r)), _decibel(every[1].get(r)), r in held_out)
        for r in sorted({*before.residual, *held_out})
    )


def _decibel(residual: Real | None) -> float | None:
    return None if residual is None else 10.0 * math.log10(max(float(np.mean(residual**2)), 1e-300))
