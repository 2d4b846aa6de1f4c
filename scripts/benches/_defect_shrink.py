"""Part of `scripts/bench defects`: how soon is a violating test case of twenty inputs made small, on one core?"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import msgspec

from saflite.campaign.lifecycle.minimizer import Minimizer
from saflite.campaign.lifecycle.repeats import ONE_FLIGHT
from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.conformance.flying import fly_once
from saflite.contract.flight import AUTOPILOT_ALIVE, Flight, FlightRecord
from saflite.contract.rng import derive
from saflite.contract.test_case import Setting, Stimulus, TestCase, identity
from saflite.contract.verdict import Verdict
from saflite.flight.autopilots.reference.defects import TABLE, trigger
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.strategies.pgfuzz import Strategy
from saflite.oracle.judge import judge

INPUTS = 20
LIMIT_S, FIRST_S, LAST_S = 60.0, 0.5, 30.0  # the trigger begins somewhere between
TRIES = 60
FLIGHTS_MAX = 400


class Shrunk(NamedTuple):
    """What became of one case of twenty inputs; `trigger` is how many the shortest known trigger has.

    `core_s` is processor time: on a busy machine it says what `wall_s` would be on an idle one.
    """

    defect: str
    inputs: int
    trigger: int
    flights: int
    wall_s: float
    core_s: float
    exhausted: bool


def broken(test_case: TestCase, policy: str) -> Verdict | None:
    """Fly the test case on the reference target and say how it breaks the policy, None if it does not."""
    return violated(test_case, policy, fly_once(test_case))


def violates(test_case: TestCase, policy: str, record: FlightRecord) -> bool:
    """Return whether a flight broke the policy."""
    return violated(test_case, policy, record) is not None


def violated(test_case: TestCase, policy: str, record: FlightRecord) -> Verdict | None:
    """Return the verdict of a flight that broke the policy."""
    name, delivered = identity(test_case), record.delivered
    simulated_s = record.trace.duration_s if record.trace else 0.0
    flight = Flight(test_case=name, flight_index=0, ending=record.ending, delivered=delivered, simulated_s=simulated_s)
    verdicts = judge(test_case, flight, record.trace, () if policy == AUTOPILOT_ALIVE else (policy,)).verdicts
    return next((one for one in verdicts if one.policy == policy and one.outcome == "violated"), None)


def padded(defect: str, rng_seed: int) -> Iterator[TestCase]:
    """Yield the defect's trigger, begun at some time, among random inputs of the whole target: twenty in all."""
    case = trigger(defect)
    rng = derive(rng_seed, "bench-shrink", defect)
    count = INPUTS - len(case.stimuli)
    settings: dict[str, Setting] = {
        "focus": 0.0,
        "steps_min": count,
        "steps_max": count,
        "release": 0.0,
        "mutated": 0.0,
    }
    noise = Strategy(template(load_campaign("policy-all")), settings, (), describe())
    for found in noise.ask(TRIES, rng):
        later_s = float(rng.uniform(FIRST_S, LAST_S)) - min((one.at_s for one in case.stimuli), default=0.0)
        begun = [msgspec.structs.replace(one, at_s=round(one.at_s + later_s, 2)) for one in case.stimuli]
        others = [_at(one, float(rng.uniform(FIRST_S, LIMIT_S - 10.0))) for one in found.stimuli]
        stimuli = tuple(sorted([*begun, *others], key=lambda one: one.at_s))
        scenario = msgspec.structs.replace(case.scenario, time_limit_s=LIMIT_S)
        yield msgspec.structs.replace(case, scenario=scenario, stimuli=stimuli)


def _at(stimulus: Stimulus, at_s: float) -> Stimulus:
    return msgspec.structs.replace(stimulus, at_s=round(at_s, 2))


def shrink(defect: str, rng_seed: int) -> Shrunk | None:
    """Minimise the first padded case that breaks the defect's policy; None if the noise hides the trigger each time."""
    policy = TABLE[defect].policy
    found = ((case, verdict) for case in padded(defect, rng_seed) if (verdict := broken(case, policy)) is not None)
    large, verdict = next(found, (None, None))
    if large is None or verdict is None:
        return None
    start_s, start_core_s, flights = time.perf_counter(), time.process_time(), 0
    minimizer = Minimizer(large, FLIGHTS_MAX, ONE_FLIGHT, verdict.witness_to_s)
    while asked := minimizer.ask():
        for case, number in asked:
            minimizer.tell(identity(case), number, broken(case, policy) is not None)
        flights += len(asked)
    wall_s, core_s = time.perf_counter() - start_s, time.process_time() - start_core_s
    left, known = len(minimizer.best.stimuli), len(trigger(defect).stimuli)
    return Shrunk(defect, left, known, flights, wall_s, core_s, exhausted=flights >= FLIGHTS_MAX)


def shrinks(defects: Iterable[str], rng_seed: int) -> Iterator[Shrunk]:
    """Yield what became of one case per defect."""
    for defect in defects:
        found = shrink(defect, rng_seed)
        if found is not None:
            yield found
