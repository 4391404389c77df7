"""The verbs as a user meets them: help, one JSON object, exit statuses, refusals; the documentation says the same."""

import json
from pathlib import Path

import commands_page
import pytest
import typer
from samples.campaigns import HAMMER
from typer.testing import CliRunner, Result

import smfe
from process.errors import InputError
from smfe.cli import answer, app
from smfe.cli.terminal import Outcome, Terminal, plain
from smfe.cli.verb import COMMON_KEYS, GROUPS, SHARED, VERBS, any_files, campaign_files, result_folders
from smfe.results import Failure

COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]


def invoked(*words: object) -> Result:
    return CliRunner().invoke(app, [str(w) for w in words], env={"COLUMNS": "80", "TERM": "dumb"})


def test_the_page_of_the_commands_is_written_from_the_commands() -> None:
    assert commands_page.PAGE.read_text(encoding="utf-8") == commands_page.page(), "python tests/commands_page.py"


@pytest.mark.parametrize("name", sorted(VERBS))
def test_every_verb_has_the_shared_options_examples_and_what_it_gives_within_80_columns(name: str) -> None:
    options = {o for p in COMMANDS[name].params for o in p.opts}
    assert {"--json", "-v", "--verbose", "-q", "--quiet"} <= options
    done = invoked(name, "--help")
    assert done.exit_code == 0
    assert "What you get:" in done.output
    assert "Examples" in done.output
    for line in VERBS[name].examples:
        assert line.startswith("smfe ")
        assert line in done.output
    assert max(map(len, done.output.splitlines())) <= 80


def test_verbs_are_grouped_in_the_order_of_the_work() -> None:
    said = invoked("--help").output
    places = [said.index(f" {group} ─") for group in GROUPS]
    assert places == sorted(places)
    assert set(VERBS) == set(COMMANDS)
    assert "Exit status" in said


def outcome(name: str, monkeypatch: pytest.MonkeyPatch, result: object) -> None:
    """Make a verb of the package return something, or raise it."""

    def given(*_: object) -> object:
        if isinstance(result, BaseException):
            raise result
        return result

    monkeypatch.setattr(smfe, name, given, raising=False)


RECOMMENDED = {
    "status": "recommended",
    "spindle_speed_rpm": 855.0,
    "depth_of_cut_mm": 12.3,
    "probability": 0.95,
    "limit_depth_mm": 15.59,
    "source": "sweep",
    "reason": "From sweep.",
}


def results(folder: Path, failed: bool = False, level: str = "note") -> Path:
    """A folder of results as far as the terminal reads it."""
    folder.mkdir(parents=True, exist_ok=True)
    rows = [{"part": "measurement", "name": "hammer", "reason": "no hits"}] if failed else []
    held = {
        "warnings": ["hammer: one", "sweep: two; look"],
        "failures": rows,
        "check": [{"cause": "drift", "level": level}],
    }
    (folder / "provenance.json").write_text(json.dumps(held))
    (folder / "presets.json").write_text(json.dumps({"recommendation": RECOMMENDED, "recommendations": [RECOMMENDED]}))
    (folder / "finding.json").write_text(json.dumps({"verdict": "named", "summary": ["friction: 3 dB", "more"]}))
    (folder / "chatter.csv").write_text(
        "file,verdict,observed,predicted_sweep,predicted_hammer\n"
        "a.csv,stable,,stable,chatter\nb.csv,chatter,stable,stable,not compared\nc.csv,undecided,,stable,stable\n"
    )
    return folder / "report.html"


def test_a_run_ends_with_the_five_lines_that_matter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    report = results(tmp_path / "results")
    outcome("run", monkeypatch, report)
    done = invoked("run", tmp_path / "campaign.toml", "--out", tmp_path / "results")
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines() == [
        "recommended: 855 rpm, 12.3 mm deep, stable with 95 %: From sweep.",
        "cutting tests: 2 stable, 0 chatter, 1 undecided or failed; predicted rightly: sweep 2 of 2, hammer 0 of 1",
        "diagnosis: friction: 3 dB",
        "2 warnings (all: -v, report); the first: sweep: two; look",
        f"report: {report}",
    ]
    assert "warning, " not in done.stderr
    said = invoked("run", tmp_path / "campaign.toml", "--out", tmp_path / "results", "-v").stderr
    assert said.count("warning, ") == 2


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (None, ""),
        ({"status": "none", "reason": "No limit."}, "no recommendation: No limit."),
        (
            {"status": "limit_only", "spindle_speed_rpm": 990.0, "limit_depth_mm": 17.256, "reason": "Why."},
            "limit, uncertainty unknown: 17.3 mm at 990 rpm; no safe depth is given: Why.",
        ),
    ],
)
def test_without_a_known_uncertainty_no_depth_is_recommended(found: dict[str, object] | None, said: str) -> None:
    assert answer.recommended(found) == said


