"""What a set of conditions could separate and detect before any data: signatures at the most likely nuisances."""

from dataclasses import dataclass

import numpy as np

from smfe.diagnosis.inference.fit import Fit, Target
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.signature import cosines, groups, tangent
from smfe.diagnosis.inference.thresholds import Detectable, detectable, threshold


@dataclass(frozen=True)
class Isolability:
    """Cosines between the signatures of causes, those that are inseparable, the sizes that would be seen."""

    cosine: np.ndarray
    groups: tuple[tuple[str, ...], ...]
    power: tuple[Detectable, ...]


def isolability(family, conditions=None, seed=0):
    """Return what conditions (default: those of the family) can separate and detect."""
    chosen = tuple(family.conditions if conditions is None else conditions)
    model = Model(family, chosen)
    u, rows = model.null(), range(len(chosen))
    predicted = {r: model.predict(r, u) for r in rows}
    slope = model.slopes(rows, u, model.nuisance)
    residual = {r: np.zeros(y.size) for r, y in predicted.items()}
    at = tangent(model, Target(predicted, u), Fit((), model.nuisance, u, 0.0, residual, slope, True))
    cosine, keys = cosines(model, at), tuple(c.key for c in model.causes)
    together = tuple(tuple(keys[k] for k in g) for g in groups(model, cosine))
    limit = threshold(model, at, np.random.default_rng([seed, 1, 0]))
    return Isolability(cosine, together, detectable(model, at, limit))
