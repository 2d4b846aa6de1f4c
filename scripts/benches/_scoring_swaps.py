"""Part of `scripts/bench scoring`: the scorer changed again and again while a real farm works at full speed.

Stretches of swapping and calm ones of as many batches take turns within one run, so that both meet the same machine.
"""

from __future__ import annotations

import math
import os
import signal
import sqlite3
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from _bootstrap import bootstrap_95
from numpy.typing import NDArray

from saflite.campaign.presets.campaigns import load_campaign
from saflite.console.run_data.run_folder import open_run
from saflite.contract.errors import FarmError, Unavailable
from saflite.contract.events import Event, Flown, Scored, ScorerChanged
from saflite.contract.rng import derive
from saflite.runtime.campaign_runner import run_campaign
from saflite.runtime.client import FarmClient

WORKERS = 2
BROKEN = "openai:none@http://127.0.0.1:9/v1"
SWAP_AMONG = ("random", "constant", BROKEN, "gap", "novelty")
FIRST = "gap"
UNSCORED = (
    "SELECT count(*) FROM test_cases WHERE place >= 0 AND test_case NOT IN "
    "(SELECT test_case FROM scores WHERE shadow = 0)"
)
FLOWN = "SELECT count(*) FROM flights WHERE ending NOT IN ('infra', 'lost')"
BUDGET_AT_FIRST = 100_000
LEFT_TO_FLY = 20  # more than rounds under way can hold in reserve


class Stretch(NamedTuple):
    """A time of swapping or of calm, in seconds since 1970."""

    swapping: bool
    from_s: float
    to_s: float


class Swapper:
    """Gives the orders to a running farm and keeps what they took."""

    def __init__(self, client: FarmClient) -> None:
        self._client = client
        self._events = client.watch(1)
        self._model = FIRST
        self._scored = 0
        self.stretches: list[Stretch] = []
        self.settled_s: list[float] = []
        self.refused_s: list[float] = []

    def run(self, count: int) -> None:
        """Swap `count` times, in stretches of one round of models, then let the campaign come to its end."""
        self._until(lambda event: isinstance(event.fact, Flown))
        for first in range(0, count, len(SWAP_AMONG)):
            before = self._scored
            self._stretch(True, partial(self._swaps, min(len(SWAP_AMONG), count - first)))
            self._stretch(False, partial(self._batches, self._scored - before))
        budget = self._client.status().flights + LEFT_TO_FLY
        answer = self._client.order("budget", number=budget)
        assert answer.accepted, answer.message

    def _stretch(self, swapping: bool, act: Callable[[], None]) -> None:
        from_s = time.time()
        act()
        self.stretches.append(Stretch(swapping, from_s, time.time()))

    def _swaps(self, count: int) -> None:
        """Change to each model in turn, the next one once a batch bears the name of the one before."""
        for model in SWAP_AMONG[:count]:
            ordered_s = time.monotonic()
            assert self._client.order("scorer", model).accepted
            self._until(partial(_is_settled, model=model))
            took = self.refused_s if model == BROKEN else self.settled_s
            took.append(time.monotonic() - ordered_s)
            self._model = self._model if model == BROKEN else model
            self._until(lambda event: isinstance(event.fact, Scored) and event.fact.model == self._model)

    def _batches(self, count: int) -> None:
        for _ in range(count):
            self._until(lambda event: isinstance(event.fact, Scored))

    def _until(self, wanted: Callable[[Event], bool]) -> None:
        """Take events in order up to the first one wanted."""
        for event in self._events:
            self._scored += isinstance(event.fact, Scored)
            if wanted(event):
                return
        raise AssertionError("the campaign ended too early")


def _is_settled(event: Event, model: str) -> bool:
    return isinstance(event.fact, ScorerChanged) and event.fact.model == model


