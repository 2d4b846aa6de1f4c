"""A run folder read beside whoever writes it: violations, flights, scores, events, traces."""

from __future__ import annotations

import sqlite3
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import msgspec

from saflite.campaign.storage.audit import told_of
from saflite.campaign.storage.contents import Contents
from saflite.campaign.storage.packing import Packing
from saflite.campaign.storage.sqlite import connect_reading, damage_named, meta
from saflite.campaign.storage.store import store_file
from saflite.campaign.storage.typed_rows import rows
from saflite.console.run_data import rows as shapes
from saflite.console.run_data.embargo import Released, split
from saflite.console.run_data.rows import ArtefactRow, Fallbacks, FlightRow, ScoreRow, UsageRow
from saflite.console.run_data.standing import Standing, standing
from saflite.console.run_data.unproven import pending, unproven
from saflite.console.view import out
from saflite.contract import wire
from saflite.contract.blobs import BlobMissing, BlobRef
from saflite.contract.circumstances import Circumstances, circumstances_of
from saflite.contract.config import Campaign
from saflite.contract.errors import Refused
from saflite.contract.events import BudgetChanged, CampaignChanged, Event, Fact, word_of
from saflite.contract.flight import Flight, Purpose, Trace, unpack_trace
from saflite.contract.memory_faults import is_memory_fault
from saflite.contract.names import recording_file
from saflite.contract.plain import argument
from saflite.contract.score import UNSCORED
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement, Violation, worst_first
from saflite.contract.work import Outcome
from saflite.evidence.folder import BlobFolder
from saflite.flight.build import library_version
from saflite.recorder.recording import read as read_recording
from saflite.recorder.summary import Finding, PolicyFacts, Rulings, RunSummary, finds_of

T = TypeVar("T")
F = TypeVar("F", bound=Fact)
EVENTS_AT_ONCE, ROUNDS_MAX = 500, 10**9
NOTHING_FLOWN = "no test case could be flown and judged"


