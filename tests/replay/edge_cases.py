"""Flights in which inputs meet at one instant, or one or two ticks apart, no defect planted: no rule may be broken.

For each policy two of its inputs (and of those any rule is about: modes, arming, the parachute) are given in both
orders, 0, 1 and 2 ticks apart, most after an earlier input; and inputs are given around the moment at which the
autopilot changes state by itself (a failsafe, the end of a flip), from a tick before it to two after it.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import product
from typing import NamedTuple

import msgspec
import numpy as np

from saflite.campaign.presets.campaigns import load_campaign, template
from saflite.campaign.presets.policy_campaigns import policy_campaigns
from saflite.conformance.flying import fly_once
from saflite.contract.flight import Flight, Trace
from saflite.contract.rng import derive
from saflite.contract.signals import SIGNALS
from saflite.contract.test_case import Stimulus, StimulusKind, TestCase, identity
from saflite.flight.autopilots.reference.autopilot import TICK_S
from saflite.flight.autopilots.reference.describe import describe
from saflite.oracle.judge import judge
from saflite.oracle.policy import policy_names

FIRST_S, TAIL_S = 1.0, 15.0  # the longest window but one is 15 s
GAPS = (0, 1, 2)
PLACE = (0.0, 0.0, 0.0, 0.0, 47.4, 8.5455938, 30.0)
VALUES: dict[str, tuple[tuple[float, ...], ...]] = {
    "MAV_CMD_DO_PARACHUTE": ((2.0,),),
    "MAV_CMD_COMPONENT_ARM_DISARM": ((0.0,), (0.0, 21196.0), (1.0,)),
    "MAV_CMD_NAV_TAKEOFF": ((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0),),
    "MAV_CMD_DO_REPOSITION": (PLACE, (0.0, 1.0, *PLACE[2:])),
    "MAV_CMD_DO_CHANGE_SPEED": ((1.0, 12.0),),
    "MAV_CMD_DO_SET_HOME": ((1.0,),),
}
COMMON: tuple[tuple[StimulusKind, str], ...] = (
    ("command", "MAV_CMD_DO_PARACHUTE"),
    ("command", "MAV_CMD_COMPONENT_ARM_DISARM"),
    *(("mode", name) for name in ("ALT_HOLD", "ACRO", "FLIP", "LOITER", "GUIDED", "RTL", "LAND", "BRAKE")),
)
_WORDS: dict[str, StimulusKind] = {
    "parameters": "parameter",
    "commands": "command",
    "sticks": "stick",
    "modes": "mode",
    "sensor_faults": "sensor_fault",
}


class Given(NamedTuple):
    """An input without its time."""

    kind: StimulusKind
    name: str
    values: tuple[float, ...]

    def at(self, at_s: float) -> Stimulus:
        """Return it as a stimulus."""
        return Stimulus(at_s=round(float(at_s), 6), kind=self.kind, name=self.name, values=self.values)


def campaigns() -> tuple[str, ...]:
    """Return the policies that inputs can break on the reference, by name of their campaign."""
    return tuple(sorted(name for name in policy_campaigns(describe()) if name != "policy-all"))


@cache
def inputs_of(campaign: str) -> tuple[Given, ...]:
    """Return the policy's inputs and the common ones, each with the values at its edges."""
    settings = load_campaign(campaign).strategy.settings
    own = [(kind, str(name)) for word, kind in _WORDS.items() for name in settings.get(word, ())]  # type: ignore[union-attr]
    return tuple(
        Given(kind, name, values) for kind, name in dict.fromkeys([*own, *COMMON]) for values in _values(kind, name)
    )


def _values(kind: StimulusKind, name: str) -> tuple[tuple[float, ...], ...]:
    if name in VALUES:
        return VALUES[name]
    info = next((entry for entry in describe().inputs if (entry.kind, entry.name) == (kind, name)), None)
    if info is None:  # a word for several (any mode), whose members are among the common ones
        return ()
    if kind in ("mode", "command"):
        return ((),)
    told = (info.low, info.default, info.high)
    return tuple((value,) for value in dict.fromkeys(told) if value is not None)


def case_of(campaign: str, stimuli: tuple[Stimulus, ...]) -> TestCase:
    """Return the campaign's test case with these inputs and time enough after them."""
    plain = template(load_campaign(campaign))
    limit_s = round(max(one.at_s for one in stimuli) + TAIL_S, 6)
    scenario = msgspec.structs.replace(plain.scenario, time_limit_s=limit_s)
    return msgspec.structs.replace(plain, scenario=scenario, stimuli=stimuli)


def start_s(campaign: str) -> float:
    """Return the time of the first input: with a mission the vehicle must have left the ground."""
    return float(load_campaign(campaign).strategy.settings.get("start_s", FIRST_S))  # type: ignore[arg-type]


def meetings(campaign: str, rng_seed: int = 1) -> Iterator[TestCase]:
    """Yield every two inputs in every order and at every gap, in an order drawn from `rng_seed`; without end."""
    rng = derive(rng_seed, "edges", campaign)
    inputs, at_s = inputs_of(campaign), start_s(campaign)
    pairs = list(product(inputs, inputs, GAPS))
    while True:
        for place in rng.permutation(len(pairs)):
            first, second, gap = pairs[place]
            before = [inputs[rng.integers(len(inputs))].at(at_s - rng.integers(0, 51) * TICK_S)]
            stimuli = [first.at(at_s), second.at(at_s + gap * TICK_S)]
            yield case_of(campaign, tuple((before if rng.random() < 0.7 else []) + stimuli))


def reactions(campaign: str, rng_seed: int = 1) -> Iterator[TestCase]:
    """Yield inputs given around what the autopilot does by itself after another, four to each input that makes it."""
    rng = derive(rng_seed, "edges-reactions", campaign)
    inputs, at_s = inputs_of(campaign), start_s(campaign)
    for place in rng.permutation(len(inputs)):
        cause = inputs[place].at(at_s)
        trace = fly_once(case_of(campaign, (cause,))).trace
        ticks = [] if trace is None else own_changes(trace, at_s + 2 * TICK_S)
        if not ticks:
            continue
        event_s = ticks[rng.integers(len(ticks))]
        for gap in (-1, *GAPS):
            met = inputs[rng.integers(len(inputs))]
            yield case_of(campaign, (cause, met.at(event_s + gap * TICK_S)))


def own_changes(trace: Trace, after_s: float) -> list[float]:
    """Return the ticks after a time in which a flag or a code changed: the one before the sample that shows it."""
    names = [name for name in trace.signals if SIGNALS[name].kind != "real"]
    changed = np.any([np.diff(trace.array(name)) != 0 for name in names], axis=0)
    return [float(at) * trace.step_s for at in np.flatnonzero(changed) if at * trace.step_s > after_s]


def broken(test_case: TestCase) -> list[str]:
    """Return what the rules that are checked on the reference say of a flight that breaks them."""
    record = fly_once(test_case)
    flight = Flight(test_case=identity(test_case), flight_index=0, ending=record.ending, delivered=record.delivered)
    verdicts = judge(test_case, flight, record.trace, policy_names()).verdicts
    return [f"{verdict.policy}: {verdict.message}" for verdict in verdicts if verdict.outcome == "violated"]
