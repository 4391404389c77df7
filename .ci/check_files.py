"""Fail if a file of the repository names a package registry's host, or a path of one machine."""

import re
import subprocess
import sys
from pathlib import Path

# Written in parts, so that this file passes its own check.
HOSTS = [
    ("py" + "pi", "org"),
    ("python" + "hosted", "org"),
    ("npm" + "js", "(org|com)"),
    ("un" + "pkg", "com"),
    ("js" + "delivr", "net"),
    ("deb", "debian", "org"),
    ("conda", "anaconda", "org"),
]
HOST = re.compile(r"\b(" + "|".join(r"\.".join(parts) for parts in HOSTS) + r")\b")
MACHINE_PATH = re.compile(r"(?<![\w.~}$/*-])/(work|tmp|root|farm|home/\w+|Users/\w+)/")
NEVER = {"uv.lock", "pylock.toml"}  # both name index hosts


def repository_files() -> list[Path]:
    """Files that are tracked, or would be after `git add`."""
    listing = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    return [path for name in listing.split("\0") if name and (path := Path(name)).is_file()]


def complaints(path: Path) -> list[str]:
    """What is wrong with one file, a line each."""
    found = [f"{path}: must not be committed"] if path.name in NEVER else []
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return found
    for number, line in enumerate(text.splitlines(), 1):
        for what, pattern in (("registry host", HOST), ("machine path", MACHINE_PATH)):
            if match := pattern.search(line):
                found.append(f"{path}:{number}: {what} {match.group()!r}")
    return found


if __name__ == "__main__":
    files = repository_files()
    found = [line for path in files for line in complaints(path)]
    print("\n".join(found) if found else f"{len(files)} files name no registry host and no machine path")
    sys.exit(bool(found))
