"""Claims about public data sets: found on this machine or fetched after the licence is shown, never anything else."""

import hashlib
import os
import subprocess
import threading
from collections.abc import Callable, Iterator
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
    monkeypatch.delenv("SMFE_REGISTRY", raising=False)
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


HASH = hashlib.sha256(CONTENT).hexdigest()


def written(folder: Path, place: str, sha256: str = HASH) -> Path:
    """Write a registry with one data set, bench/hit.csv."""
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


@pytest.fixture
def named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Write a registry and name it as the user does."""

    def name(place: str, sha256: str = HASH) -> Path:
        path = written(tmp_path / "mine", place, sha256)
        monkeypatch.setenv("SMFE_REGISTRY", str(path))
        return path

    return name


Named = Callable[..., Path]


class TestWhereItIsLookedFor:
    def test_the_users_folder_comes_first(
        self, tmp_path: Path, own_cache: Path, monkeypatch: pytest.MonkeyPatch, named: Named
    ) -> None:
        named('address = "http://x/hit.csv"')
        for root in (tmp_path / "data", own_cache):
            (root / "bench").mkdir(parents=True)
            (root / "bench" / "hit.csv").write_bytes(CONTENT)
        assert datasets.resolve("dataset:bench/hit.csv") == own_cache / "bench" / "hit.csv"
        monkeypatch.setenv("SMFE_DATA", str(tmp_path / "data"))
        assert datasets.resolve("dataset:bench/hit.csv") == tmp_path / "data" / "bench" / "hit.csv"

    def test_a_file_of_the_cache_with_another_hash_is_not_used(self, own_cache: Path, named: Named) -> None:
        named('address = "http://x/hit.csv"')
        (own_cache / "bench").mkdir(parents=True)
        (own_cache / "bench" / "hit.csv").write_bytes(CONTENT + b"x")
        with pytest.raises(InputError, match=r"'dataset:bench/hit\.csv' is not on this machine"):
            datasets.resolve("dataset:bench/hit.csv")

    def test_a_registry_beside_or_above_a_campaign_is_not_used(self, tmp_path: Path, server: str) -> None:
        """Whoever writes the folder of a campaign does not choose what is fetched, nor from where."""
        deep = tmp_path / "a" / "b"
        deep.mkdir(parents=True)
        for folder in (deep, deep / "datasets", tmp_path, tmp_path / "datasets"):
            written(folder, f'address = "{server}"')
        (deep / "campaign.toml").write_text(CAMPAIGN)
        shown: list[str] = []
        with pytest.raises(InputError, match=r"no data set 'bench' in the registry of smfe"):
            load_campaign(deep / "campaign.toml", show=shown.append)
        assert not shown

    @pytest.mark.parametrize("name", ["dataset:bench", "dataset:/hit.csv", "dataset:bench/../../x", "dataset:../x/y"])
    def test_a_name_does_not_lead_out_of_the_folder(self, name: str) -> None:
        with pytest.raises(InputError, match=r"does not name a file of a data set; write dataset:NAME/FILE"):
            datasets.resolve(name)


CAMPAIGN = """
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


