"""Bad input gets one clear line on stderr, exit code 2, and nothing is written over."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.contract.test_case import Obstacle, TestCase
from saflite.flight.autopilots.reference.describe import describe
from saflite.recorder.exports.aerialist import write_case

REFUSED = 2
NO_PATIENCE = ("-5", "-0.001", "nan", "inf")


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main([str(word) for word in words]) == REFUSED
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("saflite: refused: ")
    assert said.err.count("\n") == 1, "one line"
    return said.err


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["runn", "x"], "did you mean `saflite run`"),
        (["version"], "did you mean `saflite --version`"),
        (["run"], "campaign"),
        (["run", "nosuch"], "avoidance-m2"),
        (["run", "avoidance-m2", "--strategy", "nosuch"], "random_boxes"),
        (["run", "avoidance-m2", "--scorer", "nosuch"], "blend"),
        (["run", "avoidance-m2", "--shadow", "nosuch"], "blend"),
        (["run", "avoidance-m2", "--budget", "-5"], "got -5"),
        (["run", "avoidance-m2", "--out", "a\udcffb"], "UTF-8"),
        (["audit", "a\udcffb"], "UTF-8"),
        (["run", "avoidance-m2", "--budget", "many"], "many"),
        (["run", "avoidance-m2", "--workers", "0"], "1 or more"),
        (["run", "avoidance-m2", "--workers", "0"], "--listen"),
        (["run", "avoidance-m2", "--scale", "fly=3:1"], "min 3, max 1"),
        (["run", "avoidance-m2", "--scale", "books=1:2"], "a stage of"),
        (["run", "avoidance-m2", "--scale", "fly=1:2", "--workers", "2"], "--scale fly"),
        (["run", "avoidance-m2", "--set", "boxes_min=9"], "1 to 4"),
        (["run", "avoidance-m2", "--set", "nosuch=1"], "boxes_min"),
        (["run", "avoidance-m2", "--set", "boxes_min"], "NAME=VALUE"),
        (["run", "avoidance-m2", "--defect", "nosuch"], "parachute-in-acro"),
        (["mutate", "avoidance-m2", "--count", "0"], "1 or more"),
        (["list", "nosuch"], "strategies"),
        (["schema", "nosuch"], "Grant"),
        (["fly", "nosuch.yaml"], "nosuch.yaml"),
        (["fly", "/etc/hostname"], ".yaml"),
        (["fly", "case.doc"], "none of that name"),
        (["judge", "nosuch.ulg"], "nosuch.ulg"),
        (["judge", "nosuch.mcap"], "nosuch.mcap"),
        (["judge", "/etc/hostname"], ".ulg"),
        (["score", "nosuch.json"], "nosuch.json"),
        (["resume", "nosuch"], "books.sqlite"),
        (["replay", "nosuch.mcap"], "nosuch.mcap"),
        (["report", "nosuch"], "books.sqlite"),
        (["export", "nosuch", "--format", "yaml"], "books.sqlite"),
        (["scorer", "use", "nosuch"], "blend"),
        (["watch"], "name a run folder"),
        (["worker"], "--join"),
        (["worker", "--join", "nonsense"], "tcp/HOST:PORT"),
        (["worker", "--join", "tcp/10.0.0.5:7447"], "add --insecure"),
        (["worker", "--join", "unixsock-stream//nobody", "--stages", "fly,nosuch"], "mutate,score,fly"),
        (["worker", "--join", "unixsock-stream//nobody", "--workers", "0"], "1 or more"),
        *((["worker", "--join", "unixsock-stream//nobody", f"--patience={n}"], "--patience") for n in NO_PATIENCE),
        *((["watch", "--webhook", "http://127.0.0.1:9/", f"--patience={n}"], "--patience") for n in NO_PATIENCE),
        (["worker", "--join", "unixsock-stream//nobody", "--name", "a/b"], "worker name"),
        (
            ["worker", "--join", "unixsock-stream//nobody", "--name", "n" * 59, "--workers", "1"],
            "at most 58",
        ),
        (["worker", "--join", "unixsock-stream//nobody", "--name", "n" * 56, "--workers", "1000"], "at most 55"),
        (["worker", "--join", "unixsock-stream//nobody", "--label", "x"], "NAME=VALUE"),
        (["run", "avoidance-m2", "--listen", "nonsense"], "tcp/HOST:PORT"),
        (["run", "avoidance-m2", "--listen", "tcp/10.0.0.5:7447"], "add --insecure"),
        (["run", "avoidance-m2", "--listen", "tcp/127.0.0.1:7447"], "add --insecure"),
        (["watch", "--connect", "tcp/10.0.0.5:7447", "--campaign", "x"], "add --insecure"),
    ],
    ids=lambda value: "_".join(value) if isinstance(value, list) else "",
)
def test_wrong_words_are_refused(
    words: list[str], expected: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # no farm of somebody else's
    assert expected in refused(capsys, *words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("name = ", "TOML"),
        ('name = "x"\nbudget_flight = 3', "budget_flight"),
        ('name = "x"\nmission = "mission2"\nbudget_flights = -1', "1 to"),
        ('name = "a b"\nmission = "mission2"', "campaign name"),
        ('name = "x"\nmission = "nosuch"', "mission2"),
        ('name = "x"', "mission"),
        ('name = "x"\nmission = "broken.plan"', "broken.plan"),
        ('name = "x"\nmission = "mission2"\npolicies = ["nosuch"]', "policy"),
        ('name = "x"\nmission = "mission2"\n[target]\nname = "nosuch"', "reference"),
    ],
)
def test_wrong_campaign_files_are_refused(
    text: str, expected: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "x.toml").write_text(text)
    (tmp_path / "broken.plan").write_text('{"fileType": "Plan", "mission": {')
    assert expected in refused(capsys, "run", str(tmp_path / "x.toml"), "--out", str(tmp_path / "run"))
    assert not (tmp_path / "run").exists()


BOX = Obstacle(length_m=10.0, width_m=5.0, height_m=20.0, x_m=0.0, y_m=20.0)


def moved(x_m: float, y_m: float = 20.0) -> Obstacle:
    return msgspec.structs.replace(BOX, x_m=x_m, y_m=y_m)


def case_with(*boxes: Obstacle) -> TestCase:
    case = template(load_campaign("avoidance-m2"))
    return msgspec.structs.replace(case, scenario=msgspec.structs.replace(case.scenario, obstacles=boxes))


@pytest.mark.parametrize("number", ["nan", "inf", "-inf", "1e999", "1e39", "1_000", "", "x", "\uff11", "9" * 400])
@pytest.mark.parametrize("command", ["fly", "sitl"])
def test_a_parameter_is_a_number_that_autopilots_hold(
    command: str, number: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "case.json"
    file.write_bytes(msgspec.json.encode(template(load_campaign("avoidance-m2"))))
    said = refused(capsys, command, *([str(file)] if command == "fly" else []), "--parameter", f"WPNAV_SPEED={number}")
    assert "--parameter: expected NAME=NUMBER" in said


def test_a_number_that_no_test_case_may_have_is_refused_with_its_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file, *_ = write_case(case_with(msgspec.structs.replace(BOX, height_m=1e301)), tmp_path, "case")
    assert "3.4e+38" in refused(capsys, "fly", str(file), "--anywhere")
    assert "3.4e+38" in refused(capsys, "replay", str(file))


@pytest.mark.parametrize(
    ("boxes", "expected"),
    [
        ((BOX, moved(3.0)), "overlap"),
        ((moved(28.0),), "-40 < x < 30"),
        ((moved(-30.0), moved(-18.0), moved(-6.0), moved(6.0), moved(18.0)), "at most 4"),
        ((msgspec.structs.replace(BOX, length_m=-1.0),), "above 0"),
    ],
    ids=["overlap", "area", "five", "negative"],
)
def test_impossible_layouts_are_refused(
    boxes: tuple[Obstacle, ...], expected: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path, *_ = write_case(case_with(*boxes), tmp_path, "case")
    builds = ["reference", "reference"]
    for command, *more in (["fly"], ["score"], ["replay"], ["flake", "-n", "1"], ["bisect", *builds]):
        assert expected in refused(capsys, command, str(path), *more), command


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    campaign = load_campaign("avoidance-m2")
    Store.create(tmp_path / "run", campaign, template(campaign), describe()).close()
    return tmp_path / "run"


def test_a_run_folder_is_never_written_over(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (run_dir / "books.sqlite").read_bytes()
    assert "saflite resume" in refused(capsys, "run", "avoidance-m2", "--out", str(run_dir))
    assert (run_dir / "books.sqlite").read_bytes() == before


def test_a_run_folder_in_use_is_refused(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store.open(run_dir)
    try:
        assert "another process" in refused(capsys, "resume", str(run_dir))
    finally:
        store.close()


@pytest.mark.parametrize("keep", [0, 10, 5000])
def test_a_truncated_store_is_refused(run_dir: Path, keep: int, capsys: pytest.CaptureFixture[str]) -> None:
    for beside in run_dir.glob("books.sqlite-*"):
        beside.unlink()
    path = run_dir / "books.sqlite"
    path.write_bytes(path.read_bytes()[:keep])
    for words in (["resume"], ["report"], ["replay"], ["export", "--format", "csv"]):
        assert "books.sqlite" in refused(capsys, words[0], str(run_dir), *words[1:])
    assert not (run_dir / "report.html").exists()


def test_help_of_every_command_imports_nothing_heavy(capsys: pytest.CaptureFixture[str]) -> None:
    import subprocess
    import sys

    from saflite.console.cli import command_names

    program = (
        "import sys\nfrom saflite.console.cli import main\n"
        "for name in sys.argv[1:]:\n"
        "    try: main([name, '--help'])\n"
        "    except SystemExit: pass\n"
        "heavy = {'numpy', 'msgspec', 'zenoh', 'rich', 'sklearn', 'jsbsim', 'mcap'} & set(sys.modules)\n"
        "sys.exit(f'imported: {heavy}' if heavy else 0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *command_names()], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("usage: saflite") == len(command_names())


@pytest.mark.parametrize("seconds", ["abc", "nan", "inf", "-inf", "-1", "0", "1e400", "9" * 5_000, "86401"])
@pytest.mark.parametrize("command", ["bisect", "compare", "diff", "flake", "fly", "regress", "replay"])
def test_a_flight_has_some_time_and_not_all(command: str, seconds: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert "--wall-limit: from 0.1 to 86400 seconds" in refused(capsys, command, f"--wall-limit={seconds}")


@pytest.mark.parametrize("command", ["replay", "flake", "bisect"])
def test_a_run_nearly_of_that_name_is_asked_back_where_a_test_case_is_taken_too(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A mistyped run folder must not read as a test case of an unknown kind."""
    (tmp_path / "night").mkdir()
    (tmp_path / "night" / "books.sqlite").touch()
    builds = ["reference", "reference+parachute-in-acro"] if command == "bisect" else []
    told = refused(capsys, command, str(tmp_path / "nigth"), *builds)
    assert told.endswith(f"got none of that name; did you mean {tmp_path / 'night'}?\n")
