"""What a new user meets: names nearly right, the run that is meant, the headline, endings that are no success."""

from __future__ import annotations

import os
import re
import shlex
import sys
from contextlib import suppress
from pathlib import Path

import msgspec
import pytest

from saflite.console.cli import BROKEN_PIPE, main
from saflite.console.run_data import farm_lookup
from saflite.console.run_data.known import no_violation
from saflite.console.view import live, out
from saflite.contract.control import Status
from saflite.contract.errors import Refused, not_installed
from saflite.runtime import farm_register
from saflite.runtime.client import FarmInfo, write_info


@pytest.mark.parametrize(
    ("words", "near"),
    [
        (["run", "avoidence-m2"], "avoidance-m2"),
        (["run", "policy-a-chutes"], "policy-a-chute"),
        (["run", "avoidance-m2", "--strategy", "randomboxes"], "random_boxes"),
        (["run", "avoidance-m2", "--scorer", "surogate"], "surrogate"),
        (["run", "avoidance-m2", "--target", "referense"], "reference"),
        (["run", "policy-a-chute", "--defect", "parachute-in-akro"], "parachute-in-acro"),
        (["list", "polices"], "policies"),
        (["runn"], "run"),
        (["control", "stauts"], "status"),
        (["new", "polcy", "x"], "policy"),
        (["scorer", "lst"], "list"),
        (["run", "avoidance-m2", "--budgt", "3"], "--budget"),
        (["run", "avoidance-m2", "--target-set", "defect=x"], "defects"),
        (["watch", "runs/x", "--kind", "violaton"], "violation"),
    ],
)
def test_names_that_are_nearly_right_are_asked_back(
    words: list[str], near: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    assert f"did you mean {near}" in capsys.readouterr().err.replace("`saflite run`", "run")


def test_a_run_that_is_nearly_there_is_asked_back(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs_of(tmp_path, "night")
    for command in ("report", "resume", "audit"):
        assert main([command, str(tmp_path / "runs" / "nigt")]) == 2
        assert f"did you mean {tmp_path / 'runs' / 'night'}?" in capsys.readouterr().err


def test_what_is_like_nothing_is_not_guessed_at() -> None:
    assert "did you mean" not in str(Refused("name", expected="one of alpha, beta", got="'zzz'"))


def test_the_newest_running_farm_is_found_wherever_its_run_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(Refused, match="a run, got none"):
        farm_lookup.newest(None)
    away = tmp_path / "elsewhere" / "run"
    away.mkdir(parents=True)
    write_info(away, FarmInfo(campaign="c", endpoint="e", pid=os.getpid()))
    farm_register.note(away)
    assert farm_lookup.newest(None) == away
    farm_register.forget(away)
    with pytest.raises(Refused, match="one with a running farm"):
        farm_lookup.newest_running()


def runs_of(place: Path, *names: str) -> None:
    """Make empty runs below `runs/`, the oldest first."""
    for at, name in enumerate(names):
        folder = place / "runs" / name
        folder.mkdir(parents=True)
        (folder / "books.sqlite").touch()
        os.utime(folder / "books.sqlite", (at, at))


def test_without_a_running_farm_the_last_run_is_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    runs_of(tmp_path, "older", "newer")
    assert farm_lookup.newest(None) == Path("runs/newer")
    assert "note: no RUN was named: runs/newer is meant" in capsys.readouterr().err
    assert farm_lookup.newest(Path("x")) == Path("x")
    assert not capsys.readouterr().err


def test_what_cannot_be_done_to_a_running_farm_means_the_last_run_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    runs_of(tmp_path, "older", "works")
    write_info(Path("runs/works"), FarmInfo(campaign="c", endpoint="e", pid=os.getpid()))
    assert farm_lookup.newest(None) == Path("runs/works")
    assert farm_lookup.newest_at_rest(None) == Path("runs/older")
    write_info(Path("runs/older"), FarmInfo(campaign="c", endpoint="e", pid=os.getpid()))
    with pytest.raises(Refused, match="a run that no farm works on, got none"):
        farm_lookup.newest_at_rest(None)


def test_the_run_may_be_the_last_word() -> None:
    assert farm_lookup.last_as_run(["500", "runs/a"]) == (["500"], Path("runs/a"))
    assert farm_lookup.last_as_run(["500"]) == (["500"], None)


@pytest.mark.parametrize(("extra", "package"), [("ray", "ray>=2.56"), ("metrics", "prometheus-client>=0.21")])
def test_what_is_missing_is_told_with_a_command_that_works_wherever_ours_came_from(
    monkeypatch: pytest.MonkeyPatch, extra: str, package: str
) -> None:
    monkeypatch.setattr(sys, "executable", "/a place/bin/python")
    told = str(not_installed("it is", extra))
    advice = told[told.index("'/a place") :].strip()
    assert shlex.split(advice) == ["/a place/bin/python", "-m", "pip", "install", package]


def status(**changed: object) -> Status:
    told = dict.fromkeys(("round", "budget", "flights", "reflown", "test_cases", "candidates", "seq"), 0)
    told |= {f"violations_{name}": 0 for name in ("confirmed", "flaky", "pending")}
    told |= dict.fromkeys(("quarantined", "flights_per_s", "real_time_factor", "elapsed_s", "fallbacks"), 0)
    words = {"campaign": "c", "state": "running", "scorer": "gap", "scorer_pending": ""}
    rest: dict[str, object] = {"since_last_find_s": None, "queues": {}, "workers": []}
    return msgspec.convert({**told, **words, **rest, **changed}, Status, strict=False)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"budget": 100, "flights": 40, "flights_per_s": 1.0}, "40/100 flights  about 60 s left"),
        (
            {"budget": 100, "flights": 20, "reflown": 30, "checked": 5, "shrink_flights": 5, "flights_per_s": 1.0},
            "20/100 flights  about 4 min left",  # two flights of three are none of the budget
        ),
        ({"budget": 1000, "flights": 0}, "no flight yet"),
        ({"budget": 1000, "flights": 100, "flights_per_s": 1.0, "state": "paused"}, "PAUSED"),
        ({"budget": 10, "flights": 10, "violations_pending": 1}, "budget flown, confirming"),
        ({"budget": 10, "flights": 10, "shrink_flights": 5}, "budget flown, minimising"),
        ({"budget": 10, "flights": 10}, "budget flown, the last flights"),
        (
            {"fallbacks": 3, "fallback_why": "model not found"},
            "3 scores by the embedded scorer instead: model not found",
        ),
    ],
)
def test_the_headline_says_how_it_goes(changed: dict[str, object], words: str) -> None:
    assert words in live.one_line(status(**changed))


