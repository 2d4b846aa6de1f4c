"""The whole farm in one thread: virtual clock, seeded faulty bus, members that die and freeze, checks after each step.

One number, the seed, decides everything: `run_seed(17)` is the same run on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import farm_doubles as doubles
import msgspec
import numpy as np
from farm_blobs import FarmWorkerBlobs
from farm_checks import Ghost, at_the_end, at_the_end_of_a_clean_run, journal_is_the_state
from farm_members import BooksMember, members
from farm_shapes import CALM, SEARCHES, Shape, campaign_of, clean, shape_of
from farm_store import MemoryStore

from saflite.bus.base import Happening, Reply
from saflite.bus.faulty import FaultyNetwork
from saflite.campaign.scheduling.work_keys import FlyKey, JudgeKey
from saflite.contract import topics, wire, work
from saflite.contract.control import Control
from saflite.contract.errors import Refused
from saflite.contract.rng import derive

CHAOS_S = 40.0
"""Until when, in virtual seconds, faults are made; after that the farm must come to its end by itself."""

LIMIT_S = 900.0
"""A campaign that has not ended by then, long after the last fault, never will."""


class Report(NamedTuple):
    """How a run went."""

    found: frozenset[tuple[str, str, str]]
    set_aside: int
    fallbacks: int
    faults: int
    steps: int
    virtual_s: float
    flights: int
    orders: int


@dataclass
class World:
    """One run."""

    seed: int
    shape: Shape
    faults: int = 0
    steps: int = 0
    orders: int = 0
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = derive(self.seed, "world")
        self.campaign = campaign_of(self.shape)
        self.network = FaultyNetwork(self.seed, self.shape.trouble)
        target = msgspec.structs.replace(doubles.TARGET, repeats=self.shape.repeats)
        self.store = MemoryStore(self.campaign, doubles.TEMPLATE, target)
        self.ghost = Ghost(self.store)
        self.books = BooksMember(self.network, self.store, self.rng)
        blobs = self.store.blobs
        self.workers = members(self.network, self.campaign.name, self.shape, self.ghost, self.rng, blobs)
        self.enemy = self.network.connect("enemy")

    def run(self) -> Report:
        """Run to the end of the campaign, checking all the way."""
        self.books.start()
        for worker in self.workers:
            worker.babbles = self.shape.babbles
            worker.wedges, worker.breaks = self.shape.wedges, self.shape.breaks
            worker.strategy_ends = self.shape.strategy_ends
            self.network.later(float(self.rng.random()), worker.start)
        self._tick()
        if self.shape.chaos_per_s:
            self._chaos()
        self.network.later(CHAOS_S, self._calm_down)
        while not self._over():
            assert self.network.step(), "nothing is under way any more"
            self.steps += 1
            self.books.step()
            self.ghost.look()
            if self.steps % 400 == 0:
                self._compare_with_journal()
            assert self.network.now_s < LIMIT_S, f"not ended after {LIMIT_S} s: {self._where_it_hangs()}"
        return self._report()

    def _over(self) -> bool:
        books = self.books.books
        ended = books is not None and books.ended and not self.books.frozen
        return ended and books is not None and books.status(0.0).seq == len(self.store.all_events)

    def _compare_with_journal(self) -> None:
        """Where everything is committed, the journal must be the state."""
        books = self.books.books
        service = self.books.service
        if books is not None and service is not None and service._blocked is None and not books._out.waiting:
            journal_is_the_state(self.store, books)

    def _where_it_hangs(self) -> str:
        books = self.books.books
        return "no books" if books is None else str(books.status(self.network.now_s))

    def _report(self) -> Report:
        assert self.books.books is not None
        status = self.books.books.status(self.network.now_s)
        at_the_end(self.ghost, self.store, self.books.books, status)
        if self.shape == clean(self.shape):
            at_the_end_of_a_clean_run(self.ghost, self.shape.simulators, self.books.books)
        return Report(
            self.ghost.found(),
            self.ghost.set_aside(),
            status.fallbacks,
            self.faults + self.network.lost + self.network.doubled + self.network.cut,
            self.steps,
            self.network.now_s,
            status.flights,
            self.orders,
        )

    # ---- time and trouble ----------------------------------------------------------------------------------------

    def _tick(self) -> None:
        """Let the books' shell notice that time passes."""
        self.books.must_tick = True
        self.network.later(0.25, self._tick)

    def _chaos(self) -> None:
        if self.network.now_s > CHAOS_S:
            return
        self.faults += 1
        actions = (
            self._kill_worker,
            self._kill_worker,
            self._freeze_worker,
            self._stop_worker,
            self._kill_books,
            self._kill_books_in_commit,
            self._freeze_books,
            self._part,
            self._fill_disk,
            self._damage_blob,
            self._send_garbage,
            self._ask_unasked,
            self._lie,
            self._lie,
            self._order,
        )
        actions[int(self.rng.integers(len(actions)))]()
        self.network.later(float(self.rng.exponential(1.0 / self.shape.chaos_per_s)), self._chaos)

    def _calm_down(self) -> None:
        self.network.trouble = CALM
        self.network.heal()
        for worker in self.workers:
            worker.babbles = worker.wedges = worker.breaks = 0.0
        if self.books.books is not None and self.books.books.status(0.0).state == "paused":
            self._control(Control(verb="resume"))
        self.network.later(5.0, self._calm_down)

    def _any_worker(self) -> int:
        return int(self.rng.integers(len(self.workers)))

    def _kill_worker(self) -> None:
        self.workers[self._any_worker()].die()

    def _freeze_worker(self) -> None:
        self.workers[self._any_worker()].freeze(float(self.rng.random() * 8.0))

    def _stop_worker(self) -> None:
        self.workers[self._any_worker()].stop()

    def _kill_books(self) -> None:
        if self.books.service is not None:
            self.books.die()

    def _kill_books_in_commit(self) -> None:
        self.store.crash_next = "before" if self.rng.random() < 0.5 else "after"

    def _freeze_books(self) -> None:
        self.books.frozen = True
        self.network.later(float(self.rng.random() * 5.0), self._thaw_books)

    def _thaw_books(self) -> None:
        self.books.frozen = False

    def _part(self) -> None:
        names = [worker.name for worker in self.workers]
        island = self.rng.choice(names, size=int(self.rng.integers(1, len(names))), replace=False)
        self.network.part(frozenset(island.tolist()))
        self.network.later(float(self.rng.random() * 6.0), self.network.heal)

    def _fill_disk(self) -> None:
        self.store.full = True
        self.network.later(float(self.rng.random() * 4.0), self._empty_disk)

    def _empty_disk(self) -> None:
        self.store.full = False

    def _damage_blob(self) -> None:
        """Damage or remove a trace that waits to be judged, or what a worker has left and not reported."""
        blobs, books = self.store.blobs, self.books.books
        waiting = [] if books is None else [task.key for task in books._core.tasks if isinstance(task.key, JudgeKey)]
        flights = [books._reducer.flight_of(key) for key in waiting] if books is not None else []
        traces = [flight.trace for flight in flights if flight.trace is not None and flight.trace.digest in blobs.kept]
        if traces and self.rng.random() < 0.6:
            name = traces[int(self.rng.integers(len(traces)))].digest
            spoiled = [flight for flight in flights if flight.trace is not None and flight.trace.digest == name]
            self.ghost.spoiled.update((flight.test_case, flight.flight_index) for flight in spoiled)
            if self.rng.random() < 0.5:
                del blobs.kept[name]
                blobs.lost.add(name)
            else:
                blobs.kept[name] = b"\0" + blobs.kept[name][1:]
        elif blobs.left:
            del blobs.left[list(blobs.left)[int(self.rng.integers(len(blobs.left)))]]

    def _send_garbage(self) -> None:
        """Bits that mean nothing, and messages of this farm replayed, changed and out of place."""
        stage = str(self.rng.choice(["mutate", "score", "fly", "judge", "record"]))
        key = str(self.rng.choice([topics.work("farm-test", "fly"), f"saflite/2/farm-test/result/{stage}"]))
        if self.ghost.reports and self.rng.random() < 0.7:
            report = self.ghost.reports[-1 - int(self.rng.integers(min(4, len(self.ghost.reports))))]
            if self.rng.random() < 0.3:
                epoch = report.epoch + int(self.rng.integers(-1, 2))
                report = msgspec.structs.replace(report, worker=f"fly-{self.rng.integers(4)}", epoch=epoch)
            data = bytearray(wire.encode(report))
            if self.rng.random() < 0.5:
                place = int(self.rng.integers(len(data)))
                data[place] ^= 1 << int(self.rng.integers(8))
            payload = bytes(data)
            if payload != wire.encode(report) and _readable(payload):
                return  # the seal of the real bus stops what still can be read
        else:
            payload = self.rng.bytes(int(self.rng.integers(0, 60)))
        self.enemy.ask(key, payload, "garbage", lambda happening: None, 1.0)

    def _ask_unasked(self) -> None:
        """Ask for work without having joined, under a name of its own or that of a worker."""
        stage, books = str(self.rng.choice(topics.STAGES)), self.books.books
        if books is not None:  # it knows where there is something to be had
            stage = max((stage, *topics.STAGES), key=lambda one: bool(books._core.tasks.waiting_count(one)))  # type: ignore[arg-type]
        worker = str(self.rng.choice(["enemy", f"{stage}-0"]))
        ask = work.Ask(worker=worker, stage=stage, session="stolen", leases_max=4, wait_s=0.0)  # type: ignore[arg-type]
        key = topics.work("farm-test", ask.stage)
        self.enemy.ask(key, wire.encode(ask), "unasked", self._is_refused, 1.0)

    @staticmethod
    def _is_refused(happening: Happening) -> None:
        if isinstance(happening, Reply) and happening.payload is not None:
            assert not wire.decode(happening.payload, work.Grant).leases, "work was given to who has not joined"

    def _lie(self) -> None:
        """Hand in flights somebody else was asked to fly."""
        books = self.books.books
        if books is None:
            return
        for task in books._core.tasks.leased():
            if isinstance(task.key, FlyKey):
                flying = work.FlyWork(
                    test_case=books._reducer.test_case_of(task.key),
                    flight_index=task.key.index,
                    purpose=task.key.purpose,
                    noise=task.key.index,
                    wall_limit_s=1.0,
                )
                flown = doubles.fly(flying, FarmWorkerBlobs(self.store.blobs, "enemy"))
                flight = msgspec.structs.replace(flown.flight, build=task.target.build if task.target else "")
                result = work.FlyResult(flight=flight)
                lie = work.Report(worker="enemy", lease_id=f"run:{task.key}", epoch=task.epoch, result=result)
                key = topics.result("farm-test", "fly")
                self.enemy.ask(key, wire.encode(lie), "lie", lambda happening: None, 1.0)

    def _order(self) -> None:
        verb = str(self.rng.choice(["pause", "resume", "scorer", "shadow", "stop", "budget"]))
        self.orders += verb in ("scorer", "budget")
        text = str(self.rng.choice(["another", "broken", "scripted"])) if verb in ("scorer", "shadow") else ""
        number = self.shape.budget + int(self.rng.integers(-6, 6)) if verb == "budget" else 0
        if verb == "stop":
            self._control(Control(verb="pause"))
            verb = "resume"
        self._control(Control(verb=verb, text=text, number=number))  # type: ignore[arg-type]
        if verb == "pause":
            self.network.later(3.0, lambda: self._control(Control(verb="resume")))

    def _control(self, control: Control) -> None:
        key = topics.control("farm-test", control.verb)
        self.enemy.ask(key, wire.encode(control), "order", lambda happening: None, 1.0)


def _readable(payload: bytes) -> bool:
    try:
        wire.decode(payload, work.Report)
    except Refused:
        return False
    return True


Found = frozenset[tuple[str, str, str]]


@cache
def _clean_find(reference: Shape) -> Found:
    """What a search finds without trouble."""
    return World(10**6 + reference.search_seed, reference).run().found


def run_seed(seed: int) -> Report:
    """Run one seed and compare what it found with the same search without trouble; raises AssertionError."""
    shape = shape_of(seed)
    report = World(seed, shape).run()
    if not (report.set_aside or report.fallbacks or report.orders):
        expected = _clean_find(clean(shape))
        assert report.found == expected, (
            f"the same search found other things under trouble: {sorted(report.found ^ expected)}"
        )
    return report


def know_the_clean_finds() -> None:
    """Make the references to compare with; before a bug is planted, or they would have it, too."""
    for seed in range(SEARCHES):
        _clean_find(clean(shape_of(seed)))
