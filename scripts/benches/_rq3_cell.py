"""One campaign of `scripts/bench rq3`: a strategy, a mission, a way to choose among its mutants, a seed.

As in the SaFliTe paper's tools a round proposes five mutants, one of which is flown before the next round; without
choice it proposes one. All flights of the budget are search flights; what they violate is flown again apart from it.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar

import msgspec
from _inline import Flights, Inline

from saflite.campaign.presets.campaigns import load_campaign
from saflite.campaign.storage.contents import Contents
from saflite.contract.config import Campaign, ScorerConfig, StrategyConfig
from saflite.contract.flight import Flight
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Obstacle, TestCase, identity
from saflite.contract.work import FlyWork, Outcome
from saflite.flight.autopilots.reference.describe import describe
from saflite.flight.planner.kinematic import KinematicFlight
from saflite.scorer_pool.models import low_fidelity

STRATEGIES = ("deephyperion", "camba", "tumb", "random_boxes", "near_miss")
MISSIONS = (2, 3, 4, 5, 6, 7)
CHOOSERS: dict[str, str] = {
    "none": "constant",
    "random": "random",
    "gap": "gap",
    "kinematic": "low_fidelity",
    "blend": "blend",
    "surrogate": "surrogate",
}
"""How one of five mutants is chosen, and the scorer that does it; `ollama:TAG` besides."""

Key = TypeVar("Key", bound=Hashable)
Value = TypeVar("Value")
MUTANTS = 5
POPULATION = 10  # of the strategies that begin with random layouts: a quarter of the budget
DEADLINE_S = 1800.0  # for the choice of one of five: however slow a model is, it is the model that chooses
SHARED_MEMORY = Path("/dev/shm")


class Cell(msgspec.Struct, frozen=True, order=True):
    """One campaign to run. `flights` is its budget."""

    rng_seed: int
    mission: int
    strategy: str
    chooser: str
    flights: int = 40


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """One flight that violated: its number from 1, the distance, the behaviour's key, the boxes (l, w, h, x, y, r)."""

    flight: int
    distance_m: float
    behaviour: str
    boxes: tuple[tuple[float, ...], ...]


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """What a campaign came to. `core_s` is processor time at the end of each flight, scoring and books included.

    `answered_by_others` counts scores that the embedded scorer gave in the place of the one asked.
    """

    cell: Cell
    build: str
    distances_m: tuple[float, ...]
    core_s: tuple[float, ...]
    simulated_s: float
    found: tuple[Found, ...]
    answered_by_others: int = 0


class Memory:
    """What cells of one mission and seed share: many fly, really or cheaply, what another one flew, and are charged it.

    The reference target and the cheap flights are deterministic, so only time is saved; `owed_s` is the processor time
    that was remembered instead of spent, since it was last set to 0.
    """

    def __init__(self) -> None:
        self.flights: dict[tuple[str, int], tuple[Flight, bytes]] = {}
        self.cheap: dict[tuple[str, int], KinematicFlight] = {}
        self.cost_s: dict[object, float] = {}
        self.owed_s = 0.0

    def of(self, kept: dict[Key, Value], key: Key, make: Callable[[], Value]) -> Value:
        """Return what is kept under the key, made now if it is not."""
        if key in kept:
            self.owed_s += self.cost_s[key]
            return kept[key]
        began_s = time.process_time()
        kept[key] = make()
        self.cost_s[key] = time.process_time() - began_s
        return kept[key]


class Timed(Flights):
    """Flies, or remembers; notes the processor time spent or owed when a flight has landed."""

    def __init__(self, memory: Memory) -> None:
        super().__init__()
        self._memory = memory
        self.simulated_s = 0.0
        self.core_s: list[float] = []

    def _fly(self, work: FlyWork, cancelled: Cancelled) -> tuple[Flight, bytes]:
        fly = super()._fly
        flight, packed = self._memory.of(
            self._memory.flights, (identity(work.test_case), work.noise), lambda: fly(work, cancelled)
        )
        self.simulated_s += flight.simulated_s
        self.core_s.append(time.process_time() + self._memory.owed_s)
        return flight, packed


