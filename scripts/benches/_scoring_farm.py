"""Part of `scripts/bench scoring` that needs a real farm: overlap of scoring and flying."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import msgspec

from saflite.bus.endpoints import free_endpoint
from saflite.campaign.presets.campaigns import load_campaign
from saflite.contract.config import Campaign
from saflite.contract.test_case import Target
from saflite.runtime.campaign_runner import run_campaign

HERE = Path(__file__).resolve().parent
BATCH_S = 10.0
WORKERS = 2


@contextmanager
def slow_server(batch_s: float = BATCH_S) -> Iterator[str]:
    """Run a server that takes `batch_s` for a batch; gives the label of its model."""
    port = free_endpoint().rsplit(":", 1)[1]
    server = subprocess.Popen([sys.executable, str(HERE / "_slow_llm.py"), port, str(batch_s)])
    try:
        yield f"openai:slow@http://127.0.0.1:{port}/v1"
    finally:
        server.kill()
        server.wait()


def _rows(run_dir: Path, query: str) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(f"file:{run_dir}/books.sqlite?mode=ro", uri=True)) as store:
        return store.execute(query).fetchall()


def overlap(flights: int, lag: int) -> dict[str, float]:
    """Fly a campaign with a scorer of ten seconds a batch; `lag` 1 is the paper's loop: score, fly, score, fly."""
    with slow_server() as label, tempfile.TemporaryDirectory() as folder:
        run_dir = Path(folder) / "run"
        campaign = _slow_campaign(label, flights, lag, cascade=False)
        started_s = time.monotonic()
        run_campaign(campaign, run_dir, simulators=WORKERS, modules=(HERE / "targets" / "paced.py",))
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


def cascade(flights: int, batches_s: tuple[float, ...]) -> dict[str, dict[str, float]]:
    """Fly a campaign with servers of several speeds; `wall_over_alone` is against one without a server, before it."""
    alone_s = _cascaded("blend", flights)["wall_s"]
    found = {"alone": {"wall_s": alone_s}}
    for batch_s in batches_s:
        with slow_server(batch_s) as label:
            row = _cascaded(label, flights)
        found[f"{batch_s:g} s a batch"] = {**row, "wall_over_alone": row["wall_s"] / alone_s}
    return found


def _cascaded(label: str, flights: int) -> dict[str, float]:
    with tempfile.TemporaryDirectory() as folder:
        run_dir = Path(folder) / "run"
        started_s = time.monotonic()
        campaign = _slow_campaign(label, flights, 3, cascade=True)
        run_campaign(campaign, run_dir, simulators=WORKERS, modules=(HERE / "targets" / "paced.py",))
        wall_s = time.monotonic() - started_s
        query = "SELECT avg(scored_by = model), count(*) FROM scores WHERE NOT shadow"
        share, scores = _rows(run_dir, query)[0]
    return {"wall_s": wall_s, "decided_by_model": share, "scores": scores}


def _slow_campaign(label: str, flights: int, lag: int, *, cascade: bool) -> Campaign:
    base = load_campaign("avoidance-m2")
    replace = msgspec.structs.replace
    return replace(
        base,
        name="overlap",
        target=Target(name="paced"),
        budget_flights=flights,
        record="none",
        scorer=replace(base.scorer, model=label, batch=10, cascade=cascade, deadline_s=60.0),
        search=replace(base.search, candidates_per_round=10, flights_per_round=6, lag=lag),
    )
