"""What a seed makes of the farm in one thread: its search, its size and its troubles."""

from __future__ import annotations

from typing import NamedTuple

import farm_doubles as doubles
from farm_members import StrategyEnds

from saflite.bus.faulty import Trouble
from saflite.contract.config import Campaign, LeaseConfig
from saflite.contract.rng import derive
from saflite.contract.target_info import Repeats

SEARCHES = 12
"""How many different searches the seeds make; all seeds of one search must find the same."""

CALM = Trouble(loss=0.0, duplicate=0.0, delay_max_s=0.01)


class Shape(NamedTuple):
    """What a seed makes of the farm. The search depends on `search_seed` only, so that runs can be compared."""

    search_seed: int
    budget: int
    simulators: int
    trouble: Trouble
    chaos_per_s: float
    babbles: float
    wedges: float
    breaks: float
    builds: bool
    strategy_ends: StrategyEnds = ""

    @property
    def repeats(self) -> Repeats:
        """What the target says of its repeats: part of the search."""
        return "statistically" if self.search_seed % 3 == 0 else "bitwise"


def shape_of(seed: int) -> Shape:
    """Return the farm of a seed: few searches, many kinds of trouble."""
    rng = derive(seed, "shape")
    loss = float(rng.choice([0.0, 0.1, 0.3]))
    return Shape(
        search_seed=seed % SEARCHES,
        budget=13 if _is_scarce(seed % SEARCHES) else 9,
        simulators=int(rng.integers(1, 4)),
        trouble=Trouble(loss, float(rng.choice([0.0, 0.2])), float(rng.choice([0.01, 0.5, 2.0])), float(loss / 2)),
        chaos_per_s=float(rng.choice([0.0, 0.1, 0.4])),
        babbles=float(rng.choice([0.0, 0.0, 0.3])),
        wedges=float(rng.choice([0.0, 0.0, 0.1])),
        breaks=float(rng.choice([0.0, 0.0, 0.1])),
        builds=bool(rng.choice([False, True])),
    )


def clean(shape: Shape) -> Shape:
    """Return the same search without any trouble, on two simulators."""
    return shape._replace(
        simulators=2, trouble=CALM, chaos_per_s=0.0, babbles=0.0, wedges=0.0, breaks=0.0, builds=False
    )


def _is_scarce(search_seed: int) -> bool:
    """Whether all candidates of a round are to fly: many rounds then fly fewer than planned, and close out of turn."""
    return search_seed % 4 == 3


def campaign_of(shape: Shape) -> Campaign:
    """Return the campaign of a farm."""
    candidates, flights, lag = (4, 4, 3) if _is_scarce(shape.search_seed) else (5, 2, 2)
    lease = LeaseConfig(lease_s=2.0, heartbeat_s=0.4, wall_limit_s=20.0)
    by_chance = shape.repeats == "statistically"
    return doubles.campaign(
        shape.budget,
        rng_seed=shape.search_seed,
        lease=lease,
        candidates_per_round=candidates,
        flights_per_round=flights,
        lag=lag,
        shrink=shape.search_seed % 4 == 0,
        shrink_flights_max=30 if by_chance else 10,
        confirm_flights=3 if by_chance else None,
        confirm_needed=2 if by_chance else None,
        batch=3,
    )
