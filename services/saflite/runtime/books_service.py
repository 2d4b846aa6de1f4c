"""The shell around the books: one thread that drains its inbox, handles all, commits once, then answers and announces.

Long polls that find nothing wait and are tried again whenever the books have changed. Nothing is answered before
the commit that covers it; while the disk does not take a commit, nothing new is handed out and results stay with the
workers.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from typing import NamedTuple

import msgspec

from saflite.bus.access import check_speaker, speaks_for
from saflite.bus.base import Bus, Happening, Presence, Request
from saflite.campaign.engine.outbox import Batch
from saflite.campaign.engine.state import Books
from saflite.campaign.engine.worker_registry import FULL
from saflite.campaign.storage.store import Store
from saflite.contract import topics, wire
from saflite.contract.bounds import TOLD_CHARS_MAX, told
from saflite.contract.clock import Clock
from saflite.contract.control import Answer, Control
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.events import Event, kind_of
from saflite.contract.join import Join, Joined
from saflite.contract.modules import Outside
from saflite.contract.work import Ask, Failure, Grant, Heartbeat, Receipt, Report, Stage, blobs_left, lease_named
from saflite.runtime.admission import Terms, objection
from saflite.runtime.complaints import Complaints
from saflite.runtime.evidence import Evidence, InlineEvidence
from saflite.runtime.fair_inbox import FairInbox
from saflite.runtime.inspections import Inspections
from saflite.runtime.liveness import TOKENS_MAX, Liveness
from saflite.runtime.log_lines import log_fact
from saflite.runtime.long_poll_queue import LongPollQueue
from saflite.runtime.questions import encoded, read
from saflite.runtime.rate_limit import ANSWER_BYTES, JOIN_COST, RateLimit
from saflite.runtime.room import Room
from saflite.runtime.software import software_of, version
from saflite.simulator_worker.processes import processor_s

log = logging.getLogger(__name__)

DRAIN_MAX = 512
TICK_S = 0.1
COMMIT_RETRY_S = 0.5
LINGER_S = 3.0  # how long the books of an ended campaign still answer
BLOCKED_RETRY_S = 1.0
FULL_RETRY_S = 5.0  # after so long a worker asks again whether there is room for it
TROUBLE_S = 3.0  # so long trouble is told after it was met last
ASLEEP_S = 1.0  # steps are 0.1 s apart; after a longer gap this process was frozen, not the workers


class _Inspected(NamedTuple):
    """The blobs of a result were looked at; `damage` None means that this could not be told."""

    report: Report
    damage: str | None


class _Complaint(NamedTuple):
    """Trouble another thread met with a peer."""

    where: str
    words: str


class BooksService:
    """Serves one campaign's books on a bus."""

    def __init__(
        self,
        bus: Bus,
        campaign: str,
        books: Books,
        store: Store,
        clock: Clock,
        evidence: Evidence | None = None,
        *,
        software: Callable[[Stage], str] = software_of,
        modules: Sequence[Outside] = (),
        key_of: Callable[[str], str] = lambda _: "",
    ) -> None:
        """Serve `books` out of `store`; `evidence` looks at blobs, in this thread if none is given.

        `modules` are those from outside that workers have to have been given; `key_of` tells whose key a worker's name
        begins with.
        """
        self._terms = Terms(
            books.target, version(), software, books.campaign.scorer.guests, modules, books.campaign.needs
        )
        self._bus, self._campaign, self._books, self._store, self._clock = bus, campaign, books, store, clock
        self._evidence = evidence or InlineEvidence(store.blobs)
        self._inspections = Inspections()
        self._answered: list[Report] = []
        self._prefix = topics.prefix(campaign)
        self._inbox: FairInbox[Happening | _Inspected | _Complaint] = FairInbox(self._line_of)
        self._long_polls = LongPollQueue()
        self._liveness = Liveness(books.campaign.lease.lease_s, key_of)
        self._stepped_s, self._tick_from_s = clock.monotonic_s(), 0.0
        self._outbox: list[tuple[Request, bytes]] = []
        self._blocked: Batch | None = None
        self._trouble, self._trouble_until_s = "", 0.0
        self._commit_s, self._room = 0.0, Room(store)
        self._complaints, self._rates = Complaints(), RateLimit()
        self._ended_s: float | None = None
        self._stopping = ""
        self.crowded: set[str] = set()  # keys with more tokens than are heeded, for who can end their connections

    def stop(self, why: str) -> None:
        """Ask for a clean end: what is committed stays, the campaign can be resumed. Signal-safe."""
        self._stopping = why

    def complain(self, where: str, words: str) -> None:
        """Have trouble with a peer told in the campaign's history; from any thread."""
        self._inbox.put(_Complaint(where, words))

    def open(self) -> None:
        """Start listening on the bus."""
        for stage_topic in ("work/*", "result/*", "beat/*", "control/*"):
            self._bus.serve(f"{self._prefix}/{stage_topic}", self._inbox.put)
        self._bus.serve(topics.join(self._campaign, "*"), self._inbox.put)
        self._bus.watch(f"{self._prefix}/alive/**", self._inbox.put)
        self._bus.appear(topics.farm(self._campaign))

    def run(self) -> str:
        """Serve until the campaign is over and everybody was told, or until stopped; returns why."""
        self.open()
        while True:
            self.step(TICK_S)
            lingered = self._ended_s is not None and self._clock.monotonic_s() > self._ended_s + LINGER_S
            if self._stopping or lingered:
                if self._blocked is None:
                    self._store.keep(self._books.snapshot())
                return self._stopping or "the campaign is over"

    def step(self, wait_s: float) -> int:
        """Handle what is in the inbox, waiting up to `wait_s` for the first of it; returns how much there was."""
        count = 0
        while count < DRAIN_MAX and (happenings := self._inbox.take(0.0 if count else wait_s, DRAIN_MAX - count)):
            for happening in happenings:
                self._take(happening, self._clock.monotonic_s())
            count += len(happenings)
        now_s = self._clock.monotonic_s()
        if self._blocked is None:
            if full := self._room.trouble(now_s):
                self._in_trouble(full, now_s)
            self._pass_time(now_s)
            self._unpark(now_s)
        self._settle(now_s)
        return count

    def _pass_time(self, now_s: float) -> None:
        for peer, count in self._inbox.dropped().items():
            self._complaints.add(peer, f"{count} questions more than may wait")
        for where, words in self._complaints.due(now_s):
            log.warning("from %s: %s", where, words)
            self._books.fault(where, words, now_s)
        for worker, stage, session in self._liveness.due(now_s):
            self._books.absent(worker, stage, now_s, session=session)
        if now_s - self._stepped_s > ASLEEP_S:
            log.warning("this process stood still for %.1f s; leases get their time again", now_s - self._stepped_s)
            self._tick_from_s = now_s + self._books.lease_s
        self._stepped_s = now_s
        if now_s >= self._tick_from_s:  # before that, heartbeats that waited meanwhile come in and extend the leases
            self._books.tick(now_s)

    # -- in -------------------------------------------------------------------------------------------------------

    def _take(self, happening: Happening | _Inspected | _Complaint, now_s: float) -> None:
        if isinstance(happening, Presence):
            self._on_presence(happening, now_s)
        elif isinstance(happening, _Complaint):
            self._complaints.add(happening.where, happening.words[:500])
        elif isinstance(happening, _Inspected):
            self._on_inspected(happening, now_s)
        elif not isinstance(happening, tuple):
            self._on_request(happening, now_s)

    def _line_of(self, happening: Happening | _Inspected | _Complaint) -> str:
        """Return in whose line a happening waits that is no question."""
        if not isinstance(happening, Presence):
            return ""
        return self._liveness.key_of(happening.key.removeprefix(f"{self._prefix}/alive/").split("/")[1:2][0])

    def _on_presence(self, presence: Presence, now_s: float) -> None:
        stage, _, rest = presence.key.removeprefix(f"{self._prefix}/alive/").partition("/")
        worker, _, session = rest.partition("/")
        if not presence.present:
            self._liveness.vanished((worker, stage, session), now_s)
        elif not self._liveness.back((worker, stage, session)):
            key = self._liveness.key_of(worker)
            self.crowded.add(key)
            self._complaints.add(f"{key} on alive", f"more than {TOKENS_MAX} tokens of its key")

    def _on_request(self, request: Request, now_s: float) -> None:
        is_join = request.key.startswith(topics.join(self._campaign, ""))
        kind = "join" if is_join else request.key.removeprefix(f"{self._prefix}/").partition("/")[0]
        if not self._rates.allows(request.peer, now_s, len(request.payload)):  # no answer: it is asked again later
            self._complaints.add(f"{request.peer} on {kind}", "more questions a second than a key may ask")
            return
        try:
            if request.damaged:
                raise Refused(kind, expected="the message as it was sent", got=request.damaged)
            if kind == "join":
                self._on_join(request, read(request, Join, self._books.owner_of), now_s)
            elif kind == "work":
                self._on_ask(request, read(request, Ask, self._books.owner_of), now_s)
            elif kind == "beat":
                self._answer(request, self._books.beat(read(request, Heartbeat, self._books.owner_of), now_s))
            elif kind == "result":
                self._on_report(request, read(request, Report, self._books.owner_of), now_s)
            elif kind == "control":
                self._on_control(request, read(request, Control, self._books.owner_of), now_s)
        except Refused as fault:
            if not self._on_unreadable_report(request, kind, fault, now_s):
                request.refuse(str(fault))
            self._complaints.add(f"{request.sender[:64]} on {kind}", str(fault)[:500])

    def _on_join(self, request: Request, card: Join, now_s: float) -> None:
        if self._blocked is not None:  # the worker asks again
            return
        words = objection(card, self._terms) or self._books.join(card, now_s, owner=request.peer, gone=self._is_gone)
        if not words:
            self._rates.spend(request.peer, JOIN_COST, now_s)
            self._liveness.joined((card.worker, card.stage, card.session), now_s)
        elif words != FULL:  # who waits for a place asks every few seconds
            self._complaints.add(f"{card.worker[:64]!r} joining as {card.stage}", f"refused: {words}"[:500])
        joined = Joined(
            accepted=not words,
            message=words,
            protocol=topics.PROTOCOL,
            version=self._terms.version,
            worker=card.worker,
            session=card.session,
            campaign=self._campaign,
            target=self._books.target.name,
            lease_s=self._books.lease_s,
            retry_after_s=FULL_RETRY_S if words == FULL else 0.0,
        )
        self._answer(request, joined)

    def _is_gone(self, card: Join) -> bool:
        return self._liveness.is_gone((card.worker, card.stage, card.session))

    def _on_ask(self, request: Request, ask: Ask, now_s: float) -> None:
        if self._blocked is not None:
            request.reply(wire.encode(Grant(retry_after_s=BLOCKED_RETRY_S)))
        elif not self._grant(request, ask, now_s) and not self._long_polls.add(request, ask, now_s):
            self._answer(request, Grant())

    def _on_report(self, request: Request, report: Report, now_s: float) -> None:
        if self._blocked is not None:
            return  # the worker keeps it and sends it again
        check_speaker(request.peer, report.worker, self._books.owner_of(report.worker))
        has_blobs = blobs_left(report.result) or getattr(report.result, "unread", ())
        if not (has_blobs and self._books.awaits(report)):
            self._answer(request, self._taken(report, now_s))
            self._answered += [report] if has_blobs else []
        elif self._inspections.begin(request, report):
            self._evidence.inspect(report, lambda damage: self._inbox.put(_Inspected(report, damage)))

    def _taken(self, report: Report, now_s: float, damage: str = "") -> Receipt:
        """Take a result and answer the question for work that came with it; nobody waits for work with a receipt."""
        receipt = self._books.report(report, now_s, damage)
        if report.ask is None:
            return receipt
        self._long_polls.forget(report.worker)
        grant = self._books.ask(report.ask, now_s)
        nothing = not grant.leases and not grant.stop and not grant.refused
        return msgspec.structs.replace(receipt, grant=Grant(retry_after_s=0.0) if nothing else grant)

    def _on_unreadable_report(self, request: Request, kind: str, fault: Refused, now_s: float) -> bool:
        """Count a result that arrived whole and cannot be read as a failure of its lease; False if it names none."""
        lease = None if request.damaged or kind != "result" else lease_named(request.payload)
        if lease is None or not speaks_for(request.peer, lease.worker, self._books.owner_of(lease.worker)):
            return False
        if self._blocked is None:  # otherwise it is sent again
            failure = Failure(message=told(str(fault), TOLD_CHARS_MAX))
            report = Report(worker=lease.worker, lease_id=lease.lease_id, epoch=lease.epoch, result=failure)
            receipt = self._books.report(report, now_s)
            status = "refused" if receipt.status == "accepted" else receipt.status
            self._answer(request, msgspec.structs.replace(receipt, status=status, message=failure.message))
        return True

    def _on_inspected(self, inspected: _Inspected, now_s: float) -> None:
        report, damage = inspected.report, inspected.damage
        request = self._inspections.end(report)
        if damage is None:
            self._in_trouble("the store of blobs takes no writes: no results are taken until it does", now_s)
        elif self._blocked is None:
            self._answer(request, self._taken(report, now_s, damage))
            self._answered.append(report)

    def _on_control(self, request: Request, control: Control, now_s: float) -> None:
        if self._blocked is None:
            answer = self._books.control(control, now_s)
        elif control.verb == "status":
            answer = Answer(accepted=True, status=self._books.status(now_s), message="the store takes no writes")
        else:
            answer = Answer(accepted=False, message="the store takes no writes; try again")
        data = encoded(request, self._with_own(answer, now_s))
        self._rates.spend(request.peer, len(data) / ANSWER_BYTES, now_s)
        if self._blocked is None:
            self._outbox.append((request, data))
        else:
            request.reply(data)

    def _in_trouble(self, words: str, now_s: float) -> None:
        self._trouble, self._trouble_until_s = words[:500], now_s + TROUBLE_S

    def _with_own(self, answer: Answer, now_s: float) -> Answer:
        """Add to the status what the books' own process took, and what stands in the way until it is not met again."""
        if answer.status is None:
            return answer
        trouble = self._trouble if now_s < self._trouble_until_s else answer.status.trouble
        spent_s = answer.status.processor_s + processor_s(os.getpid())
        status = msgspec.structs.replace(answer.status, trouble=trouble, processor_s=spent_s)
        return msgspec.structs.replace(answer, status=status)

    # -- long polls -----------------------------------------------------------------------------------------------

    def _grant(self, request: Request, ask: Ask, now_s: float) -> bool:
        grant = self._books.ask(ask, now_s)
        if not grant.leases and not grant.stop and not grant.refused:
            return False
        self._answer(request, grant)
        return True

    def _unpark(self, now_s: float) -> None:
        """Try the waiting polls of each stage, oldest first, until the books have nothing more for that stage."""
        for line in self._long_polls.lines():
            for poll in self._long_polls.to_try(line):
                if self._grant(poll.request, poll.ask, now_s):
                    self._long_polls.granted(line, poll)
                elif not self._long_polls.passed_over(line, poll) or not self._books.waiting_count(line[0]):
                    break
        for poll in self._long_polls.expired(now_s):
            if not self._grant(poll.request, poll.ask, now_s):
                self._answer(poll.request, Grant(retry_after_s=0.0))

    # -- out ------------------------------------------------------------------------------------------------------

    def _answer(self, request: Request, message: msgspec.Struct) -> None:
        self._outbox.append((request, encoded(request, message)))

    def _settle(self, now_s: float) -> None:
        """Commit what has changed, then send the answers and announce the facts."""
        if self._blocked is not None and now_s < self._commit_s:
            return
        batch = self._blocked if self._blocked is not None else self._books.drain()
        dropped = tuple(digest for digest in batch.dropped if digest not in self._inspections)
        try:
            self._store.commit(batch._replace(dropped=dropped))
        except Unavailable as fault:
            if self._blocked is None:
                log.error("nothing is handed out until the store takes writes again: %s", fault)
            self._blocked, self._commit_s = batch, now_s + COMMIT_RETRY_S
            self._in_trouble(f"nothing is saved or handed out: {fault}", now_s)
            return
        if self._blocked is not None:
            log.warning("the store takes writes again")
            self._blocked, self._trouble_until_s = None, 0.0
        outbox, self._outbox = self._outbox, []
        for request, data in outbox:
            request.reply(data)
        answered, self._answered = self._answered, []
        for report in answered:
            self._evidence.answered(report)
        for event in batch.events:
            self._tell(event)
        if self._store.snapshot_due:
            self._store.keep(self._books.snapshot())
        if self._ended_s is None and self._books.ended:
            self._ended_s = now_s

    def _tell(self, event: Event) -> None:
        kind = kind_of(event.fact)
        self._bus.announce(topics.event(self._campaign, kind), wire.encode(event))
        self._bus.tell(topics.event_json(self._campaign, kind), lambda: wire.encode_json(event))
        log_fact(event.fact)