@contextmanager
def remembered(memory: Memory) -> Iterator[None]:
    """Let the cheap flights of the scorers be remembered as well."""
    fly = low_fidelity._fly

    def cheaply(test_case: TestCase, number: int) -> KinematicFlight:
        return memory.of(memory.cheap, (identity(test_case), number), lambda: fly(test_case, number))

    low_fidelity._fly = cheaply
    try:
        yield
    finally:
        low_fidelity._fly = fly


def scorer_of(chooser: str) -> str:
    """Return the label of the scorer that chooses."""
    return CHOOSERS.get(chooser, chooser)


def campaign_of(cell: Cell) -> Campaign:
    """Return the built-in campaign of the mission with the cell's strategy and choice."""
    base = load_campaign(f"avoidance-m{cell.mission}")
    settings = {"population": POPULATION} if cell.strategy in ("deephyperion", "near_miss") else {}
    rhythm = {
        "candidates_per_round": 1 if cell.chooser == "none" else MUTANTS,
        "flights_per_round": 1,
        "lag": 1,
        "random_share": 0.0,
        "novelty_weight": 0.0,
        "confirm_flights": 0,
        "confirm_needed": 1,
        "check_share": 0.0,
        "shrink": False,
    }
    return msgspec.structs.replace(
        base,
        name="rq3",
        strategy=StrategyConfig(name=cell.strategy, settings=dict(settings)),
        scorer=ScorerConfig(model=scorer_of(cell.chooser), batch=MUTANTS, cascade=False, deadline_s=DEADLINE_S),
        search=msgspec.structs.replace(base.search, **rhythm),
        budget_flights=cell.flights,
        rng_seed=cell.rng_seed,
        record="none",
    )


def run(cell: Cell, memory: Memory) -> Row:
    """Run one campaign to the end of its budget, in this process, without the bus."""
    memory.owed_s = 0.0
    flights, began_s = Timed(memory), time.process_time()
    folder = Path(tempfile.mkdtemp(prefix="saflite-rq3-", dir=SHARED_MEMORY if SHARED_MEMORY.exists() else None))
    try:
        with remembered(memory):
            inline = Inline(campaign_of(cell), folder / "run", flights)
            inline.warm(scorer_of(cell.chooser))
            inline.run(lambda status: False)
            inline.close()
        distances_m, found, others = _read(folder / "run" / "books.sqlite", scorer_of(cell.chooser))
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return Row(
        cell=cell,
        build=describe().build,
        distances_m=distances_m,
        core_s=tuple(round(at_s - began_s, 2) for at_s in flights.core_s),
        simulated_s=round(flights.simulated_s, 1),
        found=found,
        answered_by_others=others,
    )


def _read(books: Path, scorer: str) -> tuple[tuple[float, ...], tuple[Found, ...], int]:
    with closing(sqlite3.connect(books)) as database:
        contents = Contents(database)
        outcomes = list(contents.outcomes(-1, 10**9))
        judged = [contents.judgement(identity(outcome.test_case)) for outcome in outcomes]
        query = "SELECT COUNT(*) FROM scores WHERE scored_by <> ?"
        others = int(database.execute(query, (scorer,)).fetchone()[0])
    found = [
        _found(number, outcome, judgement.fingerprint)
        for number, (outcome, judgement) in enumerate(zip(outcomes, judged, strict=True), start=1)
        if outcome.violated and judgement is not None
    ]
    return tuple(_distance_m(outcome) for outcome in outcomes), tuple(found), others


def _distance_m(outcome: Outcome) -> float:
    """Return the closest approach of a flight, -1 where it said nothing."""
    return round(outcome.features.get("min_distance_m", -1.0), 3)


def _found(number: int, outcome: Outcome, behaviour: str) -> Found:
    boxes = tuple(map(_numbers, outcome.test_case.scenario.obstacles))
    return Found(flight=number, distance_m=_distance_m(outcome), behaviour=behaviour, boxes=boxes)


def _numbers(box: Obstacle) -> tuple[float, ...]:
    return (box.length_m, box.width_m, box.height_m, box.x_m, box.y_m, box.rotation_deg)
