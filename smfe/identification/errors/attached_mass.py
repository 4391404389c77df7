"""Mass that sits on the tool only to measure: an accelerometer, or the plate and frame between load cell and tool.

What is measured is the machine with the mass, ``Phi' = (Phi^-1 - w^2 m)^-1`` with ``exp(+j w t)``; the machine without
it is ``Phi = Phi' (1 + w^2 m Phi')^-1`` (:eq:`attached-mass`; Sherman and Morrison; for one direction ``H = H'/(1 + w^2
m H'_dd)``). It is exact for a rigid mass at the point where the force acts, whatever the damping. A mass m between load
cell and tool does the same to a measured force, ``F_tool = F_measured - m a``, so that one correction serves both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.errors import InputError
from process.types import Complex, Real
from smfe.identification.errors.covariance import ENTRY, deviation_of, error_variables


def without_mass(compliance: xr.Dataset, mass: float) -> tuple[xr.Dataset, tuple[str, ...]]:
    """Return a compliance without a mass that was attached at the driving point, with what is to be said about it.

    The mass moves in all directions. Of those that were not hit, or not recorded, its reaction is unknown and left out:
    the correction is then that of the axes known.

    Parameters
    ----------
    compliance : xarray.Dataset
        Measured with the mass, responses and forces at the same point; errors are carried along.
    mass : float
        m [kg].

    Raises
    ------
    InputError
        For a mass that is negative or not finite, or when no axis has both force and response.
    """
    if not 0.0 <= mass < np.inf:
        raise InputError(f"an attached mass of {mass:g} kg; give zero or a positive mass")
    if mass == 0.0:
        return compliance, ()
    rows = [str(a) for a in compliance["response"].values]
    columns = [str(a) for a in compliance["excitation"].values]
    direct = [(rows.index(a), j, a) for j, a in enumerate(columns) if a in rows]
    if not direct:
        raise InputError(
            f"the mass of {mass:g} kg cannot be taken off: no axis was both excited ({', '.join(columns)}) and "
            f"recorded ({', '.join(rows)}); record the response along the force"
        )
    phi = np.asarray(compliance["compliance"].transpose(*ENTRY).values, dtype=complex)
    inertia = mass * (2.0 * np.pi * compliance["frequency"].values) ** 2
    left, right = _operators(phi, inertia, direct)
    found = np.einsum("fij,fjk->fik", np.nan_to_num(phi), right)
    known = (
        np.isfinite(phi)
        & np.isfinite(phi[:, [i for i, _, _ in direct], [j for _, j, _ in direct]]).any(axis=1)[:, None, None]
    )
    corrected = np.zeros(len(columns), dtype=bool)
    corrected[[j for _, j, _ in direct]] = True
    known &= corrected
    found = np.where(known, found, np.nan)
    variables: dict[str, tuple[tuple[str, ...], ArrayLike, dict[Any, Any]]] = {
        "compliance": (ENTRY, found, compliance["compliance"].attrs)
    }
    deviation = deviation_of(compliance)
    if deviation is not None:
        moved = np.einsum("fij,hfjk,fkl->hfil", left, np.nan_to_num(deviation), right)
        unknown = np.isnan(deviation).any(axis=0) | ~known
        moved = np.where(unknown, np.nan, moved)
        fresh = error_variables(moved, "deviation" in compliance)
        units = {name: compliance[name].attrs if name in compliance else {"units": "m^2/N^2"} for name in fresh}
        variables.update({name: (dims, values, units[name]) for name, (dims, values) in fresh.items()})
    out = compliance.assign(variables).assign_attrs(attached_mass_kg=mass)
    return out, tuple(_notes(phi, found, left, compliance["frequency"].values, mass, direct, columns))


def _operators(phi: Complex, inertia: Real, direct: list[tuple[int, int, str]]) -> tuple[Complex, Complex]:
    """Return L and R with ``Phi = Phi' R`` and ``d Phi = L d Phi' R``, (f, rows, rows), (f, columns, columns).

    ``R = (1 + w^2 m Phi'_aa)^-1`` over the axes a known at a line, ``L = 1 - w^2 m Phi'_ra R_aa`` at the rows a.
    """
    f, n_rows, n_columns = phi.shape
    rows = np.arange(n_rows)
    left = np.broadcast_to(np.eye(n_rows, dtype=complex), (f, n_rows, n_rows)).copy()
    right = np.broadcast_to(np.eye(n_columns, dtype=complex), (f, n_columns, n_columns)).copy()
    there = np.stack([np.isfinite(phi[:, i, j]) for i, j, _ in direct], axis=1)
    for pattern in np.unique(there, axis=0):
        lines = np.flatnonzero((there == pattern).all(axis=1))
        i = np.array([direct[k][0] for k in np.flatnonzero(pattern)], dtype=np.intp)
        j = np.array([direct[k][1] for k in np.flatnonzero(pattern)], dtype=np.intp)
        if not i.size:
            continue
        block = np.nan_to_num(phi[np.ix_(lines, i, j)])  # an entry that was not measured reacts on nothing
        inverse = np.linalg.inv(np.eye(i.size) + inertia[lines, None, None] * block)
        right[np.ix_(lines, j, j)] = inverse
        whole = np.nan_to_num(phi[np.ix_(lines, rows, j)])
        left[np.ix_(lines, rows, i)] -= inertia[lines, None, None] * (whole @ inverse)
    return left, right


def _notes(
    before: Complex,
    after: Complex,
    left: Complex,
    frequency: Real,
    mass: float,
    direct: list[tuple[int, int, str]],
    columns: list[str],
) -> list[str]:
    notes = []
    i, j = [d[0] for d in direct], [d[1] for d in direct]
    change = np.abs(after[:, i, j] - before[:, i, j]) / np.abs(before[:, i, j])
    if np.isfinite(change).any():
        at = np.unravel_index(int(np.nanargmax(change)), change.shape)
        notes.append(
            f"the mass of {mass:.3g} kg was taken off; that changed the compliance by up to "
            f"{100.0 * change[at]:.2g} % ({direct[at[1]][2]} at {frequency[at[0]]:.4g} Hz)"
        )
    growth = np.linalg.norm(left, ord=2, axis=(1, 2))
    if np.nanmax(growth) > 3.0:  # a smaller growth of the errors is in their interval
        notes.append(
            f"taking the mass of {mass:.3g} kg off multiplies errors by up to {np.nanmax(growth):.2g} (at "
            f"{frequency[int(np.nanargmax(growth))]:.4g} Hz); use a lighter sensor"
        )
    cross = [before[:, a, b] for a in i for b in j if (a, b) not in set(zip(i, j, strict=True))]
    if any(np.isnan(entry).any() for entry in cross) or len(direct) < 3:
        notes.append(
            f"the mass of {mass:.3g} kg also moves across the force; only the reaction along {', '.join(columns)} as "
            "far as it was measured is taken off"
        )
    return notes
