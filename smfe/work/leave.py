"""A process that helps another ends with it, however that ended."""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import threading


def leave_with_parent() -> None:
    """End this process, without a word, as soon as the process that started it is gone."""
    threading.Thread(target=_wait, daemon=True).start()


def _wait() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)
