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
