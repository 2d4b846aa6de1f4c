"""Clocks that jump: a reboot, a suspended machine, time set back by an hour or on by a day, and none at all."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.console.run_data.run_folder import open_run
from saflite.console.view.dashboard import pages
from saflite.console.view.dashboard.source import RunSource
from saflite.contract.cloud_event import cloud_event

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

BEGAN_S = 1.7e9
BUDGET = 6


def begun(tmp_path: Path, unix_s: float = BEGAN_S) -> tuple[Path, Driver]:
    store = Store.create(tmp_path / "run", doubles.campaign(BUDGET), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store, unix_s)
    driver.run(until_flights=BUDGET // 2)
    return tmp_path / "run", driver


def gone_on(run_dir: Path, driver: Driver, unix_s: float, monotonic_s: float) -> Driver:
    """Close the books and open them again at another time of both clocks."""
    assert driver.store is not None
    driver.store.close()
    store = Store.open(run_dir)
    again = Driver.__new__(Driver)
    again.books, again.store, again.now = store.rebuild(), store, monotonic_s
    again.targets, again.service = {}, doubles.Service(store.blobs)
    again.books.begin(again.now, unix_s)
    again.commit()
    return again


@pytest.mark.parametrize("step_s", [-3_600.0, 86_400.0, -BEGAN_S])
@pytest.mark.parametrize("monotonic_s", [0.001, 5e4])
def test_a_run_taken_up_at_another_time_is_exact(step_s: float, monotonic_s: float, tmp_path: Path) -> None:
    """After a reboot the monotonic clock begins anew; the wall clock may have been set meanwhile."""
    run_dir, driver = begun(tmp_path)
    first_s = driver.books.status(driver.now).elapsed_s
    again = gone_on(run_dir, driver, BEGAN_S + step_s, monotonic_s)
    assert again.books.status(again.now).elapsed_s == pytest.approx(first_s, abs=1.0)
    again.run()
    status = again.books.status(again.now)
    assert (status.state, status.flights) == ("ended", BUDGET)
    assert status.elapsed_s == pytest.approx(first_s + again.now - monotonic_s, abs=2.0)
    assert again.store is not None
    again.store.close()
    assert audit(run_dir)["clean"], audit(run_dir)["problems"]
    with open_run(run_dir) as run:
        assert run.elapsed_s() == pytest.approx(status.elapsed_s, abs=2.0)
        assert [event.seq for event in run.events(1)] == list(range(1, run.last_events(1)[-1].seq + 1))


@pytest.mark.parametrize("unix_s", [-1e300, -1.0, 0.0, 1e12, 1e300])
def test_a_run_of_a_clock_that_is_none_is_shown(
    unix_s: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir, driver = begun(tmp_path, unix_s)
    assert driver.store is not None
    driver.store.close()
    for words in (["report"], ["watch"], ["watch", "--json"], ["export", "--format", "junit"], ["audit"]):
        assert main([words[0], str(run_dir), *words[1:]]) in (0, 1, 4), words
        assert "fault of saflite" not in capsys.readouterr().err, words
    source = RunSource(run_dir)
    assert pages.day_of(source.head().began_unix_s)
    assert source.figures().flights
    with open_run(run_dir) as run:
        event = next(iter(run.events(1)))
    assert cloud_event(event, "night", "night-0").time
