"""What must hold whatever happens, seen from outside: by the facts the books announced and what workers were told."""

from __future__ import annotations

from collections import Counter

import farm_doubles as doubles
from farm_store import MemoryStore

from saflite.campaign.engine.journal import decode_line
from saflite.campaign.engine.state import Books
from saflite.campaign.lifecycle.confirmation import violated_verdicts
from saflite.campaign.lifecycle.repeats import confirm_rule, shrink_rule
from saflite.campaign.scheduling.work_keys import FlyKey, JudgeKey, read_key
from saflite.contract.control import Status
from saflite.contract.events import (
    CampaignChanged,
    FaultSeen,
    Flown,
    Judged,
    Proposed,
    Quarantined,
    Scored,
    ViolationFound,
)
from saflite.contract.flight import FLOWN_ENDINGS, UNTOLD
from saflite.contract.ids import digest
from saflite.contract.work import FlyResult, JudgeResult, Receipt, Report

Flight = tuple[str, int]


class Ghost:
    """Follows every committed fact and every receipt, and objects at once."""

    def __init__(self, store: MemoryStore) -> None:
        self._store = store
        self.spoiled: set[tuple[str, int]] = set()  # flights whose trace was damaged before it was judged
        self._seen = 0
        self.flown: dict[Flight, Flown] = {}
        self.judged: dict[Flight, Judged] = {}
        self.planted: set[str] = set()
        self.scored: Counter[tuple[int, str]] = Counter()
        self.violations: dict[tuple[str, str], ViolationFound] = {}
        self.quarantined: dict[str, Quarantined] = {}
        self.faults: list[FaultSeen] = []
        self.accepted: dict[Flight, Report] = {}
        self.accepted_judged: set[Flight] = set()
        self.checked: dict[str, str] = {}  # digest of the flight that checked a first flight
        self.reports: list[Report] = []
        self.flown_by: set[tuple[str, int, str, str]] = set()
        self.tried: dict[str, set[int]] = {}  # flights of smaller test cases that violated
        self._rule = confirm_rule(store.campaign.search, store.target.repeats)
        self._shrinks = store.campaign.search.shrink
        self.budget_max = store.campaign.budget_flights

    @property
    def charged(self) -> int:
        """Flights that count against the budget: first flights, not those of the smallest forms of violations."""
        return sum(1 for name, index in self.flown if name in self.planted and not index)

    @property
    def flown_names(self) -> set[str]:
        """Every test case that was flown."""
        return {name for name, _ in self.flown}

    # ---- what workers were told ----------------------------------------------------------------------------------

    def sent(self, report: Report) -> None:
        """A worker really did this work."""
        self.reports.append(report)
        result = report.result
        if isinstance(result, FlyResult):
            flight = result.flight
            self.flown_by.add((flight.test_case, flight.flight_index, report.worker, flight.build))
        key = read_key(report.lease_id.partition(":")[2])
        violates = isinstance(result, JudgeResult) and violated_verdicts(result.judgement)
        if violates and isinstance(key, JudgeKey) and key.purpose == "shrink":
            self.tried.setdefault(key.test_case, set()).add(key.index)

    def received(self, report: Report, receipt: Receipt) -> None:
        """A receipt reached its worker: what it accepts must be committed, for good."""
        self.look()
        if receipt.status != "accepted":
            return
        result = report.result
        key = read_key(report.lease_id.partition(":")[2])
        match key, result:
            case FlyKey(purpose="check"), FlyResult(flight=again) if again.ending in FLOWN_ENDINGS:
                self.checked[key.test_case] = again.trace_digest
        if isinstance(key, FlyKey | JudgeKey) and key.purpose in UNTOLD:
            return
        if isinstance(result, FlyResult) and result.flight.ending in FLOWN_ENDINGS:
            flight = (result.flight.test_case, result.flight.flight_index)
            earlier = self.accepted.setdefault(flight, report)
            assert earlier.epoch == report.epoch or flight in self.spoiled, (
                f"{flight} was accepted twice, as attempts {earlier.epoch}, {report.epoch}"
            )
            assert flight in self.flown, f"{flight} was acknowledged before it was committed"
            assert self.flown[flight].worker == report.worker, f"{flight} is written down as another worker's"
        if isinstance(result, JudgeResult):
            flight = (result.judgement.test_case, result.judgement.flight_index)
            self.accepted_judged.add(flight)
            assert flight in self.judged, f"the judgement of {flight} was acknowledged before it was committed"

    # ---- what the books said -------------------------------------------------------------------------------------

    def look(self) -> None:
        """Take in the facts committed since the last look."""
        while self._seen < len(self._store.all_events):
            event = self._store.all_events[self._seen]
            self._seen += 1
            assert event.seq == self._seen, f"fact {event.seq} stands at {self._seen}"
            self._take(event.fact)

    def _take(self, fact: object) -> None:
        match fact:
            case Flown():
                flight = (fact.test_case, fact.flight_index)
                assert flight not in self.flown or flight in self.spoiled, f"{flight} was flown twice"
                assert fact.test_case in self.planted or self._shrinks, f"{fact.test_case} was flown, never proposed"
                assert fact.flight_index == 0 or (fact.test_case, 0) in self.judged, f"{flight} re-flown before judged"
                by = (*flight, fact.worker, fact.build)
                assert fact.ending in ("lost", "infra") or by in self.flown_by, (
                    f"{flight} was not flown by {fact.worker} on build {fact.build!r}"
                )
                self.flown[flight] = fact
                self.budget_max = max(self.budget_max, self._budget())
                assert self.charged <= self.budget_max, f"{self.charged} flights, budget {self.budget_max}"
            case Judged():
                flight = (fact.test_case, fact.flight_index)
                assert flight in self.flown, f"{flight} was judged but not flown"
                assert flight not in self.judged, f"{flight} was judged twice"
                assert (fact.robustness is not None and fact.robustness < 0) == bool(fact.violated), "sign and verdict"
                self.judged[flight] = fact
            case Proposed():
                self.planted.update(fact.test_cases)
            case Scored():
                for name, value in fact.scores:
                    assert 0.0 <= value <= 10.0, f"{name} scored {value}"
                    self.scored[fact.round, name] += 1
                    assert self.scored[fact.round, name] == 1, f"{name} has two deciding scores in round {fact.round}"
            case ViolationFound():
                self._take_violation(fact)
            case Quarantined():
                assert fact.test_case not in self.quarantined, f"{fact.test_case} was quarantined twice"
                self.quarantined[fact.test_case] = fact
            case FaultSeen():
                self.faults.append(fact)

    def _take_violation(self, fact: ViolationFound) -> None:
        violation = fact.violation
        key = (violation.test_case, violation.policy)
        assert key not in self.violations, f"{key} was announced twice"
        self.violations[key] = fact
        place = violation.flight_index
        first = self.judged.get((violation.test_case, place))
        assert first is not None, f"{key} was announced without a judgement"
        assert violation.policy in first.violated, f"{key} was announced, but the first flight held"
        mine = {index: self.flown[name, index] for name, index in self.flown if name == violation.test_case}
        again = {index for index, flown in mine.items() if index > place and flown.ending in FLOWN_ENDINGS}
        assert len(again) >= violation.reflown, f"{key} claims {violation.reflown} re-flights"
        close = sum(1 for index in again if self._distance(violation.test_case, index) < 1.5)
        assert close >= violation.failed_again, f"{key} claims that {violation.failed_again} failed, {close} did"
        builds = {mine[index].build for index in (place, *again)}
        assert len(builds) == 1, f"{key} is repeated on several builds: {sorted(builds)}"
        if violation.confirmation == "confirmed":
            assert violation.failed_again >= self._rule.needed, f"{key} was never repeated"
        if violation.test_case not in self.planted:
            tried, needed = len(self.tried.get(violation.test_case, ())), shrink_rule(self._rule).needed
            assert tried >= needed, f"{key} is a smallest form after {tried} flights that violated"
        if violation.confirmation == "similar":
            assert not violation.reflown, f"{key} was re-flown, though its behaviour is confirmed"
            stands = self.violations.get((violation.representative, violation.policy))
            assert stands is not None, f"{key} is similar to {violation.representative}, which was not announced"
            assert stands.violation.confirmation == "confirmed", f"{key} is similar to what was not confirmed"
            assert stands.violation.fingerprint == violation.fingerprint, f"{key} is of another behaviour"
        if violation.confirmation == "flaky":
            assert doubles.is_flaky(violation.test_case), f"{key} is called flaky, but repeats every time"

    @staticmethod
    def _distance(name: str, index: int) -> float:
        flaky = doubles.is_flaky(name)
        return 4.0 * (doubles.luck(f"{name} {index}") if flaky else doubles.luck(name))

    def _budget(self) -> int:
        orders = [decode_line(line).entry for line in self._store.lines]
        budgets = [getattr(entry, "control", None) for entry in orders]
        return max(
            (control.number for control in budgets if control is not None and control.verb == "budget"), default=0
        )

    # ---- for the end ---------------------------------------------------------------------------------------------

    def found(self) -> frozenset[tuple[str, str, str]]:
        """Return test case, policy and standing of everything found."""
        return frozenset((*key, fact.violation.confirmation) for key, fact in self.violations.items())

    def set_aside(self) -> int:
        """Return how many flights trouble alone kept from being flown or judged (poison is set aside in any run)."""
        innocent = [name for name in self.quarantined if not doubles.is_poison(name)]
        smaller = (fault.where for fault in self.faults if fault.message.startswith("given up"))  # ones tried
        given_up = sum(1 for where in smaller if not doubles.is_poison(where.split("/")[1]))
        reflights = (fact for flight, fact in self.flown.items() if flight[1])
        return len(innocent) + given_up + sum(1 for fact in reflights if fact.ending not in FLOWN_ENDINGS)


