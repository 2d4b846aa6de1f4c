"""Every procedure that ships, flown by itself on the reference, brings its rule to speak, and breaks no rule."""

from __future__ import annotations

import msgspec
import pytest

from saflite.campaign.presets.policy_campaigns import ALL, policy_campaign
from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight
from saflite.contract.rng import derive
from saflite.contract.test_case import Scenario, StartState, Target, TestCase
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.drawing import Drawing, Shares
from saflite.mutator.exposure.phases import Script, Tempo
from saflite.mutator.exposure.procedures import Procedure, moves, read_procedures
from saflite.mutator.exposure.taken import Taken
from saflite.mutator.exposure.vocabulary import Vocabulary
from saflite.mutator.operators.inputs import target_inputs
from saflite.oracle.judge import judge
from saflite.oracle.policy import load_policy

TARGET = describe()
CAMPAIGN = policy_campaign(ALL, TARGET)
assert CAMPAIGN is not None
HAVE = target_inputs(TARGET, {})
PROCEDURES = read_procedures(CAMPAIGN.strategy.settings["procedures"], CAMPAIGN.policies, HAVE)  # type: ignore[arg-type]
REST = {(entry.kind, entry.name): entry.default for entry in TARGET.inputs if entry.default is not None}
DRAWING = Drawing(Vocabulary(HAVE, Taken()), REST, Shares(own=0.75, swarm=0.8, faults=0.15, beyond=0.15))
TRIES = 8  # a few leave open whether the condition comes true
SPEAKS_WHEN_BROKEN = {
    # the vehicle refuses what the rule forbids, and the rule is about what was not refused
    *(("a-flip1", place) for place in (1, 2, 3, 4)),
    *(("arming-checks", place) for place in range(6)),
    *(("armed-in-flight", place) for place in range(3)),
    *(("arming-needs-position", place) for place in (0, 1)),
    ("arming-has-order", 0),
    *(("fence-not-breached", place) for place in range(3)),
    *(("takeoff-from-ground", place) for place in (0, 1)),
    *(("landed-on-ground", place) for place in (0, 1)),
    *(("chute-acts", place) for place in (1, 2)),  # opens by itself, or without an output: that it had a cause
    *(("failsafe-has-cause", place) for place in (0, 1)),
}
CASES = [
    pytest.param(one, (policy, place) in SPEAKS_WHEN_BROKEN, id=f"{policy}-{place}")
    for policy, known in sorted(PROCEDURES.items())
    for place, one in enumerate(known)
]


def by_itself(procedure: Procedure, seed: int) -> TestCase:
    rng = derive(seed, procedure.policy)
    start = StartState(mode="STABILIZE", altitude_m=0.0, armed=False)
    if procedure.height_m is not None:
        start = StartState(mode="LOITER", altitude_m=round(procedure.height_m.draw(rng), 1))
    script = Script(Tempo(first_s=1.0, last_s=500.0, settle_s=(1.0, 5.0), rest=REST))
    script.follow(rng, moves(rng, procedure, DRAWING))
    scenario = Scenario(start=start, time_limit_s=round(script.at_s + 4.0, 1))
    twin = load_policy(procedure.policy).file.twin
    return TestCase(target=Target(), scenario=scenario, stimuli=script.stimuli(), rng_seed=seed, twin=twin)


@pytest.mark.parametrize(("procedure", "speaks_when_broken"), CASES)
def test_a_procedure_brings_its_rule_to_speak(procedure: Procedure, *, speaks_when_broken: bool) -> None:
    outcomes: set[str] = set()
    for seed in range(1 if speaks_when_broken else TRIES):
        case = by_itself(procedure, seed)
        record = fly_once(case)
        assert record.trace is not None
        flight = Flight(test_case="", flight_index=0, ending=record.ending, delivered=record.delivered)
        (verdict,) = judge(case, flight, record.trace, (procedure.policy,)).verdicts
        outcomes.add(verdict.outcome)
        if verdict.outcome == "held":
            break
    assert "violated" not in outcomes, msgspec.to_builtins(case)
    assert speaks_when_broken or "held" in outcomes
