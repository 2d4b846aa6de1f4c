"""Reads in the journal what the rows of the other tables only name: test cases, flights, judgements, outcomes."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import msgspec

from saflite.campaign.engine.journal import Line, Settled, decode_line
from saflite.campaign.lifecycle.outcomes import outcome_of
from saflite.campaign.storage.packing import Packing
from saflite.campaign.storage.sqlite import chain_at, entries
from saflite.campaign.storage.typed_rows import rows
from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.events import CampaignChanged, Event, ViolationFound, word_of
from saflite.contract.flight import Ending, Flight, Purpose
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement, Violation
from saflite.contract.work import FlyResult, JudgeResult, MutateResult, Outcome, Result

_CASE = "SELECT line, place, round, content FROM test_cases WHERE test_case = ? ORDER BY rowid DESC"
_FLOWN = "SELECT line, place, round, content FROM test_cases WHERE test_case = ? AND round = ? AND place >= 0"
_JUDGEMENT = "SELECT line FROM judgements WHERE test_case = ? AND flight_index = ?"
_FLIGHT = "SELECT line FROM flights WHERE test_case = ? AND purpose = ? AND flight_index = ? AND line IS NOT NULL"
_VIOLATIONS = (
    "SELECT v.event, e.event FROM violations v LEFT JOIN events e ON e.seq = v.event"
    " WHERE ?1 IN ('', confirmation) AND (?2 OR confirmation <> 'similar') ORDER BY v.rowid"
)
_OUTCOMES = (
    "SELECT round, test_case, ending, flight_index, behaviours, founded FROM outcomes WHERE round > ? AND round <= ?"
    " ORDER BY round, rank"
)
_CHANGE = "SELECT seq, event FROM events WHERE kind = ? ORDER BY seq DESC LIMIT 1"
R = TypeVar("R", MutateResult, JudgeResult, FlyResult)
HELD_MAX = 4  # results kept decoded: a round's proposal, and the verdicts read beside it


class _Case(NamedTuple):
    """Where a test case stands in the journal; of one that was made here, `content` is all of it."""

    line: int | None
    place: int
    round: int
    content: bytes | None


class Contents:
    """One connection's view of what was proposed and judged."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._db = connection
        self._packing = Packing(connection, "journal")
        self._held: dict[int, Result] = {}  # by line, read last comes last: the test cases of a round stand in one

    def test_case(self, name: str) -> TestCase | None:
        """Return a test case by its identity, as it was proposed last; None if there is none of that name."""
        found = rows(self._db, _Case, _CASE, name)
        return self._test_case(found[0]) if found else None

    def _test_case(self, case: _Case) -> TestCase:
        if case.line is None:
            if case.content is None:
                raise _damaged("a test case", "neither its line nor itself")
            return wire.decode(case.content, TestCase)
        proposals = self._result(case.line, MutateResult).test_cases
        if not 0 <= case.place < len(proposals):
            raise _damaged(f"test case {case.place} of journal entry {case.line}", f"{len(proposals)} test cases")
        proposed = proposals[case.place]
        origin = msgspec.structs.replace(proposed.origin, round=case.round, index=case.place)
        return msgspec.structs.replace(proposed, origin=origin)

    def judgement(self, name: str, flight_index: int = 0) -> Judgement | None:
        """Return the judgement on a flight, None if it was not judged."""
        for (line,) in rows(self._db, tuple[int], _JUDGEMENT, name, flight_index):
            return self._result(line, JudgeResult).judgement
        return None

    def flight(self, name: str, purpose: Purpose, flight_index: int) -> Flight | None:
        """Return the record of a flight as a worker handed it in, None if there is none."""
        for (line,) in rows(self._db, tuple[int], _FLIGHT, name, purpose, flight_index):
            return self._result(line, FlyResult).flight
        return None

    def last_change(self) -> CampaignChanged | None:
        """Return how the campaign changed last, None if it never began."""
        for seq, data in rows(self._db, tuple[int, object], _CHANGE, word_of(CampaignChanged)):
            fact = wire.decode(Packing(self._db, "events").unpack(seq, data), Event).fact
            return fact if isinstance(fact, CampaignChanged) else None
        return None

    def violations(self, confirmation: str = "", *, similar: bool = True) -> list[Violation]:
        """Return the violations in the order found: of one standing if given, without `similar` ones if asked to."""
        packing, found = Packing(self._db, "events"), []
        for seq, event in rows(self._db, tuple[int, object], _VIOLATIONS, confirmation, similar):
            fact = wire.decode(packing.unpack(seq, event), Event).fact
            if not isinstance(fact, ViolationFound):
                raise _damaged(f"a violation in event {seq}", "another")
            found.append(fact.violation)
        return found

    def outcomes(self, after_round: int, upto_round: int) -> Iterator[Outcome]:
        """Yield the outcomes of the rounds in (after, upto], in order."""
        for round_, name, ending, flight_index, behaviours, founded in rows(
            self._db, tuple[int, str, Ending, int, str, int], _OUTCOMES, after_round, upto_round
        ):
            proposals = rows(self._db, _Case, _FLOWN, name, round_)
            if not proposals:
                raise _damaged(f"test case {name} of round {round_}", "none")
            ways = tuple(behaviours.split(",")) if behaviours else ()
            judgement = self.judgement(name, flight_index)
            yield outcome_of(self._test_case(proposals[0]), round_, ending, judgement, ways, founded)

    def _result(self, number: int, kind: type[R]) -> R:
        """Return a result; raises Refused where the entry holds none of this kind: a row may name any."""
        result = self._held.pop(number, None) or self._read(number)
        self._held[number] = result
        if len(self._held) > HELD_MAX:
            del self._held[next(iter(self._held))]
        if not isinstance(result, kind):
            raise _damaged(f"{kind.__name__} in journal entry {number}", type(result).__name__)
        return result

    def _read(self, number: int) -> Result:
        before = max(number, 1) - 1
        chain = chain_at(self._db, "journal", before)
        found = entries(
            self._db, "journal", Path("books.sqlite"), after=before, chain=chain, limit=1, packing=self._packing
        )
        data = next(found, None)
        try:
            line: Line | None = None if data is None else decode_line(data)
        except wire.UNREADABLE:
            line = None
        if line is None or not isinstance(line.entry, Settled):
            raise Refused("books", expected=f"a result in journal entry {number}", got="none; the journal is damaged")
        return line.entry.result


def _damaged(expected: str, got: str) -> Refused:
    return Refused("books", expected=expected, got=f"{got}; the tables are damaged")