def at_the_end(ghost: Ghost, store: MemoryStore, books: Books, status: Status) -> None:
    """Assert that every flown test case ended in exactly one recorded way, and that a replay comes to the same."""
    shown_by = {fact.violation.test_case: fact.violation.flight_index for fact in ghost.violations.values()}
    for name in {name for name, index in ghost.flown if index == 0} | set(ghost.quarantined):
        ways = ["quarantined"] if name in ghost.quarantined else []
        first = ghost.judged.get((name, shown_by.get(name, 0)))
        if first is not None and not ways:
            ways.append("violated" if any(key[0] == name for key in ghost.violations) else "held")
            assert bool(first.violated) == (ways[-1] == "violated"), f"{name}: judged {first.violated}, ended {ways}"
        assert len(ways) == 1, f"{name} ended in {len(ways)} ways: {ways}"
    for flight in ghost.accepted:
        assert flight in ghost.flown, f"{flight} was acknowledged and is missing"
    for flight in ghost.accepted_judged:
        assert flight in ghost.judged, f"the judgement of {flight} was acknowledged and is missing"
    assert status.flights == ghost.charged, f"{status.flights} flights counted, {ghost.charged} told"
    unlike = [name for name, found in ghost.checked.items() if found != doubles.flown(name, 0)[1]]
    assert status.checked >= len(ghost.checked), "checks were lost"
    assert status.unequal >= len(unlike), f"{status.unequal} flights were no repeats, {len(unlike)} were not"
    assert status.unequal == 0 or any(map(doubles.is_untrue, ghost.flown_names)), "a repeat was called none"
    firm = [
        fact.violation.test_case for fact in ghost.violations.values() if fact.violation.confirmation == "confirmed"
    ]
    confirmed = sum(1 for name in firm if name in ghost.planted)
    assert status.violations_confirmed == confirmed, "confirmed violations do not add up"
    ends = [event.fact.why for event in store.all_events if isinstance(event.fact, CampaignChanged)]
    early = any("the strategy" in why for why in ends)
    assert early or status.flights == status.budget, f"{status.flights} of {status.budget} flights were flown"
    shown = {
        fact.violation.fingerprint
        for name, fact in ((key[0], fact) for key, fact in ghost.violations.items())
        if fact.violation.confirmation == "confirmed" and name in ghost.planted
    }
    assert status.behaviours == len(shown), f"{status.behaviours} behaviours counted, {len(shown)} told"
    left = sorted([*books._core.trials, *books._core.forms])
    assert not left or ends[-1] == "stopped", f"the campaign ended while {left} were under way"
    _replay_agrees(store, status)
    _no_orphan_blobs(store, ghost, books)


