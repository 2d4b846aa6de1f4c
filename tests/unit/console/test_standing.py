"""How a run stands is told in the same words everywhere, and no input is called the smallest before it is."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.console.io import campaign_options
from saflite.console.run_data.conclusion import conclude
from saflite.console.run_data.standing import Standing, inputs_told, standing
from saflite.console.view.dashboard.source import RunSource
from saflite.contract.control import NOT_RUNNING, Control
from saflite.contract.events import CampaignChanged
from saflite.flight.autopilots.reference.describe import describe
from saflite.runtime import stop_note
from saflite.runtime.campaign_runner import ExitSummary

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver

ASKED = "the first violation is confirmed, as asked for"


def _run(run_dir: Path, until_flights: int = 10**9, *, order: str = "") -> Path:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=6)
    store = Store.create(run_dir, campaign, template(campaign), describe())
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=until_flights)
    if order:
        assert driver.books.control(Control(verb=order), driver.now).accepted  # type: ignore[arg-type]
        driver.commit()
    store.close()
    return run_dir


def _told(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> set[str]:
    """Return the states told of a run: by an audit, by the dashboard and by its report."""
    capsys.readouterr()
    assert main(["audit", str(run_dir), "--json"]) == 0
    audited = json.loads(capsys.readouterr().out)["state"]
    assert main(["report", str(run_dir)]) == 0
    text = (run_dir / "report.html").read_text()
    return {audited, RunSource(run_dir).figures().state, text.partition("campaign ")[2].partition(" ·")[0]}


def test_a_run_that_nobody_works_on_is_told_of_in_one_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _told(_run(tmp_path / "killed", 2), capsys) == {NOT_RUNNING}
    assert _told(_run(tmp_path / "paused", 2, order="pause"), capsys) == {NOT_RUNNING}
    assert _told(_run(tmp_path / "ended"), capsys) == {"ended", "ended: the budget is spent"}


def test_a_report_says_why_a_run_was_stopped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_dir = _run(tmp_path / "run", 2)
    stop_note.note(run_dir, ASKED)
    assert _told(run_dir, capsys) == {NOT_RUNNING, f"{NOT_RUNNING}: {ASKED}"}
    stop_note.forget(run_dir)
    assert _told(run_dir, capsys) == {NOT_RUNNING}


def test_what_is_no_note_is_none(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    assert stop_note.read(tmp_path / "run") == ""
    (tmp_path / "secret").write_text("told to nobody")
    (tmp_path / "run" / stop_note.FILE).symlink_to(tmp_path / "secret")
    assert stop_note.read(tmp_path / "run") == ""
    stop_note.note(tmp_path / "run", "a\nb" + "x" * 1000)
    assert stop_note.read(tmp_path / "run") == "a b" + "x" * (stop_note.CHARS_MAX - 3)
    assert (tmp_path / "secret").read_text() == "told to nobody"


@pytest.mark.parametrize(
    ("last", "shrinks", "smallest"),
    [
        (CampaignChanged(state="ended", why="the budget is spent"), True, "the smallest inputs found"),
        (CampaignChanged(state="ended", why="the budget is spent"), False, "not minimised"),
        (CampaignChanged(state="ended", why="stopped"), True, "minimising is not over"),
        (CampaignChanged(state="running", why="begun"), True, "minimising is not over"),
        (None, True, "minimising is not over"),
    ],
)
def test_inputs_are_the_smallest_only_where_minimising_is_over(
    last: CampaignChanged | None, shrinks: bool, smallest: str, tmp_path: Path
) -> None:
    assert smallest in inputs_told(standing(tmp_path, last), shrinks=shrinks)


def test_the_order_to_stop_is_told_with_the_word_known_here(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "ended: stopped" in _told(_run(tmp_path / "run", 2, order="stop"), capsys)
    assert not Standing("ended", "stopped").is_over
    conclude(tmp_path / "run", ExitSummary(True, "stopped", None, 0), as_json=False)
    assert f"resume {tmp_path / 'run'}" in capsys.readouterr().out
    conclude(tmp_path / "run", ExitSummary(False, ASKED, None, 0), as_json=False)
    assert "the smallest inputs found" not in capsys.readouterr().out
