"""What a notebook finds at hand: ``plot`` for every result, and ``.smfe`` on records, compliances and lobes.

The accessor is registered as soon as a public name of `smfe` that works with labelled data is used.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import xarray as xr

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from process.cut.force import CuttingCoefficients
    from process.cut.tool import Tool
    from smfe.identification.errors.result import Identification
    from smfe.limits.recommendation import Recommendation
    from smfe.modes.fit_modes import ModalFit
    from stability import ChatterVerdict


def plot(
    result: object,
    *others: object,
    entry: str | None = None,
    tests: object = None,
    recommendation: Recommendation | None = None,
    name: str | None = None,
) -> Figure:
    """Draw a result as the report does.

    Parameters
    ----------
    result : object
        A record, compliance, lobes or spectrum (`xarray.Dataset`), or what a verb returns: `Identification`,
        `ChatterVerdict`, `ModalFit`, `Finding`, `Look`, `LobeResult`; a `ModalModel`; or a mapping of str to
        compliances or lobes.
    *others : object
        Further compliances or lobes, to compare with.
    entry : str, optional
        Of compliances one entry with phase, error and coherence: "xy" is the response x to a force along y. Default:
        the magnitudes of all entries.
    tests : pandas.DataFrame, or sequence of (float, float, str or ChatterVerdict), optional
        On lobes, cutting tests: rows of chatter.csv, or spindle speed [rpm], depth of cut [mm] and outcome.
    recommendation : Recommendation, optional
        On lobes, the cut that is recommended.
    name : str, optional
        What `result` is called; default: its own name.

    Returns
    -------
    matplotlib.figure.Figure
        Shown by a notebook; ``.savefig("lobes.pdf")`` writes it.

    Raises
    ------
    InputError
        For what has no figure.
    """
    from smfe.reporting.notebook import figure_of, shown

    return shown(figure_of(result, others, entry, tests, recommendation, name))


@xr.register_dataset_accessor("smfe")  # type: ignore[no-untyped-call]
class Accessor:
    """What can be done with a record, a compliance or lobes, as methods of the dataset."""

    def __init__(self, dataset: xr.Dataset) -> None:
        self._dataset = dataset

    def plot(self, *others: object, **options: Any) -> Figure:
        """Draw it, with `others` to compare with; options as of `smfe.plot`."""
        return plot(self._dataset, *others, **options)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What must be known of it, a sentence each."""
        from smfe.results import unpack_warnings

        return tuple(unpack_warnings(self._dataset))

    def limits(
        self, tool: Tool | Mapping[str, Any], material: CuttingCoefficients | Mapping[str, Any], **cut: Any
    ) -> xr.Dataset:
        """Return the lobes of a compliance; arguments as of `smfe.lobes`."""
        from smfe.commands.lobes import lobes

        return lobes(self._dataset, tool, material, **cut)

    def recommendation(
        self, tool: Tool | Mapping[str, Any], material: CuttingCoefficients | Mapping[str, Any], **limits: Any
    ) -> Recommendation:
        """Return the cut that lobes, or a compliance, recommend; arguments as of `smfe.recommendation`."""
        from smfe.arrays.recommendation import recommendation

        return recommendation(self._dataset, tool, material, **limits)

    def modes(self, **options: Any) -> ModalFit:
        """Return the modes of a compliance; options as of `smfe.modal`."""
        from smfe.commands.modal import modal

        return modal(self._dataset, **options)

    def identify(self, method: str, **settings: Any) -> Identification:
        """Return the compliance that a record holds; arguments as of `smfe.identify`."""
        from smfe.commands.identify import identify

        return identify(self._dataset, method=method, **settings)

    def verdict(self, speed: float | str | None, teeth: int, **options: Any) -> ChatterVerdict:
        """Return whether a record of a cut holds chatter; arguments as of `smfe.chatter`."""
        from smfe.commands.chatter import chatter

        return chatter(self._dataset, speed, teeth, **options)
