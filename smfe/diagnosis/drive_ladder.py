"""What each cause is worth in the force domain: the error of a drive record, and of one that no fit has seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from process.errors import InputError
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.inference.fit import Target
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Values
from smfe.diagnosis.inference.search import Bench
from smfe.identification.errors.result import Progress, silent


@dataclass(frozen=True)
class ForceRung:
    """A model of the ladder.

    Parameters
    ----------
    cause : str
        Key of the cause that was added last; "" for the baseline.
    values : mapping
        All values of the joint fit (SI).
    chi2 : float
        Misfit, priors included.
    error : float
        rms force error over rms force of the record that was fitted [1].
    held_out : tuple of float
        The same of the records that were not.
    """

    cause: str
    values: Values
    chi2: float
    error: float
    held_out: tuple[float, ...] = ()


def force_ladder(
    family: DriveRecordFamily,
    causes: Sequence[str],
    held_out: Sequence[DriveRecordFamily] = (),
    progress: Progress = silent,
) -> tuple[ForceRung, ...]:
    """Fit the baseline and then one cause more at a time, everything anew each time.

    Parameters
    ----------
    family : DriveRecordFamily
        Record to fit.
    causes : sequence of str
        Keys of causes, in their order.
    held_out : sequence of DriveRecordFamily, optional
        Other records, made with ``like=family``.
    progress : callable, optional
        Told what is being done.

    Raises
    ------
    InputError
        For a key that the family does not have, or a fit that does not converge.
    """
    model = Model(family, family.conditions)
    keys = [c.key for c in model.causes]
    missing = [key for key in causes if key not in keys]
    if missing:
        raise InputError(f"no cause {missing[0]!r}; this record has {', '.join(keys)}")
    observed = {r: c.observed for r, c in enumerate(model.conditions) if c.observed is not None}
    bench = Bench(model, Target(observed, model.null()), 0, progress)
    at, rungs = bench.null(), []
    for cause in ("", *causes):
        if cause:
            at = bench.confirmed(bench.extend(at, [keys.index(cause)]))
        if not at.converged:
            raise InputError(f"the fit with {cause or 'the baseline'} did not converge: {at.reason}")
        values = model.values(at.u)
        others = tuple(other.force_error(values) for other in held_out)
        rungs.append(ForceRung(cause, values, at.chi2, family.force_error(values), others))
    return tuple(rungs)