def state_of(books: Books) -> dict[str, object]:
    """Return the durable state of the books, for comparison."""
    core = books._core
    tasks = {
        task.key: (task.epoch, task.worker, task.losses, task.undelivered, task.failures, sorted(task.avoid))
        for task in core.tasks
    }
    rounds = {number: (one.phase, one.plan, one.cost, one.open_trials) for number, one in core.rounds.under_way.items()}
    trials = {name: sorted(trial.flights) for name, trial in core.trials.items()}
    counts = {name: getattr(core.counts, name) for name in core.counts.__slots__ if name != "last_find_s"}
    scorers = (books._reducer.scorers.model, books._reducer.scorers.shadow, sorted(books._reducer.scorers.pending))
    plain = (
        core.state,
        core.rounds.planned,
        core.rounds.budget,
        sorted(core.flown),
        {digest: hold.times for digest, hold in core.holds.items()},
    )
    return {
        "tasks": tasks,
        "rounds": rounds,
        "trials": trials,
        "counts": counts,
        "scorers": scorers,
        "plain": plain,
        "seq": core.out.seq,
    }


def journal_is_the_state(store: MemoryStore, books: Books) -> None:
    """Assert that the books rebuilt from the journal are the books at hand."""
    again = store.empty_books()
    for line in store.lines:
        again.replay(line)
    assert books.snapshot() == again.snapshot(), "a snapshot is not what comes of the journal"
    live, replayed = state_of(books), state_of(again)
    for part, value in live.items():
        assert value == replayed[part], f"{part} live: {value}; after a replay: {replayed[part]}"


