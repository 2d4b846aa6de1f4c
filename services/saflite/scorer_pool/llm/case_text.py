"""Test cases in words and numbers, canonical: equal content gives equal text, whatever the case is called."""

from __future__ import annotations

import math
import re

from saflite.contract.test_case import Mission, Obstacle, Scenario, Stimulus, TestCase, identity
from saflite.flight.mission import places_of
from saflite.scorer_pool.geometry_score import look
from saflite.scorer_pool.learning.features import has_layout
from saflite.scorer_pool.relevance.knowledge import table

NAME_LENGTH_MAX = 60
KEY_LENGTH = 4
KINDS = {
    "parameter": "set parameter",
    "command": "command",
    "stick": "stick",
    "mode": "switch to mode",
    "sensor_fault": "sensor fault",
}


def number(value: float) -> str:
    """Return a number with two decimals at most, without needless zeros; large and tiny ones with 6 digits."""
    if not math.isfinite(value):
        return str(value)
    if value != 0.0 and not 0.01 <= abs(value) < 1e7:
        return f"{value:.6g}"
    return f"{value:.2f}".rstrip("0").rstrip(".")


def exact(value: float) -> str:
    """Return a setting or command value with six significant digits."""
    return f"{value:.6g}"


def name(text: str) -> str:
    """Return a name as it may stand in a prompt: letters, digits and `_.-` only, so that it can give no orders."""
    return re.sub(r"[^A-Za-z0-9_.\-]+", "_", text)[:NAME_LENGTH_MAX]


def keys(test_cases: tuple[TestCase, ...]) -> tuple[str, ...]:
    """Return a short key per test case, made of its identity: no number a model could count wrongly.

    Equal test cases get equal keys; different ones never do (the keys grow until they differ).
    """
    names = [identity(case) for case in test_cases]
    length = KEY_LENGTH
    while len({full[:length] for full in names}) < len(set(names)):
        length += 1
    return tuple(f"c{full[:length]}" for full in names)


def obstacle_text(box: Obstacle) -> str:
    """Return one box on one line."""
    base = f", base {number(box.z_m)}" if box.z_m else ""
    return (
        f"centre ({number(box.x_m)}, {number(box.y_m)}), length {number(box.length_m)}, width {number(box.width_m)}, "
        f"height {number(box.height_m)}, rotated {number(box.rotation_deg)} deg{base}"
    )


def stimulus_text(stimulus: Stimulus) -> str:
    """Return one timed input on one line, with the label of its parameter table where there is one."""
    values = ", ".join(exact(value) for value in stimulus.values)
    label = _label(stimulus)
    given = f" = {values}" if values else ""
    return f"at {number(stimulus.at_s)} s {KINDS[stimulus.kind]} {name(stimulus.name)}{given}{label}"


def _label(stimulus: Stimulus) -> str:
    row = table().get(stimulus.name)
    return f" ({row.label})" if row and row.label else ""


def values_text(test_case: TestCase) -> str:
    """Return all that makes the test case, on several lines: what a score may be kept under."""
    lines = [f"obstacle {place}: {obstacle_text(box)}" for place, box in enumerate(test_case.scenario.obstacles, 1)]
    lines += [f"input {place}: {stimulus_text(given)}" for place, given in enumerate(test_case.stimuli, 1)]
    return "\n".join(lines) if lines else "nothing is changed"


def geometry_text(scenario: Scenario) -> str:
    """Return what can be computed of a layout before it is flown, on one line; empty without a layout."""
    if scenario.mission is None or not scenario.obstacles:
        return ""
    seen = look(scenario)
    gap = f"narrowest passage between two obstacles {number(seen.gap_m)} m" if math.isfinite(seen.gap_m) else ""
    way = (
        "an obstacle stands in the straight way"
        if seen.path_m < 0.05
        else f"straight way passes {number(seen.path_m)} m from the nearest obstacle"
    )
    return "; ".join(part for part in (way, gap) if part)


def mission_text(mission: Mission) -> str:
    """Return the way of the mission in local metres, on one line."""
    places = [
        f"{place.kind} ({number(place.x_m)}, {number(place.y_m)}) at {number(place.z_m)} m"
        for place in places_of(mission)
    ]
    return " -> ".join(["start (0, 0)", *places])


def canonical(test_case: TestCase) -> str:
    """Return the text a score is cached under: scenario, settings and stimuli, never identity, origin or seed."""
    scenario, target = test_case.scenario, test_case.target
    mission = mission_text(scenario.mission) if scenario.mission else "no mission"
    start = f"{scenario.start.mode} {number(scenario.start.altitude_m)} m" if scenario.start else "ground"
    wind = f"{number(scenario.wind.mean_mps)}/{number(scenario.wind.gust_mps)}/{number(scenario.wind.from_deg)}"
    settings = ",".join(f"{key}={exact(value)}" for key, value in sorted(target.parameters.items()))
    return "\n".join((target.name, settings, mission, start, wind, values_text(test_case)))


def differences(test_cases: tuple[TestCase, ...]) -> tuple[str, ...]:
    """Return per test case what sets it apart from what most have, on one line; empty where nothing does."""
    fields = [_fields(case) for case in test_cases]
    counts: dict[tuple[str, str], int] = {}
    for row in fields:
        for item in row.items():
            counts[item] = counts.get(item, 0) + 1
    common = {item for item, count in counts.items() if count > len(test_cases) / 2}
    return tuple(
        ", ".join(f"{key} {value}" for key, value in row.items() if (key, value) not in common) for row in fields
    )


def _fields(test_case: TestCase) -> dict[str, str]:
    """Return the parts of a test case that can be compared with those of others."""
    row: dict[str, str] = {}
    for place, box in enumerate(test_case.scenario.obstacles, 1):
        row[f"obstacle {place} centre"] = f"({number(box.x_m)}, {number(box.y_m)})"
        row[f"obstacle {place} size"] = f"{number(box.length_m)} x {number(box.width_m)} x {number(box.height_m)}"
        row[f"obstacle {place} rotation"] = number(box.rotation_deg)
    for given in test_case.stimuli:
        values = ", ".join(exact(value) for value in given.values)
        key = f"{KINDS[given.kind]} {name(given.name)}"
        row[key] = "; ".join(filter(None, (row.get(key, ""), f"{values} at {number(given.at_s)} s".strip())))
    if not has_layout(test_case) and not test_case.stimuli:
        row["inputs"] = "none"
    return row
