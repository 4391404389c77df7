"""`smfe simulate`: from a scenario to a folder of records, with the campaign that reads them and what is true."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from process.errors import InputError
from smfe._version import __version__
from smfe.campaign.datasets import Show
from smfe.progress import Progress, silent
from smfe.records.formats.channels import listed
from smfe.results import Failures, write_groups
from smfe.scenario.run import NothingLeft, campaign_text, standing_axes, truths, write_records
from smfe.scenario.scenario import Scenario, load_scenario


def _to_stderr(text: str) -> None:
    """Show a notice where nothing else is given to show it."""
    print(f"notice: {text}", file=sys.stderr)


def simulate(
    scenario: Path | str | Scenario,
    out: Path | str,
    workers: int | None = None,
    progress: Progress = silent,
    show: Show = _to_stderr,
    failures: Failures | None = None,
) -> Path:
    """Simulate the trials of a scenario and write their records with the campaign file that reads them.

    Everything is made in a temporary folder and moved to `out` when it is complete. The same scenario makes the same
    numbers, with any number of workers.

    Parameters
    ----------
    scenario : path or Scenario
        Scenario file, or what `smfe.scenario.load_scenario` read.
    out : path
        Folder for ``campaign.toml``, ``records/``, ``truth.nc`` and ``scenario.toml``; made when missing.
    workers : int, optional
        Records at a time; default: as many as there are cores.
    progress : callable, optional
        Called with (record that is finished, done, of).
    show : callable, optional
        Called with each notice: conditions that are left out, axes that stand still in a cut, records of an earlier
        scenario in `out`; default: printed to stderr.
    failures : list of Failure, optional
        Collects the conditions that are left out, because the machine is not stable in them or cannot be simulated.

    Returns
    -------
    Path
        The campaign file.

    Raises
    ------
    InputError
        When the scenario is wrong, or no condition is left; nothing is then written.
    """
    loaded = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    out_of_it: Failures = [] if failures is None else failures
    true = truths(loaded, out_of_it)
    notices = standing_axes(loaded)
    for notice in notices:
        show(notice)
    with _made_aside(Path(out)) as folder:
        records = write_records(loaded, folder, workers, progress, out_of_it)
        missing = [f"left out, {failure.name}: {failure.reason}" for failure in out_of_it]
        if not any(records):
            raise NothingLeft("\n  ".join([f"{loaded.path.name}: the machine cannot be measured", *missing]))
        for notice in missing:
            show(notice)
        notices = [*notices, *missing]
        true = {e.name: true[e.name] for e, one in zip(loaded.entries, records, strict=True) if one and e.name in true}
        write_groups(folder / "truth.nc", true)
        (folder / "scenario.toml").write_text(_with_versions(loaded), encoding="utf-8")
        text = campaign_text(loaded, records, notices)
        (folder / "campaign.toml").write_text(text, encoding="utf-8")
    for notice in _left_behind(Path(out) / "records", (Path(w.file).name for one in records for w in one)):
        show(notice)
    return Path(out) / "campaign.toml"


@contextmanager
def _made_aside(out: Path) -> Iterator[Path]:
    """Yield an empty folder beside `out`; what is in it in the end goes to `out`, the campaign file last."""
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file; name a folder")
    out.parent.mkdir(parents=True, exist_ok=True)
    aside = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".part", dir=out.parent))
    try:
        yield aside
        for path in sorted(p for p in aside.rglob("*") if p.is_file() and p.name != "campaign.toml"):
            target = out / path.relative_to(aside)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, target)
        os.replace(aside / "campaign.toml", out / "campaign.toml")
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _with_versions(scenario: Scenario) -> str:
    packages = ("numpy", "scipy", "numba", "xarray")
    versions = ", ".join([f"smfe {__version__}", *(f"{p} {importlib.metadata.version(p)}" for p in packages)])
    text = scenario.path.read_text(encoding="utf-8")
    return f"# simulated with seed {scenario.file.scenario.seed} by {versions}\n{text}"


def _left_behind(folder: Path, written: Iterable[str]) -> list[str]:
    """Return a sentence about records in the folder of records that this scenario has not written."""
    new = set(written)
    old = sorted(path.name for path in folder.iterdir() if path.is_file() and path.name not in new)
    if not old:
        return []
    return [
        f"{folder} also holds {len(old)} file(s) of an earlier scenario, which the campaign does not read: "
        f"{listed(old, 8)}; delete them where nothing else does"
    ]
