"""What the reference denies is no cause; what stopped it is named, although it never answered."""

from __future__ import annotations

import msgspec

from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight, FlightRecord
from saflite.contract.test_case import Scenario, StartState, Stimulus, Target, TestCase, identity
from saflite.contract.verdict import Judgement
from saflite.flight.autopilots.reference.defects import trigger
from saflite.oracle.judge import judge


def judged(case: TestCase, record: FlightRecord, policy: str, *, by_plan: bool = False) -> Judgement:
    delivered = None if by_plan else record.delivered
    simulated_s = record.trace.duration_s if record.trace else 0.0
    flight = Flight(
        test_case=identity(case), flight_index=0, ending=record.ending, simulated_s=simulated_s, delivered=delivered
    )
    return judge(case, flight, record.trace, (policy,))


def orders_every_second(**parameters: float) -> TestCase:
    """Holding the place while a parachute is ordered again and again."""
    orders = tuple(
        Stimulus(at_s=float(at_s), kind="command", name="MAV_CMD_DO_PARACHUTE", values=(2.0,)) for at_s in range(15)
    )
    scenario = Scenario(start=StartState(mode="GUIDED", altitude_m=20.0), time_limit_s=16.0)
    return TestCase(target=Target(parameters=parameters), scenario=scenario, stimuli=orders)


def test_a_rule_applies_in_spite_of_orders_that_are_denied() -> None:
    case = orders_every_second()
    record = fly_once(case)
    assert record.delivered is not None
    assert {one.answer for one in record.delivered} == {"denied"}, "no parachute is fitted"
    (by_plan,) = judged(case, record, "a-guided1", by_plan=True).verdicts
    (verdict,) = judged(case, record, "a-guided1").verdicts
    assert by_plan.outcome == "vacuous", "an order stands"
    assert verdict.outcome == "held"


def test_the_input_under_which_the_autopilot_died_is_part_of_the_fingerprint() -> None:
    case = trigger("stick-range-unchecked")
    record = fly_once(case)
    assert record.ending == "autopilot_died"
    assert record.delivered
    last = max(record.delivered, key=lambda one: one.at_s)
    told = judged(case, record, "upright")
    assert "autopilot-alive" in {verdict.policy for verdict in told.verdicts if verdict.outcome == "violated"}
    spared = tuple(one for one in record.delivered if one is not last)
    without = judged(case, record._replace(delivered=spared), "upright")
    assert told.fingerprint != without.fingerprint
    denied = msgspec.structs.replace(last, answer="denied")
    assert judged(case, record._replace(delivered=(*spared, denied)), "upright").fingerprint == without.fingerprint
