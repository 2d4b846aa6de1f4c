"""Entries of the books are told in words of earlier ones: what comes back, what it takes, what is told of damage."""

from __future__ import annotations

import shutil
import sqlite3
import zlib
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from books_drive import Driver, doubles

from saflite.campaign.engine.state import Books
from saflite.campaign.storage.audit import audit, told_of
from saflite.campaign.storage.contents import Contents
from saflite.campaign.storage.packing import BYTES_MAX, FIRST, Packing, learnt_after
from saflite.campaign.storage.rebuild import rebuild
from saflite.campaign.storage.store import Store, store_file
from saflite.contract.errors import Refused


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run long enough to have taken words twice."""
    run_dir = tmp_path_factory.mktemp("packing") / "run"
    driver = Driver(*_opened(Store.create(run_dir, doubles.campaign(80), doubles.TEMPLATE, doubles.TARGET)))
    driver.run()
    assert driver.store is not None
    driver.store.close()
    return run_dir


@pytest.fixture
def run_dir(kept: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(kept, tmp_path / "run"))


def _opened(store: Store) -> tuple[Books, Store]:
    return store.rebuild(), store


def _table(database: sqlite3.Connection, kind: str = "journal") -> Iterator[tuple[int, bytes]]:
    query = {"journal": "SELECT n, line FROM journal ORDER BY n", "events": "SELECT seq, event FROM events"}[kind]
    yield from database.execute(query)


def test_words_are_taken_after_ever_more_entries() -> None:
    due = [number for number in range(1, 40_000) if learnt_after(number) != learnt_after(number + 1)]
    assert due == [FIRST, 8 * FIRST, 64 * FIRST, 512 * FIRST]
    assert learnt_after(1) == learnt_after(FIRST) == 0
    assert learnt_after(FIRST + 1) == learnt_after(8 * FIRST) == FIRST


def test_entries_take_less_than_half_of_what_they_take_each_by_itself(run_dir: Path) -> None:
    with closing(sqlite3.connect(store_file(run_dir))) as database:
        packing = Packing(database, "journal")
        stored = [(packed, packing.unpack(number, packed)) for number, packed in _table(database) if number > 8 * FIRST]
    assert len(stored) > 100
    assert 2 * sum(len(packed) for packed, _ in stored) < sum(len(zlib.compress(entry)) for _, entry in stored)


@pytest.mark.parametrize("table", ["journal", "events"])
@pytest.mark.parametrize(
    "damage",
    [
        "DELETE FROM words WHERE chained = '{0}'",
        "UPDATE words SET content = x'00' WHERE chained = '{0}'",
        "UPDATE words SET content = 'text' WHERE chained = '{0}'",
        "UPDATE words SET content = NULL WHERE chained = '{0}'",
        "UPDATE words SET after = after + 1 WHERE chained = '{0}'",
        "UPDATE words SET content = (SELECT w.content FROM words w WHERE w.chained <> '{0}' LIMIT 1)",
        "DROP TABLE words",
    ],
)
def test_words_that_are_not_as_they_were_taken_are_told_in_a_line(run_dir: Path, table: str, damage: str) -> None:
    with closing(sqlite3.connect(store_file(run_dir))) as database:
        database.execute(damage.format(table))
        database.commit()
    said = told_of(run_dir)
    assert "journal" in said or "events" in said or "words" in said
    assert "\n" not in said
    with pytest.raises(Refused):
        Store.open(run_dir).rebuild()
    if table == "events" and "SET content = (" not in damage and "DROP" not in damage:  # the journal is whole
        rebuild(run_dir)
        assert audit(run_dir, blobs=False)["clean"]


def test_any_flipped_byte_of_words_is_told(run_dir: Path) -> None:
    with closing(sqlite3.connect(store_file(run_dir))) as database:
        words = bytearray(database.execute("SELECT content FROM words WHERE chained = 'journal' LIMIT 1").fetchone()[0])
        for place in range(0, len(words), 37):
            words[place] ^= 0x10
            packing = Packing(database, "journal")
            database.execute("UPDATE words SET content = ? WHERE chained = 'journal'", (bytes(words),))
            with pytest.raises(Refused, match="words after entry"):
                packing.unpack(FIRST + 1, b"")
            words[place] ^= 0x10


def test_an_entry_that_unpacks_without_end_is_refused() -> None:
    with closing(sqlite3.connect(":memory:")) as database:
        packing = Packing(database, "journal")
        bomb = packing.pack(1, bytes(BYTES_MAX + 1))
        assert len(bomb) < 100_000
        with pytest.raises(Refused, match="entry 1"):
            packing.unpack(1, bomb)
        for data in (bomb[:-1], packing.pack(1, b"x") + b"y", "text", None, 5):
            with pytest.raises(Refused, match="entry 1"):
                packing.unpack(1, data)
        assert packing.unpack(1, packing.pack(1, b"")) == b""


def test_reading_a_whole_campaign_unpacks_words_and_proposals_once(run_dir: Path) -> None:
    """A mutator that starts anew is told all: that used to unpack 32 KB of words, and a round, for each result read."""
    with closing(sqlite3.connect(store_file(run_dir))) as database:
        read: list[str] = []
        database.set_trace_callback(read.append)
        outcomes = list(Contents(database).outcomes(-1, 10_000))
    rounds = {outcome.round for outcome in outcomes}
    assert len(outcomes) > 40
    assert len(rounds) < len(outcomes) / 2
    assert sum("FROM words" in statement for statement in read) <= 2  # the run has taken words twice
    assert sum("line FROM journal" in statement for statement in read) <= len(rounds) + len(outcomes)
