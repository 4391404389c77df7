"""Walk a page as its reader does: in an empty folder, block after block, from the top to the bottom.

What a block of a page is, is said by the text that the reader sees:

- ``sh`` runs in the folder; any exit status but 0 fails.
- ``python`` runs in the folder, each block alone.
- ``toml``, or another language, becomes the file that the paragraph above names last, in code style, before its colon;
  where the last sentence begins with "Add", it is added to the end of that file.
- ``text`` without such a name is to be looked at.

A comment before a block says otherwise: ``<!-- not run: REASON -->``, or ``<!-- exit status 3: REASON -->``.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

RUN = ("sh", "python")
SHOWN = ("text",)
FENCE = re.compile(r"^(?P<fence>```+)(?P<language>\S*)[ \t]*\n(?P<body>.*?)^(?P=fence)[ \t]*$", re.M | re.S)
COMMENT = re.compile(
    r"<!--\s*(?:(?P<not_run>not run)|exit status (?P<status>\d+)):\s*(?P<reason>(?:(?!-->).)*?)\s*-->\s*\Z", re.S
)
NAMED = re.compile(r"`(?P<name>[\w./-]+\.\w+)`[^`]*:\Z", re.S)
LONGEST = 300.0  # seconds of a block


class Stopped(Exception):
    """A block of a page did not do what the page says."""


@dataclass(frozen=True)
class Block:
    """One fenced block.

    Parameters
    ----------
    line : int
        Line of its fence in the page, from 1.
    language : str
        As the fence says.
    text : str
        What stands between the fences.
    file : str or None
        Name of the file that it becomes.
    added : bool
        Whether it is added to the file.
    status : int
        Exit status that it must end with.
    not_run : str or None
        Why it is not run.
    """

    line: int
    language: str
    text: str
    file: str | None = None
    added: bool = False
    status: int = 0
    not_run: str | None = None


def blocks(page: str) -> list[Block]:
    """Return the blocks of a page that are written in a language; directives are none."""
    out = []
    for match in FENCE.finditer(page):
        language = match["language"]
        if language.startswith("{"):
            continue
        line = page.count("\n", 0, match.start()) + 1
        above = page[: match.start()].rstrip()
        comment = COMMENT.search(above)
        if comment:
            above = above[: comment.start()].rstrip()
        paragraph = above.rpartition("\n\n")[2]
        named = None if language in RUN else NAMED.search(paragraph)
        out.append(
            Block(
                line,
                language,
                match["body"],
                named and named["name"],
                re.split(r"[.!?]\s+", paragraph)[-1].startswith("Add"),
                int(comment["status"]) if comment and comment["status"] else 0,
                comment["reason"] if comment and comment["not_run"] else None,
            )
        )
    return out


def faults(page: str) -> list[str]:
    """Return what is wrong with the blocks of a page before any of them runs."""
    out = []
    for block in blocks(page):
        where = f"line {block.line}"
        if not block.language:
            out.append(f"{where}: a block says its language: sh, python, toml or text")
        elif block.not_run is not None:
            if len(block.not_run) < 8:
                out.append(f"{where}: say why the block is not run")
        elif block.language not in (*RUN, *SHOWN) and block.file is None:
            out.append(f"{where}: the paragraph above must name the file, in code style, and end with a colon")
        elif block.language == "toml":
            try:
                tomllib.loads(block.text)
            except tomllib.TOMLDecodeError as error:
                out.append(f"{where}: no TOML: {error}")
        elif block.language == "python":
            try:
                compile(block.text, f"line {block.line}", "exec")
            except SyntaxError as error:
                out.append(f"{where}: no Python: {error}")
    return out


def walk(folder: Path, page: str) -> list[tuple[Block, str]]:
    """Run the blocks of a page in a folder; return each with what it printed.

    Of the standard error of a block that succeeds only warnings and failures are kept, without the names of steps.
    """
    out = []
    with tempfile.TemporaryDirectory() as commands:
        environment = _environment(Path(commands))
        for block in blocks(page):
            printed = ""
            if block.not_run is None and block.language in RUN:
                printed = _run(block, folder, environment)
            elif block.not_run is None and block.file is not None:
                path = folder / block.file
                path.parent.mkdir(parents=True, exist_ok=True)
                with path.open("a" if block.added else "w", encoding="utf-8") as stream:
                    stream.write(("\n" if block.added else "") + block.text)
            out.append((block, printed))
    return out


def walked(folder: Path, page: str) -> None:
    """Fill a folder with ``walk``, what the page makes, and ``printed.json``, what its blocks print."""
    (folder / "walk").mkdir()
    found = [(block.line, printed) for block, printed in walk(folder / "walk", page)]
    (folder / "printed.json").write_text(json.dumps(found), encoding="utf-8")


def _environment(commands: Path) -> dict[str, str]:
    """Return the environment of a shell in which `smfe` and `python` are those that run this."""
    for name, call in (("smfe", '-m smfe "$@"'), ("python", '"$@"')):
        script = commands / name
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" {call}\n', encoding="utf-8")
        script.chmod(0o755)
    own = {
        "PATH": f"{commands}{os.pathsep}{os.environ['PATH']}",
        "MPLBACKEND": "Agg",
        "NO_COLOR": "1",
        "COLUMNS": "110",
    }
    single = {name: "1" for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")}
    return {**os.environ, **own, **single, "PYTHONWARNINGS": "default"}


def _run(block: Block, folder: Path, environment: dict[str, str]) -> str:
    call = ["bash", "-euo", "pipefail", "-c"] if block.language == "sh" else [sys.executable, "-c"]
    ended = subprocess.run(
        [*call, block.text], cwd=folder, env=environment, capture_output=True, text=True, timeout=LONGEST, check=False
    )
    if ended.returncode != block.status:
        raise Stopped(
            f"line {block.line}: exit status {ended.returncode}, expected {block.status}\n{block.text}"
            f"printed:\n{ended.stdout}{ended.stderr}"
        )
    if block.language == "python" and ended.stderr:
        raise Stopped(f"line {block.line}: warnings of Python\n{ended.stderr}")
    said = ended.stderr.splitlines()
    if not block.status:
        said = [line for line in said if line.startswith(("warning", "note", "failed"))]
    return "\n".join([*said, ended.stdout.rstrip()]).strip("\n")
