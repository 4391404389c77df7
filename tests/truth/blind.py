"""A blind examination: data with something hidden; the answer opens only after the finding has been handed in."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from truth.axis import Truth
from truth.campaign import DESIGNS, Record, measure, reduce
from truth.chain import Chain
from truth.effects import EFFECTS, OUTSIDE, apply


def seed_of(text: str | int) -> int:
    """Seed from a number or from any text, e.g. the hash of a commit."""
    if isinstance(text, int):
        return text
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:6], "big")


@dataclass(frozen=True)
class Answer:
    """What was hidden: name -> size with its sign; empty: nothing. `machine` and `chain` are the true values."""

    seed: int
    effects: dict[str, float]
    outside: bool
    machine: dict[str, Any]
    chain: dict[str, Any]


class Sealed:
    """Data of one examination. `records` and `reduced` are open; the answer is not, but `commitment` fixes it."""

    def __init__(self, answer: Answer, design: str, records: list[Record]) -> None:
        text = json.dumps(asdict(answer), sort_keys=True)
        self.seed = answer.seed
        self.design = design
        self.records = records
        self.commitment = hashlib.sha256(text.encode()).hexdigest()
        self.finding: str | None = None
        self.__answer = answer

    @property
    def reduced(self) -> list[Record]:
        """Compliances of all records with an excitation."""
        return [reduce(r) for r in self.records if r["condition"].method != "silent"]

    def reveal(self, finding: str) -> Answer:
        """Hand in the finding (serialised, not empty) and get the answer. The first finding counts."""
        if not isinstance(finding, str) or not finding:
            raise TypeError("hand in the finding as text first, e.g. JSON")
        if self.finding is not None and finding != self.finding:
            raise ValueError("another finding was handed in before; the answer is known since")
        self.finding = finding
        return self.__answer

    def require(self, ok: bool, finding: str) -> None:
        """Fail with the seed, the answer and the finding unless `ok`."""
        if not ok:
            hidden = self.reveal(finding).effects
            raise AssertionError(
                f"seed {self.seed}, design {self.design}: hidden {hidden or 'nothing'}; said {finding}"
            )

    def __repr__(self) -> str:
        return f"Sealed(seed={self.seed}, design={self.design!r}, commitment={self.commitment[:12]})"


def chosen(
    rng: np.random.Generator, effects: Sequence[str | None], count: int, scale: tuple[float, float]
) -> dict[str, float]:
    """Choose effects and their sizes, signs included."""
    names = [effects[i] for i in rng.permutation(len(effects))[:count]]
    sizes = {}
    for name in sorted(n for n in names if n is not None):
        effect = (EFFECTS | OUTSIDE)[name]
        size = effect.size * float(np.exp(rng.uniform(*np.log(scale))))
        sizes[name] = size * float(rng.choice([-1.0, 1.0])) if effect.signed else size
    return sizes


def draw(
    seed: str | int,
    *,
    effects: Sequence[str | None] = (None, *EFFECTS),
    count: int = 1,
    scale: tuple[float, float] = (1.0, 1.0),
    design: str = "full",
    snr: float = 40.0,
    truth: Truth | None = None,
) -> Sealed:
    """Hide something and measure.

    Parameters
    ----------
    seed : str or int
        A number, or text such as the hash of a commit: everything follows from it.
    effects : sequence
        To choose from; None stands for nothing. Names of `EFFECTS` and `OUTSIDE`.
    count : int, optional
        How many different ones are hidden together.
    scale : (float, float), optional
        Range of the size over the size that must be found, evenly in the logarithm.
    design : str, optional
        Key of `DESIGNS`; its order is drawn as well.
    snr : float, optional
        Response over noise at the middle level [dB].
    truth : Truth, optional
        Machine before nuisances are drawn.
    """
    number = seed_of(seed)
    rng = np.random.default_rng([number, 1])
    sizes = chosen(rng, effects, count, scale)
    machine = (truth or Truth()).with_nuisances(rng)
    true, chain = apply(sizes, machine, replace(Chain(), snr=snr))
    records = measure(true, DESIGNS[design](int(rng.integers(2**31))), int(rng.integers(2**31)), chain)
    answer = Answer(number, sizes, any(n in OUTSIDE for n in sizes), asdict(true), asdict(chain))
    return Sealed(answer, design, records)
