"""Where the records of others lie: a folder or a bare git repository, named by a variable or near the checkout."""

import io
import os
import subprocess
from dataclasses import dataclass
from pathlib import Path

from places import CHECKOUT


class AbsentError(Exception):
    """The records are not here; the message says where they come from and how to name their place."""


@dataclass(frozen=True)
class Source:
    """A public repository of which files are read."""

    repository: str  # owner/name
    variable: str  # of the environment, with the path of a copy
    licence: str

    def read(self, path: str) -> io.BytesIO:
        """Return one file, from a folder or out of a bare repository."""
        for place in self._copies():
            if (place / path).is_file():
                return io.BytesIO((place / path).read_bytes())
            if (place / "HEAD").is_file():
                shown = subprocess.run(
                    ["git", f"--git-dir={place}", "show", f"HEAD:{path}"], capture_output=True, check=False
                )
                if shown.returncode == 0:
                    return io.BytesIO(shown.stdout)
        raise AbsentError(
            f"{path} of the public repository {self.repository} ({self.licence}) is not here; set {self.variable} to a "
            "copy of it, a folder or a bare repository"
        )

    def _copies(self) -> list[Path]:
        named = os.environ.get(self.variable)
        if named:
            return [Path(named)]
        beside = CHECKOUT.parent / ".mirror" / self.repository.replace("/", "+")
        return [beside, beside / "repo"]
