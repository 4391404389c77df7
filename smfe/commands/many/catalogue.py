"""`smfe catalogue`: ask the table of many campaigns, and draw what it says of machines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from process.errors import InputError
from smfe.fleet.doubts import doubt_table
from smfe.fleet.prior import Prior, prior_of
from smfe.fleet.select import selected
from smfe.fleet.table import read_catalogue
from smfe.fleet.tracks import Mode, drift_table, fleet_table, modes_of
from smfe.results import check_target, write_atomically, write_csv


@dataclass(frozen=True)
class Catalogue:
    """What a catalogue says of the rows that were asked for.

    Parameters
    ----------
    rows : pandas.DataFrame
        The rows; columns end in their unit.
    campaigns : pandas.DataFrame
        All rows of the campaigns that have one among them, by which they are doubted.
    """

    rows: pd.DataFrame
    campaigns: pd.DataFrame

    @property
    def modes(self) -> list[Mode]:
        """Modes of every machine, of the peaks among the rows."""
        return modes_of(self.rows)

    def drift(self) -> pd.DataFrame:
        """Return how each mode of each machine drifts, percent a year; see `smfe.fleet.tracks.drift_table`."""
        return drift_table(self.modes)

    def fleet(self) -> pd.DataFrame:
        """Return how each mode scatters over the machines; see `smfe.fleet.tracks.fleet_table`."""
        return fleet_table(self.modes)

    def doubts(self) -> pd.DataFrame:
        """Return which campaigns to doubt, and why; see `smfe.fleet.doubts`."""
        return doubt_table(self.campaigns, modes_of(self.campaigns))

    def prior(self) -> Prior:
        """Return mean and covariance of the modes; see `smfe.fleet.prior`."""
        return prior_of(self.modes)


def catalogue(
    root: Path | str,
    machine: Sequence[str] = (),
    where: Sequence[str] = (),
    since: str | None = None,
    until: str | None = None,
    kind: str | None = None,
    output: Path | str | None = None,
    draw: Path | str | None = None,
    prior: Path | str | None = None,
) -> Catalogue:
    """Ask the catalogue of many campaigns.

    Parameters
    ----------
    root : path
        Folder of the results of many campaigns, its ``catalogue.parquet``, or the results of one campaign.
    machine : sequence of str, optional
        Only these machines.
    where : sequence of str, optional
        Only rows for which all of these hold: "frequency_Hz > 30".
    since, until : str, optional
        Only rows measured from, until this date (2025-01-31).
    kind : str, optional
        Only rows of this kind: "peak", "limit", "cutting_test", ...
    output : path, optional
        CSV file to write the rows to.
    draw : path, optional
        Folder for the pictures drift.png, fleet.png and doubts.png, those of which there is something to draw.
    prior : path, optional
        TOML file to write the modes to that are to be expected of such a machine, as a ``[[model]]``, and beside it,
        with the suffix .json, their mean and covariance; a name that ends in .json gives this one alone.

    Returns
    -------
    Catalogue
        The rows, and what they say of machines.

    Raises
    ------
    InputError
        When there is no catalogue, a condition cannot be understood, or a prior has nothing to rest on.
    """
    whole = read_catalogue(Path(root)).to_pandas()
    rows = selected(whole, machine, where, since, until, kind)
    found = Catalogue(rows, whole[whole["campaign"].isin(rows["campaign"])])
    for path in (output, prior):
        if path is not None:
            check_target(Path(path))
    if prior is not None:
        _write_prior(found.prior(), Path(prior))
    if output is not None:
        write_csv(Path(output), rows)
    if draw is not None:
        # Drawing stays out of the numerics: only the composition imports it, and only where it is called.
        from smfe.reporting.fleet import write_pictures

        if not write_pictures(found.modes, found.doubts(), Path(draw)):
            raise InputError("there is nothing to draw: no peak among the rows that were asked for")
    return found


def _write_prior(prior: Prior, path: Path) -> None:
    write_atomically(path.with_suffix(".json"), lambda p: p.write_text(prior.as_json(), encoding="utf-8"))
    if path.suffix != ".json":
        write_atomically(path, lambda p: p.write_text(prior.as_toml(), encoding="utf-8"))
