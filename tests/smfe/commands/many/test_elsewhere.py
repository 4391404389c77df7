"""Campaigns that lie elsewhere, and workers elsewhere: the same catalogue."""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import fsspec
import pytest
from pyarrow import parquet
from truth.archive import write_archive

import smfe
from process.errors import InputError
from smfe.commands.many.folders import find
from smfe.commands.many.places import fetched, packed, source_of, unpack_into
from smfe.commands.many.run import Batch


@pytest.fixture
def bucket(tmp_path: Path) -> Iterator[str]:
    """A campaign in a file system that no path reaches."""
    (file,) = write_archive(tmp_path / "in", 1, tests=1)
    memory = fsspec.filesystem("memory")
    for path in file.parent.iterdir():
        memory.pipe_file(f"/bucket/mill/{path.name}", path.read_bytes())
    yield "memory://bucket"
    memory.rm("/bucket", recursive=True)


def test_a_campaign_at_an_address_is_fetched_with_the_records_it_names(bucket: str, tmp_path: Path) -> None:
    memory = fsspec.filesystem("memory")
    memory.pipe_file("/bucket/mill/unrelated.bin", b"x")
    (found,) = find([bucket])
    assert find([f"{bucket}/*/campaign.toml"]) == [found]
    with fetched(found.address) as (local, _source):
        assert {p.name for p in local.parent.iterdir()} == {
            "campaign.toml",
            "hammer_x.csv",
            "hammer_y.csv",
            "cut_1.csv",
        }
        assert local.read_bytes() == memory.cat_file("/bucket/mill/campaign.toml")
    assert not local.exists()


@pytest.mark.slow
def test_results_of_an_address_are_those_of_its_files_and_follow_their_changes(bucket: str, tmp_path: Path) -> None:
    first = smfe.run([bucket], tmp_path / "out", jobs=1)
    assert list(first.states.values()) == ["done"]
    assert smfe.run([bucket], tmp_path / "out", jobs=1).unchanged == 1
    here = smfe.run([tmp_path / "in"], tmp_path / "here", jobs=1)
    tables = [parquet.read_table(b.catalogue).drop(["campaign"]) for b in (first, here)]
    assert tables[0].equals(tables[1])
    memory = fsspec.filesystem("memory")
    text = memory.cat_file("/bucket/mill/campaign.toml").decode()
    memory.pipe_file("/bucket/mill/campaign.toml", text.replace("80 mm", "63 mm").encode())
    assert smfe.run([bucket], tmp_path / "out", jobs=1).unchanged == 0


@pytest.mark.parametrize("name", ["/etc/passwd", "../secret.csv", "http://host/x.csv"])
def test_a_campaign_at_an_address_names_no_files_outside_its_folder(name: str) -> None:
    memory = fsspec.filesystem("memory")
    memory.pipe_file("/elsewhere/c.toml", f'[campaign]\nname = "c"\n[[cutting_test]]\nfile = "{name}"\n'.encode())
    with pytest.raises(InputError, match="lie in its folder"):
        source_of("memory://elsewhere/c.toml")


def test_what_is_not_there_is_said() -> None:
    with pytest.raises(InputError, match="no campaign there"):
        find(["memory://nothing/here"])
    with pytest.raises(InputError, match="cannot be opened"):
        find(["nosuch://x"])


def test_results_that_are_returned_take_the_place_of_others_in_one_step(tmp_path: Path) -> None:
    made, there = tmp_path / "made", tmp_path / "there"
    (made / ".kept").mkdir(parents=True)
    (made / "frf.nc").write_bytes(b"new")
    (made / ".kept" / "lock").write_text("process 1")
    there.mkdir()
    (there / "old.csv").write_text("old")
    unpack_into(there, packed(made))
    assert {p.relative_to(there).as_posix() for p in there.rglob("*") if p.is_file()} == {"frf.nc"}
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


CLUSTER = """
import json, os, signal, sys, threading, time
from pathlib import Path
import smfe
from distributed import Client, LocalCluster

def finished(root):
    return len(list(Path(root).glob("*/.kept/run.json")))

def main():
    given, out, seen = sys.argv[1:4]
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as local:
        killed = []
        def kill():
            while not finished(out):
                time.sleep(0.02)
            with Client(local.scheduler_address, set_as_default=False) as client:
                pids = client.run(os.getpid)
                pid = sorted(pids.values())[0]
            os.kill(pid, signal.SIGKILL)
            killed.append(pid)
        if seen == "seen":
            threading.Thread(target=kill, daemon=True).start()
        else:
            import smfe.commands.many.run as many
            from smfe.work.cluster import Cluster
            Cluster.everywhere = lambda *_: False
        batch = smfe.run([given], out, scheduler=local.scheduler_address)
        print(json.dumps([batch.states, len(killed)]))

if __name__ == "__main__":
    main()
"""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Batch]:
    """An archive, and what one process makes of it."""
    folder = tmp_path_factory.mktemp("alone")
    write_archive(folder / "in", 5, 2, tests=1)
    return folder / "in", smfe.run([folder / "in"], folder / "one", jobs=1)


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["seen", "not seen"])
def test_a_cluster_gives_the_same_catalogue_also_where_a_worker_is_killed(
    workers: str, alone: tuple[Path, Batch], tmp_path: Path
) -> None:
    """With "not seen" the workers return their results; with "seen" they write them, and one is killed on the way."""
    archive, batch = alone
    (tmp_path / "script.py").write_text(CLUSTER)
    command = [sys.executable, "script.py", str(archive), str(tmp_path / "two"), workers]
    done = subprocess.run(command, cwd=tmp_path, check=True, capture_output=True, text=True)
    states, killed = json.loads(done.stdout.splitlines()[-1])
    assert states == batch.states
    assert killed == (workers == "seen")
    assert (tmp_path / "two" / "catalogue.parquet").read_bytes() == batch.catalogue.read_bytes()
    assert smfe.run([archive], tmp_path / "two", jobs=1).unchanged == 5


def test_a_cluster_that_is_not_there_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smfe.work.cluster.CONNECT", 0.2)
    write_archive(tmp_path / "in", 1, tests=0)
    with pytest.raises(InputError, match="no scheduler answers"):
        smfe.run([tmp_path / "in"], tmp_path / "out", scheduler="tcp://127.0.0.1:1")