def test_a_reader_that_has_gone_is_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(_text: str = "") -> None:
        raise BrokenPipeError

    monkeypatch.setattr(out, "line", gone)
    monkeypatch.setattr(out, "mute", lambda *_: None)
    assert main(["--version"]) == BROKEN_PIPE


LONG = "9" * 40


@pytest.mark.parametrize(
    ("words", "told", "untold"),
    [
        (["run", "nosuch"], "see `saflite list campaigns`", "lists-blind"),
        (["run", "avoidance-m22"], "did you mean avoidance-m2?", "avoidance-m5"),
        (["run", "/etc/passwd"], "campaign file (/etc/passwd): expected the name of a campaign, or a .toml file", "m2"),
        (["comparing"], "did you mean `saflite", "did you mean score?"),
        (["fly", "--", "case.json", "--json"], "--json goes before `--`", "did you mean"),
        (["run", "avoidance-m2", "--budget", "9" * 20], f"at most 18 digits is expected, not '{'9' * 20}'", "…"),
        (["run", "avoidance-m2", "--budget", LONG], "9…'", LONG),
        (["run", "avoidance-m2", "--minutes", LONG], "a number from -1e+18 to 1e+18 is expected", LONG),
        (["worker", "--join", "runs/nope"], "'runs/nope', where there is no folder", "unreadable"),
        (["worker", "--join", "runs/nope", "--name", "bob x"], "got 'bob x'", "bob x-fly-1"),
        (["fly", "none/case.json"], "got no folder", "No such file"),
        (["fly", "case.json"], "expected a readable file, got none of that name", "No such file"),
    ],
)
def test_an_error_says_what_is_meant_and_no_more(
    words: list[str], told: str, untold: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    said = capsys.readouterr().err
    assert told in said
    assert untold not in said


CAMPAIGN = (
    'name = "x"\nmission = "mission2"\npolicies = ["upright"]\nbudget_flights = 9\n[strategy]\nname = "random_boxes"\n'
)
POLICY = """id = "mine"
statement = "It stays upright."
formula = "always (tilt_deg < 80)"
[inputs]
parameters = ["RTL_ATL"]
"""


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (CAMPAIGN.replace("9", "nan"), "finite numbers at `budget_flights`, got nan"),
        (CAMPAIGN + "[strategy.settings]\nwalls = [1, inf]\n", "finite numbers at `strategy.settings.walls[1]`"),
        (CAMPAIGN.replace("9", "1.5"), "`budget_flights`: a whole number is expected, not a number with a fraction"),
        (CAMPAIGN.replace('"x"', "5"), "`name`: a text is expected, not a whole number"),
        (CAMPAIGN.replace('"mission2"', "[2]"), "`mission`: a text is expected, not a list"),
        (POLICY, "[inputs] parameters ("),
        (POLICY, "line 5): expected an input of reference: "),
        (POLICY, "got 'RTL_ATL'; did you mean RTL_ALT?"),
        (POLICY.replace("formula", "formla"), "policy file"),
        (POLICY.replace("formula", "formla").replace("ATL", "ALT"), "`formula`"),
    ],
)
def test_what_is_wrong_in_a_file_is_told_by_its_key(
    text: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "x.toml").write_text(text)
    assert main(["run", str(tmp_path / "x.toml"), "--out", str(tmp_path / "run")]) == 2
    said = capsys.readouterr().err
    assert told in said
    assert "is unknown" not in said or "formla" in said


def test_names_to_choose_from_are_told_once_and_not_all() -> None:
    known = [f"{place:016x}" for place in range(40) for _ in range(3)]
    said = str(no_violation(known, "zzz", "runs/x"))
    assert "did you mean" not in said
    assert len(re.findall(r"\b[0-9a-f]{16}\b", said)) == 8
    assert "and 32 more" in said
    assert "did you mean 0a1b2c3d4e5f6789?" in str(no_violation([*known, "0a1b2c3d4e5f6789"], "0a1b2c3d4e5f678", "x"))


def test_a_full_standard_output_is_named(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    with Path("/dev/full").open("w") as full:
        monkeypatch.setattr("sys.stdout", full)
        assert main(["list", "campaigns"]) == 3
        with suppress(OSError):
            full.flush()
    assert "unavailable: standard output: No space left on device" in capsys.readouterr().err
