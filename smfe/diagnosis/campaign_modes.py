"""Modes that a baseline names: those of a ``[[model]]``, or those fitted to a measured compliance."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from process.errors import InputError
from process.labels import at_tool
from process.machine.modes import ModalModel
from smfe.campaign import Campaign
from smfe.diagnosis.suspect import Suspect
from smfe.identification.errors.result import Identification
from smfe.modes.fit_modes import fit_modes


@dataclass(frozen=True)
class NamedModes:
    """Modes of a baseline.

    Parameters
    ----------
    modal : ModalModel
        The modes.
    band : (float, float)
        Lowest and highest natural frequency that count as modes of the machine [Hz].
    suspects : tuple of Suspect
        What the fit warns of.
    spread : mapping
        What a ``[[model]]`` states as its ``uncertainty``, relative; empty where it states none.
    """

    modal: ModalModel
    band: tuple[float, float]
    suspects: tuple[Suspect, ...] = ()
    spread: Mapping[str, float] = field(default_factory=dict)


def modes_named(campaign: Campaign, name: str, found: Mapping[str, Identification]) -> NamedModes:
    """Return the modes of a model, or fit those of a measurement.

    Parameters
    ----------
    campaign : Campaign
        With its models.
    name : str
        Of a model or of a measurement.
    found : mapping
        Measurement name -> identification.

    Raises
    ------
    InputError
        When a measurement does not carry a modal model.
    """
    for model in campaign.models:
        if model.name == name:
            low, high = float(model.modal.frequency.min()), float(model.modal.frequency.max())
            given = {n: getattr(model.spread, n) for n in ("frequency", "damping", "stiffness")}
            return NamedModes(model.modal, (low, high), spread={n: s for n, s in given.items() if s > 0.0})
    if name not in found:
        raise InputError(f"baseline: measurement '{name}' is no compliance, so it has no modes; name one that is")
    try:
        fit = fit_modes(at_tool(found[name].compliance))
        modal = fit.modal_model()
    except InputError as error:
        raise InputError(
            f"baseline: measurement '{name}' does not give the modes of a simulation ({error}); declare them as a "
            "[[model]] and name that"
        ) from error
    # Stiff modes above the measured band stand for what is not seen of the machine.
    top = float(found[name].compliance["frequency"].max())
    inside = modal.frequency[modal.frequency <= top]
    advice = "see the modes with smfe modal; declare better ones as a [[model]]"
    suspects = tuple(Suspect("missing_mode", "note", name, warning, advice) for warning in fit.warnings)
    return NamedModes(modal, (float(inside.min()), float(inside.max())), suspects)