class RunFolder:
    """Read-only view of a run; close it, or use it in a `with`."""

    def __init__(self, run_dir: Path) -> None:
        self.path = run_dir
        self._file = store_file(run_dir)
        self._db = connect_reading(self._file)
        self._blobs, self._contents = BlobFolder(run_dir), Contents(self._db)
        self.campaign = self._meta("campaign", Campaign)
        self.template = self._meta("template", TestCase)
        self.target = self._meta("target", TargetInfo)

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, kind: type[BaseException] | None, fault: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the store."""
        self._db.close()

    def standing(self) -> Standing:
        """Return how the run stands."""
        with damage_named(self._file):
            return standing(self.path, self._contents.last_change())

    # ---- what was found ------------------------------------------------------------------------------------------

    def violations(self, confirmation: str = "", *, similar: bool = True) -> list[Violation]:
        """Return the violations in the order found: of one standing if given, without `similar` ones if asked to."""
        with damage_named(self._file):
            return self._contents.violations(confirmation, similar=similar)

    def standings(self) -> Counter[str]:
        """Return how many finds there are of each standing, as the books count them: without smallest forms."""
        query = (
            "SELECT confirmation, count(*) FROM violations WHERE test_case IN (SELECT test_case FROM selected)"
            " GROUP BY confirmation"
        )
        return Counter(dict(self._rows(tuple[str, int], query)))

    def smallest_forms(self) -> frozenset[str]:
        """Return the test cases among `violations` that are smallest forms of others, and no finds of their own."""
        query = "SELECT test_case FROM violations WHERE test_case NOT IN (SELECT test_case FROM selected)"
        return frozenset(name for (name,) in self._rows(tuple[str], query))

    def test_case(self, name: str) -> TestCase:
        """Return a test case by its identity; raises Refused if the run holds none of that name."""
        with damage_named(self._file):
            test_case = self._contents.test_case(name)
        if test_case is not None:
            return test_case
        raise Refused("test case", where=str(self.path), expected="one of this run", got=repr(name))

    def judgement(self, name: str, flight_index: int = 0) -> Judgement | None:
        """Return the judgement on a flight, None if it was not judged."""
        with damage_named(self._file):
            return self._contents.judgement(name, flight_index)

    def budget(self) -> int:
        """Return how many first flights may be flown: as ordered last, else as the campaign has it."""
        return next((fact.budget for fact in reversed(self.facts(BudgetChanged))), self.campaign.budget_flights)

    def endings(self) -> dict[str, int]:
        """Return how many test cases of the search ended in each state (held, confirmed, flaky, quarantined, ...)."""
        query = "SELECT state, count(*) FROM endings WHERE test_case IN (SELECT test_case FROM selected) GROUP BY state"
        return dict(self._rows(tuple[str, int], query))

    def outcomes(self) -> Iterator[Outcome]:
        """Yield what became of the test cases of all rounds, in order."""
        with damage_named(self._file):
            yield from self._contents.outcomes(-1, ROUNDS_MAX)

    def states(self) -> dict[str, int]:
        """Return the states of the target that test cases reached in their first flights, most often reached first."""
        return self.coverage()[1]

    def rulings(self) -> dict[str, Rulings]:
        """Return what each of the campaign's policies said of the test cases searched, by their first flights."""
        return self.coverage()[0]

    def coverage(self) -> tuple[dict[str, Rulings], dict[str, int]]:
        """Return `rulings` and `states` in one pass over the judgements."""
        counts: dict[str, Counter[str]] = {name: Counter() for name in self.campaign.policies}
        reached: Counter[str] = Counter()
        for judgement in self._first_judgements():
            for verdict in judgement.verdicts:
                counts.setdefault(verdict.policy, Counter())[verdict.outcome] += 1
            reached.update({state for one in judgement.transitions for state in (one.before, one.after)})
        rulings = {name: Rulings(**count) for name, count in counts.items()}
        return rulings, dict(sorted(reached.items(), key=lambda pair: (-pair[1], pair[0])))

    def _first_judgements(self) -> Iterator[Judgement]:
        query = (
            "SELECT j.test_case FROM judgements j JOIN flights f"
            " ON f.test_case = j.test_case AND f.flight_index = j.flight_index"
            " WHERE j.flight_index = 0 AND f.purpose = 'search'"
        )
        for (test_case,) in self._rows(tuple[str], query):
            judgement = self.judgement(test_case)
            if judgement is not None:
                yield judgement

    def recording(self, name: str) -> str:
        """Return the recording of a test case relative to the run folder, empty if there is none."""
        query = "SELECT flight_index FROM recordings WHERE test_case = ? AND digest <> '' ORDER BY flight_index"
        for (index,) in self._rows(tuple[int], query, name):
            return recording_file(name, index)
        return ""

    def findings(self, *, similar: bool = False) -> list[Finding]:
        """Return the violations with what is known of each, confirmed and worst first; `similar` ones if asked for."""
        found = sorted(self.violations(similar=similar), key=worst_first)
        memory, forms = self.memory_faults(), self.smallest_forms()
        return [self._finding(one, one.test_case in memory, one.test_case in forms) for one in found]

    def finding(self, violation: Violation) -> Finding:
        """Return a violation with what is known of it."""
        name = violation.test_case
        return self._finding(violation, name in self.memory_faults(), name in self.smallest_forms())

    def _finding(self, violation: Violation, memory: bool, is_form: bool) -> Finding:
        name, test_case = violation.test_case, self.test_case(violation.test_case)
        judgement, recording = self.judgement(name, violation.flight_index), self.recording(name)
        circumstances = self._circumstances(violation, test_case, memory)
        made_of = test_case.origin.parent if is_form else ""
        return Finding(violation, test_case, judgement, recording, circumstances, made_of)

    def _circumstances(self, violation: Violation, test_case: TestCase, memory: bool) -> Circumstances:
        rows = self.flights(violation.test_case)
        shown = next((row for row in rows if row.shows(violation)), None)
        flight = None if shown is None else self.flight(shown)
        again = [row for row in rows if row.purpose == "check" and violation.flight_index == 0]
        equal = [row for row in again if shown is not None and row.trace_digest == shown.trace_digest]
        found = circumstances_of(test_case, self.target, None if flight is None else flight.delivered)
        return msgspec.structs.replace(found, repeated=len(again), equal=len(equal), memory_safety=memory)

    def summary(self, released: Released = ()) -> RunSummary:
        """Return the campaign's result as exports want it, of findings of memory safety the `released` ones only."""
        rulings, flights, violations = self.rulings(), self.flights(), self.violations()
        found, endings, now = self.findings(), self.endings(), self.standing()
        shown, hidden = split(found, released)
        return RunSummary(
            campaign=self.campaign,
            policies=tuple(self._facts(name, rulings) for name in self.campaign.policies),
            findings=tuple(shown),
            flights=self.flown()["search"],
            held=sum(endings.get(word, 0) for word in ("held", "vacuous", "inconclusive")),
            elapsed_s=self.elapsed_s(),
            version=library_version("saflite-farm"),
            withheld=len(finds_of(hidden)),
            pending=Counter(one.policy for one in pending(flights, violations)),
            unproven=len(unproven(flights, violations)),
            budget=self.budget(),
            state=now.text,
            failed=now.broke or (NOTHING_FLOWN if all_set_aside(endings) else ""),
            unfinished=now.is_unfinished,
        )

    def _facts(self, name: str, rulings: dict[str, Rulings]) -> PolicyFacts:
        from saflite.oracle.policy import load_policy

        file = load_policy(name, self.campaign.policy_texts).file
        words = " ".join(file.interestingness.split())
        return PolicyFacts(file.id, file.title, words, file.source, rulings.get(file.id, Rulings()))

    # ---- what was flown ------------------------------------------------------------------------------------------

    def flights(self, name: str = "") -> list[FlightRow]:
        """Return the flights in the order counted, those of one test case if named; raises Refused for damage."""
        query = (
            "SELECT f.test_case, f.flight_index, f.purpose, f.ending, f.simulated_s, f.wall_s, f.trace_digest,"
            " f.worker, j.robustness, coalesce(j.violated, '') FROM flights f LEFT JOIN judgements j"
            " ON f.purpose NOT IN ('check', 'shrink') AND j.test_case = f.test_case AND j.flight_index = f.flight_index"
            " WHERE ?1 = '' OR f.test_case = ?1 ORDER BY f.rowid"
        )
        return [shapes.flight_row(columns) for columns in self._rows(shapes.FLIGHT, query, name)]

    def flight(self, row: FlightRow) -> Flight | None:
        """Return the whole record of a flight, with what was delivered; None where no worker handed one in."""
        with damage_named(self._file):
            return self._contents.flight(row.test_case, row.purpose, row.flight_index)

    def artefacts(self, name: str = "") -> list[ArtefactRow]:
        """Return the named files that flights left, those of one test case if named."""
        query = "SELECT * FROM artefacts WHERE ?1 = '' OR test_case = ?1 ORDER BY rowid"
        found = [shapes.artefact_row(columns) for columns in self._rows(shapes.ARTEFACT, query, name)]
        return [row for row in found if not self._blobs.fault(row.blob)]

    def content(self, blob: BlobRef) -> bytes:
        """Return what a blob of the run holds; raises BlobMissing if it is not there or damaged."""
        return self._blobs.get(blob)

    def trace(self, digest: str) -> Trace | None:
        """Return a trace that was kept, None if it was not or is damaged."""
        query = "SELECT trace_blob, trace_bytes FROM flights WHERE trace_digest = ? AND trace_blob <> ''"
        for blob, size_bytes in self._rows(tuple[str, int], query, digest):
            try:
                return unpack_trace(self._blobs.get(BlobRef(digest=blob, size_bytes=size_bytes)))
            except BlobMissing:
                continue
        return self._recorded_trace(digest)

    def _recorded_trace(self, digest: str) -> Trace | None:
        query = (
            "SELECT r.test_case, r.flight_index FROM recordings r JOIN flights f ON f.test_case = r.test_case"
            " AND f.flight_index = r.flight_index WHERE f.trace_digest = ? AND r.digest <> ''"
        )
        for name, index in self._rows(tuple[str, int], query, digest):
            with suppress(Refused):
                return read_recording(self.path / recording_file(name, index)).trace
        return None

    def flown(self) -> Counter[Purpose]:
        """Return how many flights were counted, by what they were flown for."""
        return Counter(dict(self._rows(tuple[Purpose, int], "SELECT purpose, count(*) FROM flights GROUP BY purpose")))

    def memory_faults(self) -> frozenset[str]:
        """Return the test cases any flight of which ended by a fault of memory: all finds of them are private first."""
        query = "SELECT test_case, message FROM flights WHERE ending = 'autopilot_died'"
        found = self._rows(tuple[str, str], query)
        return frozenset(name for name, message in found if is_memory_fault("autopilot_died", message))

    def good_before(self, name: str, parent: str = "") -> str:
        """Return the test case whose first flight last kept every rule before one was flown, `parent` if it did.

        Empty if there is none.
        """
        query = (
            "SELECT f.test_case FROM flights f JOIN judgements j"
            " ON j.test_case = f.test_case AND j.flight_index = f.flight_index"
            " WHERE f.purpose = 'search' AND j.violated = '' AND j.robustness IS NOT NULL"
            " AND f.rowid < (SELECT min(rowid) FROM flights WHERE test_case = ?1)"
            " ORDER BY f.test_case = ?2 DESC, f.rowid DESC LIMIT 1"
        )
        return next((found for (found,) in self._rows(tuple[str], query, name, parent)), "")

    # ---- scores --------------------------------------------------------------------------------------------------

    def scores(self) -> list[ScoreRow]:
        """Return every score beside what came of its test case, where the round that it was given in selected it.

        A test case may be scored in several rounds and is flown once: its flight answers one score of each model.
        """
        query = (
            "SELECT s.test_case, s.model, s.scored_by, s.value, s.shadow, s.fault, coalesce(c.selected_by, ''),"
            " j.violated FROM scores s LEFT JOIN selected c ON c.test_case = s.test_case AND c.round = s.round"
            " LEFT JOIN judgements j ON j.test_case = c.test_case AND j.flight_index = 0"
            " ORDER BY s.rowid"
        )
        return [shapes.score_row(columns) for columns in self._rows(shapes.SCORE, query)]

    def fallbacks(self) -> Fallbacks:
        """Return how often the model that decides gave no score."""
        query = "SELECT fault, scored_by FROM scores WHERE fault != '' AND shadow = 0 ORDER BY rowid"
        found = [*self._rows(tuple[str, str], query)]
        unscored = sum(1 for _, scored_by in found if scored_by == UNSCORED)
        return Fallbacks(len(found) - unscored, unscored, found[-1][0] if found else "")

    def usage(self) -> list[UsageRow]:
        """Return what scoring took, per model."""
        query = (
            "SELECT model, 1, calls, tokens_in, tokens_out, latency_s, cost_usd, asked_again, cached, faults"
            " FROM usage ORDER BY model"
        )
        return shapes.in_sum(self._rows(UsageRow, query))

    def events(self, from_seq: int = 1) -> Iterator[Event]:
        """Yield the committed events from a sequence number on."""
        while True:
            query = "SELECT seq, event FROM events WHERE seq >= ? ORDER BY seq LIMIT ?"
            yield from (found := self._events(query, from_seq, EVENTS_AT_ONCE))
            if len(found) < EVENTS_AT_ONCE:
                return
            from_seq = found[-1].seq + 1

    def last_events(self, count: int) -> list[Event]:
        """Return the last committed events, in order."""
        return self._events("SELECT seq, event FROM events ORDER BY seq DESC LIMIT ?", count)[::-1]

    def first_event(self) -> Event | None:
        """Return the first event, None before there is one."""
        return next(iter(self._events("SELECT seq, event FROM events ORDER BY seq LIMIT 1")), None)

    def facts(self, kind: type[F]) -> list[F]:
        """Return the facts of one kind, in the order told."""
        query = "SELECT seq, event FROM events WHERE kind = ? ORDER BY seq"
        found = (event.fact for event in self._events(query, word_of(kind)))
        return [fact for fact in found if isinstance(fact, kind)]

    def last_change(self) -> int:
        """Return the number of the event with which the state of the campaign changed last; 0 before it began."""
        query = "SELECT seq FROM events WHERE kind = ? ORDER BY seq DESC LIMIT 1"
        return next((seq for (seq,) in self._rows(tuple[int], query, word_of(CampaignChanged))), 0)

    def _events(self, query: str, *values: object) -> list[Event]:
        """Return the events of the (number, content) rows that a query finds."""
        packing = Packing(self._db, "events")
        return [
            wire.decode(packing.unpack(seq, data), Event)
            for seq, data in self._rows(tuple[int, object], query, *values)
        ]

    def elapsed_s(self) -> float:
        """Return how long the books were open, up to the last event; the time between sittings is none of it."""
        last = self._rows(tuple[float], "SELECT at_unix_s FROM events ORDER BY seq DESC LIMIT 1")
        sitting = self._rows(
            tuple[float, float], "SELECT elapsed_before_s, opened_unix_s FROM sittings ORDER BY rowid DESC LIMIT 1"
        )
        (until_s,), (before_s, opened_s) = next(last, (0.0,)), next(sitting, (0.0, 0.0))
        return before_s + max(0.0, until_s - opened_s)

    def _rows(self, kind: Any, query: str, *values: object) -> Iterator[Any]:
        with damage_named(self._file):
            yield from rows(self._db, kind, query, *values)

    def _meta(self, key: str, kind: type[T]) -> T:
        with damage_named(self._file):
            value = meta(self._db, key)
        if value:
            return wire.decode(value, kind)
        raise Refused("books", where=str(self._file), expected=f"a store that names its {key}", got="nothing")


def all_set_aside(endings: Mapping[str, int]) -> bool:
    """Whether test cases ended, and none because it was flown and judged."""
    return 0 < endings.get("quarantined", 0) == sum(endings.values())


def tell_loss(run_dir: Path) -> None:
    """Say on stderr, before anything else is told of a run, what of its books is lost or damaged."""
    words = told_of(run_dir)
    if words:
        out.complain("warning", f"what follows is not the whole run: {words}; see `saflite audit {argument(run_dir)}`")


def open_run(run_dir: Path) -> RunFolder:
    """Open a run folder for reading; raises Refused if there is no run or its store is damaged."""
    try:
        return RunFolder(run_dir)
    except sqlite3.DatabaseError as fault:
        raise Refused("books", where=str(store_file(run_dir)), expected="an intact store", got=str(fault)) from fault
