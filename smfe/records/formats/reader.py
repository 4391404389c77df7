"""Files are read in a process of their own: what a damaged one does to a library, it does there.

Readers of foreign formats loop for ever on some damaged files, end the process on others (a bit in a MATLAB file is
enough), or ask for all the memory there is; nothing in a process can keep a library from it. So one second process
(`formats.reader_process`) is started where the first file is read and kept, and everything that knows a format runs in
it, with a limit of memory and of time. When it does not answer in time it is ended, and that is said in a sentence, as
it is when the library has ended it; the next file is read by a new one.

Numbers come back through a small piece of shared memory, a slot at a time, so that both sides find it in their caches;
everything else is text (JSON): nothing is ever unpickled. Where no process can be started (a frozen program), files
are read here.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import json
import mmap
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from process.errors import InputError
from smfe.records.formats import table
from smfe.records.formats.table import Format, Table, UnknownColumn

P = ParamSpec("P")
T = TypeVar("T")

SECONDS = 15.0
"""How long an answer may take, for files of no size; a slow disk needs a few, a library that loops needs for ever."""

RATE = 1e6
"""Bytes of a file that get another second: ten times less than the slowest reader needs on a machine of its own."""

_PATIENCE = 12
"""How many quarters of that time more are waited for a process that does not compute at all."""

START = 60.0
"""How long the second process may take to start; on a machine that is busy that counts, and no file is to blame."""

MOST, MOST_TIMES = 1 << 26, 128
"""Numbers in one answer [bytes]: so many, and so many more for each byte of the file, which may be packed."""

MEMORY, MEMORY_TIMES = 400 << 20, 384
"""Memory in which an answer is found [bytes]: three times as much."""

SLOT = 1 << 20
"""Bytes of a slot; there are two."""

CLASSES: dict[str, type] = {"Table": Table}
"""Dataclasses that an answer may hold, by their names; a format adds its own."""

_SCRIPT = Path(__file__).with_name("reader_process.py")
_INSIDE = False
"""Whether this is the process that reads."""


def apart(function: Callable[Concatenate[Path, P], T]) -> Callable[Concatenate[Path, P], T]:
    """Return a function of a file that runs in the process that reads.

    Parameters
    ----------
    function : callable
        A function of a module: path, and arguments that JSON can hold. It returns tables, functions, data sets, what
        JSON can hold, or lists and iterators of these.

    Returns
    -------
    callable
        The same; it raises `InputError` also where reading takes too long, needs too much memory or ends its process.
    """

    @functools.wraps(function)
    def run(path: Path, /, *args: P.args, **kwargs: P.kwargs) -> T:
        process = _start()
        if process is None:
            return function(path, *args, **kwargs)
        request = {"function": [function.__module__, function.__name__], "args": args, "named": kwargs}
        found: T = process.ask(path, {**request, "free": table.available()})
        return found

    return run


def format_apart(form: Format) -> Format:
    """Return a format whose files are read in the process that reads."""
    return replace(
        form,
        read_tables=apart(form.read_tables),
        read_blocks=None if form.read_blocks is None else apart(form.read_blocks),
        read_segments=None if form.read_segments is None else apart(form.read_segments),
        stated_units=None if form.stated_units is None else apart(form.stated_units),
    )


class _Process:
    """A running process, its answers and what it was started by."""

    def __init__(self) -> None:
        folder = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
        handle, self.name = tempfile.mkstemp(prefix="smfe-", dir=folder)
        try:
            os.write(handle, bytes(2 * SLOT))  # all of it is there: a full disk is found out here
            self.memory = mmap.mmap(handle, 2 * SLOT)
            self.slots = np.frombuffer(self.memory, np.uint8).reshape(2, SLOT)
        finally:
            os.close(handle)
        # -P: the folder of the script holds modules of the names of the standard library's.
        self.process = subprocess.Popen(
            [sys.executable, "-P", str(_SCRIPT), self.name, str(SLOT)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            encoding="utf-8",
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
                "OPENBLAS_NUM_THREADS": "1",
                "OMP_NUM_THREADS": "1",
                "ARROW_DEFAULT_MEMORY_POOL": "system",  # the others reserve more addresses than the limit has
            },
        )
        self.owner = os.getpid()
        self.lock = threading.Lock()
        self.forgotten: list[int] = []
        self.answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        assert self.process.stdout is not None
        threading.Thread(target=self._listen, args=(self.process.stdout,), daemon=True).start()

    def _listen(self, stream: IO[str]) -> None:
        """Pass on the lines, and an empty one at their end."""
        with contextlib.suppress(ValueError):  # closed meanwhile
            for line in stream:
                self.answers.put(line)
        self.answers.put("")

    def answer(self, seconds: float) -> str | None:
        """Return the next line, "" when the process has died, None when the time is up."""
        try:
            return self.answers.get(timeout=seconds)
        except queue.Empty:
            return None

    def ask(self, path: Path, request: dict[str, Any]) -> Any:
        """Return what a function or an iterator in the process returns."""
        if self not in _running or self.owner != os.getpid():
            raise InputError(f"{path.name}: the process that was reading it has been ended; read it again")
        size = path.stat().st_size if path.is_file() else 0
        limits = {"most": MOST + MOST_TIMES * size, "memory": MEMORY + MEMORY_TIMES * size}
        seconds = SECONDS + size / RATE
        with self.lock:
            forgotten = [self.forgotten.pop() for _ in range(len(self.forgotten))]
            request = {**request, "path": str(path.absolute()), "forget": forgotten, "seconds": seconds, **limits}
            self._say(json.dumps(request))
            try:
                found = json.loads(self._line(path, seconds))
                arrays = self._arrays(path, found["arrays"], seconds)
            except BaseException:  # what was going to be said now would be taken for an answer to something else
                if self in _running:
                    _running.remove(self)
                self.end()
                raise
        if "error" in found:
            kind, message, *more = found["error"]
            raise UnknownColumn(message, *more) if kind == "UnknownColumn" else InputError(message)
        return self._value(path, found["value"], arrays)

    def _say(self, line: str) -> None:
        assert self.process.stdin is not None
        with contextlib.suppress(OSError):  # that it has died is what the answer says
            self.process.stdin.write(line + "\n")
            self.process.stdin.flush()

    def _worked(self) -> float | None:
        """Return the seconds that the process has computed; None where the system does not say."""
        try:
            fields = Path(f"/proc/{self.process.pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
            return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        except (OSError, ValueError, IndexError):
            return None

    def _line(self, path: Path, seconds: float) -> str:
        line = self.answer(seconds)
        # On a machine that is busy, and from a disk that is slow, it may have had little of that time.
        computed, idle, slice_ = 0.0, 0, seconds / 4.0
        while line is None and computed < 0.7 * seconds and idle < _PATIENCE:
            before = self._worked()
            line = self.answer(slice_)
            worked = self._worked()
            if before is None or worked is None or worked - before > 0.7 * slice_:
                break
            computed += worked - before
            idle += worked - before < 0.01 * slice_
        if line:
            return line
        what = f"does not come back within {seconds:.3g} s"
        if line == "":
            code = self.process.wait()
            name = signal.Signals(-code).name if -code in set(signal.Signals) else f"status {code}"
            what = f"breaks down ({name})"
        raise InputError(
            f"{path.name}: cannot be read: the library that reads such files {what}; the file is damaged: copy or "
            "export it again"
        )

    def _arrays(self, path: Path, stated: list[tuple[str, list[int]]], seconds: float) -> list[Any]:
        """Return arrays, which come one behind the other in slots; the first is full when they are announced."""
        arrays = [np.empty(shape, kind) for kind, shape in stated]
        total = sum(a.nbytes for a in arrays)
        count = -(-total // SLOT)
        places = iter([a.reshape(-1).view(np.uint8) for a in arrays if a.size])
        place, at = next(places, None), 0
        for k in range(count):
            if k > 0:
                self._line(path, seconds)
            slot, begin = self.slots[k % 2, : min(SLOT, total - k * SLOT)], 0
            while begin < slot.size:
                assert place is not None
                part = min(slot.size - begin, place.size - at)
                place[at : at + part] = slot[begin : begin + part]
                begin, at = begin + part, at + part
                if at == place.size:
                    place, at = next(places, None), 0
            if k + 2 < count:
                self._say("")
        return arrays

    def _value(self, path: Path, coded: Any, arrays: list[Any]) -> Any:
        def of(entry: Any) -> Any:
            return self._value(path, entry, arrays)

        if not isinstance(coded, list):
            return coded
        kind, content = coded
        match kind:
            case "array":
                return arrays[content]
            case "scalar":
                return arrays[content][()]
            case "texts":
                shape, letters, entries = content
                return np.array(entries, dtype=str if letters == "U" else object).reshape(shape)
            case "list":
                return [of(entry) for entry in content]
            case "tuple":
                return tuple(of(entry) for entry in content)
            case "dict":
                return {of(key): of(entry) for key, entry in content}
            case "object":
                name, values = content
                return CLASSES[name](*map(of, values))
            case "dataset":
                import xarray as xr

                variables = {n: (tuple(dims), of(values), of(attrs)) for n, dims, attrs, values in content[0]}
                coords = {n: variables[n] for n in content[1]}
                return xr.Dataset({n: v for n, v in variables.items() if n not in coords}, coords, of(content[2]))
            case "iterator":
                return self._items(path, content)
        raise ValueError(f"an answer of unknown kind '{kind}'")

    def _items(self, path: Path, number: int) -> Iterator[Any]:
        try:
            while True:
                found = self.ask(path, {"next": number})
                if found is None:
                    return
                yield found
        finally:
            self.forgotten.append(number)

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
        with contextlib.suppress(OSError):
            os.unlink(self.name)


_lock = threading.Lock()
_running: list[_Process] = []
_dead: list[str] = []
"""Why there can be no process."""


def _start() -> _Process | None:
    """Return the process that reads files; None where there can be none, or this is it."""
    if _INSIDE:
        return None
    with _lock:
        if _running and _running[0].owner != os.getpid():
            _running.clear()  # of the process that we were forked from
        if not _running and not _dead:
            try:
                process = _Process()
            except OSError as error:
                _dead.append(str(error))
                return None
            if process.answer(START):
                with contextlib.suppress(OSError):
                    os.unlink(process.name)  # both sides have it open; on Windows it goes at the end
                _running.append(process)
            else:  # what was started is no Python interpreter
                _dead.append("it does not answer")
                process.end()
        return _running[0] if _running else None


@atexit.register
def _end() -> None:
    for process in _running:
        process.end()