@pytest.mark.parametrize("options", [[], ["-v"], ["-q"]])
def test_json_is_one_object_with_the_keys_of_the_documentation(
    options: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome("run", monkeypatch, results(tmp_path / "results"))
    done = invoked("run", tmp_path / "c.toml", "--out", tmp_path / "results", "--json", *options)
    content = json.loads(done.stdout)
    assert set(content) == set(VERBS["run"].keys)
    assert content["recommendation"] == RECOMMENDED
    assert content["finding"] == {"verdict": "named", "summary": ["friction: 3 dB", "more"]}
    assert len(content["warnings"]) == 2


@pytest.mark.parametrize(("failed", "level", "code"), [(True, "note", 3), (False, "fault", 3), (False, "warning", 0)])
def test_a_fault_that_remains_is_status_3_and_a_named_cause_alone_0(
    failed: bool, level: str, code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome("run", monkeypatch, results(tmp_path / "results", failed, level))
    done = invoked("run", tmp_path / "c.toml", "--out", tmp_path / "results")
    assert done.exit_code == code
    assert ("failed, measurement hammer: no hits" in done.stderr) == failed


@pytest.mark.parametrize("problem", [InputError("the tool has no teeth"), FileNotFoundError(2, "No such file", "x")])
def test_wrong_input_is_one_message_and_status_1(problem: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    outcome("check", monkeypatch, problem)
    done = invoked("check", "campaign.toml")
    assert (done.exit_code, done.stdout) == (1, "")
    (line,) = [t for t in done.stderr.splitlines() if t.startswith("smfe: ")]
    done = invoked("check", "campaign.toml", "--json")
    assert json.loads(done.stdout) == {"error": line.removeprefix("smfe: ")}


def test_a_mistake_of_ours_is_a_sentence_and_its_traceback_is_shown_to_whoever_asks(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    outcome("check", monkeypatch, ZeroDivisionError("a case that nobody thought of"))
    done = invoked("check", "campaign.toml", "--json")
    assert done.exit_code == 1
    assert "a mistake in smfe (ZeroDivisionError in test_commands.py, line" in json.loads(done.stdout)["error"]
    assert "Traceback" not in done.stderr
    assert "Traceback" in invoked("check", "campaign.toml", "-v").stderr


def test_wrong_usage_is_status_2_and_says_nothing_on_stdout() -> None:
    for words in (["run"], ["fly"], ["run", "c.toml", "--speed"]):
        done = invoked(*words)
        assert (done.exit_code, done.stdout) == (2, "")


def test_quiet_says_the_result_alone(capsys: pytest.CaptureFixture[str]) -> None:
    found = Outcome(["found"], {}, ["careful"], [])
    for terminal, err in ((Terminal(), "warning, careful\n"), (Terminal(quiet=True), "")):
        with terminal.bar() as progress:
            if terminal.quiet:
                progress("work", 0, 1)
        terminal.end(found)
        said = capsys.readouterr()
        assert (said.out, said.err) == ("found\n", err)
    with pytest.raises(typer.Exit):
        Terminal(quiet=True).end(Outcome([], {}, failures=[Failure("lobes", "lobes_1", "why")]))
    assert capsys.readouterr().err == "failed, lobes lobes_1: why\n"


def test_numbers_that_json_does_not_have_are_null() -> None:
    import numpy as np

    content = {"a": float("inf"), "b": [np.float64("nan"), np.int64(2)], "c": Path("x"), "d": (True, None)}
    assert json.loads(json.dumps(plain(content), allow_nan=False)) == {
        "a": None,
        "b": [None, 2],
        "c": "x",
        "d": [True, None],
    }


def test_a_report_of_nothing_is_refused_with_what_it_needs(tmp_path: Path) -> None:
    done = invoked("report", tmp_path)
    assert done.exit_code == 1
    assert "holds no results" in done.stderr
    assert "smfe run CAMPAIGN --out" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_shells_complete_campaign_files_and_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "shop").mkdir()
    for name in ("campaign.toml", "cut.csv", ".hidden.toml", "shop/second.toml"):
        (tmp_path / name).write_text("")
    assert campaign_files("") == ["campaign.toml", "shop/"]
    assert campaign_files("c") == ["campaign.toml"]
    assert campaign_files("shop/") == ["shop/second.toml"]
    assert campaign_files(str(tmp_path) + "/s") == [f"{tmp_path}/shop/"]
    assert any_files("c") == ["campaign.toml", "cut.csv"]
    assert result_folders("") == ["shop/"]
    assert campaign_files("nowhere/") == []


def test_the_keys_of_all_verbs_are_said_once() -> None:
    assert set(SHARED) == {"as_json", "verbose", "quiet"}
    assert all(set(COMMON_KEYS) <= set(about.keys) for about in VERBS.values())


def test_a_file_in_the_place_of_a_folder_of_results_is_refused_before_work(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(HAMMER)
    (tmp_path / "hit.csv").write_text("t,Fx,ax\n0,0,0\n1,0,0\n")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / ".kept").write_text("x")
    done = invoked("run", tmp_path / "c.toml", "--out", tmp_path / "results")
    assert done.exit_code == 1
    assert ".kept' is a file where a folder is needed" in done.stderr.replace("\n", " ")
    (tmp_path / "results" / ".kept").unlink()
    (tmp_path / "results" / "pockets.csv").mkdir()
    done = invoked("run", tmp_path / "c.toml", "--out", tmp_path / "results")
    assert done.exit_code == 1
    assert [path.name for path in (tmp_path / "results").iterdir()] == ["pockets.csv"]


@pytest.mark.parametrize("verb", ["run", "check", "diagnose", "simulate"])
def test_what_is_no_campaign_is_refused_in_a_sentence(verb: str) -> None:
    more = ("results",) if verb in ("run", "simulate") else ()
    with pytest.raises(InputError, match=r"int is no (campaign|scenario); give the path"):
        getattr(smfe, verb)(5, *more)
