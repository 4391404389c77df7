"""The same sentence about several records, axes or measurements, said once."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from smfe.reporting.content.style import listed, spoken

_HEADS: tuple[tuple[str, re.Pattern[str]], ...] = (
    ("excitation", re.compile(r"excitation ([^\s:,]+)[:,] ")),
    ("response", re.compile(r"response ([^\s:,]+)[:,] ")),
    ("record", re.compile(r"((?:[\w.+-]+[/\\])*[\w.+-]+\.[A-Za-z]\w{0,6})[:,] ")),
    ("channel", re.compile(r"((?:force|acceleration|displacement|encoder_position|drive_force|spindle)[\w ]*)[:,] ")),
    ("entry", re.compile(r"([xyz]{2}(?: and [xyz]{2})?)[:,] ")),
    ("hit", re.compile(r"hit (\d+)[:,] ")),
)
"""What a sentence may begin with, and what that is called."""

_NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?![\w]|\.\d)")

_FEW = 4
"""More records than this are counted instead of named."""


@dataclass(frozen=True)
class Said:
    """One sentence and what it is about.

    Parameters
    ----------
    where : tuple of str
        Measurements, lobes or files; empty: everything.
    about : str
        "x, y and z", "3 records"; empty where the sentence concerns all of it.
    text : str
        The sentence, with a capital letter and a full stop.
    """

    where: tuple[str, ...]
    about: str
    text: str

    @property
    def named(self) -> str:
        """What it is said of, counted when it is much."""
        return listed(map(spoken, self.where)) if len(self.where) <= 2 * _FEW else f"{len(self.where)} measurements"

    @property
    def whole(self) -> str:
        """The sentence with what it is about at its end."""
        return f"{self.text.removesuffix('.')} ({self.about})." if self.about else self.text


def merged(warnings: Iterable[tuple[str, str]]) -> list[Said]:
    """Merge warnings that say the same.

    Two say the same when they differ in nothing but the record, axis or measurement they begin with, or in numbers: of
    numbers the smallest and the largest are said.

    Parameters
    ----------
    warnings : iterable of (str, str)
        Where, and what is said.

    Returns
    -------
    list of Said
        In the order in which each was said first.
    """
    groups: dict[str, list[tuple[str, Mapping[str, str], str]]] = {}
    for where, sentence in warnings:
        heads, body = _parted(sentence)
        groups.setdefault(_NUMBER.sub("#", body), []).append((where, heads, body))
    return [_said(group) for group in groups.values()]


def _parted(sentence: str) -> tuple[Mapping[str, str], str]:
    """Return what a sentence begins with (kind -> which) and the rest."""
    heads: dict[str, str] = {}
    rest = sentence.strip()
    while True:
        for kind, pattern in _HEADS:
            found = pattern.match(rest)
            if found and kind not in heads:
                heads[kind] = found[1]
                rest = rest[found.end() :]
                break
        else:
            return heads, rest


def _said(group: Sequence[tuple[str, Mapping[str, str], str]]) -> Said:
    where = tuple(dict.fromkeys(w for w, _, _ in group if w))
    return Said(where, _about([heads for _, heads, _ in group]), sentence(_ranged([body for _, _, body in group])))


def _about(heads: Sequence[Mapping[str, str]]) -> str:
    """Return which axes, else which records a sentence is about."""
    parts = []
    for kind in ("excitation", "response", "entry", "channel", "record", "hit"):
        names = list(dict.fromkeys(h[kind] for h in heads if kind in h))
        # The axis of excitation says which record is meant.
        if not names or (kind == "record" and "excitation" in heads[0]):
            continue
        which = (
            f"{len(names)} {kind}s" if len(names) > _FEW else listed(map(spoken, names) if kind == "channel" else names)
        )
        parts.append(f"{kind} {which}" if kind in ("excitation", "response", "entry", "hit") else which)
    return ", ".join(parts)


def _ranged(bodies: Sequence[str]) -> str:
    """Return the sentence with the ends of each number that differs."""
    rows = [_NUMBER.findall(body) for body in bodies]

    def ends(at: int) -> str:
        texts = sorted({row[at] for row in rows}, key=float)
        return texts[0] if len(texts) == 1 else f"{texts[0]} to {texts[-1]}"

    places = iter(range(len(rows[0])))
    return _NUMBER.sub(lambda _: ends(next(places)), bodies[0])


def sentence(text: str) -> str:
    """Return a text with a capital letter and a full stop; a name with a dot or an underscore keeps its letter."""
    text = re.sub(r"^([xyz]): ", r"Axis \1: ", text.strip())
    first = text.split(" ", 1)[0]
    if first[:1].islower() and first.rstrip(",;:").isalpha():
        text = text[0].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else f"{text}."
