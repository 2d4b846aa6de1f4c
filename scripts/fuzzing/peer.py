"""A valid peer of the books: it has joined every stage, holds real leases, and answers them as a worker does.

What it says then is made wrong by `mutations.py`; whatever the books raise comes out of `send`.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import farm_doubles as doubles
import msgspec
from mutations import steers

from saflite.bus.base import Reply
from saflite.bus.memory import MemoryNetwork
from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store
from saflite.console.run_data.run_folder import open_run
from saflite.console.view import live
from saflite.console.view.report import data, page
from saflite.contract import topics, wire
from saflite.contract.blobs import BlobGet, BlobOpen, BlobPut, BlobRef, ref_of
from saflite.contract.control import Answer, Control
from saflite.contract.events import Event
from saflite.contract.join import Join
from saflite.contract.test_case import identity
from saflite.contract.work import (
    Ask,
    Failure,
    Grant,
    HandedBack,
    Heartbeat,
    JudgeWork,
    Lease,
    Receipt,
    RecordWork,
    Report,
    Result,
    ScoreWork,
    Stage,
    WarmWork,
    Work,
)
from saflite.runtime.books_service import BooksService
from saflite.runtime.evidence import BlobRequests
from saflite.runtime.software import software_of

BUDGET = 300
TURNS_MAX = 60
CONTROLS = ("pause", "resume", "budget", "scorer", "shadow", "status", "events")
TAGS: dict[str, Stage] = {
    "mutated": "mutate",
    "scored": "score",
    "warmed": "score",
    "flown": "fly",
    "judged": "judge",
    "recorded": "record",
    "failed": "fly",
    "handed_back": "score",
}


class Said(NamedTuple):
    """A valid message as plain values, and where it goes."""

    key: str
    message: dict[str, Any]
    lease: Lease | None = None


class _Clock:
    def __init__(self, network: MemoryNetwork) -> None:
        self._network = network

    def monotonic_s(self) -> float:
        return 1000.0 + self._network.now_s

    def unix_s(self) -> float:
        return 1.7e9 + self._network.now_s


class Peer:
    """Books of a campaign on a bus in memory, with their real store, and the peer.

    Args:
        record: which flights the campaign records; with all of them there is a recording to report soon.
        flights: those of a round, out of twice as many candidates; with few of them there is a round to propose soon.
    """

    def __init__(self, record: str = "violations", flights: int = 20) -> None:
        shm = Path("/dev/shm")
        self.folder = Path(tempfile.mkdtemp(prefix="saflite-fuzz-", dir=shm if shm.is_dir() else None))
        self.network = MemoryNetwork()
        rounds: dict[str, Any] = {"candidates_per_round": 2 * flights, "flights_per_round": flights}
        campaign = doubles.campaign(BUDGET, **rounds, record=record)
        self.name = campaign.name
        self.store = Store.create(self.folder / "run", campaign, doubles.TEMPLATE, doubles.TARGET)
        self.books = self.store.rebuild()
        clock = _Clock(self.network)
        self.books.begin(clock.monotonic_s(), clock.unix_s())
        self.service = BooksService(self.network.connect("books"), self.name, self.books, self.store, clock)
        self.service.open()
        self.network.connect("blobs").serve(f"{topics.prefix(self.name)}/blob/*", BlobRequests(self.store.blobs).answer)
        self.bus = self.network.connect("peer")
        self.worker = doubles.Service(self.store.blobs)
        self._replies: list[Reply] = []
        self._swaps = self._seen = self._asked = 0
        for stage in topics.STAGES:
            for worker in workers(stage):
                self.ask(topics.join(self.name, stage), card(stage, worker))

    # -- talking ---------------------------------------------------------------------------------------------------

    def send(self, key: str, payload: bytes) -> Reply | None:
        """Send a message and let the books handle it; what they raise comes out here."""
        self._replies.clear()
        self._asked += 1
        self.bus.ask(key, payload, self._asked, self._replies.append, 60.0)  # type: ignore[arg-type]
        for _ in range(2):
            self.network.run_until(self.network.now_s + 0.01)
            self.service.step(0.0)
        self.network.run_until(self.network.now_s)
        return next((reply for reply in self._replies if reply.tag == self._asked), None)  # not of a poll that waited

    def ask(self, key: str, message: msgspec.Struct) -> Any:
        """Say something valid; returns the answer, which must be one."""
        reply = self.send(key, wire.encode(message))
        assert reply is not None, f"no answer to {message}"
        assert reply.payload is not None, f"{message} was refused: {reply.refused}"
        return read(key, reply.payload)

    def report(self, lease: Lease, result: Result, worker: str) -> Receipt:
        """Answer a lease as a worker does."""
        report = Report(worker=worker, lease_id=lease.lease_id, epoch=lease.epoch, result=result)
        receipt: Receipt = self.ask(topics.result(self.name, stage_of(lease)), report)
        return receipt

    # -- valid messages --------------------------------------------------------------------------------------------

    def lease(self, stage: Stage, kinds: tuple[type, ...] = ()) -> tuple[Lease, str] | None:
        """Return a lease of a stage and who holds it, doing the others' work until there is one; None at the end."""
        for turn in range(TURNS_MAX):
            for worker in workers(stage):
                for lease in self._granted(stage, worker, 1):
                    if not kinds or isinstance(lease.work, kinds):
                        return lease, worker
                    self.report(lease, self._done(lease.work), worker)
            if self.books.ended:
                return None
            if WarmWork in kinds:
                self._swaps += 1
                self.ask(topics.control(self.name, "scorer"), Control(verb="scorer", text=f"model-{self._swaps}"))
                continue
            for other in topics.STAGES:
                if other != stage:
                    self._work(other, turn)
            self.network.run_until(self.network.now_s + 0.2)
        return None

    def _work(self, stage: Stage, turn: int) -> None:
        worker = workers(stage)[turn % 2]
        for lease in self._granted(stage, worker, 16):
            self.report(lease, self._done(lease.work), worker)

    def _done(self, work: Work) -> Result:
        """Do work as its stage does; a flight whose digest is another's could not be refused, and is found here."""
        if isinstance(work, JudgeWork | RecordWork) and work.flight.trace is not None:
            name = identity(work.test_case)
            if doubles.flown(name, work.flight.flight_index)[1] != work.flight.trace_digest:
                return Failure(message="the trace is not the flight's", unread=(work.flight.trace,))
        return self.worker.do(work)

    def _granted(self, stage: Stage, worker: str, many: int) -> tuple[Lease, ...]:
        cursor = self.worker.cursor_of(stage)
        ask = Ask(worker=worker, stage=stage, session="life", leases_max=many, wait_s=0.0, cursor=cursor)
        grant: Grant = self.ask(topics.work(self.name, stage), ask)
        if grant.refused:
            self.ask(topics.join(self.name, stage), card(stage, worker))
        return grant.leases

    def valid(self, kind: str, number: int) -> Said | None:
        """Return a valid message of a kind, None where the campaign has come to its end."""
        verb, _, rest = kind.partition(" ")
        stage = topics.STAGES[number % len(topics.STAGES)]
        worker = workers(stage)[number % 2]
        if verb == "Report":
            return self._result(rest)
        if verb == "Join":
            return Said(topics.join(self.name, stage), plain(card(stage, f"other-{number % 50}")))
        if verb == "Ask":
            ask = Ask(worker=worker, stage=stage, session="life", wait_s=0.5, targets=card("fly", "w").targets)
            return Said(topics.work(self.name, stage), plain(ask))
        if verb == "Heartbeat":
            beat = Heartbeat(worker=worker, stage=stage, session="life", leases=((f"run:{stage}/0", 1),), done=3)
            return Said(topics.beat(self.name, stage), plain(beat))
        if verb == "Control":
            order = CONTROLS[number % len(CONTROLS)]
            control = Control(verb=order, text="gap", number=BUDGET)  # type: ignore[arg-type]
            return Said(topics.control(self.name, order), plain(control))
        return self._blob(verb, b"some bytes %d" % (number % 100))

    def _result(self, tag: str) -> Said | None:
        kinds = {"warmed": (WarmWork,), "scored": (ScoreWork,)}.get(tag, ())
        found = self.lease(TAGS[tag], kinds)
        if found is None:
            return None
        lease, worker = found
        done = self._done(lease.work) if tag != "failed" else None  # done, a scorer need not be told all again
        result = HandedBack(message="x") if tag == "handed_back" else done or Failure(message="x")
        report = Report(worker=worker, lease_id=lease.lease_id, epoch=lease.epoch, result=result)
        return Said(topics.result(self.name, stage_of(lease)), plain(report), lease)

    def _blob(self, verb: str, content: bytes) -> Said:
        ref: BlobRef = ref_of(content)
        message: dict[str, msgspec.Struct] = {
            "BlobOpen": BlobOpen(worker="w-fly-a", keep=(ref.digest,)),
            "BlobGet": BlobGet(digest=ref.digest, offset=0, length=100),
            "BlobPut": BlobPut(worker="w-fly-a", ref=ref, data=content),
        }
        name = verb.removeprefix("Blob").lower()
        return Said(topics.blob(self.name, name), plain(message[verb]))  # type: ignore[arg-type]

    def settle(self, said: Said) -> None:
        """Give back a lease that the message did not end, so that the campaign goes on."""
        if said.lease is not None:
            self.report(said.lease, HandedBack(message="after all"), said.message["worker"])
        elif "/control/" in said.key and self.books.status(self.network.now_s).state == "paused":
            self.ask(topics.control(self.name, "resume"), Control(verb="resume"))

    # -- the end ---------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Check that the books balance, can be read again, and that people can be shown all that was said."""
        try:
            self.books.validate()
            self.look()
            again = self.store.rebuild()
            again.begin(0.0, 1.7e9)
            again.validate()
            self.store.close()
            found = audit(self.folder / "run")
            assert found["clean"], found
            shown = page.render(data.read(open_run(self.folder / "run")), "run")
            assert "<script>alert" not in shown, "the report holds a script that a message brought"
            assert "<img src=x" not in shown, "the report holds markup that a message brought"
        finally:
            shutil.rmtree(self.folder, ignore_errors=True)

    def look(self) -> None:
        """Show the campaign as the live screen and the watcher do."""
        from rich.console import Console

        answer: Answer = self.ask(topics.control(self.name, "status"), Control(verb="status"))
        assert answer.status is not None
        with Path("/dev/null").open("w") as nowhere:
            Console(file=nowhere, width=120).print(live._drawn(answer.status))
        assert live.one_line(answer.status)
        for event in self._events():
            assert not steers(live.fact_text(event.fact)), event

    def _events(self) -> Iterable[Event]:
        """Yield the events not looked at yet."""
        while True:
            control = Control(verb="events", number=self._seen + 1)
            answer: Answer = self.ask(topics.control(self.name, "events"), control)
            if not answer.events:
                return
            for fact in answer.events:
                event = wire.decode(fact, Event)
                self._seen = event.seq
                yield event


