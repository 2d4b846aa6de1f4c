"""One search for one planted defect: its policy's campaign with `pgfuzz`, in one process, to the first find."""

from __future__ import annotations

import tempfile
import time
from collections import OrderedDict
from pathlib import Path
from typing import NamedTuple

import msgspec
from _inline import Flights, Inline

from saflite.campaign.presets.campaigns import load_campaign
from saflite.campaign.presets.policy_campaigns import pgfuzz_settings
from saflite.contract.config import Campaign, ScorerConfig, StrategyConfig
from saflite.contract.flight import Flight
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Setting, StartState, Target, identity
from saflite.contract.work import FlyResult, FlyWork, Result
from saflite.flight.autopilots.reference.defects import TABLE
from saflite.flight.autopilots.reference.describe import describe

FLIGHTS_PER_ROUND, CANDIDATES_PER_ROUND = 8, 48
KEPT = 64
ARMS: dict[str, str] = {
    "shipped": "the scorer of the built-in campaign chooses among the mutants: relevance, for dead autopilots random",
    "relevance": "the scorer relevance chooses",
    "random": "a random pick among the same mutants",
    "novelty": "the scorer novelty chooses",
    "surrogate": "the scorer surrogate chooses",
    "ensemble": "the scorer ensemble chooses",
    "pgfuzz": "the mutants flown as they come, no choice",
    "published": "the same, drawn as the published tool draws: its lists, its rounds, no changes to close cases",
}
PUBLISHED: dict[str, Setting] = {"focus": 0.0, "mutated": 0.0, "bursts": 0.0, "echoed": 0.0, "release": 1.0}


class Found(NamedTuple):
    """What one search came to. `found` is false where the budget ran out first: the counts are then a lower bound."""

    defect: str
    arm: str
    rng_seed: int
    found: bool
    rounds: int
    flights: int
    simulated_h: float
    wall_s: float


class CountedFlights(Flights):
    """Flies, counts simulated time, and remembers the last few flights: confirmations come soon after."""

    def __init__(self) -> None:
        super().__init__()
        self.simulated_s = 0.0
        self._recent: OrderedDict[str, tuple[Flight, bytes]] = OrderedDict()

    def do(self, work: FlyWork, cancelled: Cancelled) -> Result:  # type: ignore[override]
        """Fly the test case of the lease and count it, confirmations included."""
        name = identity(work.test_case)
        if name not in self._recent:
            self._recent[name] = self._fly(work, cancelled)
            if len(self._recent) > KEPT:
                self._recent.popitem(last=False)
        flight, packed = self._recent[name]
        self.simulated_s += flight.simulated_s
        changed = {"test_case": name, "flight_index": work.flight_index, "worker": "inline"}
        return FlyResult(flight=msgspec.structs.replace(flight, trace=self.blobs.put(packed), **changed))


def campaign_of(defect: str, arm: str, rng_seed: int, flights: int) -> Campaign:
    """Return the campaign of the defect's policy with the defect planted, changed as the arm says.

    Flights begin in the state the bug is known from (`Defect.start`), as in the paper's second question.
    """
    base = load_campaign(f"policy-{TABLE[defect].policy}")
    parameters = {**TABLE[defect].parameters, **base.target.parameters}
    own = base.strategy.settings
    if base.strategy.name != "pgfuzz":
        own = pgfuzz_settings(TABLE[defect].policy, describe())
    settings = {**own, **(PUBLISHED if arm == "published" else {})}
    chosen = arm not in ("pgfuzz", "published")
    model = {"shipped": base.scorer.model, "pgfuzz": "constant", "published": "constant"}.get(arm, arm)
    candidates = CANDIDATES_PER_ROUND if chosen else FLIGHTS_PER_ROUND
    search = {
        "candidates_per_round": candidates,
        "flights_per_round": FLIGHTS_PER_ROUND,
        "shrink": False,
        "lag": 1,
    }
    return msgspec.structs.replace(
        base,
        name=f"bench-{defect}",
        start=StartState(mode=TABLE[defect].start[0], altitude_m=TABLE[defect].start[1]) if base.start else None,
        target=Target(parameters=parameters, settings={"defects": [defect]}),
        strategy=StrategyConfig(name="pgfuzz", settings=settings),
        scorer=ScorerConfig(model=model, batch=16),
        search=msgspec.structs.replace(base.search, **search),
        budget_flights=flights,
        rng_seed=rng_seed,
        record="none",
    )


def search(defect: str, arm: str, rng_seed: int, flights: int) -> Found:
    """Search until the first confirmed violation of the defect's policy, or until the flights are spent."""
    flyer, start = CountedFlights(), time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="saflite-defects-") as folder:
        inline = Inline(campaign_of(defect, arm, rng_seed, flights), Path(folder) / "run", flyer)
        status = inline.run(lambda now: now.violations_confirmed > 0)
        inline.close()
    return Found(
        defect=defect,
        arm=arm,
        rng_seed=rng_seed,
        found=status.violations_confirmed > 0,
        rounds=status.round,
        flights=status.flights,
        simulated_h=flyer.simulated_s / 3600.0,
        wall_s=time.perf_counter() - start,
    )
