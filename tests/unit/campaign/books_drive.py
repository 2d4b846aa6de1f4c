"""Drives books by hand: every message encoded and decoded, every change committed before the answer counts."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import cast, get_args

import msgspec

from saflite.campaign.engine.state import Books
from saflite.campaign.storage.store import Store
from saflite.contract import wire
from saflite.contract.join import Join
from saflite.contract.target_info import Repeats
from saflite.contract.topics import PROTOCOL
from saflite.contract.work import Ask, Grant, Lease, Receipt, Report, Result, Stage, TargetBuild

sys.path.insert(0, str(Path(__file__).parents[2] / "farm"))

import farm_doubles as doubles
from farm_store import MemoryStore

__all__ = ["Driver", "MemoryStore", "doubles", "new_books"]


class Driver:
    """One set of books, a store (or none) and the services of the simulated farm."""

    def __init__(self, books: Books, store: Store | None = None, unix_s: float = 1.7e9) -> None:
        self.books, self.store, self.now = books, store, 100.0
        self.targets: dict[str, tuple[TargetBuild, ...]] = {}
        self.service = doubles.Service(None if store is None else store.blobs)
        books.begin(self.now, unix_s)
        self.commit()

    def commit(self) -> None:
        """Commit what changed."""
        batch = self.books.drain()
        if self.store is not None:
            self.store.commit(batch)
        self.books.validate()

    def ask(self, stage: Stage, worker: str = "a", leases_max: int = 1, cursor: int | None = None) -> tuple[Lease, ...]:
        """Ask for work, having joined; workers of the fly stage have the targets noted for them."""
        known = self.service.cursor_of(stage) if cursor is None else cursor
        targets = self.targets.get(worker, ()) if stage == "fly" else ()
        card = Join(protocol=PROTOCOL, worker=worker, stage=stage, targets=targets)
        assert not self.books.join(card, self.now)
        ask = Ask(worker=worker, stage=stage, leases_max=leases_max, cursor=known, targets=targets)
        grant = self.books.ask(ask, self.now)
        self.commit()
        return wire.decode(wire.encode(grant), Grant).leases

    def report(self, lease: Lease, result: Result, worker: str = "a") -> Receipt:
        """Hand a result in."""
        report = Report(worker=worker, lease_id=lease.lease_id, epoch=lease.epoch, result=result)
        receipt = self.books.report(wire.decode(wire.encode(report), Report), self.now)
        self.commit()
        return receipt

    def do(self, stage: Stage, worker: str = "a", many: int = 1) -> int:
        """Do up to `many` pieces of work of a stage; returns how many there were."""
        leases = self.ask(stage, worker, many)
        for lease in leases:
            receipt = self.report(lease, self.service.do(lease.work), worker)
            assert receipt.status == "accepted", receipt
        return len(leases)

    def wait_for(self, stage: Stage, worker: str, cursor: int) -> tuple[Lease, ...]:
        """Do the work of the other stages until there is some of this one; returns its leases, not done."""
        while not (leases := self.ask(stage, worker, cursor=cursor)):
            for other in get_args(Stage):
                if other != stage:
                    self.do(other, many=9)
            self.now += 0.5
            self.books.tick(self.now)
            assert not self.books.ended, f"the campaign ended without more to {stage}"
        return leases

    def run(self, workers: tuple[str, ...] = ("a", "b"), until_flights: int = 10**9) -> None:
        """Run until the campaign has ended or so many flights were flown."""
        while not self.books.ended and self.books.status(self.now).flights < until_flights:
            for stage in ("mutate", "score", "fly", "judge", "record"):
                for worker in workers:
                    self.do(stage, worker, 2)
            self.now += 0.5
            self.books.tick(self.now)
            assert self.now < 1e5, "the campaign does not end"


def new_books(budget: int = 20, *, repeats: Repeats = "bitwise", **search: object) -> Driver:
    """Books with a store in memory."""
    target = msgspec.structs.replace(doubles.TARGET, repeats=repeats)
    store = MemoryStore(doubles.campaign(budget, **search), doubles.TEMPLATE, target)  # type: ignore[arg-type]
    return Driver(store.rebuild(), cast(Store, store))
