"""A store in memory that can crash in the middle of a commit and run out of space. What is committed survives."""

from __future__ import annotations

from saflite.campaign.engine.outbox import Batch
from saflite.campaign.engine.state import Books
from saflite.contract import wire
from saflite.contract.config import Campaign
from saflite.contract.errors import Unavailable
from saflite.contract.events import Event
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.contract.work import Outcome


class Crash(Exception):
    """The process of the books dies here."""


class MemoryStore:
    """Has the methods of `campaign.storage.store.Store` that the service around the books uses."""

    def __init__(self, campaign: Campaign, template: TestCase, target: TargetInfo) -> None:
        self.campaign, self.template, self.target = campaign, template, target
        self.lines: list[bytes] = []
        self.all_events: list[Event] = []
        self.files: dict[str, bytes] = {}
        self.outcome_rows: dict[tuple[int, int], Outcome] = {}
        self.full = False
        self.crash_next = ""  # "before" or "after": die at the next commit

    def empty_books(self) -> Books:
        """Return books that were never opened."""
        return Books(self.campaign, self.template, self.target, run_id="run", read_model=self)

    def rebuild(self) -> Books:
        """Return the books as last committed."""
        books = self.empty_books()
        for line in self.lines:
            books.replay(line)
        self.files = {name: data for name, data in self.files.items() if name in books.wanted_traces}
        return books

    def commit(self, batch: Batch) -> None:
        """Make a batch durable, or not."""
        if not batch:
            return
        if self.full and batch.lines:
            raise Unavailable("the disk is full")
        if self.crash_next == "before" and batch.lines:
            self.files.update(batch.traces)  # files may be there already when the commit never happens
            raise Crash
        assert batch.first_line == len(self.lines), "a batch was left out or committed twice"
        self.files.update(batch.traces)
        self.lines += batch.lines
        for event in batch.events:
            assert event.seq == len(self.all_events) + 1, f"event {event.seq} after {len(self.all_events)}"
            self.all_events.append(event)
        for row in batch.rows:
            if row.table == "outcomes":
                number, rank, _, content = row.values
                assert isinstance(number, int)
                assert isinstance(rank, int)
                assert isinstance(content, bytes)
                self.outcome_rows[number, rank] = wire.decode(content, Outcome)
        for name in batch.dropped:
            self.files.pop(name, None)
        if self.crash_next == "after" and batch.lines:
            raise Crash

    def trace(self, trace_digest: str) -> bytes | None:
        """See `ReadModel.trace`."""
        return self.files.get(trace_digest)

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """See `ReadModel.outcomes`."""
        found: list[Outcome] = []
        for number, rank in sorted(self.outcome_rows):
            if after_round < number <= upto_round:
                if len(found) >= limit and number != found[-1].round:
                    break
                found.append(self.outcome_rows[number, rank])
        return tuple(found)

    def events(self, from_seq: int, limit: int) -> tuple[bytes, ...]:
        """See `ReadModel.events`."""
        return tuple(wire.encode(event) for event in self.all_events[from_seq - 1 : from_seq - 1 + limit])
