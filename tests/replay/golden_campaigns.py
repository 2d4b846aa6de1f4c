"""One small campaign per strategy, in one process without the bus, and what each of its flights came to.

Draws and ties by the identity of a test case move a search when identities change: the noise of `low_fidelity` (in
`blend`), the random picks, and ties among the parents of `deephyperion` (`rank_share`), `pgfuzz` (`mutated`) and
`exposure` (`kept`). So each strategy is run twice: as users run it, and with all of that off, where the rows hold
whatever identities are.
"""

from __future__ import annotations

import hashlib
import json
import sqlite3
import sys
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts" / "benches"))
from _inline import Flights, Inline

from saflite.campaign.presets.campaigns import load_campaign
from saflite.campaign.presets.policy_campaigns import pgfuzz_settings
from saflite.campaign.storage.contents import Contents
from saflite.contract.config import Campaign, ScorerConfig, SearchConfig, StrategyConfig
from saflite.contract.test_case import Setting, Target, TestCase, identity
from saflite.contract.work import Outcome
from saflite.flight.autopilots.reference.describe import describe

BOXES, CHUTE = "avoidance-m1", "policy-a-chute"
TIME_LIMIT_S = {BOXES: 120.0, CHUTE: 40.0}  # mission 1 takes 85 s; a vehicle that finds no way would fly for 500 s
CHUTE_DEFECT = "parachute-while-climbing"
FREE = "-free-of-identities"

Row = dict[str, Any]


class Search(NamedTuple):
    """A strategy with settings that have it learn within a few flights, on a built-in campaign."""

    campaign: str
    strategy: str
    settings: dict[str, Setting]
    scorer: str
    free: bool = False
    budget: int = 12
    rng_seed: int = 1


SEARCHES: dict[str, Search] = {
    "random_boxes": Search(BOXES, "random_boxes", {}, "blend"),
    "deephyperion": Search(BOXES, "deephyperion", {"population": 4}, "blend"),
    "near_miss": Search(BOXES, "near_miss", {"population": 4}, "blend"),
    "camba": Search(BOXES, "camba", {}, "gap", budget=8),
    "tumb": Search(BOXES, "tumb", {}, "gap", budget=8),
    "portfolio": Search(BOXES, "portfolio", {"given": ["population=4"]}, "gap", budget=12),
    "pgfuzz": Search(CHUTE, "pgfuzz", {"focus": 0.9}, "relevance", budget=12, rng_seed=3),
    "exposure": Search(CHUTE, "exposure", {}, "relevance", budget=16),
    f"random_boxes{FREE}": Search(BOXES, "random_boxes", {}, "gap", True, budget=8),
    f"deephyperion{FREE}": Search(
        BOXES, "deephyperion", {"population": 4, "rank_share": 0.0}, "gap", True, budget=8, rng_seed=2
    ),
    f"near_miss{FREE}": Search(BOXES, "near_miss", {"population": 4}, "gap", True, budget=8),
    f"pgfuzz{FREE}": Search(CHUTE, "pgfuzz", {"focus": 0.9, "mutated": 0.0}, "relevance", True, budget=10, rng_seed=3),
    f"exposure{FREE}": Search(CHUTE, "exposure", {"kept": 0.0}, "relevance", True, budget=10),
}


def campaign_of(search: Search) -> Campaign:
    """Return the built-in campaign as the search changes it."""
    base = load_campaign(search.campaign)
    rhythm = SearchConfig(candidates_per_round=8, flights_per_round=4, lag=1, confirm_flights=1)
    return msgspec.structs.replace(
        base,
        name="golden",
        time_limit_s=TIME_LIMIT_S[search.campaign],
        target=planted(base.target) if search.campaign == CHUTE else base.target,
        strategy=StrategyConfig(name=search.strategy, settings={**_settings(search, base), **search.settings}),
        scorer=ScorerConfig(model=search.scorer, batch=16),
        search=msgspec.structs.replace(rhythm, random_share=0.0) if search.free else rhythm,
        budget_flights=search.budget,
        rng_seed=search.rng_seed,
        record="none",
    )


def _settings(search: Search, base: Campaign) -> dict[str, Setting]:
    if search.campaign == BOXES:
        return {}  # strategies as they are by default
    return pgfuzz_settings("a-chute", describe()) if search.strategy == "pgfuzz" else base.strategy.settings


def planted(target: Target) -> Target:
    """Return the vehicle with the defect that the parachute's campaign is to find."""
    return msgspec.structs.replace(target, settings={"defects": [CHUTE_DEFECT]})


def parameters_of(test_case: TestCase) -> dict[str, float]:
    """Return the parameters set before the flight."""
    return test_case.target.parameters


def content_key(test_case: TestCase) -> str:
    """Return the hash of what is flown, whatever the test case's identity and its vehicle's name and defects."""
    content = (test_case.scenario, test_case.stimuli, test_case.rng_seed, parameters_of(test_case))
    text = json.dumps(msgspec.to_builtins(content), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def finds(name: str) -> list[Row]:
    """Run a search to the end of its budget and return its flights in order of round and rank."""
    with tempfile.TemporaryDirectory(prefix="saflite-golden-") as folder:
        inline = Inline(campaign_of(SEARCHES[name]), Path(folder) / "run", Flights())
        inline.run(lambda status: False)
        inline.close()
        return rows(Path(folder) / "run" / "books.sqlite")


def rows(books: Path) -> list[Row]:
    """Return what the books say of each flight: what was flown, how close it came, what was violated."""
    with closing(sqlite3.connect(books)) as database:
        flown = database.execute("SELECT round, rank FROM outcomes ORDER BY round, rank").fetchall()
        outcomes = list(Contents(database).outcomes(-1, 10**9))
        confirmations = database.execute(
            "SELECT test_case, policy, confirmation FROM violations ORDER BY policy"
        ).fetchall()
    return [_row(number, rank, outcome, confirmations) for (number, rank), outcome in zip(flown, outcomes, strict=True)]


def _row(number: int, rank: int, outcome: Outcome, confirmations: list[tuple[str, str, str]]) -> Row:
    test_case = identity(outcome.test_case)
    return {
        "round": number,
        "rank": rank,
        "content": content_key(outcome.test_case),
        "robustness": repr(outcome.guidance),  # of a rule that never applied: what the search went by
        "violated": sorted(outcome.violated),
        "confirmation": {policy: decided for name, policy, decided in confirmations if name == test_case},
    }
