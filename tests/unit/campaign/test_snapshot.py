"""The state kept beside the journal: equal to what a replay gives, never in the way of the journal."""

from __future__ import annotations

import ast
import hashlib
import os
import pickle
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any, cast, get_args

import msgspec
import pytest
from books_drive import Driver, MemoryStore, doubles, new_books
from test_chance import Chancy

from saflite.campaign.engine import snapshot
from saflite.campaign.engine.core import Core
from saflite.campaign.engine.state import Books
from saflite.campaign.lifecycle.minimizer import Minimizer
from saflite.campaign.lifecycle.repeats import ONE_FLIGHT
from saflite.campaign.storage import snapshot_file as snapshot_files
from saflite.campaign.storage.audit import audit, resume_faults, told_of
from saflite.campaign.storage.rebuild import rebuild
from saflite.campaign.storage.seal import is_sealed, seal, seal_file
from saflite.campaign.storage.snapshot_file import code, code_files, snapshot_file
from saflite.campaign.storage.store import Store, store_file
from saflite.console.run_data.run_folder import open_run
from saflite.contract import wire
from saflite.contract.blobs import BlobMissing
from saflite.contract.control import Control, Verb
from saflite.contract.errors import Refused
from saflite.contract.rng import derive
from saflite.contract.target_info import Repeats
from saflite.contract.test_case import Target
from saflite.contract.work import Failure, HandedBack, Lease, Report, Result, Stage


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


def test_entries_in_a_snapshot_are_not_read_but_their_damage_is_told_when_somebody_does(
    stopped: Path, tmp_path: Path
) -> None:
    run_dir = copy_of(stopped, tmp_path / "run")
    seal_file(run_dir).unlink()  # as if it had been killed
    before, _ = opened(run_dir)
    assert not seal_file(run_dir).exists(), "nobody has looked at its tables"
    database = sqlite3.connect(store_file(run_dir))
    number, line = database.execute(
        "SELECT n, line FROM journal WHERE n IN (SELECT line FROM judgements) LIMIT 1"
    ).fetchone()
    damaged = line[:40] + bytes([line[40] ^ 1]) + line[41:]
    database.execute("UPDATE journal SET line = ? WHERE n = ?", (damaged, number))
    database.commit()
    database.close()
    assert resume_faults(run_dir) == []
    books, so_far = opened(run_dir)
    assert so_far > number
    assert books.snapshot() == before.snapshot()
    store = Store.open(run_dir)
    with pytest.raises(Refused, match=f"journal, entry {number}|journal entry {number}"):
        store.outcomes(-1, 10**6, 10**6)
    store.close()
    assert f"journal entry {number}" in told_of(run_dir)
    assert any(f"journal entry {number}" in problem for problem in audit(run_dir, blobs=False)["problems"])


def test_a_store_is_sealed_that_has_a_few_holes_or_nothing_at_all(tmp_path: Path) -> None:
    with (tmp_path / "books.sqlite").open("wb") as file:  # as SQLite and sparse copies leave them
        for page in (b"1", b"2", b"3"):
            file.write(page * 4096)
            file.seek(8192, os.SEEK_CUR)
        file.truncate()
    seal(tmp_path)
    assert is_sealed(tmp_path)
    os.truncate(tmp_path / "books.sqlite", 0)
    seal(tmp_path)
    assert is_sealed(tmp_path)
    os.truncate(tmp_path / "books.sqlite", 2**40)
    seal(tmp_path)
    assert not is_sealed(tmp_path)


def test_a_killed_run_is_sealed_again_by_the_audit_that_finds_it_whole(stopped: Path, tmp_path: Path) -> None:
    run_dir = copy_of(stopped, tmp_path / "run")
    seal_file(run_dir).unlink()
    opened(run_dir)
    assert not is_sealed(run_dir)
    assert audit(run_dir, blobs=False)["problems"] == []
    assert is_sealed(run_dir)
    opened(run_dir)
    assert is_sealed(run_dir)


def test_who_looks_on_while_the_books_are_closed_keeps_no_seal_from_them(stopped: Path, tmp_path: Path) -> None:
    """As the console's live view does when books start again: nothing else would seal the run at its end."""
    run_dir = copy_of(stopped, tmp_path / "run")
    store = Store.open(run_dir)
    with open_run(run_dir) as looking_on:
        assert looking_on.last_events(1)
        for _ in range(2):
            Driver(store.rebuild(), store).commit()
            store.close()
            assert is_sealed(run_dir)
            assert looking_on.last_events(1)
            store = Store.open(run_dir)
    store.close()
    assert is_sealed(run_dir)
    assert not run_dir.joinpath("books.sqlite-wal").exists()
    assert audit(run_dir, blobs=False)["problems"] == []


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


# ---- at any moment -------------------------------------------------------------------------------------------------


def unsorted(result: Result) -> Result:
    """Return a result as a peer sends it whose encoder keeps the keys of mappings in another order."""

    def turned(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: turned(part) for key, part in sorted(value.items(), reverse=True)}
        return [turned(part) for part in value] if isinstance(value, list | tuple) else value

    turned_round: Result = msgspec.convert(turned(msgspec.to_builtins(result)), Result)
    return turned_round


