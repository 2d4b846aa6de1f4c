"""The books on disk: nothing torn, nothing lost, damage named."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import msgspec
import pytest
from books_drive import Driver, doubles

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.projections import FORMAT
from saflite.campaign.storage.sqlite import entries
from saflite.campaign.storage.store import Store, store_file
from saflite.console.run_data.run_folder import open_run
from saflite.contract import wire
from saflite.contract.control import Control, Status
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.events import Event, FaultSeen
from saflite.contract.ids import digest
from saflite.contract.names import recording_file
from saflite.contract.work import ScoreWork


def started(run_dir: Path, budget: int = 20, **search: object) -> Driver:
    store = Store.create(run_dir, doubles.campaign(budget, **search), doubles.TEMPLATE, doubles.TARGET)  # type: ignore[arg-type]
    return Driver(store.rebuild(), store)


def closed(driver: Driver) -> Status:
    assert driver.store is not None
    status = driver.books.status(driver.now)
    driver.store.close()
    return status


def exact(status: Status) -> tuple[object, ...]:
    names = ("state", "round", "budget", "flights", "reflown", "test_cases", "candidates", "seq", "scorer", "queues")
    finds = ("violations_confirmed", "violations_flaky", "quarantined", "fallbacks")
    return tuple(getattr(status, name) for name in (*names, *finds))


def test_a_rebuilt_store_is_the_books_as_they_were(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    driver.run(until_flights=11)
    before = closed(driver)
    store = Store.open(tmp_path / "run")
    assert exact(store.rebuild().status(driver.now)) == exact(before)


def test_a_campaign_interrupted_anywhere_finds_the_same_with_an_exact_budget(tmp_path: Path) -> None:
    whole = started(tmp_path / "whole", 25)
    whole.run()
    closed(whole)
    driver = started(tmp_path / "parts", 25)
    for flights in (1, 4, 9, 10, 17, 99):
        driver.run(until_flights=flights)
        driver.ask("fly", "gone")
        closed(driver)
        store = Store.open(tmp_path / "parts")
        driver = Driver(store.rebuild(), store)
    driver.run()
    status = closed(driver)
    assert (status.flights, status.state) == (25, "ended")
    query = "SELECT fingerprint, test_case, policy, confirmation FROM violations ORDER BY 1, 2, 3"
    found = [sqlite3.connect(store_file(tmp_path / name)).execute(query).fetchall() for name in ("whole", "parts")]
    assert found[0] == found[1] != []


def test_what_processor_time_was_worth_is_told_of_one_whole_sitting_only(tmp_path: Path) -> None:
    """Behaviours are counted over all sittings, processor time in each by itself."""
    driver = started(tmp_path / "run")
    driver.run(until_flights=11)
    first = msgspec.structs.replace(closed(driver), processor_s=60.0)
    assert first.behaviours_per_core_minute == first.behaviours
    store = Store.open(tmp_path / "run")
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=12)
    second = msgspec.structs.replace(closed(driver), processor_s=1.0)
    assert (first.sittings, second.sittings) == (1, 2)
    assert second.behaviours_per_core_minute is None


def test_the_time_between_two_sittings_is_none_of_the_run(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    driver.run(until_flights=11)
    closed(driver)
    for after_s in (86_400.0, -3_600.0):  # a day later; then by a clock put back
        store = Store.open(tmp_path / "run")
        driver = Driver(store.rebuild(), store, unix_s=1.7e9 + after_s)
        driver.run(until_flights=driver.books.status(driver.now).flights + 4)
        open_s = closed(driver).elapsed_s
        with open_run(tmp_path / "run") as run:
            assert 0.0 < run.elapsed_s() == pytest.approx(open_s, abs=1.0)  # what came last may not be written down


def test_events_can_be_read_again_from_any_place(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    driver.run()
    answer = driver.books.control(Control(verb="events", number=3), driver.now)
    events = [wire.decode(data, Event) for data in answer.events]
    assert [event.seq for event in events] == list(range(3, driver.books.status(driver.now).seq + 1))


def test_recordings_of_violations_stay_and_all_traces_go(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    driver.run()
    assert driver.store is not None
    database = sqlite3.connect(store_file(tmp_path / "run"))
    violated = {row[0] for row in database.execute("SELECT test_case FROM violations WHERE confirmation != 'similar'")}
    traces = {digest(doubles.flown(name, 0)[2]) for name in violated}
    kept = set(driver.store.blobs.digests())
    recordings = {row[0] for row in database.execute("SELECT digest FROM recordings")}
    assert len(recordings) == len(violated)
    assert recordings <= kept
    assert not traces & kept, "each stands in its recording"
    assert kept == {blob.digest for blob in driver.books.wanted_blobs}
    assert len(kept) <= 4 * len(violated)  # three flights with a log, one recording


def test_a_recording_has_a_name_for_people_that_comes_back(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    driver.run()
    closed(driver)
    database = sqlite3.connect(store_file(tmp_path / "run"))
    rows = database.execute("SELECT test_case, flight_index, digest FROM recordings").fetchall()
    assert rows
    for name, index, named in rows:
        file = recording_file(name, index)
        assert digest((tmp_path / "run" / file).read_bytes()) == named
        (tmp_path / "run" / file).unlink()
    store = Store.open(tmp_path / "run")
    store.rebuild()
    assert all((tmp_path / "run" / recording_file(name, index)).is_file() for name, index, _ in rows)


def test_a_trace_lost_before_its_judgement_is_flown_again(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    driver.run(until_flights=1)
    while not driver.books.status(driver.now).queues["judge"]:
        assert sum(driver.do(stage, worker, many=9) for stage in ("mutate", "score", "fly") for worker in "ab")
    assert driver.store is not None
    waiting = driver.books.status(driver.now).queues["judge"]
    assert waiting
    assert closed(driver).flights
    for name in driver.store.blobs.digests():
        driver.store.blobs.path(name).write_bytes(b"torn")
    store = Store.open(tmp_path / "run")
    driver = Driver(store.rebuild(), store)
    assert driver.books.status(driver.now).queues["judge"] == 0
    driver.run()
    assert closed(driver).flights == 20
    faults = [event.message for event in _faults(tmp_path / "run")]
    assert sum("its trace was not on disk" in message for message in faults) == waiting


def _faults(run_dir: Path) -> list[FaultSeen]:
    events = entries(sqlite3.connect(store_file(run_dir)), "events", store_file(run_dir))
    facts = [wire.decode(event, Event).fact for event in events]
    return [fact for fact in facts if isinstance(fact, FaultSeen)]


def test_a_second_opener_is_refused(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    with pytest.raises(Refused, match="another process works on"):
        Store.open(tmp_path / "run")
    closed(driver)
    Store.open(tmp_path / "run").close()


def test_an_earlier_run_is_not_written_over(tmp_path: Path) -> None:
    closed(started(tmp_path / "run"))
    with pytest.raises(Refused, match="resume"):
        Store.create(tmp_path / "run", doubles.campaign(), doubles.TEMPLATE, doubles.TARGET)


@pytest.mark.parametrize("keep", [0, 1000, 0.5, 0.9])
def test_a_truncated_store_is_named(tmp_path: Path, keep: float) -> None:
    driver = started(tmp_path / "run")
    driver.run()
    closed(driver)
    path = store_file(tmp_path / "run")
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data)) if keep < 1 else int(keep)])
    with pytest.raises(Refused, match=r"books\.sqlite") as refused:
        Store.open(tmp_path / "run").rebuild()
    assert "restore the run folder" in str(refused.value)


def test_any_flipped_bit_in_the_journal_is_noticed(tmp_path: Path) -> None:
    driver = started(tmp_path / "run", 3)
    driver.run()
    closed(driver)
    path = store_file(tmp_path / "run")
    database = sqlite3.connect(path)
    lines = database.execute("SELECT n, line FROM journal").fetchall()
    for number, line in lines[:: max(1, len(lines) // 10)]:
        damaged = bytearray(line)
        damaged[len(line) // 2] ^= 4
        database.execute("UPDATE journal SET line = ? WHERE n = ?", (bytes(damaged), number))
        database.commit()
        store = Store.open(tmp_path / "run")
        with pytest.raises(Refused, match=f"journal entry {number}"):
            store.rebuild()
        store.close()
        database.execute("UPDATE journal SET line = ? WHERE n = ?", (line, number))
        database.commit()


def test_a_full_disk_refuses_the_batch_whole_and_takes_it_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = started(tmp_path / "run")
    driver.run(until_flights=3)
    store, books = driver.store, driver.books
    assert store is not None
    store._db.execute(f"PRAGMA max_page_count = {store._db.execute('PRAGMA page_count').fetchone()[0]}")
    books.fault("test", "".join(digest(b"%d" % number) for number in range(4000)), driver.now)
    batch = books.drain()
    with pytest.raises(Unavailable, match="takes no writes"):
        store.commit(batch)
    assert not store._db.in_transaction
    with pytest.raises(Unavailable):
        store.commit(batch)
    store._db.execute("PRAGMA max_page_count = 1000000")
    store.commit(batch)
    driver.run()
    status = closed(driver)
    assert exact(Store.open(tmp_path / "run").rebuild().status(driver.now)) == exact(status)


def test_another_format_is_refused(tmp_path: Path) -> None:
    closed(started(tmp_path / "run"))
    database = sqlite3.connect(store_file(tmp_path / "run"))
    database.execute("UPDATE meta SET value = '99' WHERE key = 'format'")
    database.commit()
    with pytest.raises(Refused, match=f"store format {FORMAT}"):
        Store.open(tmp_path / "run")


def test_a_stopped_campaign_goes_on_when_opened_again(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    driver.run(until_flights=5)
    driver.books.control(Control(verb="stop"), driver.now)
    driver.commit()
    assert closed(driver).state == "ended"
    store = Store.open(tmp_path / "run")
    driver = Driver(store.rebuild(), store)
    assert driver.books.status(driver.now).state == "running"
    driver.run()
    assert closed(driver).flights == 20


def test_a_mutator_is_told_old_rounds_from_the_store_in_whole_rounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("saflite.campaign.scheduling.work_messages.OUTCOMES_MAX", 4)
    driver = started(tmp_path / "run", 60)
    driver.run(until_flights=40)
    assert driver.store is not None
    driver.service = doubles.Service(driver.store.blobs)  # a new mutator knows nothing and is told in several leases
    driver.run()
    assert closed(driver).flights == 60


def test_campaign_and_template_come_back_as_given(tmp_path: Path) -> None:
    campaign = doubles.campaign(7)
    store = Store.create(tmp_path / "run", campaign, doubles.TEMPLATE, doubles.TARGET)
    assert msgspec.structs.asdict(store.campaign) == msgspec.structs.asdict(campaign)
    assert store.template == doubles.TEMPLATE


def test_a_scorer_that_starts_anew_is_told_the_latest_outcomes_without_tracks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("saflite.campaign.scheduling.work_messages.RECENT_MAX", 6)
    driver = started(tmp_path / "run", 60)
    driver.run(until_flights=40)
    work = driver.wait_for("score", "fresh", cursor=-1)[0].work
    assert isinstance(work, ScoreWork)
    rounds = {outcome.round for outcome in work.recent}
    assert max(rounds) <= work.cursor
    assert (work.from_cursor, min(rounds) > 0) == (-1, True)
    assert all(outcome.track == () for outcome in work.recent)


def test_a_grant_never_outgrows_a_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    driver = started(tmp_path / "run", 60)
    driver.do("mutate")
    monkeypatch.setattr("saflite.campaign.scheduling.work_messages.GRANT_MAX_BYTES", 15_000)
    assert len(driver.ask("score", leases_max=9)) == 2


def test_a_run_that_is_closed_where_its_folder_was_moved_goes_on_where_it_is_now(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    driver.run(until_flights=3)
    (tmp_path / "run").rename(tmp_path / "away")
    shutil.copytree(tmp_path / "away", tmp_path / "run")
    before = {path: path.read_bytes() for path in (tmp_path / "run").glob("books.*")}
    status = closed(driver)
    assert {path: path.read_bytes() for path in (tmp_path / "run").glob("books.*")} == before
    store = Store.open(tmp_path / "away")
    assert exact(store.rebuild().status(driver.now)) == exact(status)
    store.close()
    assert audit(tmp_path / "away")["problems"] == []


@pytest.mark.parametrize("put", ["nothing", "a folder", "a copy", "a link to a copy"])
def test_a_run_folder_that_is_moved_under_the_books_holds_them_up_until_it_is_back(tmp_path: Path, put: str) -> None:
    run_dir, away, strange = tmp_path / "run", tmp_path / "away", tmp_path / "strange"
    driver = started(run_dir)
    driver.run(until_flights=3)
    run_dir.rename(away)
    if put == "a folder":
        run_dir.mkdir()
    elif put == "a copy":
        shutil.copytree(away, run_dir)
    elif put == "a link to a copy":
        shutil.copytree(away, strange)
        run_dir.symlink_to(strange)
    before = sorted((path, path.stat().st_size) for path in (*run_dir.rglob("*"), *strange.rglob("*")))
    driver.books.fault("here", "something to commit", driver.now)
    batch = driver.books.drain()
    assert driver.store is not None
    for _ in range(2):
        with pytest.raises(Unavailable, match="moved or replaced"):
            driver.store.commit(batch)
    driver.store.keep(driver.books.snapshot())
    assert sorted((path, path.stat().st_size) for path in (*run_dir.rglob("*"), *strange.rglob("*"))) == before
    if run_dir.is_symlink():
        run_dir.unlink()
    elif put != "nothing":
        shutil.rmtree(run_dir)
    away.rename(run_dir)
    driver.store.commit(batch)
    driver.run(until_flights=9)
    before_close = closed(driver)
    store = Store.open(run_dir)
    assert exact(store.rebuild().status(driver.now)) == exact(before_close)
    store.close()
    assert audit(run_dir)["problems"] == []
