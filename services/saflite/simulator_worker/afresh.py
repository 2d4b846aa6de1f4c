"""The end of a flight flown afresh: without all that came before the vehicle was called back to a place."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from typing import NamedTuple

from msgspec.structs import replace

from saflite.contract.test_case import Scenario, Stimulus, TestCase

QUIET_S = 12.0  # in which it comes to rest where it was ordered
_GO, _TURN, _UP = "MAV_CMD_DO_REPOSITION", "MAV_CMD_CONDITION_YAW", "MAV_CMD_NAV_TAKEOFF"
_LEAVE_NOTHING = frozenset(
    {
        *(_GO, _TURN, _UP, "MAV_CMD_COMPONENT_ARM_DISARM", "MAV_CMD_NAV_LAND", "MAV_CMD_DO_SET_MODE"),
        *("MAV_CMD_NAV_RETURN_TO_LAUNCH", "MAV_CMD_NAV_LOITER_UNLIM", "MAV_CMD_DO_FLIP"),
    }
)
"""Orders that another mode or another order ends. Others set something: a speed, a home, a fence, an open parachute."""


class Second(NamedTuple):
    """The second flight, from when on the two must go alike (s), and the places of the orders that call it there."""

    test_case: TestCase
    from_s: float = 0.0
    orders: frozenset[int] = frozenset()


def afresh(test_case: TestCase, rest: Mapping[str, float], denied: Container[int] = ()) -> Second | None:
    """Return the flight that only does what comes after the last order to a place that nothing followed for 12 s.

    It begins in LOITER where the first began, keeps the settings, and has nothing else to do until it is ordered to
    GUIDED, with the sticks as they were put back, and to that place. None where there is no such order, nothing came
    before, or something of it is still in force: a stick or a fault that is not as it rests (`rest`, by name), or an
    order that sets something. An order that was refused (`denied`, by place) calls nobody: a vehicle that stands
    disarmed is not where it was called. Nor is one that waited on the ground and is ordered there without a take-off:
    some autopilots take that order, and stay.
    """
    stimuli, stands = test_case.stimuli, _stands(test_case.scenario)
    for index in reversed([at for at, one in enumerate(stimuli) if one.name == _GO and at not in denied]):
        last = index
        while last + 1 < len(stimuli) and stimuli[last + 1].name == _TURN:
            last += 1
        from_s = stimuli[last].at_s + QUIET_S
        until_s = stimuli[last + 1].at_s if last + 1 < len(stimuli) else test_case.scenario.time_limit_s
        begins = [at for at in range(index) if (stimuli[at].kind, stimuli[at].name) == ("mode", "GUIDED")]
        if until_s < from_s or not begins:
            continue
        rises = [at for at in range(begins[-1], index) if stands and stimuli[at].name == _UP]
        if stands and not rises:
            continue
        before = stimuli[: begins[-1]]
        settings = tuple(one for one in before if one.kind == "parameter")
        if len(settings) == len(before) or not _over(before, rest):
            return None
        given = (*settings, *_sticks(before, stimuli[begins[-1]].at_s))
        kept = (*given, *stimuli[begins[-1] :])
        second = replace(test_case, scenario=_waiting(test_case.scenario), stimuli=kept)
        return Second(second, from_s, frozenset(len(given) + at - begins[-1] for at in (*rises[-1:], index)))
    return None


def _stands(scenario: Scenario) -> bool:
    """Say whether the vehicle waits on the ground where nothing else is ordered."""
    start = scenario.start
    return start is not None and (not start.armed or start.altitude_m <= 0.0)


def _over(before: Sequence[Stimulus], rest: Mapping[str, float]) -> bool:
    """Say whether nothing of what was given is in force any more, but settings."""
    held = {one.name: one.values for one in before if one.kind in ("stick", "sensor_fault")}
    orders = {one.name for one in before if one.kind == "command"}
    return orders <= _LEAVE_NOTHING and all(values == (rest.get(name),) for name, values in held.items())


def _sticks(before: Sequence[Stimulus], at_s: float) -> list[Stimulus]:
    """Return the sticks as they were put back, at one moment: on the ground the throttle rests elsewhere."""
    return [replace(one, at_s=at_s) for one in {one.name: one for one in before if one.kind == "stick"}.values()]


def _waiting(scenario: Scenario) -> Scenario:
    start = scenario.start
    if start is None or _stands(scenario):
        return scenario
    return replace(scenario, start=replace(start, mode="LOITER"))
