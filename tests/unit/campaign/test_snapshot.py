"""The state kept beside the journal: equal to what a replay gives, never in the way of the journal."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from books_drive import Driver, MemoryStore, doubles, new_books
from test_chance import Chancy

from saflite.campaign.engine import snapshot
from saflite.campaign.engine.core import Core
from saflite.campaign.engine.state import Books
from saflite.campaign.lifecycle.minimizer import Minimizer
from saflite.campaign.lifecycle.repeats import ONE_FLIGHT
from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.rebuild import rebuild
from saflite.campaign.storage.snapshot_file import snapshot_file
from saflite.campaign.storage.store import Store, store_file
from saflite.contract.target_info import Repeats


def replayed(store: MemoryStore) -> Books:
    books = store.empty_books()
    for line in store.lines:
        books.replay(line)
    return books


@pytest.mark.parametrize(("repeats", "shrink"), [("bitwise", False), ("bitwise", True), ("statistically", True)])
def test_a_snapshot_is_what_a_replay_gives_and_what_was_put_back(repeats: Repeats, shrink: bool) -> None:
    driver = new_books(3 if shrink else 25, repeats=repeats, shrink=shrink, record="none" if shrink else "violations")
    assert isinstance(driver.store, MemoryStore)
    if shrink:
        driver.service = Chancy(0.7, "ABC", driver.store.blobs)
    taken = 0
    while not driver.books.ended:
        for stage in ("mutate", "score", "fly", "judge", "record"):
            driver.do(stage, "ab"[taken % 2], 2)
        driver.now += 0.5
        driver.books.tick(driver.now)
        driver.commit()
        taken += 1
        if taken % 8 and not driver.books.ended:
            continue
        state, again = driver.books.snapshot(), driver.store.empty_books()
        again.restore(state)
        assert again.snapshot() == state == replayed(driver.store).snapshot()
    assert taken > 10


def test_whatever_the_parts_remember_is_kept_or_named_as_not() -> None:
    driver = new_books(5)
    core: Core = driver.books._core
    reducer = driver.books._reducer
    minimizer = Minimizer(doubles.TEMPLATE, 10, ONE_FLIGHT)
    parts = (reducer.scorers, reducer.minimization, reducer.behaviours, reducer.checks)
    for part in (core.rounds, core.tasks, *parts, minimizer):
        kept = set(snapshot.FIELDS[type(part)])
        assert set(vars(part)) - snapshot.UNKEPT == kept, f"{type(part).__name__} remembers what no snapshot keeps"
    assert set(vars(reducer)) == {*("core", "minimization", "flights", "proposals", "scorers", "behaviours", "checks")}
    for stateless in (reducer.flights, reducer.proposals):
        assert set(vars(stateless)) <= {"_core", "_minimization", "_flights", "_behaviours", "_checks"}


def test_what_was_counted_in_another_order_gives_the_same_bytes() -> None:
    states = []
    for order in (("A", "B"), ("B", "A")):
        driver = new_books(5)
        driver.books._core.exposure.states.update(order)
        driver.books._core.exposure.steps |= {(one, one, "", "") for one in order}
        states.append(driver.books.snapshot())
    assert states[0] == states[1]


@pytest.mark.parametrize("data", [b"", b"\x00", b"\x93\x80\x90\x90", b"\x93\x01\x02\x03", b"\xc1", b"\x91\x80"])
def test_what_is_no_snapshot_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="not a snapshot"):
        new_books(5).books.restore(data)


# ---- beside the journal --------------------------------------------------------------------------------------------


def half(run_dir: Path) -> Path:
    """Make a run that was stopped half-way, its state kept some lines before."""
    store = Store.create(run_dir, doubles.campaign(15, record="none"), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=6)
    store.keep(driver.books.snapshot())
    driver.run(until_flights=12)
    store.close()
    return run_dir


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return half(tmp_path_factory.mktemp("half") / "run")


def copy_of(run_dir: Path, place: Path) -> Path:
    place.mkdir()
    for path in run_dir.glob("books.*"):
        (place / path.name).write_bytes(path.read_bytes())
    return place


def opened(run_dir: Path) -> tuple[Books, int]:
    """Return the books as rebuilt, and how many journal entries were not replayed."""
    store = Store.open(run_dir)
    books, so_far = store.rebuild(), store._kept_line
    store.close()
    return books, so_far


def test_books_opened_again_come_of_the_snapshot_and_the_lines_behind_it(stopped: Path, tmp_path: Path) -> None:
    run_dir = copy_of(stopped, tmp_path / "run")
    books, so_far = opened(run_dir)
    lines = sqlite3.connect(store_file(run_dir)).execute("SELECT count(*) FROM journal").fetchone()[0]
    assert 0 < so_far < lines
    snapshot_file(run_dir).unlink()
    again, none = opened(run_dir)
    assert none == 0
    assert books.snapshot() == again.snapshot()


def test_a_snapshot_that_is_damaged_of_another_run_or_ahead_is_not_used(stopped: Path, tmp_path: Path) -> None:
    whole = snapshot_file(stopped).read_bytes()
    other = snapshot_file(half(tmp_path / "other")).read_bytes()
    for number, data in enumerate((b"", whole[:-1], whole[:100] + b"x" + whole[101:], whole[40:], other)):
        run_dir = copy_of(stopped, tmp_path / str(number))
        snapshot_file(run_dir).write_bytes(data)
        assert opened(run_dir)[1] == 0
        assert not audit(run_dir, blobs=False)["problems"]


def test_an_audit_tells_a_whole_snapshot_of_another_state(stopped: Path, tmp_path: Path) -> None:
    from saflite.campaign.storage import snapshot_file as files
    from saflite.campaign.storage.witness import start_of

    run_dir = copy_of(stopped, tmp_path / "run")
    database = sqlite3.connect(store_file(run_dir))
    line, chain = database.execute("SELECT n, chain FROM journal ORDER BY n DESC LIMIT 1").fetchone()
    made_up = new_books(15).books.snapshot()
    files.keep(run_dir, start_of(database), line, chain, made_up)
    database.close()
    problems = audit(run_dir, blobs=False)["problems"]
    assert any("books.snapshot is not the state" in problem for problem in problems)
    rebuild(run_dir)
    assert not snapshot_file(run_dir).exists()
    assert not audit(run_dir, blobs=False)["problems"]
