"""Flights flown on from snapshots: are they those flown from the start, and what do they cost?

Parts: `equal` draws test cases that part from a golden flight at some stimulus, flies each from a snapshot there and
from the start, and compares bit by bit; `shrink` makes violating test cases of twenty inputs small, once with every
flight flown from the start, once with snapshots held where they pay. Times are of one core, flown in turns.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import msgspec
from _defect_shrink import FLIGHTS_MAX, padded, violates

from saflite.campaign.lifecycle.minimizer import Minimizer
from saflite.campaign.lifecycle.repeats import ONE_FLIGHT
from saflite.conformance.flying import DEADLINE_S, opened
from saflite.contract.errors import Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.rng import derive
from saflite.contract.target import ForkingSession
from saflite.contract.test_case import Stimulus, TestCase, identity
from saflite.flight.autopilots.reference.defects import TABLE, trigger
from saflite.runtime.clock import WallClock
from saflite.simulator_worker.agreement import differences
from saflite.simulator_worker.prefixes import Prefixes, agree_until_s
from saflite.simulator_worker.processes import children, resident_mib
from saflite.simulator_worker.sandbox import SNAPSHOTS_MAX
from saflite.simulator_worker.targets import reference

GOLDEN = Path(__file__).resolve().parents[2] / "tests" / "replay"
DEFECTS = ("parachute-in-acro", "gps-failsafe-without-action", "circle-radius-reversed")
Fly = Callable[[TestCase], FlightRecord]


class Pair(NamedTuple):
    """One test case flown both ways: where it parts from the one held, and what each way took."""

    share: float
    whole_s: float
    rest_s: float
    wrong: tuple[str, ...]


def never() -> bool:
    """Never stop."""
    return False


def parted(base: TestCase, number: int) -> TestCase:
    """Return the test case with its past up to a drawn stimulus and another future: some inputs gone or moved."""
    rng = derive(2026, "bench-snapshots", identity(base), number)
    stimuli = sorted(base.stimuli, key=lambda stimulus: stimulus.at_s)
    place = int(rng.integers(len(stimuli)))
    rest = [one for one in stimuli[place + 1 :] if rng.random() < 0.7]
    limit_s = base.scenario.time_limit_s
    later = [msgspec.structs.replace(one, at_s=round(one.at_s + float(rng.uniform(0, 2)), 2)) for one in rest]
    if rng.random() < 0.5:
        later.append(Stimulus(at_s=round(float(rng.uniform(stimuli[place].at_s, limit_s)), 2), kind="mode", name="RTL"))
    return msgspec.structs.replace(base, stimuli=(*stimuli[:place], *later))


def pairs(session: ForkingSession, count: int) -> Iterator[Pair]:
    """Fly test cases both ways, in turns."""
    sys.path.insert(0, str(GOLDEN))
    from golden_cases import cases

    bases = [case for case in cases().values() if len(case.stimuli) > 1]
    for number in range(count):
        base = bases[number % len(bases)]
        case = parted(base, number)
        at_s = agree_until_s(base, case)
        at_s = base.scenario.time_limit_s / 2 if at_s == float("inf") else at_s
        try:
            held = session.snapshot(base, at_s, DEADLINE_S, never)
        except Unavailable:  # the base had ended before
            held = session.snapshot(base, 0.0, DEADLINE_S, never)
        start_s = time.perf_counter()
        rest = session.fly_from(held, case, DEADLINE_S, never)
        middle_s = time.perf_counter()
        whole = session.fly(case, DEADLINE_S, never)
        end_s = time.perf_counter()
        session.drop(held)
        length_s = whole.trace.duration_s if whole.trace is not None else 0.0
        share = min(1.0, held.at_s / max(length_s, 0.1))
        yield Pair(share, end_s - middle_s, middle_s - start_s, tuple(differences(whole, rest)))


def equal(count: int) -> dict[str, Any]:
    """Return how many flights differ, and the cost of a rest beside that of the whole, by where they part."""
    with opened(reference) as session:
        assert isinstance(session, ForkingSession)
        found = list(pairs(session, count))
    figures: dict[str, Any] = {"cases": len(found), "different": sum(bool(pair.wrong) for pair in found)}
    for low, high in ((0.0, 0.25), (0.25, 0.5), (0.5, 0.75), (0.75, 1.01)):
        some = [pair for pair in found if low <= pair.share < high]
        if some:
            cost = median(pair.rest_s / pair.whole_s for pair in some)
            figures[f"parting at {100 * low:.0f} to {min(100, 100 * high):.0f} %"] = {
                "cases": len(some),
                "from the start_ms": round(1e3 * median(pair.whole_s for pair in some), 1),
                "from the snapshot_ms": round(1e3 * median(pair.rest_s for pair in some), 1),
                "share of the cost": round(cost, 2),
            }
    return figures


def core_s() -> float:
    """Return the processor time of this process and of all that ended below it: a busy machine does not change it."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + ended.ru_utime + ended.ru_stime


