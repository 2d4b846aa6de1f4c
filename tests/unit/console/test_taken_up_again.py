"""A run that is taken up again shows what is new, and in a line what was found before."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.storage.store import Store
from saflite.console import cli
from saflite.console.io import campaign_options
from saflite.console.run_data.run_folder import open_run
from saflite.console.view import live
from saflite.flight.autopilots.reference.describe import describe

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver


def _create(run_dir: Path) -> None:
    campaign = campaign_options.changed(load_campaign("avoidance-m2"), budget=20)
    Store.create(run_dir, campaign, template(campaign), describe()).close()


def _sitting(run_dir: Path, capsys: pytest.CaptureFixture[str], until_flights: int = 10**9) -> tuple[str, list[str]]:
    """Go on with a run; returns the first line shown, and the test cases of the violations shown."""
    view = live.open_view(run_dir, quiet=False)
    store = Store.open(run_dir)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=until_flights)
    view.update(driver.books.status(driver.now))
    store.close()
    view.close()
    lines = capsys.readouterr().out.splitlines()
    return lines[0], [line for line in lines if line.startswith("VIOLATION")]


def test_what_was_found_before_is_a_line_and_not_told_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_dir = tmp_path / "run"
    _create(run_dir)
    head, before = _sitting(run_dir, capsys, 10)
    assert "so far" not in head, "it is new"
    assert before
    with open_run(run_dir) as run:
        confirmed = run.standings()["confirmed"]
    head, after = _sitting(run_dir, capsys)
    assert head.startswith(f"so far: {confirmed} violation")
    assert after
    assert not {*before} & {*after}
    with open_run(run_dir) as run:
        told = [one for one in run.violations() if one.confirmation != "similar"]
    assert len(before) + len(after) == len(told)


@pytest.mark.parametrize("command", ["run", "resume"])
def test_both_may_be_given_minutes(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _create(tmp_path / "old")
    words = ["run", "avoidance-m2", "--out", str(tmp_path / "new")] if command == "run" else ["resume"]
    words += [] if command == "run" else [str(tmp_path / "old")]
    assert cli.parser_of(command).parse_args([*words[1:], "--minutes", "1.5"]).minutes == 1.5
    assert cli.main([*words, "--minutes", "0"]) == cli.REFUSED
    assert "--minutes: expected 0.01 or more" in capsys.readouterr().err
