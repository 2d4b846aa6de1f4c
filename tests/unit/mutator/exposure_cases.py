"""Test cases and a strategy for the tests of `exposure`."""

from __future__ import annotations

import msgspec
import numpy as np

from saflite.contract.test_case import Origin, Scenario, StartState, Stimulus, Target, TestCase
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.operators.inputs import target_inputs
from saflite.mutator.strategies.exposure import Strategy

HAVE = target_inputs(describe(), {})
BOUNDED = [entry for entry in HAVE.values() if entry.kind == "parameter" and np.isfinite(entry.high)]
START = StartState(mode="LOITER", altitude_m=30.0)
TEMPLATE = TestCase(target=Target(), scenario=Scenario(start=START, time_limit_s=60.0), rng_seed=5)
POLICIES = ("a-rtl1", "a-chute", "upright")
LAST = Stimulus(at_s=60.0, kind="mode", name="LAND")  # the end of a flight
HINTS = ["a-rtl1 start:GUIDED@12 mode:RTL parameter:RTL_ALT", "a-chute start:ALT_HOLD@50 command:MAV_CMD_DO_PARACHUTE"]


def case(*stimuli: Stimulus, text: str = "", parent: str = "", altitude_m: float = 30.0) -> TestCase:
    start = StartState(mode="LOITER", altitude_m=altitude_m)
    scenario = Scenario(start=start, time_limit_s=60.0)
    origin = Origin(strategy="exposure", note=text, parent=parent)
    return msgspec.structs.replace(TEMPLATE, scenario=scenario, stimuli=stimuli, origin=origin)


def given(kind: str, name: str, *values: float, at_s: float = 1.0) -> Stimulus:
    return Stimulus(at_s=at_s, kind=kind, name=name, values=values)  # type: ignore[arg-type]


def strategy(**settings: object) -> Strategy:
    return Strategy(TEMPLATE, {"hints": list(HINTS), **settings}, POLICIES, describe())  # type: ignore[dict-item]