def made_small(large: TestCase, policy: str, fly: Fly) -> tuple[str, int, float]:
    """Minimise with one way of flying; return what is left, flights, and seconds spent flying."""
    minimizer, flights, flying_s = Minimizer(large, FLIGHTS_MAX, ONE_FLIGHT), 0, 0.0
    while asked := minimizer.ask():
        for case, number in asked:
            start_s = time.perf_counter()
            record = fly(case)
            flying_s += time.perf_counter() - start_s
            minimizer.tell(identity(case), number, violates(case, policy, record))
            flights += 1
    return identity(minimizer.best), flights, flying_s


def shrink(defect: str) -> dict[str, Any]:
    """Minimise one padded trigger both ways."""
    policy = TABLE[defect].policy
    with opened(reference) as session:
        assert isinstance(session, ForkingSession)

        def plain(case: TestCase) -> FlightRecord:
            return session.fly(case, DEADLINE_S, never)

        large = next((case for case in padded(defect, 1) if violates(case, policy, plain(case))), None)
        if large is None:
            return {"defect": defect, "hidden": True}
        shared = Prefixes(session, WallClock(), SNAPSHOTS_MAX)

        def sharing(case: TestCase) -> FlightRecord:
            return shared.fly(case, DEADLINE_S, never)

        start_s = core_s()
        left, flights, plain_s = made_small(large, policy, plain)
        middle_s = core_s()
        left_too, flights_too, shared_s = made_small(large, policy, sharing)
        held_mib = sum(resident_mib(pid) for pid in children(os.getpid()))
        shared.close()
        end_s = core_s()
    assert (left, flights) == (left_too, flights_too), "snapshots changed what minimising found"
    return {
        "defect": defect,
        "inputs": f"{len(large.stimuli)} (trigger {len(trigger(defect).stimuli)})",
        "flights": flights,
        "from the start_s": round(plain_s, 1),
        "with snapshots_s": round(shared_s, 1),
        "of a core, from the start_s": round(middle_s - start_s, 1),
        "of a core, with snapshots_s": round(end_s - middle_s, 1),
        "held_mib": round(held_mib),
    }


def main(argv: list[str]) -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(prog="bench snapshots", description=__doc__)
    parser.add_argument("--part", choices=["equal", "shrink"], action="append")
    parser.add_argument("--cases", type=int, default=200)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(argv)
    found: dict[str, Any] = {}
    parts = options.part or ["equal", "shrink"]
    if "equal" in parts:
        found["equal"] = equal(options.cases)
    if "shrink" in parts:
        found["shrink"] = [shrink(defect) for defect in DEFECTS]
    sys.stdout.write(json.dumps(found, indent=None if options.json else 2) + "\n")
    return int(found.get("equal", {}).get("different", 0) > 0)