def swaps(count: int) -> dict[str, object]:
    """Change the scorer `count` times under load, every fifth time to a broken one, and count what it cost.

    Rounds are of one batch and two flights, so that batches follow one another closely.

    Raises:
        Unavailable: the orders could not all be given.
    """
    base = load_campaign("avoidance-m2")
    scorer = msgspec.structs.replace(base.scorer, model=FIRST)
    search = msgspec.structs.replace(base.search, candidates_per_round=base.scorer.batch, flights_per_round=2)
    campaign = msgspec.structs.replace(
        base, name="swaps", budget_flights=BUDGET_AT_FIRST, record="none", scorer=scorer, search=search
    )
    done: list[Swapper] = []
    with tempfile.TemporaryDirectory() as folder:
        run_dir = Path(folder) / "run"
        thread = threading.Thread(target=_swap, args=(run_dir, count, done), daemon=True)
        thread.start()
        status = run_campaign(campaign, run_dir, simulators=WORKERS).status
        thread.join()
        with closing(sqlite3.connect(f"file:{run_dir}/books.sqlite?mode=ro", uri=True)) as store:
            unscored = store.execute(UNSCORED).fetchone()[0]
            flown = store.execute(FLOWN).fetchone()[0]
        with open_run(run_dir) as run:
            events = list(run.events())
    if not done or status is None or status.state != "ended":
        raise Unavailable("the swaps broke off; the reason stands above")
    swapper = done[0]
    changes = [event.fact for event in events if isinstance(event.fact, ScorerChanged)]
    return {
        "swaps_done": sum(change.ready for change in changes),
        "swaps_rolled_back": sum(not change.ready for change in changes),
        "candidates_unscored": unscored,
        "flights": flown,
        "flights_lost": status.budget - flown,
        "old_batches_after_a_swap_max": _late_batches(events),
        "settled_s_median": float(np.median(swapper.settled_s)),
        "settled_s_max": max(swapper.settled_s),
        "broken_refused_s_max": max(swapper.refused_s, default=math.nan),
        **_throughput(swapper.stretches, events),
    }


def _swap(run_dir: Path, count: int, done: list[Swapper]) -> None:
    """Swap on the farm in `run_dir` once it is there; stops it where that goes wrong."""
    try:
        client = _client(run_dir)
        try:
            swapper = Swapper(client)
            swapper.run(count)
            done.append(swapper)
        finally:
            client.close()
    except BaseException:
        os.kill(os.getpid(), signal.SIGINT)
        raise


def _client(run_dir: Path) -> FarmClient:
    while True:
        try:
            return FarmClient.of_run(run_dir)
        except FarmError:
            time.sleep(0.1)


# ---- what the books say --------------------------------------------------------------------------------------------


def _late_batches(events: Sequence[Event]) -> int:
    """Return how many batches at most still bore the old model's name after a swap: those handed out before it."""
    most = late = 0
    model = ""
    for event in events:
        if isinstance(event.fact, ScorerChanged) and event.fact.ready:
            model, late = event.fact.model, 0
        elif isinstance(event.fact, Scored) and model and event.fact.model != model:
            late += 1
            most = max(most, late)
    return most


def _throughput(stretches: Sequence[Stretch], events: Sequence[Event]) -> dict[str, float]:
    """Return simulated seconds flown per second in stretches of swapping and of calm; the dip with its 95 % interval.

    Simulated time, as models choose test cases of different lengths. Stretches are drawn in pairs for the interval.
    """
    flights = np.array(
        [
            (event.at_unix_s - event.fact.wall_s, event.at_unix_s, event.fact.simulated_s)
            for event in events
            if isinstance(event.fact, Flown)
        ]
    )
    rows = np.array([(_simulated_s(flights, one), one.to_s - one.from_s) for one in stretches])
    swapping, calm = rows[0::2], rows[1::2]
    everything = np.arange(len(swapping))

    def rates(index: NDArray[np.intp]) -> tuple[float, float]:
        during, beside = swapping[index].sum(axis=0), calm[index].sum(axis=0)
        return float(during[0] / during[1]), float(beside[0] / beside[1])

    def ratio(index: NDArray[np.intp]) -> float:
        during, beside = rates(index)
        return during / beside

    low, high = bootstrap_95(ratio, len(everything), derive(1, "swaps"))
    return {
        "simulated_s_per_s_swapping": rates(everything)[0],
        "simulated_s_per_s_calm": rates(everything)[1],
        "throughput_ratio": ratio(everything),
        "throughput_ratio_low": low,
        "throughput_ratio_high": high,
    }


def _simulated_s(flights: NDArray[np.float64], stretch: Stretch) -> float:
    """Return the simulated seconds that fall into a stretch; `flights` has rows (from s, to s, simulated s)."""
    inside_s = np.minimum(flights[:, 1], stretch.to_s) - np.maximum(flights[:, 0], stretch.from_s)
    return float((np.maximum(0.0, inside_s) / (flights[:, 1] - flights[:, 0]) * flights[:, 2]).sum())