def _replay_agrees(store: MemoryStore, status: Status) -> None:
    again = store.rebuild().status(0.0)
    for field in (
        "flights",
        "reflown",
        "test_cases",
        "candidates",
        "violations_confirmed",
        "quarantined",
        "seq",
        "state",
    ):
        live, replayed = getattr(status, field), getattr(again, field)
        assert live == replayed, f"{field}: {live} live, {replayed} after a replay"


def _no_orphan_blobs(store: MemoryStore, ghost: Ghost, books: Books) -> None:
    violated = {name for name, _ in ghost.violations}
    shown = {(fact.violation.test_case, fact.violation.flight_index) for fact in ghost.violations.values()}
    similar = {fact.violation.test_case for fact in ghost.violations.values() if not fact.violation.reflown}
    kept, wanted = set(store.blobs.kept), {blob.digest for blob in books.wanted_blobs}
    there = kept | store.blobs.lost
    for name, index in shown:
        either = {digest(doubles.flown(name, index)[2]), digest(doubles.recording(name, index))}
        assert name in similar or either & there, "neither trace nor recording of a violation is there"
    assert wanted <= there, "a blob the books name is gone"
    assert kept <= wanted, "a blob nobody needs was left"
    flights = {index for name, index in ghost.flown if name in violated}
    most = len(violated) * (2 * len(flights) + 1)  # trace and log of each flight, the recording
    assert len(kept) <= most, f"{len(kept)} blobs for {len(violated)} violations"


def at_the_end_of_a_clean_run(ghost: Ghost, simulators: int, books: Books) -> None:
    """Assert what only holds where nothing went wrong: re-flights on another worker."""
    for key, fact in ghost.violations.items():
        workers = fact.violation.workers
        if simulators > 1 and fact.violation.reflown:
            assert len(set(workers)) > 1, f"{key} was re-flown by the worker that flew it: {workers}"
