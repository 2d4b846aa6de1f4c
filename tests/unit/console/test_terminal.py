"""What a worker or a model server says of itself cannot steer the terminal it is shown on."""

from __future__ import annotations

import json
import sys
import warnings
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from saflite.console.cli import main
from saflite.console.view import live, out
from saflite.contract.control import Status, WorkerStatus
from saflite.contract.events import FaultSeen, Quarantined
from saflite.contract.plain import plain

EVIL = "\x1b]0;owned\x07\x1b[2J\x9b31m\r\x08\x7f\u202egnp.exe\u2028x"
STEERING = set("\x1b\x07\x9b\r\x08\x7f\u202e\u2028")


def test_lines_tables_and_complaints_hold_no_controls(capsys: pytest.CaptureFixture[str]) -> None:
    out.line(f"a {EVIL}\tb\nc")
    out.table([(EVIL, "x\ny")], headers=("one", EVIL))
    out.complain("refused", EVIL)
    shown = capsys.readouterr()
    assert not STEERING & set(shown.out + shown.err)
    assert "\\x1b[2J\\x9b31m\\x0d" in shown.out
    assert "x\\x0ay" in shown.out, "a cell stays on its line"
    assert "\tb\nc" in shown.out


def test_json_stays_json_and_holds_no_controls(capsys: pytest.CaptureFixture[str]) -> None:
    out.json({"said": EVIL, "tag": "\U000e0041", "fine": "30° ±µ"})
    shown = capsys.readouterr().out
    assert not (STEERING | {"\U000e0041"}) & set(shown)
    assert json.loads(shown) == {"said": EVIL, "tag": "\U000e0041", "fine": "30° ±µ"}


def test_ordinary_text_is_left_alone() -> None:
    for text in ("", "altitude 30° ±0.5 m · µs", "日本", "back\\slash"):
        assert plain(text) == text


def test_no_fact_looks_like_several() -> None:
    for fact in (
        FaultSeen(where="w", message=f"x\n  12  VIOLATION {EVIL}"),
        Quarantined(test_case="0" * 16, attempts=1, last="lost", message=EVIL + "\n"),
    ):
        text = live.fact_text(fact)
        assert text.isprintable()
        assert "\n" not in text


def test_without_colour_nothing_is_dim_either(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("FORCE_COLOR", "1")
    for told, styled in (("", True), ("1", False)):
        monkeypatch.setenv("NO_COLOR", told)
        terminal = StringIO()
        shown = live.console()
        shown.file = terminal
        shown.print("idle", style="dim")
        assert ("\x1b[2m" in terminal.getvalue()) is styled


def screen(said: str, of_worker: str) -> str:
    """What the live screen shows of a farm that says something wherever it can."""
    from rich.console import Console

    worker = WorkerStatus(
        worker=said, host=said, stage="fly", state=of_worker, leases=0, done=0, busy_share=0.0, silent_s=0.0
    )
    status = Status(
        campaign=said, state="running", round=0, budget=1, flights=0, reflown=0, test_cases=0, candidates=0,
        violations_confirmed=0, violations_flaky=0, violations_pending=0, quarantined=1, flights_per_s=0.0,
        real_time_factor=0.0, since_last_find_s=None, elapsed_s=0.0, scorer=said, scorer_pending=said, trouble=said,
        fallbacks=1, fallback_why=said, queues={said: 1}, workers=(worker, replace(worker, host="other")), seq=0,
    )  # fmt: skip
    with Path("/dev/null").open("w") as nowhere:
        console = Console(width=400, record=True, file=nowhere)
        console.print(live._drawn(status))
        console.print(live._styled(f"VIOLATION {said}"))
        return console.export_text()


@pytest.mark.parametrize(
    "said", ["[/][red]", "[blink]", "[link=x]y[/link]", "[/nonsense]", "\\", "\\" * 3, "[red]\\\\\\"]
)
def test_the_live_screen_takes_words_for_words(said: str) -> None:
    assert screen(said, said).count(said) >= 7


@pytest.mark.parametrize("said", [EVIL, EVIL * 60, "\ud800"])
def test_the_live_screen_shows_no_controls_and_every_length(said: str) -> None:
    assert not (STEERING - {"\x1b"}) & set(screen(said, "idle"))


@pytest.mark.parametrize("words", [["--help"], ["list", "policies"], ["list", "signals", "-v"], ["list"]])
def test_long_lines_are_folded_to_the_width_asked_for_and_whole_in_a_pipe(
    words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    main(words)
    whole = capsys.readouterr().out
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    main(words)
    folded = capsys.readouterr().out
    assert whole.split() == folded.split(), "no word is lost"
    over = [[line for line in text.splitlines() if len(line) > 60] for text in (whole, folded)]
    assert over[0], "nothing had to be folded"
    assert len(over[1]) < len(over[0])


def test_what_has_no_width_left_stays_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert out.folded(" " * 30, "a text of many words that would be folded to one word a line").count("\n") == 0
    assert out.folded("name  ", " " * 90).strip() == "name"
    assert out.folded("name  ", "a text of many words that is folded below itself").splitlines() == [
        "name  a text of many words that is",
        "      folded below itself",
    ]


def test_numbers_that_are_none_have_no_line_of_our_code_told(capsys: pytest.CaptureFixture[str]) -> None:
    """A worker's trace without numbers had `report` say which line of ours divided them."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        out.begin()
        np.minimum.at(np.zeros(1), [0], np.array([np.nan]))
        np.float64(1.0) / np.float64(0.0)
    assert told == []
    assert main(["list", "exports"]) == 0
    assert capsys.readouterr().err == ""
