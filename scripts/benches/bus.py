"""The books over the real bus: throughput, processor share, waiting times, and 100,000 damaged messages.

Everything is real but the doing of the work: the books run in their own process with the router and the SQLite store,
a generator of simulated workers polls them over Zenoh from this process.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
from _load_generator import LoadGenerator, Made, percentile_ms

from saflite.bus.base import Bus, Reply, Sample, seal, unseal
from saflite.bus.private_socket import PrivateSocket
from saflite.bus.zenoh import ZenohBus, leave_process, open_client
from saflite.campaign.presets.campaigns import template
from saflite.campaign.storage.store import Store
from saflite.contract import topics, wire
from saflite.contract.config import Campaign, LeaseConfig, ScorerConfig, SearchConfig
from saflite.contract.control import Answer, Control
from saflite.contract.errors import Refused
from saflite.contract.events import Event, FaultSeen, ViolationFound
from saflite.contract.rng import derive
from saflite.contract.work import Ask, Failure, Grant, Heartbeat, Orders, Receipt, Report, Stage
from saflite.evidence.folder import WorkerFolder
from saflite.flight.autopilots.reference.describe import describe
from saflite.runtime.clock import WallClock

CAMPAIGN = "bench-bus"
SESSIONS = 8
BESIDE: dict[Stage, int] = {"mutate": 1, "score": 4}
JUDGES = 8
PER_ROUND = 8  # as in the built-in campaigns, but 400 rounds at once, so that work is always there to hand out


class BooksProcess(NamedTuple):
    """The books under measurement."""

    pid: int
    endpoint: str
    run_dir: Path

    def cpu_s(self) -> float:
        """Return the processor time used so far."""
        fields = Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def resident_mib(self) -> float:
        """Return the memory in use."""
        pages = int(Path(f"/proc/{self.pid}/statm").read_text().split()[1])
        return round(pages * os.sysconf("SC_PAGE_SIZE") / 2**20, 1)


def campaign(budget: int, per_round: int) -> Campaign:
    """Return a campaign with much to do at once and no recordings."""
    return Campaign(
        name=CAMPAIGN,
        mission="mission2",
        budget_flights=budget,
        search=SearchConfig(candidates_per_round=per_round, flights_per_round=per_round, lag=400),
        scorer=ScorerConfig(model="constant", batch=40),
        lease=LeaseConfig(lease_s=10.0),
        record="none",
    )


@contextmanager
def books_process(what: Campaign) -> Iterator[BooksProcess]:
    """Run the books in a process of their own for a while."""
    with tempfile.TemporaryDirectory(prefix="saflite-bench-") as folder, PrivateSocket() as socket:
        run_dir = Path(folder) / "run"
        Store.create(run_dir, what, template(what), describe()).close()
        endpoint = socket.endpoint
        command = [sys.executable, "-m", "saflite.runtime.serve", "books", "--campaign", what.name]
        command += ["--listen", endpoint, "--run-dir", str(run_dir), "--parent", str(os.getpid())]
        with (Path(folder) / "books.log").open("wb") as sink:
            process = subprocess.Popen(command, stderr=sink)
        try:
            yield BooksProcess(process.pid, endpoint, run_dir)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(10)


def throughput(seconds: float, workers: int, rate: float) -> dict[str, Any]:
    """Pace `workers` simulated ones, nearly all flyers, so that about `rate` results a second go through the books."""
    think_s = workers / (rate / 2)  # each flight gives two results: the flight and its verdict
    with books_process(campaign(1_000_000, PER_ROUND)) as books:
        buses = [open_client(f"generator-{number}", books.endpoint) for number in range(SESSIONS)]
        follower = open_client("follower", books.endpoint)
        events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        follower.follow(topics.event(CAMPAIGN, "violation"), _stamped(events))
        made = Made(cache(lambda worker: WorkerFolder(books.run_dir, worker)))
        generator = LoadGenerator(buses, CAMPAIGN, made, think_s)
        _fill(generator, workers, think_s)
        generator.grant_s, generator.receipt_s, generator.reports = [], [], 0
        cpu_s, began_s = books.cpu_s(), WallClock().monotonic_s()
        generator.run_for(seconds)
        passed_s = WallClock().monotonic_s() - began_s
        figures = {
            "workers": workers,
            "results_per_s": round(generator.reports / passed_s, 1),
            "books_cpu_share": round((books.cpu_s() - cpu_s) / passed_s, 3),
            "books_ms_per_result": round(1000.0 * (books.cpu_s() - cpu_s) / max(1, generator.reports), 3),
            "books_resident_mib": books.resident_mib(),
            "grant_p50_ms": percentile_ms(generator.grant_s, 50),
            "grant_p99_ms": percentile_ms(generator.grant_s, 99),
            "receipt_p50_ms": percentile_ms(generator.receipt_s, 50),
            "receipt_p99_ms": percentile_ms(generator.receipt_s, 99),
            **_latencies(events, generator),
        }
        for bus in [*buses, follower]:
            bus.close()
    return figures


def _fill(generator: LoadGenerator, workers: int, think_s: float) -> None:
    """Let the generator work until rounds of work lie ready and `workers` of all stages are spread out evenly."""
    for stage, count in BESIDE.items():
        generator.join(stage, count)
    generator.run_for(15)
    generator.join("judge", JUDGES)
    flyers = workers - JUDGES - sum(BESIDE.values())
    for tenth in range(10):
        generator.join("fly", flyers * (tenth + 1) // 10 - flyers * tenth // 10)
        generator.run_for(think_s / 10)
    generator.run_for(think_s + 1)


def _stamped(events: queue.SimpleQueue[Any]) -> Any:
    clock = WallClock()
    return lambda sample: events.put((clock.monotonic_s(), sample))


def _latencies(events: queue.SimpleQueue[Any], generator: LoadGenerator) -> dict[str, Any]:
    """Return how long after its last result a violation reached a subscriber."""
    waits: list[float] = []
    while not events.empty():
        at_s, sample = events.get()
        assert isinstance(sample, Sample)
        fact = wire.decode(sample.payload, Event).fact
        if isinstance(fact, ViolationFound):
            reported_s = generator.reported_at_s.get(fact.violation.test_case, ())
            waits += [at_s - max(before)] if (before := [sent_s for sent_s in reported_s if sent_s < at_s]) else []
    return {
        "violations": len(waits),
        "violation_event_p50_ms": percentile_ms(waits, 50),
        "violation_event_p99_ms": percentile_ms(waits, 99),
    }


def damaged_to_books(count: int) -> dict[str, Any]:
    """Send `count` damaged messages of every kind to real books; none may be taken, the books must live on."""
    with books_process(campaign(1_000, per_round=8)) as books:
        bus = open_client("damaging", books.endpoint)
        client: queue.SimpleQueue[Any] = queue.SimpleQueue()
        _status(bus, client)
        before = books.resident_mib()
        refused = silent = taken = 0
        rng = derive(1, "damaging")
        samples = _samples()
        replies: queue.SimpleQueue[Any] = queue.SimpleQueue()
        under_way = 0
        for number in range(count):
            key, data = samples[number % len(samples)]
            payload, attachment = _damage(rng, data, seal(key, "damaging", data), number)
            _send_raw(bus, key, payload, attachment, number, replies)
            under_way += 1
            while under_way > 200 or (number == count - 1 and under_way):
                reply = replies.get(timeout=60)
                under_way -= 1
                taken += reply.payload is not None
                refused += bool(reply.refused)
                silent += reply.payload is None and not reply.refused
        status = _status(bus, client)
        bus.close()
        return {
            "damaged_messages": count,
            "refused": refused,
            "unanswered": silent,
            "accepted": taken,
            "books_alive": Path(f"/proc/{books.pid}").exists() and status.accepted,
            "books_growth_mib": round(books.resident_mib() - before, 1),
        }


def damaged_to_workers(count: int) -> dict[str, Any]:
    """Feed `count` damaged answers of every kind through the unsealing and decoding every worker does."""
    rng = derive(2, "damaging")
    accepted = 0
    messages: list[msgspec.Struct] = [
        Grant(), Orders(cancel=("a",)), Receipt(lease_id="a", epoch=1, status="accepted"), Answer(accepted=True),
        Event(seq=1, at_unix_s=0.0, fact=FaultSeen(where="a", message="b")),
    ]  # fmt: skip
    for number in range(count):
        message = messages[number % len(messages)]
        data = wire.encode(message)
        payload, attachment = _damage(rng, data, seal("k", "books", data), number)
        if unseal("k", attachment, payload)[1]:
            continue
        try:
            wire.decode(payload, type(message))
        except Refused:
            continue
        accepted += 1
    return {"damaged_answers": count, "answers_accepted": accepted}


def _samples() -> list[tuple[str, bytes]]:
    report = Report(worker="damaging", lease_id="fly/1", epoch=1, result=Failure(message="x" * 40))
    return [
        (topics.work(CAMPAIGN, "fly"), wire.encode(Ask(worker="damaging", stage="fly", wait_s=0.0))),
        (topics.result(CAMPAIGN, "fly"), wire.encode(report)),
        (topics.beat(CAMPAIGN, "fly"), wire.encode(Heartbeat(worker="damaging", stage="fly", leases=(("a", 1),)))),
        (topics.control(CAMPAIGN, "stop"), wire.encode(Control(verb="stop"))),
    ]


def _damage(rng: Any, payload: bytes, attachment: bytes, number: int) -> tuple[bytes, bytes]:
    """Return the message with flipped bits, cut short, lengthened, made of noise, or with another message's seal."""
    kind = number // 4 % 5
    body = bytearray(payload)
    if kind == 0:
        for _ in range(int(rng.integers(1, 4))):
            body[int(rng.integers(len(body)))] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        del body[int(rng.integers(len(body))) :]
    elif kind == 2:
        body += rng.integers(0, 256, int(rng.integers(1, 64)), dtype="uint8").tobytes()
    elif kind == 3:
        body = bytearray(rng.integers(0, 256, int(rng.integers(1, 200)), dtype="uint8").tobytes())
    else:
        attachment = seal("other/key", "damaging", payload)
    if kind < 4 and bytes(body) == payload:
        body.append(0)  # the flips undid each other
    return bytes(body), attachment


