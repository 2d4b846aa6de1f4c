"""What a run keeps, and what becomes of it when somebody makes it smaller."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from books_drive import Driver, doubles, new_books

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.prune import prune
from saflite.campaign.storage.rebuild import rebuild
from saflite.campaign.storage.sqlite import connect_reading
from saflite.campaign.storage.store import Store, store_file
from saflite.contract.errors import Refused
from saflite.contract.names import recording_file


def made(run_dir: Path, *, until_flights: int = 10**9, **search: object) -> Path:
    """A run with several finds."""
    campaign = doubles.campaign(24, **search)  # type: ignore[arg-type]
    store = Store.create(run_dir, campaign, doubles.TEMPLATE, doubles.TARGET)
    Driver(store.rebuild(), store).run(until_flights=until_flights)
    store.close()
    return run_dir


def recordings(run_dir: Path) -> set[str]:
    return {path.name for path in (run_dir / "recordings").iterdir()}


def named(run_dir: Path) -> set[str]:
    rows = connect_reading(store_file(run_dir)).execute(
        "SELECT test_case, flight_index FROM recordings WHERE digest <> ''"
    )
    return {Path(recording_file(name, index)).name for name, index in rows}


def test_one_find_of_each_behaviour_stays_and_the_books_balance(tmp_path: Path) -> None:
    run_dir = made(tmp_path / "run", record="all")
    before = recordings(run_dir)
    done = prune(run_dir)
    assert done.after_bytes < done.before_bytes
    assert 0 < done.recordings <= done.behaviours < len(before)
    assert recordings(run_dir) == named(run_dir) < before
    assert audit(run_dir)["clean"]
    rebuild(run_dir)
    assert audit(run_dir)["clean"]
    assert recordings(run_dir) == named(run_dir)


def test_the_worst_finds_stay_where_not_all_fit(tmp_path: Path) -> None:
    run_dir = made(tmp_path / "run")
    whole = prune(run_dir)
    assert whole.recordings > 1
    half = prune(run_dir, whole.after_bytes // 2)
    assert half.after_bytes <= whole.after_bytes // 2
    assert 0 < half.recordings < whole.recordings
    none = prune(run_dir, 0)
    assert (none.after_bytes, none.recordings, recordings(run_dir)) == (0, 0, set())
    assert none.behaviours == whole.behaviours
    assert audit(run_dir)["clean"]


def test_a_dry_run_changes_nothing_and_says_what_would_be(tmp_path: Path) -> None:
    run_dir = made(tmp_path / "run", record="all")
    before = audit(run_dir)
    told = prune(run_dir, dry=True)
    assert audit(run_dir) == before
    assert prune(run_dir) == told


@pytest.mark.parametrize("until_flights", [11, 10**9])
@pytest.mark.parametrize("kept", ["all", "no lock", "no snapshot"])
def test_a_dry_run_writes_nothing_and_needs_no_lock(until_flights: int, kept: str, tmp_path: Path) -> None:
    run_dir = made(tmp_path / "run", until_flights=until_flights)
    for name in {"no lock": ("books.lock",), "no snapshot": ("books.snapshot",)}.get(kept, ()):
        (run_dir / name).unlink(missing_ok=True)
    before = {path: path.stat() for path in (run_dir, *run_dir.rglob("*"))}
    told = prune(run_dir, 0, dry=True)
    after = {path: path.stat() for path in (run_dir, *run_dir.rglob("*"))}
    assert set(after) == set(before)
    assert {path: (one.st_mtime_ns, one.st_ino) for path, one in after.items()} == {
        path: (one.st_mtime_ns, one.st_ino) for path, one in before.items()
    }
    assert prune(run_dir, 0) == told


def test_what_work_under_way_needs_stays(tmp_path: Path) -> None:
    run_dir = made(tmp_path / "run", until_flights=11)
    prune(run_dir, 0)
    assert audit(run_dir)["clean"]
    store = Store.open(run_dir)
    driver = Driver(store.rebuild(), store)
    driver.run()
    assert driver.books.status(driver.now).flights == 24
    store.close()
    figures = audit(run_dir)
    assert figures["clean"], figures["problems"]


def test_a_run_in_use_is_not_pruned(tmp_path: Path) -> None:
    run_dir = made(tmp_path / "run")
    store = Store.open(run_dir)
    for dry in (False, True):
        with pytest.raises(Refused, match="use"):
            prune(run_dir, dry=dry)
    store.close()


def kept_bytes(keep_mb: int) -> int:
    driver = new_books(30, record="all")
    core = driver.books._core
    core.campaign = msgspec.structs.replace(core.campaign, keep_mb=keep_mb)
    driver.run()
    assert driver.books.status(driver.now).flights == 30
    assert core.full == (keep_mb == 1)
    return sum(hold.size_bytes for hold in core.holds.values())


def test_no_more_is_kept_than_the_campaign_allows(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = kept_bytes(2000)
    monkeypatch.setattr("saflite.campaign.lifecycle.retention.MB", whole // 3)  # flights of tests are small
    assert kept_bytes(1) < whole // 2
