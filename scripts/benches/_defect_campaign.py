"""Part of `scripts/bench defects`: `policy-all` with three defects on, to the end of what it makes smaller."""

from __future__ import annotations

import random
import re
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import msgspec
from _inline import Flights, Inline
from _search_run import Job, Watch

from saflite.campaign.presets.campaigns import load_campaign
from saflite.console.run_data.run_folder import RunFolder
from saflite.contract.flight import Flight
from saflite.contract.service import Cancelled
from saflite.contract.test_case import Setting
from saflite.contract.work import FlyWork
from saflite.flight.autopilots.reference.defects import SETTING, TABLE

DEFECTS = 3
SMALLER = ("shrink", "shrunk")


class Three(NamedTuple):
    """One campaign. `first_core_s` and `smaller_core_s` are processor time of flying alone, by what it was for.

    A find counts where its test case violates with the defect alone and not without any. `inputs_of_the_smallest` is
    the least number of inputs of a confirmed find of the defect, `made_smaller` of each find: inputs before and after.
    """

    campaign: str
    rng_seed: int
    budget: int
    flights: int
    defects: tuple[str, ...]
    found_within: dict[str, int]
    by_policy: dict[str, list[str]]
    inputs_of_the_smallest: dict[str, int]
    false_alarms: dict[str, int]
    flights_that_made_smaller: int
    made_smaller: tuple[tuple[int, int], ...]
    first_core_s: float
    smaller_core_s: float


class Timed(Flights):
    """Notes what flights for a purpose took."""

    def __init__(self) -> None:
        super().__init__()
        self.core_s = Counter[str]()

    def _fly(self, work: FlyWork, cancelled: Cancelled) -> tuple[Flight, bytes]:
        start_s = time.process_time()
        flown = super()._fly(work, cancelled)
        self.core_s[work.purpose] += time.process_time() - start_s  # type: ignore[assignment]
        return flown


def drawn(rng_seed: int) -> tuple[str, ...]:
    """Return planted defects by a number."""
    return tuple(random.Random(rng_seed).sample(sorted(TABLE), DEFECTS))


def three(rng_seed: int, budget: int) -> Three:
    """Run `policy-all` with three defects on, to the end."""
    defects, base, flights = drawn(rng_seed), load_campaign("policy-all"), Timed()
    settings: dict[str, Setting] = {SETTING: list(defects)}
    target = msgspec.structs.replace(base.target, settings=settings)
    campaign = msgspec.structs.replace(base, target=target, budget_flights=budget, rng_seed=rng_seed, record="none")
    watch = Watch(Job("all", defects, (), rng_seed, budget), campaign)
    with tempfile.TemporaryDirectory(prefix="saflite-three-") as folder:
        run_dir = Path(folder) / "run"
        inline = Inline(campaign, run_dir, flights)
        status = inline.run(lambda now: watch.look(run_dir, now) and False)
        inline.close()
        smallest, made_smaller = sizes(run_dir, watch)
    return Three(
        *(base.name, rng_seed, budget, status.flights, defects, watch.found),
        {defect: sorted(policies) for defect, policies in sorted(watch.by_policy.items())},
        *(smallest, dict(watch.false_alarms), status.shrink_flights, made_smaller),
        round(flights.core_s["search"], 1),
        round(sum(flights.core_s[purpose] for purpose in SMALLER), 1),
    )


def sizes(run_dir: Path, watch: Watch) -> tuple[dict[str, int], tuple[tuple[int, int], ...]]:
    """Return the inputs of the smallest find of each defect found, and those of every find before and after."""
    smallest: dict[str, int] = {}
    pairs = []
    with RunFolder(run_dir) as run:
        for one in sorted(run.violations("confirmed"), key=lambda one: len(run.test_case(one.test_case).stimuli)):
            case = run.test_case(one.test_case)
            if named := re.match("smallest form of ([0-9a-f]+)", one.message):
                pairs.append((len(run.test_case(named[1]).stimuli), len(case.stimuli)))
            for defect in [found for found in watch.found if found not in smallest]:
                if watch.is_of(case, defect, one.policy):
                    smallest[defect] = len(case.stimuli)
    return smallest, tuple(sorted(pairs))
