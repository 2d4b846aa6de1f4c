"""`saflite conformance` over modules from outside: good ones pass, broken ones are named, unknown ones refused."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from saflite.console.cli import main
from saflite.contract import modules
from saflite.mutator.strategies import random_boxes
from saflite.scorer_pool.models import gap
from saflite.simulator_worker import registry


@pytest.fixture(autouse=True)
def _nothing_from_outside() -> Iterator[None]:
    yield
    modules.forget()


def test_a_strategy_and_a_scorer_from_outside_pass(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    strategy, scorer = tmp_path / "own_boxes.py", tmp_path / "own_gap.py"
    strategy.write_text(Path(random_boxes.__file__).read_text().replace('"random_boxes"', '"own_boxes"'))
    scorer.write_text(Path(gap.__file__).read_text())
    assert main(["conformance", "strategy", "own_boxes", "--module", str(strategy)]) == 0
    assert "BAD" not in capsys.readouterr().out
    assert main(["conformance", "scorer", "own_gap", "--module", str(scorer), "--json"]) == 0
    assert not any(json.loads(capsys.readouterr().out).values())


def test_a_strategy_under_another_name_is_found_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "renamed.py"
    file.write_text(Path(random_boxes.__file__).read_text())
    assert main(["conformance", "strategy", "renamed", "--module", str(file)]) == 1
    assert "names 'random_boxes' as its strategy" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ["strategy", "scorer", "target"])
def test_what_is_not_there_is_refused(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["conformance", kind, "nowhere"]) == 2
    assert "nowhere" in capsys.readouterr().err


POINT_MASS = Path(__file__).parents[3] / "deploy" / "examples" / "targets" / "point_mass.py"
DESCRIBE, OPEN, FLY = (
    '"""Say what it is."""',
    '"""Return a session; nothing needs to be brought up."""',
    '"""Step the mass',
)
KILLED = "__import__('os').kill(__import__('os').getpid(), 9)\n        "
RECORD, BUILD = 'return FlightRecord("completed", trace, delivered=tuple(given))', "Path(__file__).read_bytes()"


def broken(folder: Path, name: str, old: str, new: str) -> str:
    """Write the point mass under another name with one thing wrong; returns its file."""
    text = POINT_MASS.read_text().replace('name="point_mass"', f'name="{name}"')
    assert old in text
    file = folder / f"{name}.py"
    file.write_text(text.replace(old, new))
    return str(file)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (DESCRIBE, 'raise RuntimeError("no hardware")', "describe() that answers, got RuntimeError: no hardware"),
        (DESCRIBE, "__import__('threading').Event().wait()", "describe() that answers, got TimeoutError"),
        ("return TargetInfo(", "return dict(", "describe() that returns a TargetInfo, got dict"),
        ('kind="sensor_fault"', 'kind="gust"', "Invalid enum value 'gust'"),
        ('name="made"', 'name="other"', "describe() of a target called 'made', got 'other'"),
    ],
)
def test_a_target_that_cannot_tell_what_it_is_is_refused(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    old: str,
    new: str,
    words: str,
) -> None:
    monkeypatch.setattr(registry, "DESCRIBE_S", 0.2 if "Event" in new else 20.0)
    assert main(["conformance", "target", "made", "--module", broken(tmp_path, "made", old, new)]) == 2
    said = capsys.readouterr().err
    assert said.startswith("saflite: refused: target (made): expected ")
    assert words in said


@pytest.mark.parametrize(
    ("old", "new", "check", "words"),
    [
        (FLY, "__import__('os')._exit(0)\n        " + FLY, "flies_as_it_describes", "died: exit code 0"),
        (FLY, KILLED + FLY, "flies_as_it_describes", "died: signal SIGKILL"),
        (FLY, "__import__('threading').Event().wait()\n        " + FLY, "flies_as_it_describes", "no end within 1 s"),
        (RECORD, "return None", "flies_as_it_describes", "returned a NoneType, no FlightRecord"),
        ("taken = ranges", "taken = False and ranges", "flies_as_it_describes", "denied every parameter"),
        ("default=2", "default=99", "describes_itself_without_contradiction", "GAIN: its default 99 is not in its"),
        (BUILD, "__import__('os').urandom(8)", "describes_itself_without_contradiction", "something else each time"),
    ],
)
def test_a_target_that_does_not_do_what_it_says_is_found_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, check: str, words: str
) -> None:
    file = broken(tmp_path, "made", old, new)
    assert main(["conformance", "target", "made", "--module", file, "--limit", "1", "--json"]) == 1
    assert any(words in text for text in json.loads(capsys.readouterr().out)[check])


@pytest.mark.parametrize("kind", ["target", "strategy", "scorer"])
def test_a_module_with_the_name_of_one_of_ours_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    ours = {"target": POINT_MASS, "strategy": Path(random_boxes.__file__), "scorer": Path(gap.__file__)}
    name = {"target": "reference", "strategy": "random_boxes", "scorer": "gap"}[kind]
    file = tmp_path / f"{name}.py"
    file.write_text(ours[kind].read_text())
    assert main(["conformance", kind, name, "--module", str(file)]) == 2
    assert "of ours has" in capsys.readouterr().err


def test_what_a_target_prints_does_not_stand_among_the_words(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    file = broken(tmp_path, "made", FLY, "print('chatter', flush=True)\n        " + FLY)
    assert main(["conformance", "target", "made", "--module", file, "--json"]) == 0
    told = capfd.readouterr()
    assert not any(json.loads(told.out).values())
    assert "chatter" in told.err
