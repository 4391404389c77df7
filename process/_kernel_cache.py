"""A folder for compiled kernels where neither the installation nor the home can be written: a container, a shared disk.

numba keeps what it compiles beside the source or in the user's cache, and refuses to compile where it may write to
neither, so that nothing could be imported.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

VARIABLE = "NUMBA_CACHE_DIR"


def provide() -> None:
    """Name a folder of this user's own in the temporary folder, if there is no better place and none is named.

    What numba finds there it runs: a folder that another user could have written is never taken.

    Raises
    ------
    ImportError
        When no folder can be written.
    """
    own = Path(__file__).parent
    if os.environ.get(VARIABLE) or os.access(own, os.W_OK | os.X_OK):
        return
    import tempfile

    for place in (own / "__pycache__", _user_cache()):
        try:  # what a system grants is seen by asking for it
            place.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=place).close()
        except OSError:
            continue
        return
    try:
        folder = Path(tempfile.gettempdir()) / f"smfe-kernels-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
        if hasattr(os, "getuid") and (found.st_uid != os.getuid() or found.st_mode & 0o077 or folder.is_symlink()):
            folder = Path(tempfile.mkdtemp(prefix="smfe-kernels-"))
    except OSError as error:
        raise ImportError(
            "smfe keeps its compiled kernels in a folder, and none of these can be written: its own, the user's cache, "
            f"the temporary folder ({error}); set {VARIABLE} to a folder that can"
        ) from None
    os.environ[VARIABLE] = str(folder)
    if "numba" in sys.modules:  # it has read its settings already
        sys.modules["numba"].config.CACHE_DIR = str(folder)


def _user_cache() -> Path:
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"
    except RuntimeError:  # no home at all
        return Path("/nonexistent")
