"""Where something stands in a TOML file: `tomllib` says it of syntax errors alone."""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_right
from collections.abc import Mapping

Loc = tuple[str | int, ...]
"""Keys and numbers of entries that lead to a place: ("measurement", 0, "records", 1, "file")."""

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SPACE = re.compile(r"[ \t]*")
_GAP = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_PLAIN = re.compile(r"[^,\]}\n#]*")
_TEXT = re.compile(
    r'"""(?:[^\\]|\\.)*?"{3,5}|' + r"'''.*?'{3,5}|" + r'"(?:[^"\\\n]|\\.)*"|' + r"'[^'\n]*'",
    re.DOTALL,
)
_AT = re.compile(r"\(at line (\d+), column \d+\)")
_COMMA = re.compile(r"""=\s*["']?[-+]?\d+,\d+""")
_QUOTED_BACKSLASH = re.compile(r'"([^"\n]*\\[^"\n]*)"')


def lines_of(text: str) -> dict[Loc, int]:
    """Return the line, counted from 1, of every key, table and entry of a list in a file that `tomllib` has read."""
    scanner = _Scanner(text)
    scanner.file()
    return scanner.found


def line_of(lines: Mapping[Loc, int], where: Loc) -> int | None:
    """Return the line of a place, of what it would stand in where it is missing; None for the file as a whole."""
    for end in range(len(where), 0, -1):
        if where[:end] in lines:
            return lines[where[:end]]
    return None


class _Scanner:
    """Walks through a file once; that it is TOML is known."""

    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0
        self.breaks = [i for i, c in enumerate(text) if c == "\n"]
        self.found: dict[Loc, int] = {}
        self.last: dict[Loc, int] = {}  # list of tables -> number of its last table

    def mark(self, where: Loc) -> None:
        self.found.setdefault(where, bisect_right(self.breaks, self.at - 1) + 1)

    def skip(self, pattern: re.Pattern[str]) -> str:
        match = pattern.match(self.text, self.at)
        assert match is not None
        self.at = match.end()
        return match.group()

    def starts(self, text: str) -> bool:
        return self.text.startswith(text, self.at)

    def file(self) -> None:
        table: Loc = ()
        while True:
            self.skip(_GAP)
            if self.at >= len(self.text):
                return
            if self.starts("["):
                table = self.head()
            else:
                self.pair(table)

    def head(self) -> Loc:
        """Read ``[a.b]`` or ``[[a.b]]``."""
        begin, many = self.at, self.starts("[[")
        self.at += 2 if many else 1
        names = self.keys()
        self.at += 2 if many else 1
        end, self.at = self.at, begin
        where: Loc = ()
        for i, name in enumerate(names):
            where = (*where, name)
            self.mark(where)
            if many and i == len(names) - 1:
                self.last[where] = self.last.get(where, -1) + 1
            if where in self.last:
                where = (*where, self.last[where])
        self.mark(where)
        self.at = end
        return where

    def keys(self) -> list[str]:
        """Read ``a . "b" . 'c'``, up to what is behind it."""
        names = []
        while True:
            self.skip(_SPACE)
            if self.text[self.at] in "\"'":
                name = self.skip(_TEXT)
                names.append(str(tomllib.loads(f"k = {name}")["k"]))
            else:
                names.append(self.skip(_BARE))
            self.skip(_SPACE)
            if not self.starts("."):
                return names
            self.at += 1

    def pair(self, table: Loc) -> None:
        begin = self.at
        names = self.keys()
        end, self.at = self.at, begin
        for i in range(len(names)):
            self.mark((*table, *names[: i + 1]))
        self.at = end + 1  # behind "="
        self.value((*table, *names))

    def value(self, where: Loc) -> None:
        self.skip(_SPACE)
        if self.text[self.at] in "\"'":
            self.skip(_TEXT)
        elif self.starts("["):
            self.entries(where, "]")
        elif self.starts("{"):
            self.entries(where, "}")
        else:
            self.skip(_PLAIN)

    def entries(self, where: Loc, end: str) -> None:
        """Read a list, or the pairs of a table in one line."""
        self.at += 1
        count = 0
        while True:
            self.skip(_GAP)
            if self.starts(end):
                self.at += 1
                return
            if self.starts(","):
                self.at += 1
            elif end == "}":
                self.pair(where)
            else:
                self.mark((*where, count))
                self.value((*where, count))
                count += 1


def syntax_advice(text: str, error: tomllib.TOMLDecodeError) -> tuple[int | None, str]:
    """Return the line of a syntax error and what is probably meant: a decimal comma, a backslash, quotes.

    Parameters
    ----------
    text : str
        The file.
    error : tomllib.TOMLDecodeError
        What `tomllib` says of it.
    """
    at = _AT.search(str(error))
    number = int(at.group(1)) if at else None
    said = str(error).partition(" (at ")[0]
    lines = text.splitlines()
    line = lines[number - 1].strip() if number is not None and number <= len(lines) else ""
    backslash = _QUOTED_BACKSLASH.search(line)
    if backslash:
        name = backslash.group(1)
        slashes = name.replace("\\\\", "/").replace("\\", "/")
        return (
            number,
            f"a backslash in double quotes begins an escape: write \"{slashes}\", or '{name}' in single quotes",
        )
    if _COMMA.search(line.partition("#")[0]):
        mended = re.sub(r"(\d),(\d)", r"\1.\2", line.partition("#")[0].strip())
        return number, f"'{line}' has a decimal comma: write {mended}, and a quantity as text with its unit, \"0.2 mm\""
    return number, f"not TOML: {said}; texts need quotes, tables one line"


def place(where: Loc, raw: Mapping[str, object]) -> str:
    """Return a place in words: "measurement 'hammer', records[0].file"; tables that have a name are called by it."""
    begin = ""
    rest = where
    if len(where) >= 2 and isinstance(where[1], int):
        tables = raw.get(str(where[0]))
        table = tables[where[1]] if isinstance(tables, list) and where[1] < len(tables) else None
        name = table.get("file" if where[0] == "cutting_test" else "name") if isinstance(table, dict) else None
        if isinstance(name, str) and name:
            begin, rest = f"{str(where[0]).replace('_', ' ')} '{name}'", where[2:]
    text = ""
    for part in rest:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return ", ".join(filter(None, [begin, text.lstrip(".")]))