def workers(stage: Stage) -> tuple[str, str]:
    """Return the names of the two workers of a stage: some re-flights want another than the first."""
    return f"w-{stage}-a", f"w-{stage}-b"


def stage_of(lease: Lease) -> Stage:
    """Return the stage a lease is of."""
    word: str = lease.work.__struct_config__.tag  # type: ignore[assignment]
    return "score" if word == "warm" else word  # type: ignore[return-value]


def card(stage: Stage, worker: str) -> Join:
    """Return what a worker of the peer says of itself."""
    said = {"protocol": topics.PROTOCOL, "worker": worker, "session": "life", "stage": stage, "host": "h"}
    targets = [{"name": doubles.TARGET.name, "build": ""}]
    return msgspec.convert({**said, "software": software_of(stage), "targets": targets, "labels": {"gpu": "1"}}, Join)


def plain(message: msgspec.Struct) -> dict[str, Any]:
    """Return a message as plain values."""
    found: dict[str, Any] = msgspec.to_builtins(message, builtin_types=(bytes,))
    return found


def read(key: str, payload: bytes) -> Any:
    """Return an answer of the books; raises Refused where it does not fit its own type."""
    kind = key.split("/")[3] if not key.startswith(topics.JOIN_ROOT) else ""
    for row in topics.TOPICS:
        mine = row.root == topics.JOIN_ROOT if not kind else row.pattern.startswith(f"{kind}/")
        exact = "{" in row.pattern or row.pattern == "/".join(key.split("/")[3:])
        if mine and exact and row.answer is not None:
            return wire.decode(payload, row.answer)
    raise AssertionError(f"no answer is known on {key}")
