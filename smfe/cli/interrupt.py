"""Ctrl-C that is not lost: an exception in a callback of a library is dropped there, and the work would go on."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

AGAIN = 0.1
"""Seconds after which a Ctrl-C that a callback has dropped is pressed again."""

_pressed = threading.Event()


@contextmanager
def listening() -> Iterator[None]:
    """Remember Ctrl-C while the block runs, so that `answer` and callbacks that drop it can raise it again.

    A program that has its own way with Ctrl-C, or ignores it, is left alone.
    """
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    _pressed.clear()
    hook: Callable[[Any], Any] = sys.unraisablehook

    def press(_number: int, _frame: FrameType | None) -> None:
        _pressed.set()
        raise KeyboardInterrupt

    def dropped(what: Any) -> None:
        # Raised at once it would be dropped again, in the same callback.
        if issubclass(what.exc_type, KeyboardInterrupt):
            again = threading.Timer(AGAIN, _press_again)
            again.daemon = True
            again.start()
        else:
            hook(what)

    signal.signal(signal.SIGINT, press)
    sys.unraisablehook = dropped
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        sys.unraisablehook = hook
        _pressed.clear()


def _press_again() -> None:
    """Send the signal itself, which a call that waits hears, too; where there is none, what stands for it."""
    main = threading.main_thread().ident
    if main is not None and hasattr(signal, "pthread_kill"):
        signal.pthread_kill(main, signal.SIGINT)
    else:
        _thread.interrupt_main()


def answer() -> None:
    """Raise KeyboardInterrupt where Ctrl-C was pressed and the work has gone on all the same."""
    if _pressed.is_set() and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt
