"""Does a test case ask only for what a target says it has? The check most targets need, from their description."""

from __future__ import annotations

import math
from collections.abc import Mapping

from saflite.contract.errors import Refused
from saflite.contract.target_info import InputInfo, TargetInfo, check_settings
from saflite.contract.test_case import Scenario, Stimulus, StimulusKind, TestCase


def check_described(info: TargetInfo, test_case: TestCase) -> None:
    """Raise Refused for what the description does not name: inputs, settings, modes, missions, time.

    Values of stimuli may lie outside their range (an autopilot is there to refuse them); parameters set before the
    start may not.
    """
    _check_scenario(info, test_case.scenario)
    inputs = {(one.kind, one.name): one for one in info.inputs}
    for name, value in test_case.target.parameters.items():
        _check_parameter(inputs.get(("parameter", name)), name, value)
    check_settings(test_case.target.settings, info.settings, info.name)
    for number, stimulus in enumerate(test_case.stimuli):
        _check_stimulus(inputs, stimulus, f"stimulus {number}")


def _check_scenario(info: TargetInfo, scenario: Scenario) -> None:
    if not 0.0 < scenario.time_limit_s <= info.time_limit_max_s:
        raise Refused("time_limit_s", expected=f"above 0, at most {info.time_limit_max_s:g}", got=scenario.time_limit_s)
    if scenario.mission is not None and not info.missions:
        raise Refused("mission", expected=f"none: {info.name} flies from a start state", got=scenario.mission.name)
    modes = {start.mode for start in info.start_states}
    if scenario.mission is None and scenario.start is not None and scenario.start.mode not in modes:
        raise Refused("start mode", expected=f"one of {', '.join(sorted(modes))}", got=repr(scenario.start.mode))


def _check_parameter(one: InputInfo | None, name: str, value: float) -> None:
    if one is None:
        raise Refused("parameter", expected="one that the target describes", got=repr(name))
    low = -math.inf if one.low is None else one.low
    high = math.inf if one.high is None else one.high
    if not low <= value <= high:
        raise Refused(f"parameter {name}", expected=f"{low:g} to {high:g} {one.unit}".rstrip(), got=value)


def check_time_and_count(stimulus: Stimulus, where: str) -> None:
    """Raise Refused for a stimulus before the start, or with another count of numbers than its kind has.

    What the numbers are is the autopilot's to judge. How many a command takes is the target's.
    """
    if not stimulus.at_s >= 0.0:
        raise Refused("stimulus time", where=where, expected="0 or later", got=stimulus.at_s)
    count = len(stimulus.values)
    if stimulus.kind in ("parameter", "stick") and count != 1:
        raise Refused("stimulus values", where=where, expected="one number", got=stimulus.values)
    if stimulus.kind == "mode" and count:
        raise Refused("stimulus values", where=where, expected="a mode's name and no number", got=stimulus.values)
    if stimulus.kind == "sensor_fault" and count > 1:
        raise Refused("stimulus values", where=where, expected="one number at most", got=stimulus.values)


def _check_stimulus(inputs: Mapping[tuple[StimulusKind, str], InputInfo], stimulus: Stimulus, where: str) -> None:
    kind = stimulus.kind
    if (kind, stimulus.name) not in inputs:
        known = [name for other, name in inputs if other == kind]
        expected = f"a {kind.replace('_', ' ')} that the target describes"
        raise Refused("stimulus", where=where, expected=expected, got=repr(stimulus.name), known=known)
    check_time_and_count(stimulus, where)
    if not all(map(math.isfinite, stimulus.values)):
        raise Refused("stimulus values", where=where, expected="finite numbers", got=stimulus.values)
