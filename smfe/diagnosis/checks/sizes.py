"""Audit of sizes: a compliance ten times that of the declared model, a stiffness or a force that nothing has."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import xarray as xr

from process.cut.engagement import Engagement
from process.cut.force import CuttingCoefficients, force_harmonics
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import axis_present
from smfe.campaign import Model
from smfe.diagnosis.checks.compliances import FACTORS
from smfe.diagnosis.checks.suspect import Suspect
from smfe.identification.sweep.passes import in_cut

DYNAMIC_STIFFNESS = (1e3, 1e11)
"""Least and greatest dynamic stiffness at the largest resonance that a machine has at its tool [N/m].

A slender boring bar has 1e5 N/m at rest and a hundredth of it in resonance; a large machine frame 1e9 N/m.
"""

OF_MODEL = 1.35
"""Ratio about a factor of units within which a measured compliance over that of its model is taken for it."""

LEAST = 8.0
"""Smallest factor of units that is looked for against a model: a machine may well be three times as soft."""

OF_FORCE = 12.0
"""Ratio of measured and predicted cutting force, or its inverse, from which a force is not believed.

Cutting coefficients of a handbook are within a factor of two, wear and run-out add as much; a kilonewton is 1000.
"""


def stiffness_suspects(name: str, compliance: xr.Dataset) -> list[Suspect]:
    """Name driving points whose dynamic stiffness at the largest resonance no tool tip has."""
    out = []
    array = compliance["compliance"]
    for axis in (str(a) for a in array["response"].values if a in array["excitation"].values):
        phi = np.abs(array.sel(response=axis, excitation=axis).values)
        if "compliance_std" in compliance:
            std = compliance["compliance_std"].sel(response=axis, excitation=axis).values
            phi = phi[phi > 5.0 * np.nan_to_num(std)]
        phi = phi[np.isfinite(phi) & (phi > 0.0)]
        if phi.size < 5:
            continue
        stiffness = 1.0 / float(np.quantile(phi, 0.98))
        if not DYNAMIC_STIFFNESS[0] <= stiffness <= DYNAMIC_STIFFNESS[1]:
            low, high = DYNAMIC_STIFFNESS
            out.append(
                Suspect(
                    "unit_error",
                    "fault",
                    f"{name}, {axis}{axis}",
                    f"its dynamic stiffness at the largest resonance is {stiffness:.3g} N/m; machines have {low:g} to "
                    f"{high:g} N/m there",
                    "correct the unit, scale or sensitivity of force or motion in [channels]",
                    excludes=(("measurement", name),),
                )
            )
    return out


def model_suspects(compliances: Mapping[str, xr.Dataset], models: Sequence[Model]) -> list[Suspect]:
    """Name measurements whose compliance is that of a declared model times a well-known factor of units.

    The median of ``|Phi / Phi_model|`` over the lines where both are at least a tenth of their largest: a peak that
    lies elsewhere than the model says moves it little.
    """
    out = []
    for model in models:
        for name, compliance in compliances.items():
            ratio = {a: r for a in "xyz" if (r := _ratio(compliance, model, a)) is not None}
            for text, factor in ((t, f) for t, f in FACTORS.items() if f > LEAST):
                axes = [a for a, r in ratio.items() if _near(r, factor)]
                if axes:
                    sizes = ", ".join(f"{ratio[a]:.3g} in {a}{a}" for a in axes)
                    out.append(
                        Suspect(
                            "unit_error",
                            "fault",
                            f"{name}, {', '.join(2 * a for a in axes)}",
                            f"it is {sizes} times the compliance of the model '{model.name}': this is the factor of "
                            f"{text}",
                            "correct the unit of the channel in [channels], or the model",
                            excludes=(("measurement", name),),
                        )
                    )
    return out


def _near(ratio: float, factor: float) -> bool:
    return min(abs(math.log(ratio / factor)), abs(math.log(ratio * factor))) < math.log(OF_MODEL)


def _ratio(compliance: xr.Dataset, model: Model, axis: str) -> float | None:
    array = compliance["compliance"]
    if axis not in array["response"].values or axis not in array["excitation"].values:
        return None
    phi = np.abs(array.sel(response=axis, excitation=axis).values)
    k = "xyz".index(axis)
    declared = np.abs(model.modal.matrix(compliance["frequency"].values)[:, k, k])
    clear = np.isfinite(phi) & (phi > 0.0) & (declared > 0.1 * declared.max(initial=0.0))
    if "compliance_std" in compliance:
        std = compliance["compliance_std"].sel(response=axis, excitation=axis).values
        clear &= phi > 5.0 * np.nan_to_num(std)
    if np.count_nonzero(clear) < 10:
        return None
    # Where both have their peaks: a mode that the model does not know says nothing about a unit.
    both = clear & (phi > 0.1 * phi[clear].max())
    return float(np.median(phi[both] / declared[both])) if np.count_nonzero(both) >= 5 else None


def force_suspects(
    record: xr.Dataset,
    where: str,
    cut: tuple[Tool, Engagement, CuttingCoefficients],
    depth: float,
    feed_per_tooth: float,
    excludes: tuple[tuple[str, str], ...] = (),
) -> list[Suspect]:
    """Compare the fluctuation of a cutting force with what tool and work material make of the cut.

    The root mean square over all measured axes, measured while the tool cuts, over that of the first five harmonics of
    the tooth passing frequency. Chatter raises it; a unit changes it by much more.
    """
    axes = axis_present(record, "force") if "force" in record else []
    if not axes:
        return []
    try:
        harmonics = force_harmonics(*cut, depth, feed_per_tooth, [1, 2, 3, 4, 5])
    except InputError:
        return []
    predicted = math.sqrt(0.5 * float(np.sum(np.abs(harmonics[:, ["xyz".index(a) for a in axes]]) ** 2)))
    inside = in_cut(record)
    samples = record["force"].sel(axis=axes).values[:, inside]
    if samples.shape[1] < 16 or predicted <= 0.0:
        return []
    measured = math.sqrt(float(np.sum(np.var(samples, axis=1))))
    if measured <= 0.0 or 1.0 / OF_FORCE < measured / predicted < OF_FORCE:
        return []
    return [
        Suspect(
            "unit_error",
            "fault",
            f"{where}, force",
            f"it fluctuates by {measured:.3g} N rms in the cut, where tool, material, depth and feed per tooth make "
            f"{predicted:.3g} N",
            "correct the unit or scale of the force in [channels], the coefficients in [material], or depth and feed",
            excludes=excludes,
        )
    ]
