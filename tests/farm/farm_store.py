"""A store in memory that can crash in the middle of a commit and run out of space. What is committed survives."""

from __future__ import annotations

import sqlite3

from farm_blobs import FarmBlobs

from saflite.campaign.engine.outbox import Batch
from saflite.campaign.engine.read_model import in_one_answer
from saflite.campaign.engine.state import Books
from saflite.campaign.storage.contents import Contents
from saflite.campaign.storage.projections import CREATE, Tables
from saflite.contract import wire
from saflite.contract.blobs import BlobRef
from saflite.contract.config import Campaign
from saflite.contract.errors import Unavailable
from saflite.contract.events import Event
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.contract.work import Outcome

SNAPSHOT_LINES = 40


class Crash(Exception):
    """The process of the books dies here."""


class MemoryStore:
    """Has the methods of `campaign.storage.store.Store` that the service around the books uses."""

    def __init__(self, campaign: Campaign, template: TestCase, target: TargetInfo) -> None:
        self.campaign, self.template, self.target = campaign, template, target
        self.lines: list[bytes] = []
        self.all_events: list[Event] = []
        self.blobs = FarmBlobs()
        self.full = False
        self.crash_next = ""  # "before" or "after": die at the next commit
        self._batches: list[Batch] = []  # committed, not in the tables yet
        self._db: sqlite3.Connection | None = None
        self._kept: tuple[int, bytes] = (0, b"")

    def empty_books(self) -> Books:
        """Return books that were never opened."""
        return Books(self.campaign, self.template, self.target, run_id="run", read_model=self)

    def rebuild(self) -> Books:
        """Return the books as last committed."""
        books, (so_far, state) = self.empty_books(), self._kept
        if so_far:
            books.restore(state)
        for line in self.lines[so_far:]:
            books.replay(line)
        self.blobs.keep_only(frozenset(blob.digest for blob in books.wanted_blobs))
        return books

    @property
    def snapshot_due(self) -> bool:
        """See `Store`: often, so that most books opened again come of one."""
        return len(self.lines) >= self._kept[0] + SNAPSHOT_LINES

    def keep(self, state: bytes) -> None:
        """See `Store`."""
        self._kept = len(self.lines), state

    def room_bytes(self) -> int | None:
        """See `Store`."""
        return 0 if self.full else None

    def commit(self, batch: Batch) -> None:
        """Make a batch durable, or not."""
        if not batch:
            return
        if self.full and batch.lines:
            raise Unavailable("the disk is full")
        if self.crash_next == "before" and batch.lines:
            raise Crash
        assert batch.first_line == len(self.lines), "a batch was left out or committed twice"
        assert set(batch.flushed) <= self.blobs.kept.keys() | self.blobs.lost, "a blob that is to be kept is not there"
        self.lines += batch.lines
        for event in batch.events:
            assert event.seq == len(self.all_events) + 1, f"event {event.seq} after {len(self.all_events)}"
            self.all_events.append(event)
        self._batches.append(batch)
        self.blobs.drop(batch.dropped)
        if self.crash_next == "after" and batch.lines:
            raise Crash

    def blob_fault(self, blob: BlobRef, *, deep: bool = False) -> str:
        """See `ReadModel.blob_fault`."""
        return self.blobs.fault(blob, deep=deep)

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """See `ReadModel.outcomes`."""
        found: list[Outcome] = []
        for outcome in Contents(self._tables()).outcomes(after_round, upto_round):
            if len(found) >= limit and outcome.round != found[-1].round:
                break
            found.append(outcome)
        return tuple(found)

    def _tables(self) -> sqlite3.Connection:
        """Return the tables of the real store, brought up to date; hardly anyone asks for them."""
        if self._db is None:
            self._db = sqlite3.connect(":memory:")
            for statement in CREATE:
                self._db.execute(statement)
        tables = Tables(self._db)
        for batch in self._batches:
            tables.tails = tables.add(batch)
        self._batches.clear()
        return self._db

    def events(self, from_seq: int) -> tuple[bytes, ...]:
        """See `ReadModel.events`."""
        return in_one_answer(wire.encode(event) for event in self.all_events[from_seq - 1 :])
