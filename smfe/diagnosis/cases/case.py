"""What is tested of a campaign: a family of models, which of its conditions belong to which measurement, its modes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from process.errors import InputError
from process.labels import at_tool
from process.machine.modes import ModalModel
from smfe.campaign import Campaign
from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.frf.modes import SPREAD, FittedModes
from smfe.diagnosis.inference.problem import Family
from smfe.identification.errors.result import Identification
from smfe.modes.fit_modes import fit_modes
from smfe.records.formats.channels import did_you_mean, listed


@dataclass(frozen=True)
class Case:
    """A campaign in the form that the inference takes."""

    family: Family  # baseline, causes, conditions and proposals
    groups: Mapping[str, tuple[str, ...]]  # name of a measurement, or file of a cutting test -> names of its conditions
    held_out: tuple[str, ...] = ()  # those of the groups that the campaign holds out
    suspects: tuple[Suspect, ...] = field(default=())  # what was noticed about the data on the way

    def held_out_conditions(self, more: Iterable[str] = ()) -> tuple[str, ...]:
        """Return the conditions that no fit uses: those held out by the campaign, and those of `more` measurements."""
        names = dict.fromkeys((*self.held_out, *more))
        for name in names:
            if name not in self.groups:
                near = did_you_mean(name, self.groups)
                raise InputError(f"'{name}' cannot be held out{near}; compared are {listed(self.groups)}")
        if len(names) == len(self.groups):
            raise InputError(f"{listed(names)}: everything is held out, nothing is left to be fitted; leave some in")
        return tuple(condition for name in names for condition in self.groups[name])


@dataclass(frozen=True)
class NamedModes:
    """Modes of a baseline: those of a ``[[model]]``, or those fitted to a measured compliance."""

    modal: ModalModel  # the modes
    band: tuple[float, float]  # lowest and highest natural frequency that count as modes of the machine [Hz]
    suspects: tuple[Suspect, ...] = ()  # what the fit warns of
    spread: Mapping[str, float] = field(default_factory=dict)
    """What a ``[[model]]`` states as its ``uncertainty``, relative; empty where it states none."""
    fitted: FittedModes | None = None  # what a fit knows of them; None where they were declared


def modes_named(campaign: Campaign, name: str, found: Mapping[str, Identification], whole: bool = False) -> NamedModes:
    """Return the modes of a model, or fit those of a measurement, by its name.

    With `whole` the model has all that the compliance was fitted with (`ModalFit.modal_model`); `band` is that of the
    modes alone.
    """
    for model in campaign.models:
        if model.name == name:
            low, high = float(model.modal.frequency.min()), float(model.modal.frequency.max())
            given = {n: getattr(model.spread, n, 0.0) for n in ("frequency", "damping", "stiffness")}
            return NamedModes(model.modal, (low, high), spread={n: s for n, s in given.items() if s > 0.0})
    if name not in found:
        raise InputError(f"baseline: measurement '{name}' is no compliance, so it has no modes; name one that is")
    try:
        fit = fit_modes(at_tool(found[name].compliance))
        modes, modal, doubt = fit.modal_model(), fit.modal_model(whole), fit.doubt(whole)
    except InputError as error:
        raise InputError(
            f"baseline: measurement '{name}' does not give the modes of a simulation ({error}); declare them as a "
            "[[model]] and name that"
        ) from error
    # Stiff modes above the measured band stand for what is not seen of the machine.
    top = float(found[name].compliance["frequency"].max())
    inside = modes.frequency[modes.frequency <= top]
    advice = "see the modes with smfe modal; declare better ones as a [[model]]"
    suspects = tuple(Suspect("missing_mode", "note", name, warning, advice) for warning in fit.warnings)
    # One whose damping is known no better than that of any mode is no mode that other measurements must show: at 45 Hz
    # with (13 +- 5) %, where the lowest mode of the machine lay at 76 Hz, it made one of them contradict the others.
    known = FittedModes(doubt, (doubt[:, 0] > 0.0) & (doubt[:, 1] < SPREAD["damping"]))
    return NamedModes(modal, (float(inside.min()), float(inside.max())), suspects, fitted=known)
