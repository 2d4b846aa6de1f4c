"""Every procedure that ships, flown by itself on the reference, brings its rule to speak, and breaks no rule."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from thinned import thinned

from saflite.conformance.flying import fly_once
from saflite.conformance.procedures import ProcedureFlights
from saflite.contract.flight import Flight
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.procedures import Procedure
from saflite.oracle.finding import find
from saflite.oracle.formula import clauses
from saflite.oracle.judge import judge
from saflite.oracle.policy import Policy, load_policy
from saflite.oracle.signals import FlightSignals
from saflite.oracle.stl import Evaluator

FLIGHTS = ProcedureFlights(describe())
TRIES = 8  # a few leave open whether the condition comes true
SPEAKS_WHEN_BROKEN = {
    # the vehicle refuses what the rule forbids, and the rule is about what was not refused
    *(("a-flip1", place) for place in (1, 2, 3, 4)),
    *(("arming-checks", place) for place in range(9)),
    *(("armed-in-flight", place) for place in range(3)),
    *(("arming-needs-position", place) for place in (0, 1)),
    ("arming-has-order", 0),
    *(("fence-not-breached", place) for place in range(4)),
    *(("takeoff-from-ground", place) for place in (0, 1)),
    *(("landed-on-ground", place) for place in (0, 1)),
    ("place-needs-position", 1),
    *(("chute-acts", place) for place in (1, 2)),  # opens by itself, or without an output: that it had a cause
    *(("failsafe-has-cause", place) for place in (0, 1)),
    ("guided-stays-down", 1),  # that an order to a place is refused as the pilot begins to lift off
}
ONLY_WHEN_BROKEN = {
    # a vehicle that flies as it should never comes where these ask for something, or on a mission only
    **{name: {0} for name in ("armed-in-flight", "arming-has-order", "arming-needs-position", "landed-on-ground")},
    "acro-sticks": {10, 11, 12, 13},  # a stick held, and the vehicle still not leaning its way
    "arming-checks": {1},  # armed with a voltage too low
    "disarm-delay": {2, 3, 5, 6},
    "flip-goes-back": {1},
    "failsafe-has-cause": set(range(6)),
    "fence-action": {1},  # PX4 alone holds before it acts
    "fence-not-breached": {0, 1, 2},
    "guided-stays-down": {1},
    "order-taken": {6, 7, 10},  # orders to a mission, which no procedure flies
    "mirrored-alike": {2},  # a mission
    "place-needs-position": {0, 1},
    "speed-flown": {7},  # the reference refuses a speed to climb at
    "turned-alike": {2},  # a mission
}
CLAUSE_TRIES = 20
PROCEDURES = [
    (policy, place, one) for policy, known in sorted(FLIGHTS.procedures.items()) for place, one in enumerate(known)
]
CASES = thinned(
    [(one, (policy, place) in SPEAKS_WHEN_BROKEN) for policy, place, one in PROCEDURES],
    each=2,
    ids=[f"{policy}-{place}" for policy, place, _ in PROCEDURES],
)


def applied(case: TestCase, policy: Policy) -> set[int]:
    """Return which clauses of a rule ask something of a flight."""
    record = fly_once(case)
    assert record.trace is not None
    flight = Flight(test_case="", flight_index=0, ending=record.ending, delivered=record.delivered)
    signals = FlightSignals(case, flight, record.trace)
    assumed = {name: np.full(signals.samples, value) for name, value in policy.file.assumed.items()}
    evaluator = Evaluator({**assumed, **signals.pick(policy.needed)}, record.trace.step_s)
    found = [find(evaluator, clause) for clause in clauses(policy.formula)]
    return {place for place, one in enumerate(found) if one is not None and one.applied_share > 0}


@pytest.mark.live
@pytest.mark.parametrize("name", sorted(FLIGHTS.procedures))
def test_each_clause_of_a_rule_is_brought_to_speak(name: str) -> None:
    policy = load_policy(name)
    left = set(range(len(clauses(policy.formula)))) - ONLY_WHEN_BROKEN.get(name, set())
    for seed in range(CLAUSE_TRIES):
        for procedure in FLIGHTS.procedures[name]:
            left -= applied(FLIGHTS.by_itself(procedure, seed), policy) if left else set()
    assert not left, "clauses by their number"


@pytest.mark.parametrize(("procedure", "speaks_when_broken"), CASES)
def test_a_procedure_brings_its_rule_to_speak(procedure: Procedure, *, speaks_when_broken: bool) -> None:
    outcomes: set[str] = set()
    for seed in range(1 if speaks_when_broken else TRIES):
        case = FLIGHTS.by_itself(procedure, seed)
        record = fly_once(case)
        assert record.trace is not None
        flight = Flight(test_case="", flight_index=0, ending=record.ending, delivered=record.delivered)
        (verdict,) = judge(case, flight, record.trace, (procedure.policy,)).verdicts
        outcomes.add(verdict.outcome)
        if verdict.outcome == "held":
            break
    assert "violated" not in outcomes, msgspec.to_builtins(case)
    assert speaks_when_broken or "held" in outcomes
