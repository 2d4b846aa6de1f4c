"""`saflite up`, as services that start it again and again give it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

from saflite.campaign.presets.campaigns import load_campaign
from saflite.campaign.storage.seal import seal_file
from saflite.campaign.storage.store import Store
from saflite.console.cli import FOUND, INFRASTRUCTURE, REFUSED, main
from saflite.console.operations import running
from saflite.console.run_data import reporting
from saflite.console.run_data.conclusion import conclude
from saflite.console.run_data.run_folder import open_run
from saflite.contract.control import Control
from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.reference.describe import describe
from saflite.runtime import campaign_runner
from saflite.runtime.campaign_runner import ExitSummary

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles


@pytest.fixture
def farm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A farm file; no farm of it runs."""

    def start(*args: object, **options: object) -> ExitSummary:
        raise Unavailable("a farm was started")

    monkeypatch.setattr(campaign_runner, "resume", start)
    _name_campaign(tmp_path, doubles.campaign(10).name)
    (tmp_path / "farm.toml").write_text('campaign = "night.toml"\nrun = "run"\n[workers]\nmutate = 1\n')
    return str(tmp_path / "farm.toml")


def _name_campaign(folder: Path, name: str, budget: int = 10) -> None:
    text = f'name = "{name}"\nmission = "mission2"\npolicies = ["min-obstacle-distance"]\nbudget_flights = {budget}\n'
    (folder / "night.toml").write_text(text)


def _campaign(run_dir: Path, *, stopped: bool = False, snapshot: bool = True) -> None:
    """Run a campaign to its end, or until it is told to stop; `snapshot`: keep the state of its books beside them."""
    store = Store.create(run_dir, doubles.campaign(10), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=3 if stopped else 10**9)
    if stopped:
        driver.books.control(Control(verb="stop", text="the budget is spent"), driver.now)
        driver.commit()
    if snapshot:
        store.keep(driver.books.snapshot())
    store.close()


def _contents(run_dir: Path) -> dict[str, bytes]:
    return {str(path.relative_to(run_dir)): path.read_bytes() for path in run_dir.rglob("*") if path.is_file()}


@pytest.mark.parametrize(("options", "snapshot"), [([], True), (["--json"], True), ([], False)])
def test_a_campaign_that_is_over_is_left_alone_with_exit_code_0(
    options: list[str], snapshot: bool, farm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir = tmp_path / "run"
    _campaign(run_dir, snapshot=snapshot)
    assert (run_dir / "books.snapshot").exists() == snapshot
    assert conclude(run_dir, ExitSummary(True, "the budget is spent", None, 0), as_json=True) == FOUND
    capsys.readouterr()
    before = _contents(run_dir)
    for _ in range(2):
        assert main(["up", farm, *options]) == 0
        said = capsys.readouterr().out
        for part in ("over", "the budget is spent", "confirmed", str(run_dir / reporting.REPORT)):
            assert part in said
    assert _contents(run_dir) == before


def test_one_that_is_over_is_left_alone_whether_its_books_were_closed_or_not(
    farm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Books that were killed once are not sealed at the end of a later sitting either: their tables are not known."""
    run_dir = tmp_path / "run"
    _campaign(run_dir, stopped=True)
    seal_file(run_dir).unlink()
    store = Store.open(run_dir)
    Driver(store.rebuild(), store).run()
    store.close()
    assert not seal_file(run_dir).exists()
    reporting.write(run_dir)
    before = _contents(run_dir)
    assert main(["up", farm]) == 0
    assert "is over" in capsys.readouterr().out
    assert _contents(run_dir) == before
    store = Store.open(run_dir)  # killed while it looked at a campaign that was over: a log stays beside the store
    (run_dir / "log").write_bytes((run_dir / "books.sqlite-wal").read_bytes())
    store.close()
    (run_dir / "log").rename(run_dir / "books.sqlite-wal")
    assert main(["up", farm]) == 0


def test_a_report_of_an_earlier_sitting_does_not_end_it(
    farm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir = tmp_path / "run"
    _campaign(run_dir, stopped=True)
    report, _ = reporting.write(run_dir)
    store = Store.open(run_dir)
    driver = Driver(store.rebuild(), store, unix_s=report.stat().st_mtime + 1.0)
    driver.run()
    store.close()
    assert main(["up", farm]) == INFRASTRUCTURE
    assert "a farm was started" in capsys.readouterr().err
    with open_run(run_dir) as run:
        (ended_unix_s,) = (event.at_unix_s for event in run.last_events(1))
    reporting.write(run_dir)
    os.utime(report, (ended_unix_s, ended_unix_s))
    assert main(["up", farm]) == 0


@pytest.mark.parametrize("moved_s", [-18_000.0, 18_000.0])
def test_a_clock_that_was_set_is_no_reason_to_go_on_or_to_rest(
    moved_s: float, farm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was hours ahead until the network set it; the report seemed older than the end that it tells of."""
    run_dir = tmp_path / "run"
    _campaign(run_dir, stopped=True)
    early, _ = reporting.write(run_dir)
    of_the_first_sitting = early.read_bytes()
    store = Store.open(run_dir)
    Driver(store.rebuild(), store).run()
    store.close()
    report, _ = reporting.write(run_dir)
    with open_run(run_dir) as run:
        (ended_unix_s,) = (event.at_unix_s for event in run.last_events(1))
    os.utime(report, (ended_unix_s + moved_s, ended_unix_s + moved_s))
    assert main(["up", farm]) == 0
    report.write_bytes(of_the_first_sitting)
    os.utime(report, (ended_unix_s + moved_s, ended_unix_s + moved_s))
    assert main(["up", farm]) == INFRASTRUCTURE
    assert "a farm was started" in capsys.readouterr().err


def test_one_that_was_told_to_stop_is_gone_on_with(
    farm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _campaign(tmp_path / "run", stopped=True)
    reporting.write(tmp_path / "run")
    assert main(["up", farm]) == INFRASTRUCTURE
    assert "a farm was started" in capsys.readouterr().err


def test_one_that_was_killed_before_its_report_was_written_is_gone_on_with(
    farm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _campaign(tmp_path / "run")
    assert main(["up", farm]) == INFRASTRUCTURE
    assert "a farm was started" in capsys.readouterr().err


@pytest.mark.parametrize("over", [True, False])
def test_a_run_of_another_campaign_is_refused_by_both_names(
    over: bool, farm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ended with 0, as if the campaign that the file names had been run."""
    run_dir = tmp_path / "run"
    _campaign(run_dir, stopped=not over)
    reporting.write(run_dir)
    _name_campaign(tmp_path, "another")
    before = _contents(run_dir)
    assert main(["up", farm]) == REFUSED
    said = capsys.readouterr().err
    assert "campaign another" in said
    assert "campaign farm-test" in said
    assert _contents(run_dir) == before


def test_a_changed_budget_is_noted_and_the_run_goes_on_as_it_began(
    farm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "run"
    running.create(folder, load_campaign(str(tmp_path / "night.toml")), describe())
    assert main(["up", farm]) == INFRASTRUCTURE
    assert "note:" not in capsys.readouterr().err
    _name_campaign(tmp_path, doubles.campaign(10).name, budget=20)
    assert main(["up", farm]) == INFRASTRUCTURE
    assert "goes on as it began" in capsys.readouterr().err
    (tmp_path / "night.toml").unlink()
    assert main(["up", farm]) == INFRASTRUCTURE
    assert "a farm was started" in capsys.readouterr().err, "what is not there any more keeps no farm from going on"
