"""What a worker or a model server says of itself cannot steer the terminal it is shown on."""

from __future__ import annotations

import json

import pytest

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


def test_the_live_screen_takes_names_for_names() -> None:
    from rich.console import Console

    worker = WorkerStatus(
        worker=f"[/][red]{EVIL}", stage="fly", state="[bold]", leases=0, done=0, busy_share=0.0, silent_s=0.0
    )
    status = Status(
        campaign=f"[blink]{EVIL}", state="running", round=0, budget=1, flights=0, reflown=0, test_cases=0, candidates=0,
        violations_confirmed=0, violations_flaky=0, violations_pending=0, quarantined=0, flights_per_s=0.0,
        real_time_factor=0.0, since_last_find_s=None, elapsed_s=0.0, scorer="[link=x]y[/link]", scorer_pending="",
        fallbacks=0, queues={"[/nonsense]": 1}, workers=(worker,), seq=0,
    )  # fmt: skip
    console = Console(width=200, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(live._drawn(status))
    shown = console.export_text()
    assert not (STEERING - {"\x1b"}) & set(shown)
    for text in ("[/][red]", "[bold]", "[blink]", "[link=x]y[/link]", "[/nonsense]"):
        assert text in shown
