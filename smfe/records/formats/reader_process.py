"""The process that reads files: whatever a damaged one does to a library, it does it here.

Run as a script by `formats.reader`, never imported: it takes requests from its input, one in a line as JSON, calls a
function of a format, and answers with a line of JSON. Arrays follow through shared memory. It imports what a format
needs when the first of its files comes.
"""

import importlib
import json
import mmap
import os
import signal
import sys
import types
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np


class _TooLarge(Exception):
    """An answer has more numbers than a file of its size may hold."""


class _Answers:
    """What is read from and written to, and the iterators that have been handed out."""

    def __init__(self, memory: str, slot: int) -> None:
        # Libraries write to the standard streams what would be taken for answers.
        self.requests: IO[str] = os.fdopen(os.dup(0), encoding="utf-8")
        self.answers: IO[str] = os.fdopen(os.dup(1), "w", encoding="utf-8")
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nothing, stream)
        with open(memory, "r+b") as file:
            self.slots = np.frombuffer(mmap.mmap(file.fileno(), 2 * slot), np.uint8).reshape(2, slot)
        self.slot = slot
        self.iterators: dict[int, Iterator[Any]] = {}
        self.count = 0

    def say(self, line: str) -> None:
        self.answers.write(line + "\n")
        self.answers.flush()

    def answer(self, request: dict[str, Any]) -> None:
        """Answer one request."""
        for number in request["forget"]:
            self.iterators.pop(number, None)
        arrays: list[Any] = []
        path = Path(request["path"])
        try:
            if "function" in request:  # what is imported does not count
                importlib.import_module(request["function"][0])
            with _limited(request):
                found: dict[str, Any] = {"value": self.coded(_called(self, path, request), arrays)}
                arrays = [np.asarray(a, order="C") for a in arrays]
            total = sum(a.nbytes for a in arrays)
            if total > request["most"]:
                raise _TooLarge(
                    f"{path.name}: {path.stat().st_size / 1e6:.3g} MB that unpack to {total / 1e6:.3g} MB of numbers; "
                    f"of a file of this size at most {request['most'] / 1e6:.3g} MB are read at once: cut the record, "
                    "or save it less packed"
                )
        except Exception as error:
            arrays, found = [], {"error": _error(path, request, error)}
        found["arrays"] = [[a.dtype.str, a.shape] for a in arrays]
        self.send(json.dumps(found), [a.reshape(-1).view(np.uint8) for a in arrays if a.size])

    def send(self, head: str, arrays: list[Any]) -> None:
        """Send the head and the bytes of arrays, a slot at a time; the second next slot waits for its turn."""
        total = sum(a.size for a in arrays)
        source, at = iter(arrays), 0
        array = next(source, None)
        for k in range(max(-(-total // self.slot), 1)):
            if k > 1:
                self.requests.readline()
            slot, begin = self.slots[k % 2, : min(self.slot, total - k * self.slot)], 0
            while begin < slot.size:
                assert array is not None
                part = min(slot.size - begin, array.size - at)
                slot[begin : begin + part] = array[at : at + part]
                begin, at = begin + part, at + part
                if at == array.size:
                    array, at = next(source, None), 0
            self.say(head if k == 0 else "")

    def coded(self, value: Any, arrays: list[Any]) -> Any:
        """Return a value as JSON can hold it; arrays are numbered and noted down."""

        def of(entry: Any) -> Any:
            return self.coded(entry, arrays)

        if value is None or type(value) in (bool, int, float, str):
            return value
        if isinstance(value, np.ndarray) and value.dtype.kind in "OSU":
            return ["texts", [list(value.shape), value.dtype.kind, [_text(entry) for entry in value.ravel().tolist()]]]
        if isinstance(value, np.ndarray | np.generic) and value.dtype.kind not in "OSU":
            array = np.asarray(value)
            arrays.append(array)
            return ["scalar" if isinstance(value, np.generic) else "array", len(arrays) - 1]
        if isinstance(value, list):
            return ["list", [of(entry) for entry in value]]
        if isinstance(value, tuple):
            return ["tuple", [of(entry) for entry in value]]
        if isinstance(value, dict):
            return ["dict", [[of(key), of(entry)] for key, entry in value.items()]]
        if is_dataclass(value):
            return ["object", [type(value).__name__, [of(getattr(value, field.name)) for field in fields(value)]]]
        if type(value).__name__ == "Dataset":
            variables = [[n, list(v.dims), of(dict(v.attrs)), of(v.values)] for n, v in value.variables.items()]
            return ["dataset", [variables, list(value.coords), of(dict(value.attrs))]]
        if isinstance(value, Iterator):
            self.count += 1
            self.iterators[self.count] = value
            return ["iterator", self.count]
        return _text(value)


def _text(value: Any) -> str:
    return value.decode("utf-8", errors="replace") if isinstance(value, bytes) else str(value)


def _called(answers: _Answers, path: Path, request: dict[str, Any]) -> Any:
    if "next" in request:
        return next(answers.iterators[request["next"]], None)
    module, name = request["function"]
    from smfe.records.formats import table

    free = request["free"]
    table.available = lambda: free  # as the process sees it that asks
    function: Callable[..., Any] = getattr(sys.modules[module], name)
    return function(path, *request["args"], **request["named"])


def _error(path: Path, request: dict[str, Any], error: Exception) -> list[Any]:
    from process.errors import InputError
    from smfe.records.formats.table import UnknownColumn, too_large

    if isinstance(error, UnknownColumn):
        return ["UnknownColumn", str(error), list(error.names), error.count]
    if isinstance(error, InputError | _TooLarge):
        return ["InputError", str(error)]
    if isinstance(error, MemoryError):
        return ["InputError", too_large(path)]
    reason = " ".join(str(error).split())[:200] or type(error).__name__
    return ["InputError", f"{path.name}: cannot be read ({reason}); the file is damaged: copy or export it again"]


@contextmanager
def _limited(request: dict[str, Any]) -> Iterator[None]:
    """Let what states huge numbers fail here instead of filling the memory; not on Windows, nor on macOS."""
    try:
        import resource
    except ImportError:
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    cpu, last = resource.getrlimit(resource.RLIMIT_CPU)
    with suppress(ValueError, OSError):
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + request["memory"], hard))
        spent = resource.getrusage(resource.RUSAGE_SELF)
        # Whoever would end us may have been ended.
        limit = int(spent.ru_utime + spent.ru_stime + request["seconds"]) + 5
        resource.setrlimit(resource.RLIMIT_CPU, (limit, last))
    try:
        yield
    finally:
        with suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
            resource.setrlimit(resource.RLIMIT_CPU, (cpu, last))


def main() -> None:
    """Answer every line of the input."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # it is for the process that asks, which ends us if it likes
    answers = _Answers(sys.argv[1], int(sys.argv[2]))
    # The package itself imports everything that knows a record; a format needs little of that.
    package = types.ModuleType("smfe.records")
    package.__path__ = [str(Path(__file__).resolve().parents[1])]
    sys.modules["smfe.records"] = package
    from smfe.records.formats import reader

    reader._INSIDE = True
    answers.say("ready")
    while line := answers.requests.readline():
        answers.answer(json.loads(line))


if __name__ == "__main__":
    main()
