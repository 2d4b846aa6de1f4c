"""Part of `scripts/bench defects`: what a campaign spends on making its finds smaller, and how small they become."""

from __future__ import annotations

import random
import re
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
from _inline import Flights, Inline

from saflite.campaign.presets.campaigns import load_campaign
from saflite.console.run_data.run_folder import RunFolder
from saflite.contract.flight import Flight
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Setting
from saflite.contract.work import FlyWork
from saflite.flight.autopilots.reference.defects import SETTING, TABLE

DEFECTS = 3


class Spent(NamedTuple):
    """One campaign to its end; `first_core_s` and `shrink_core_s` are processor time of flying alone.

    `inputs`: of each find that was made smaller, before and after. `first_done`: flights of all kinds when the last
    first flight had been flown.
    """

    rng_seed: int
    defects: tuple[str, ...]
    budget: int
    first_flights: int
    shrink_flights: int
    first_core_s: float
    shrink_core_s: float
    first_done: int
    inputs: tuple[tuple[int, int], ...]
    core_s: float


class Timed(Flights):
    """Notes what each flight took."""

    def __init__(self) -> None:
        super().__init__()
        self.core_s: dict[str, float] = {}
        self.count: dict[str, int] = {}
        self.first_done = 0

    def _fly(self, work: FlyWork, cancelled: Cancelled) -> tuple[Flight, bytes]:
        start_s = time.process_time()
        flown = super()._fly(work, cancelled)
        kind = work.purpose
        self.core_s[kind] = self.core_s.get(kind, 0.0) + time.process_time() - start_s
        self.count[kind] = self.count.get(kind, 0) + 1
        if kind == "search":
            self.first_done = sum(self.count.values())
        return flown


def drawn(rng_seed: int) -> tuple[str, ...]:
    """Return three planted defects by a number."""
    return tuple(random.Random(rng_seed).sample(sorted(TABLE), DEFECTS))


def made_smaller(run: RunFolder) -> Iterator[tuple[int, int]]:
    """Yield of every find made smaller how many inputs it had, and its smallest form."""
    for form in run.violations("confirmed"):
        if named := re.match("smallest form of ([0-9a-f]+)", form.message):
            yield len(run.test_case(named[1]).stimuli), len(run.test_case(form.test_case).stimuli)


def campaign(rng_seed: int, budget: int) -> Spent:
    """Run `policy-all` with three defects on, to the end of its budget and of what it makes smaller."""
    defects, start_s = drawn(rng_seed), time.process_time()
    base = load_campaign("policy-all")
    settings: dict[str, Setting] = {SETTING: list(defects)}
    target = msgspec.structs.replace(base.target, settings=settings)
    whole = msgspec.structs.replace(base, target=target, budget_flights=budget, rng_seed=rng_seed, record="none")
    flights = Timed()
    with tempfile.TemporaryDirectory(prefix="saflite-spent-") as folder:
        inline = Inline(whole, Path(folder) / "run", flights)
        status = inline.run(lambda _: False)
        inline.close()
        with RunFolder(Path(folder) / "run") as run:
            inputs = tuple(sorted(made_smaller(run)))
    shrink_s = sum(flights.core_s.get(kind, 0.0) for kind in ("shrink", "shrunk"))
    first_s, core_s = flights.core_s.get("search", 0.0), time.process_time() - start_s
    return Spent(
        *(rng_seed, defects, budget, status.flights, status.shrink_flights),
        *(round(first_s, 1), round(shrink_s, 1), flights.first_done, inputs, round(core_s, 1)),
    )
