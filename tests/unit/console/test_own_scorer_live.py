"""A scorer from outside that a farm was given can be changed to while it flies, from where nobody names its file."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from saflite.console.cli import main
from saflite.contract import modules
from saflite.contract.control import Answer, Control, Status, Verb
from saflite.runtime import run_modules
from saflite.runtime.client import FarmClient, FarmInfo, write_info

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, new_books

MODULE = "class Model:\n    def __init__(self, *_): raise SystemExit('it was run')\n    score = warm = close = None\n"


class _Client:
    """A client of books in this process."""

    def __init__(self, driver: Driver) -> None:
        self._driver, self.ordered = driver, list[Control]()

    def status(self) -> Status:
        return self._driver.books.status(self._driver.now)

    def order(self, verb: Verb, text: str) -> Answer:
        self.ordered.append(Control(verb=verb, text=text))
        return self._driver.books.control(self.ordered[-1], self._driver.now)

    def close(self) -> None:
        pass


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[_Client]:
    """A farm works in `runs/with`, which has been given `mine.py`, another in `without`, which has not."""
    monkeypatch.chdir(tmp_path)
    for name in ("CACHE", "DATA"):
        monkeypatch.setenv(f"XDG_{name}_HOME", str(tmp_path / name))
    (tmp_path / "mine.py").write_text(MODULE)
    for run in (Path("runs/with"), Path("without")):
        run.mkdir(parents=True)
        write_info(run, FarmInfo(campaign="c", endpoint="e", pid=os.getpid()))
    run_modules.note(Path("runs/with"), modules.use([Path("mine.py")]))
    modules.forget()
    client = _Client(new_books(4))

    def reached(*_: object, **__: object) -> _Client:
        return client

    monkeypatch.setattr(FarmClient, "of_run", reached)
    monkeypatch.setattr(FarmClient, "connect", reached)
    yield client
    modules.forget()


@pytest.mark.parametrize(
    "where", [["runs/with"], [], ["--connect", "tcp/127.0.0.1:9", "--campaign", "c", "--insecure"]]
)
def test_what_the_farm_was_given_may_be_ordered(where: list[str], asked: _Client) -> None:
    """Where it is not told here what a farm was given, the farm says so."""
    assert main(["scorer", "use", "mine", *where, "--no-wait"]) == 0
    assert main(["scorer", "shadow", "gap", "mine:fast", *where]) == 0
    orders = [Control(verb="scorer", text="mine"), Control(verb="shadow", text="gap,mine:fast")]
    assert asked.ordered == orders


@pytest.mark.parametrize(("model", "where"), [("mine", ["without"]), ("mein", ["runs/with"]), ("mein", [])])
def test_what_it_was_not_given_is_refused_with_what_to_do(
    model: str, where: list[str], asked: _Client, capsys: pytest.CaptureFixture[str]
) -> None:
    for words in (["scorer", "use", model, *where], ["scorer", "shadow", "gap", model, *where]):
        assert main(words) == 2
        said = capsys.readouterr().err
        assert f"got '{model}'" in said
        assert "started with (--module FILE)" in said
    assert asked.ordered == []
