"""Parts of `scripts/bench scoring` that need a real farm: overlap of scoring and flying, swaps under load."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import msgspec

from saflite.campaign.builtin import load_campaign
from saflite.contract import wire
from saflite.contract.config import Campaign
from saflite.contract.errors import FarmError
from saflite.contract.events import Event, Scored, ScorerChanged
from saflite.contract.test_case import Target
from saflite.runtime.client import FarmClient
from saflite.runtime.local import free_endpoint, run_campaign

HERE = Path(__file__).resolve().parent
BATCH_S = 10.0
WORKERS = 2
BROKEN = "openai:none@http://127.0.0.1:9/v1"
SWAP_AMONG = ("random", "constant", BROKEN, "gap", "novelty")


@contextmanager
def slow_server() -> Iterator[str]:
    """Run a server that takes ten seconds a batch; gives the label of its model."""
    port = free_endpoint().rsplit(":", 1)[1]
    server = subprocess.Popen([sys.executable, str(HERE / "_slow_llm.py"), port, str(BATCH_S)])
    try:
        yield f"openai:slow@http://127.0.0.1:{port}/v1"
    finally:
        server.kill()
        server.wait()


def _rows(run_dir: Path, query: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(f"file:{run_dir}/books.sqlite?mode=ro", uri=True)) as store:
        return store.execute(query).fetchall()


# ---- overlap ------------------------------------------------------------------------------------------------------


def overlap(flights: int, lag: int) -> dict[str, float]:
    """Fly a campaign with a scorer of ten seconds a batch; `lag` 1 is the paper's loop: score, fly, score, fly."""
    with slow_server() as label, tempfile.TemporaryDirectory() as folder:
        run_dir = Path(folder) / "run"
        campaign = _slow_campaign(label, flights, lag)
        started_s = time.monotonic()
        run_campaign(campaign, run_dir, simulators=WORKERS, target_files=(HERE / "targets" / "paced.py",))
        wall_s = time.monotonic() - started_s
        flown = _rows(run_dir, "SELECT count(*), sum(wall_s) FROM flights")[0]
        span = _rows(run_dir, "SELECT min(from_unix_s), max(to_unix_s) FROM attempts WHERE stage = 'fly'")[0]
        batches = _rows(run_dir, "SELECT sum(calls) FROM usage WHERE model LIKE 'openai:%'")[0][0]
        strangers = _rows(run_dir, "SELECT count(*) FROM scores WHERE scored_by != model")[0][0]
    scoring_s, flying_s = batches * BATCH_S, flown[1] / WORKERS
    return {
        "flights": flown[0],
        "wall_s": wall_s,
        "scoring_s": scoring_s,
        "flying_s": flying_s,
        "wall_over_longer": wall_s / max(scoring_s, flying_s),
        "busy_share_first_to_last_flight": flying_s / (span[1] - span[0]),
        "busy_share_whole_run": flying_s / wall_s,
        "scored_by_embedded": strangers,
    }


def _slow_campaign(label: str, flights: int, lag: int) -> Campaign:
    base = load_campaign("avoidance-m2")
    replace = msgspec.structs.replace
    return replace(
        base,
        name="overlap",
        target=Target(name="paced"),
        budget_flights=flights,
        record="none",
        scorer=replace(base.scorer, model=label, batch=10, deadline_s=60.0),
        search=replace(base.search, candidates_per_round=10, flights_per_round=6, lag=lag),
    )


# ---- swaps --------------------------------------------------------------------------------------------------------


def swaps(flights: int, count: int) -> dict[str, float]:
    """Change the scorer `count` times while a campaign runs at full speed, every fifth time to a broken one."""
    with tempfile.TemporaryDirectory() as folder:
        calm = _fast_run(Path(folder) / "calm", flights, 0)
        busy = _fast_run(Path(folder) / "busy", flights, count)
    return {
        "swaps_ordered": count,
        "swaps_done": busy["changed"],
        "swaps_rolled_back": busy["rolled_back"],
        "candidates_unscored": busy["unscored"],
        "flights_lost": flights - busy["flights"],
        "old_batches_after_a_swap_max": busy["late_batches"],
        "flights_per_s_calm": calm["flights"] / calm["wall_s"],
        "flights_per_s_swapping": busy["flights"] / busy["wall_s"],
        "throughput_ratio": (busy["flights"] / busy["wall_s"]) / (calm["flights"] / calm["wall_s"]),
    }


def _fast_run(run_dir: Path, flights: int, count: int) -> dict[str, float]:
    base = load_campaign("avoidance-m2")
    scorer = msgspec.structs.replace(base.scorer, model="gap")
    campaign = msgspec.structs.replace(base, name="swaps", budget_flights=flights, record="none", scorer=scorer)
    seen: list[Event] = []
    swapper = threading.Thread(target=_swap, args=(run_dir, count, seen), daemon=True)
    swapper.start()
    started_s = time.monotonic()
    run_campaign(campaign, run_dir, simulators=WORKERS)
    wall_s = time.monotonic() - started_s
    swapper.join(timeout=30.0)
    flown = _rows(run_dir, "SELECT count(*) FROM flights WHERE ending NOT IN ('infra', 'lost')")[0][0]
    unscored = _rows(
        run_dir, "SELECT count(*) FROM selected WHERE test_case NOT IN (SELECT test_case FROM scores WHERE shadow = 0)"
    )[0][0]
    facts = [
        msgspec.msgpack.decode(row[0], type=Event) for row in _rows(run_dir, "SELECT event FROM events ORDER BY seq")
    ]
    changes = [event.fact for event in facts if isinstance(event.fact, ScorerChanged)]
    return {
        "wall_s": wall_s,
        "flights": flown,
        "unscored": unscored,
        "changed": sum(change.ready for change in changes),
        "rolled_back": sum(not change.ready for change in changes),
        "late_batches": _late_batches(facts),
    }


def _late_batches(events: list[Event]) -> int:
    """Return how many batches at most still bore the old model's name after a swap."""
    most = late = 0
    model = ""
    for event in events:
        if isinstance(event.fact, ScorerChanged) and event.fact.ready:
            model, late = event.fact.model, 0
        elif isinstance(event.fact, Scored) and model and event.fact.model != model:
            late += 1
            most = max(most, late)
    return most


def _swap(run_dir: Path, count: int, seen: list[Event]) -> None:
    """Order one swap after another, each when the one before has settled, until the farm is gone."""
    client: FarmClient | None = None
    for number in range(count):
        while True:
            try:
                client = client or FarmClient.of_run(run_dir)
                status = client.status(within_s=5.0)
                if not status.scorer_pending:
                    client.order("scorer", SWAP_AMONG[number % len(SWAP_AMONG)], within_s=5.0)
                    break
            except FarmError:
                if client is not None:
                    return
            time.sleep(0.05)
    if client is not None:
        client.close()


__all__ = ["overlap", "swaps", "wire"]
