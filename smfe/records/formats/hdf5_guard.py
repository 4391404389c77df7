"""A time limit for the HDF5 library, which runs on for ever on some damaged files, and ends the process on others.

Nothing in a process can end a loop of a library that holds the interpreter, and most of what makes the library loop
cannot be seen from outside: superblock and file length may be right, and a text be longer than the heap it stands in.
So a second process, started once, opens each file first and walks through all of it but the samples
(`formats.hdf5_probe`). When it does not answer in time it is ended, and that is said in a sentence, as it is when
the library has ended the process itself.

What it costs does not depend on the samples: the index of their pieces is walked through, they are not read. Where no
process can be started (a frozen program), files are opened without it.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
from pathlib import Path
from typing import IO

from process.errors import InputError

SECONDS = 60.0
"""How long a file may take; a slow network disk needs a few, a library that loops needs for ever."""

START = 60.0
"""How long the second process may take to start; on a machine that is busy that counts, and no file is to blame."""

_SCRIPT = Path(__file__).with_name("hdf5_probe.py")


class _Probe:
    """A running process, its answers and what it was started by."""

    def __init__(self) -> None:
        # -P: the folder of the script holds modules of the names of the standard library's.
        self.process = subprocess.Popen(
            [sys.executable, "-P", str(_SCRIPT)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            encoding="utf-8",
            env={**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)},
        )
        self.owner = os.getpid()
        self.answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        assert self.process.stdout is not None
        threading.Thread(target=self._listen, args=(self.process.stdout,), daemon=True).start()

    def _listen(self, stream: IO[str]) -> None:
        """Pass on the lines, and an empty one at their end."""
        with contextlib.suppress(ValueError):  # closed meanwhile
            for line in stream:
                self.answers.put(line)
        self.answers.put("")

    def ask(self, path: Path, seconds: float) -> str | None:
        """Return the answer, "" when the process has died, None when the time is up."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(str(path)) + "\n")
            self.process.stdin.flush()
        except OSError:
            return ""
        return self.answer(seconds)

    def answer(self, seconds: float) -> str | None:
        """Return the next line, "" when the process has died, None when the time is up."""
        try:
            return self.answers.get(timeout=seconds)
        except queue.Empty:
            return None

    def end(self) -> None:
        """End the process, and only this one."""
        if self.owner != os.getpid():
            return
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()


_lock = threading.Lock()
_running: list[_Probe] = []
_dead: list[str] = []


def check(path: Path, kind: str) -> None:
    """Refuse a file on which the HDF5 library does not come back.

    Parameters
    ----------
    path : Path
        The file.
    kind : str
        What it should be, for the message.

    Raises
    ------
    InputError
        When walking through it takes more than `SECONDS`, or ends the process that does.
    """
    with _lock:
        probe = _start()
        if probe is None:
            return
        answer = probe.ask(path.absolute(), SECONDS)
        if answer:
            return
        _running.clear()
        probe.end()
    what = f"does not come back within {SECONDS:g} s" if answer is None else "breaks down"
    raise InputError(
        f"{path.name}: cannot be read as {kind}: the HDF5 library {what}; the file is damaged: copy or export it again"
    )


def _start() -> _Probe | None:
    """Return the process that opens files; None where there can be none."""
    if _running and _running[0].owner != os.getpid():
        _running.clear()  # of the process that we were forked from
    if not _running and not _dead:
        try:
            probe = _Probe()
        except OSError as error:
            _dead.append(str(error))
            return None
        if probe.answer(START):
            _running.append(probe)
        else:  # what was started is no Python interpreter, or has no h5py
            _dead.append("it does not answer")
            probe.end()
    return _running[0] if _running else None


@atexit.register
def _end() -> None:
    for probe in _running:
        probe.end()