class Turmoil:
    """Drives books by hand as a bad night would: results late, wrong or unsorted, workers gone, orders, time."""

    def __init__(self, driver: Driver, rng_seed: int) -> None:
        self.driver, self.rng = driver, derive(rng_seed, "turmoil")
        self.held: list[tuple[Lease, str]] = []

    def step(self) -> None:
        driver, books = self.driver, self.driver.books
        worker = "abc"[int(self.rng.integers(3))]
        kind = self.rng.random()
        if kind < 0.5:
            stages: tuple[Stage, ...] = get_args(Stage)
            stage = stages[int(self.rng.integers(len(stages)))]
            self.held += [(lease, worker) for lease in driver.ask(stage, worker, int(self.rng.integers(1, 4)))]
        elif kind < 0.9 and self.held:
            lease, holder = self.held.pop(int(self.rng.integers(len(self.held))))
            report = Report(worker=holder, lease_id=lease.lease_id, epoch=lease.epoch, result=self._result(lease))
            books.report(wire.decode(msgspec.msgpack.encode(report), Report), driver.now)  # keys as they were put
        elif kind < 0.93:
            books.absent(worker, "fly", driver.now)
        elif kind < 0.96:
            driver.now += float(self.rng.uniform(0.0, 40.0))
            books.tick(driver.now)
        else:
            verbs: tuple[Verb, ...] = ("pause", "resume", "budget", "shadow", "scorer")
            verb = verbs[int(self.rng.integers(len(verbs)))]
            text = ("gap", "blend", "random")[int(self.rng.integers(3))]
            books.control(Control(verb=verb, text=text, number=int(self.rng.integers(5, 60))), driver.now)
        driver.commit()

    def _result(self, lease: Lease) -> Result:
        kind = self.rng.random()
        if kind < 0.05:
            return HandedBack(message="busy")
        if kind < 0.15:
            return Failure(message="the simulator died")
        try:
            return unsorted(self.driver.service.do(lease.work))
        except BlobMissing:  # the lease was lost meanwhile, and its trace was dropped
            return Failure(message="its trace is gone")


@pytest.mark.parametrize("rng_seed", range(6))
def test_at_any_moment_the_snapshot_is_the_fold_of_the_journal_from_its_beginning(rng_seed: int) -> None:
    repeats: Repeats = "statistically" if rng_seed % 3 else "bitwise"
    template = msgspec.structs.replace(doubles.TEMPLATE, target=Target(parameters={"A": 1.0, "B": 2.0}))
    target = msgspec.structs.replace(doubles.TARGET, repeats=repeats)
    store = MemoryStore(doubles.campaign(12, shrink=bool(rng_seed % 2)), template, target)
    driver = Driver(store.rebuild(), cast(Store, store))
    night = Turmoil(driver, rng_seed)
    restored, upto = store.empty_books(), 0
    for number in range(300):
        night.step()
        if night.rng.random() > 0.04 and number < 299:
            continue
        state = driver.books.snapshot()
        for line in store.lines[upto:]:
            restored.replay(line)
        assert restored.snapshot() == replayed(store).snapshot() == state, f"step {number}"
        restored, upto = store.empty_books(), len(store.lines)
        restored.restore(state)
    assert driver.books.status(driver.now).flights > 0


FOLD = """
import hashlib, pickle, sys
sys.path[:0] = sys.argv[1:3]
from books_drive import new_books
driver = new_books(12, shrink=True, repeats="statistically")
books = driver.store.empty_books()
for line in pickle.load(sys.stdin.buffer):
    books.replay(line)
print(hashlib.sha256(books.snapshot()).hexdigest())
"""


def test_another_process_folds_the_journal_to_the_same_bytes() -> None:
    driver = new_books(12, shrink=True, repeats="statistically")
    assert isinstance(driver.store, MemoryStore)
    night = Turmoil(driver, 7)
    for _ in range(300):
        night.step()
    here = Path(__file__).parent
    said = subprocess.run(
        [sys.executable, "-c", FOLD, str(here), str(here.parents[1] / "farm")],
        input=pickle.dumps(list(driver.store.lines)),
        env={**os.environ, "PYTHONHASHSEED": "12345"},
        capture_output=True,
        check=True,
    )
    assert said.stdout.decode().strip() == hashlib.sha256(driver.books.snapshot()).hexdigest()


def test_a_snapshot_names_all_code_its_state_comes_of() -> None:
    """Else books of other code would be put back, and an audit would not know them."""
    package = Path(snapshot.__file__).parents[2]
    left, met = [package / "campaign/engine/state.py"], set[Path]()
    while left:
        path = left.pop()
        if path in met:
            continue
        met.add(path)
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("saflite"):
                base = package.joinpath(*str(node.module).split(".")[1:])
                places = (base.with_suffix(".py"), *(base / f"{one.name}.py" for one in node.names))
                left += [place for place in places if place.is_file()]
    assert met <= set(code_files())


def test_code_that_changed_while_the_books_were_open_is_not_taken_for_what_ran(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code.cache_clear()
    store = Store.create(tmp_path / "run", doubles.campaign(5, record="none"), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    monkeypatch.setattr(snapshot_files, "code_files", list)  # as if other files stood there now
    store.keep(driver.books.snapshot())
    store.close()
    monkeypatch.undo()
    assert opened(tmp_path / "run")[1] > 0, "the snapshot names the code that made it"
    code.cache_clear()
