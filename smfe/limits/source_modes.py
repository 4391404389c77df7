"""The modes behind one source of lobes: as declared, or fitted to its compliance; and the cut that is asked about.

What is solved in time (pitch, bands of depth, forced vibration) needs modes: those of a ``[[model]]``, or those that
fit a measured compliance (`smfe.modes.fit_modes`), of which is said how far they are from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import xarray as xr

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import at_tool
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from smfe.campaign import Campaign, LobeRequest
from smfe.campaign.machine import MACHINE
from smfe.limits.cut_conditions import turned, turned_modes
from smfe.limits.machine_lobes import FedMachine, fed
from smfe.modes.fit_modes import fit_modes, model_error


@dataclass(frozen=True)
class AskedCut:
    """A cut of a campaign with the modes of one source, in the axes of the cut.

    Parameters
    ----------
    request : LobeRequest
        The ``[[lobes]]`` that it is of.
    source : str
        Measurement or model.
    tool, arc, coefficients
        The cut.
    modes : ModalModel or FedMachine
        Of the source, x along the feed.
    notes : tuple of str
        What must be known of the modes.
    """

    request: LobeRequest
    source: str
    tool: Tool
    arc: AnyEngagement
    coefficients: CuttingCoefficients
    modes: ModalModel | FedMachine
    notes: tuple[str, ...] = ()


def request_of(campaign: Campaign, lobes: str | None = None, source: str | None = None) -> tuple[LobeRequest, str]:
    """Return a request for lobes and one of its sources, by name; without a name the first.

    Parameters
    ----------
    campaign : Campaign
        With its ``[[lobes]]``.
    lobes : str, optional
        "lobes_1", or "lobes_1_20mm" where the table has several widths.
    source : str, optional
        One of its ``measurements``.

    Raises
    ------
    InputError
        When there is none of that name.
    """
    if not campaign.lobes:
        raise InputError(f"{campaign.path.name}: it asks for no lobes; add a [[lobes]] table, which says the cut")
    found = [r for r in campaign.lobes if lobes in (None, r.name)]
    if not found:
        raise InputError(f"there are no lobes '{lobes}'; the campaign has {_listed([r.name for r in campaign.lobes])}")
    if source is not None and not any(source in r.measurements for r in found):
        every = list(dict.fromkeys(n for r in found for n in r.measurements))
        raise InputError(f"no [[lobes]] asked about names '{source}'; the measurements there are {_listed(every)}")
    request = next(r for r in found if source is None or source in r.measurements)
    name = source or request.measurements[0]
    return request, name


def asked_cut(campaign: Campaign, request: LobeRequest, source: str, compliance: xr.Dataset | None) -> AskedCut:
    """Return the cut of a request with the modes of a source.

    Parameters
    ----------
    campaign : Campaign
        Tool, work material, models.
    request, source
        From `request_of`.
    compliance : xarray.Dataset or None
        Of the source, where it was measured.

    Raises
    ------
    InputError
        When no modes can be fitted to the compliance, or the source is a machine in motion and no feed is given.
    """
    assert campaign.tool is not None
    assert campaign.coefficients is not None
    arc = request.arc(campaign.tool.diameter)
    declared = next((m.modal for m in campaign.models if m.name == source), None)
    notes: Sequence[str] = ()
    modes: ModalModel | FedMachine
    if source == MACHINE and isinstance(campaign.machine_model, Machine):
        if request.feed is None:
            raise InputError(
                "the machine of [machine] has other modes at each feed, and the feed follows the spindle speed; say "
                'one feed in [[lobes]], e.g. feed = "500 mm/min", or name a [[model]] or a measurement'
            )
        modes = fed(campaign.machine_model, request, request.feed)
    elif declared is not None:
        modes = turned_modes(declared, request.feed_direction)
    elif compliance is None:
        raise InputError(f"'{source}' is asked for, and its compliance is not known")
    else:
        if request.feed_direction:
            compliance, notes = turned(compliance, request.feed_direction)
        modes, said = fitted_modes(compliance)
        notes = [*notes, *said]
    return AskedCut(request, source, campaign.tool, arc, campaign.coefficients, modes, tuple(notes))


def fitted_modes(compliance: xr.Dataset) -> tuple[ModalModel, list[str]]:
    """Return the modes that fit a measured compliance, and what must be known of them.

    Raises
    ------
    InputError
        When none can be fitted.
    """
    fit = fit_modes(at_tool(compliance))
    modal = fit.modal_model()
    frequency = ", ".join(f"{f:.4g}" for f in fit.table()["frequency_Hz"])
    note = f"the limits are those of modes fitted to the measured compliance ({frequency} Hz, {model_error(fit)})"
    return modal, [note, *fit.warnings]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(f"'{n}'" for n in names)
