"""Test cases for a target of which only its description is known."""

from __future__ import annotations

from collections.abc import Iterator

from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import Scenario, Stimulus, Target, TestCase
from saflite.flight.mission import builtin_mission, mission_names

TIME_LIMIT_S, MISSION_LIMIT_S = 3.0, 500.0
PER_KIND = 3  # inputs of each kind that are tried
FIRST_S, APART_S = 0.5, 0.1


def default_cases(info: TargetInfo) -> tuple[TestCase, ...]:
    """Return short flights: undisturbed, with inputs of each kind at the ends of their ranges, under another number."""
    plain = TestCase(target=Target(name=info.name), scenario=scenario(info), rng_seed=1)
    cases = [plain]
    for place in (0, -1):
        stimuli = tuple(sorted(_stimuli(info, place), key=lambda one: one.at_s))
        if stimuli:
            cases.append(TestCase(target=plain.target, scenario=plain.scenario, stimuli=stimuli, rng_seed=1))
    cases.append(TestCase(target=plain.target, scenario=plain.scenario, stimuli=cases[-1].stimuli, rng_seed=2))
    return tuple(cases)


def scenario(info: TargetInfo) -> Scenario:
    """Return the shortest flight the target can begin: from its usual start state, otherwise a built-in mission."""
    if info.start_states:
        return Scenario(start=info.start_states[0], time_limit_s=min(TIME_LIMIT_S, info.time_limit_max_s))
    return Scenario(
        mission=builtin_mission(mission_names()[0]), time_limit_s=min(MISSION_LIMIT_S, info.time_limit_max_s)
    )


def _stimuli(info: TargetInfo, place: int) -> Iterator[Stimulus]:
    at_s = FIRST_S
    tried: dict[str, int] = {}
    for one in info.inputs:
        tried[one.kind] = tried.get(one.kind, 0) + 1
        if tried[one.kind] <= PER_KIND:
            due_s = 0.0 if one.at_start else round(at_s, 3)
            yield Stimulus(at_s=due_s, kind=one.kind, name=one.name, values=values_of(one, place))
            at_s += APART_S


def values_of(one: InputInfo, place: int) -> tuple[float, ...]:
    """Return what an input is given: the lowest (place 0) or highest (-1) value known, its default, or nothing."""
    if one.choices:
        return (one.choices[place],)
    end = (one.low, one.high)[place]
    if end is not None:
        return (end,)
    return () if one.default is None else (one.default,)