class TestFetching:
    def test_the_licence_is_shown_before_the_file_is_there(self, own_cache: Path, server: str, named: Named) -> None:
        named(f'address = "{server}"')
        target = own_cache / "bench" / "hit.csv"
        shown: list[tuple[str, bool]] = []
        path = datasets.resolve("dataset:bench/hit.csv", lambda text: shown.append((text, target.exists())))
        assert path == target
        assert path.read_bytes() == CONTENT
        ((text, already_there),) = shown
        assert not already_there
        for part in ("CC-BY-4.0", "A hit on a bench", "Nobody (2024)", server):
            assert part in text
        assert datasets.resolve("dataset:bench/hit.csv", None) == target, "the second time without asking"

    def test_nothing_is_fetched_without_being_allowed(self, own_cache: Path, server: str, named: Named) -> None:
        named(f'address = "{server}"')
        with pytest.raises(InputError) as caught:
            datasets.resolve("dataset:bench/hit.csv")
        for part in ("$SMFE_DATA is not set", str(own_cache / "bench" / "hit.csv"), server, "CC-BY-4.0"):
            assert part in str(caught.value)
        assert not own_cache.exists()

    def test_no_program_is_started(
        self, own_cache: Path, server: str, named: Named, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """An archive is what it is: no installer is called, and nothing of what came is run."""

        def started(*_: object, **__: object) -> None:
            raise AssertionError("a program was started")

        named(f'address = "{server}"')
        monkeypatch.setattr(subprocess, "Popen", started)
        monkeypatch.setattr(os, "system", started)
        assert datasets.resolve("dataset:bench/hit.csv", lambda text: None).read_bytes() == CONTENT

    def test_another_hash_is_refused_and_not_kept(self, own_cache: Path, server: str, named: Named) -> None:
        named(f'address = "{server}"', "0" * 64)
        with pytest.raises(InputError, match=r"could not fetch http://127.* hash of downloaded file"):
            datasets.resolve("dataset:bench/hit.csv", lambda text: None)
        assert not (own_cache / "bench" / "hit.csv").exists()

    def test_a_missing_page(self, server: str, named: Named) -> None:
        named(f'address = "{server}x"')
        with pytest.raises(
            InputError, match=r"could not fetch .*hit\.csvx: 404 .*; fetch it by hand to .*hit\.csv \(sha256"
        ):
            datasets.resolve("dataset:bench/hit.csv", lambda text: None)

    def test_a_campaign_reads_what_was_fetched(
        self, tmp_path: Path, own_cache: Path, server: str, named: Named
    ) -> None:
        named(f'address = "{server}"')
        (tmp_path / "campaign.toml").write_text(CAMPAIGN)
        said = r"line 10: measurement 'hit', records\[0\]\.file: 'dataset:bench/hit\.csv' is not on this machine"
        with pytest.raises(InputError, match=said):
            load_campaign(tmp_path / "campaign.toml")
        campaign = load_campaign(tmp_path / "campaign.toml", show=lambda text: None)
        assert campaign.files == (own_cache / "bench" / "hit.csv",)


class TestRegistry:
    def test_unknown_names_are_answered_with_those_there_are(self, named: Named) -> None:
        named('address = "http://x"')
        with pytest.raises(
            InputError, match=r"no data set 'bnech' in the registry of smfe \(did you mean 'bench'\?\), nor in .*'emps'"
        ):
            datasets.resolve("dataset:bnech/hit.csv")
        with pytest.raises(InputError, match=r"no file 'hti\.csv' in data set 'bench' \(did you mean 'hit\.csv'\?\)"):
            datasets.resolve("dataset:bench/hti.csv")

    def test_one_that_is_not_there(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("SMFE_REGISTRY", str(tmp_path / "none.toml"))
        with pytest.raises(InputError, match=r"none\.toml: no registry of data sets: No such file"):
            datasets.resolve("dataset:bench/hit.csv")

    @pytest.mark.parametrize(
        "place",
        [
            "",
            'address = "/etc/passwd"',
            'address = "file:///etc/passwd"',
            'address = "http://x"\npackage = "y"',
            'package = "x"\nversion = "1"\nmember = "y"',
            'url = "x"',
        ],
    )
    def test_a_file_has_an_address_of_the_web_and_nothing_else(self, tmp_path: Path, place: str) -> None:
        with pytest.raises(InputError, match=r"registry\.toml: files"):
            datasets.read_registry(written(tmp_path, place))

    def test_ours_is_complete_and_its_campaigns_name_its_files(self) -> None:
        ours = datasets.read_registry(datasets.INSTALLED)
        assert sorted(ours) == [
            "emps",
            "milling_forces_ubc",
            "pyfrf_hammer",
            "sdypy_ema_beam",
            "sinumerik_speedloop",
            "toolpoint_hammer_ubc",
        ]
        for name, entry in ours.items():
            text = (REPOSITORY / "datasets" / f"{name}.toml").read_text(encoding="utf-8")
            named = [part.split('"')[0] for part in text.split(f"dataset:{name}/")[1:]]
            assert named
            assert set(named) <= set(entry.files)


SHARED = Path(os.environ.get("SMFE_DATA", REPOSITORY.parent / "shared" / "data"))


@pytest.mark.skipif(not SHARED.is_dir(), reason="public data not here (set SMFE_DATA)")
class TestPublicData:
    def test_the_files_here_are_those_of_the_registry(self) -> None:
        for name, entry in datasets.read_registry(datasets.INSTALLED).items():
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