def _send_raw(
    bus: ZenohBus, key: str, payload: bytes, attachment: bytes, tag: int, inbox: queue.SimpleQueue[Any]
) -> None:
    bus.ask(key, payload, tag, inbox.put, 30.0, attachment=attachment)


def _status(bus: Bus, inbox: queue.SimpleQueue[Any]) -> Answer:
    payload = wire.encode(Control(verb="status"))
    for attempt in range(50):
        bus.ask(topics.control(CAMPAIGN, "status"), payload, attempt, inbox.put, 2.0)
        reply: Reply = inbox.get(timeout=10)
        if reply.payload is not None:
            return wire.decode(reply.payload, Answer)
        WallClock().sleep_s(0.1)
    raise AssertionError("the books do not answer")


def main(argv: list[str]) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="scripts/bench bus", description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--rate", type=float, default=500.0, help="results per second to pace the generator at")
    parser.add_argument("--workers", help="only pace so many, one count after the other: 300,1000")
    parser.add_argument("--damaged", type=int, default=100_000)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    if options.workers:
        for count in map(int, options.workers.split(",")):
            row = {**throughput(options.seconds, count, options.rate), "load_1min": round(os.getloadavg()[0], 1)}
            print(json.dumps(row), flush=True)
        leave_process(0)
    figures = {
        "polling_1000": throughput(options.seconds, 1000, options.rate),
        "polling_100": throughput(options.seconds, 100, min(options.rate, 200.0)),
        "damaged": {**damaged_to_books(options.damaged), **damaged_to_workers(options.damaged)},
    }
    if options.json:
        print(json.dumps(figures))
    else:
        for name, rows in figures.items():
            print(name)
            for key, value in rows.items():
                print(f"  {key:24} {value}")
    sys.stdout.flush()
    good = figures["damaged"]["accepted"] == figures["damaged"]["answers_accepted"] == 0
    leave_process(0 if good else 1)
