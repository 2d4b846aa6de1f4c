"""The UAV testing competition's test-case document (Aerialist) to test case and back, without loss.

Both spellings are read: `robot`/`mission` (current) and `drone`/`test` (2024). What the document cannot say (stimuli,
start state, rng_seed, settings of the target) stands under the key `saflite`, which other tools ignore; wind and time
limit stand there only where the document's own words do not give them to the last digit, and go before those words.
A test case keeps the document it came from; writing starts from it and changes only what differs, so nothing is lost.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import PurePath
from typing import Any

import msgspec

from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.outside import parse_json
from saflite.contract.test_case import Mission, Obstacle, Scenario, StartState, Stimulus, Target, TestCase, Twin, Wind
from saflite.flight.competition.yaml_text import Located
from saflite.flight.competition.yaml_text import Path as Place

OURS = "saflite"
ROBOT_WORDS, PLAN_WORDS = ("robot", "drone"), ("mission", "test")
TIME_LIMIT_S = 500.0
_FLAT = 7  # l, w, h, x, y, z, r
# what all case studies of the competition set, and the one command they give: fly the mission after one second
_PARAMS = {
    "NAV_ACC_RAD": 0.5,
    "NAV_MC_ALT_RAD": 0.5,
    "NAV_RCL_ACT": 3,
    "NAV_DLL_ACT": 0,
    "MIS_YAW_ERR": 12.0,
    "MIS_TAKEOFF_ALT": 1.0,
    "MPC_YAW_MODE": 0,
    "SDLOG_PROFILE": 7,
}
_COMMANDS = [{"timestamp": 1, "mode": 3, "x": 0, "y": 0, "z": 0.5, "r": 0}]

FindMission = Callable[[str, str], Mission]
"""Gives the mission a document names: (the name of the plan file, where it is named); raises Refused."""


class Ours(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What stands under `saflite`: the parts of a test case the competition has no words for.

    `wind` and `time_limit_s` are None where those of `simulation` are in force.
    """

    rng_seed: int = 0
    target: Target = Target()
    start: StartState | None = None
    wind: Wind | None = None
    time_limit_s: float | None = None
    stimuli: tuple[Stimulus, ...] = ()
    heading_deg: float = 0.0
    twin: Twin = ""


# ---- reading ------------------------------------------------------------------------------------------------------


def to_test_case(document: Located, find_mission: FindMission) -> TestCase:
    """Return the test case in a document; raises Refused with file and line for what cannot be understood or flown.

    Vehicle parameters of the document are the real autopilot's and are kept, not applied to the reference target.
    """
    robot = _section(document, *ROBOT_WORDS)
    simulation = _section(document, "simulation")
    _section(document, *PLAN_WORDS)
    ours = _in_force(document, simulation)
    assert ours.wind is not None, "in force, so set"
    assert ours.time_limit_s is not None, "in force, so set"
    plan = robot.get("mission_file")
    if plan is not None and not isinstance(plan, str):
        raise _refused(document, (_word(document, ROBOT_WORDS), "mission_file"), "the name of a .plan file", plan)
    if plan is None and ours.start is None:
        raise _refused(
            document, (_word(document, ROBOT_WORDS),), "`mission_file` under `robot` (or `drone`)", "no mission"
        )
    where = document.at((_word(document, ROBOT_WORDS), "mission_file"))
    obstacles = _obstacles(document, simulation.get("obstacles"))
    scenario = Scenario(
        mission=None if plan is None else find_mission(plan, where),
        start=ours.start,
        obstacles=obstacles,
        wind=ours.wind,
        time_limit_s=ours.time_limit_s,
    )
    return TestCase(
        target=ours.target,
        scenario=scenario,
        stimuli=ours.stimuli,
        rng_seed=ours.rng_seed,
        heading_deg=ours.heading_deg,
        twin=ours.twin,
        source=json.dumps(document.data, separators=(",", ":"), ensure_ascii=False),
    )


def _word(document: Located, words: tuple[str, ...]) -> str:
    return next((word for word in words if word in document.data), words[0])


def _section(document: Located, *words: str) -> dict[str, Any]:
    word = _word(document, words)
    section = document.data.get(word)
    if section is None:
        return {}
    if not isinstance(section, dict):
        raise _refused(document, (word,), "a mapping", type(section).__name__)
    return section


def _refused(document: Located, path: Place, expected: str, got: object) -> Refused:
    return Refused(".".join(map(str, path)) or "test case", where=document.at(path), expected=expected, got=got)


def _ours(document: Located) -> Ours:
    try:
        return wire.convert(document.data.get(OURS, {}), Ours, strict=True)
    except msgspec.ValidationError as fault:
        raise _refused(document, (OURS,), "what the farm wrote", str(fault)) from fault


def _in_force(document: Located, simulation: dict[str, Any]) -> Ours:
    """Return what stands under `saflite`, wind and limit of `simulation` where it names none: both are always set."""
    ours, wind, limit_s = _ours(document), _wind(document, simulation), _time_limit_s(document, simulation)
    return msgspec.structs.replace(
        ours,
        wind=wind if ours.wind is None else ours.wind,
        time_limit_s=limit_s if ours.time_limit_s is None else ours.time_limit_s,
    )


def of_simulation(document: Located) -> tuple[Wind, float]:
    """Return the wind and the time limit, seconds, in the words of `simulation`; raises Refused as `to_test_case`."""
    simulation = _section(document, "simulation")
    return _wind(document, simulation), _time_limit_s(document, simulation)


def _number(document: Located, path: Place, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _refused(document, path, "a finite number", repr(value))
    return float(value)


def _obstacles(document: Located, raw: Any) -> tuple[Obstacle, ...]:
    base: Place = ("simulation", "obstacles")
    if raw is None:
        return ()
    if not isinstance(raw, list):
        raise _refused(document, base, "a list", type(raw).__name__)
    if raw and not isinstance(raw[0], dict):
        if len(raw) % _FLAT:
            raise _refused(document, base, "l, w, h, x, y, z, r for every box", f"{len(raw)} numbers")
        numbers = [_number(document, (*base, index), value) for index, value in enumerate(raw)]
        return tuple(_flat_box(numbers[start : start + _FLAT]) for start in range(0, len(numbers), _FLAT))
    return tuple(_box(document, (*base, index), entry) for index, entry in enumerate(raw))


def _flat_box(numbers: list[float]) -> Obstacle:
    length, width, height, x, y, z, turn = numbers
    return Obstacle(length_m=length, width_m=width, height_m=height, x_m=x, y_m=y, z_m=z, rotation_deg=turn)


def _box(document: Located, path: Place, raw: Any) -> Obstacle:
    if not isinstance(raw, dict):
        raise _refused(document, path, "a mapping with size and position", repr(raw))
    _refuse_others(document, path, raw, ("size", "position", "shape"))
    shape = raw.get("shape", "box")
    if str(shape).lower() != "box":
        raise _refused(document, (*path, "shape"), "box (other shapes are not flown)", repr(shape))
    size, position = raw.get("size"), raw.get("position")
    for word, part in (("size", size), ("position", position)):
        if not isinstance(part, dict):
            raise _refused(document, (*path, word), "a mapping", repr(part))
    assert isinstance(size, dict), "checked above"
    assert isinstance(position, dict), "checked above"
    _refuse_others(document, (*path, "size"), size, tuple("lwh"))
    _refuse_others(document, (*path, "position"), position, tuple("xyzr"), "`r` turns it, in degrees")

    def number(word: str, part: dict[str, Any], key: str, default: float | None = None) -> float:
        return _number(document, (*path, word, key), part.get(key, default))

    return _flat_box(
        [
            *(number("size", size, key) for key in "lwh"),
            *(number("position", position, key) for key in "xy"),
            number("position", position, "z", 0.0),
            number("position", position, "r", 0.0),
        ]
    )


def _refuse_others(document: Located, path: Place, part: dict[str, Any], known: tuple[str, ...], fix: str = "") -> None:
    """Refuse words unknown to a box: it would stand elsewhere, or be another one, than whoever wrote them meant."""
    for word in part:
        if word not in known:
            what, where = ".".join(map(str, path)), document.at_key((*path, word))
            raise Refused(what, where=where, expected=f"one of {', '.join(known)}", got=repr(word[:80]), fix=fix)


def _time_limit_s(document: Located, simulation: dict[str, Any]) -> float:
    limit = simulation.get("timeout")
    if limit is None:
        return TIME_LIMIT_S
    number = _number(document, ("simulation", "timeout"), limit)
    return number if number > 0 else TIME_LIMIT_S


def _wind(document: Located, simulation: dict[str, Any]) -> Wind:
    """Return the steady wind and the greatest gust above it; the direction vector (x north, y east) says where to.

    As Gazebo's wind plugin has it: the vector's length does not count, and `velocity_max` caps `velocity_mean`. What of
    a slanted wind blows up or down is left out; a wind that blows nowhere in the plane is refused.
    """
    raw = simulation.get("wind")
    if raw is None:
        return Wind()
    path: Place = ("simulation", "wind")
    if not isinstance(raw, dict):
        raise _refused(document, path, "a mapping", repr(raw))
    mean = _speed(document, (*path, "velocity_mean"), raw.get("velocity_mean", 0.0))
    most = _speed(document, (*path, "velocity_max"), raw.get("velocity_max", mean))
    towards = raw.get("direction", [1, 0, 0])
    if not isinstance(towards, list) or len(towards) != 3:
        raise _refused(document, (*path, "direction"), "a list of 3 numbers", repr(towards))
    north, east, up = (_number(document, (*path, "direction", index), value) for index, value in enumerate(towards))
    if not north and not east:
        if not most:
            return Wind()
        raise _refused(document, (*path, "direction"), "a direction in the plane: x or y other than 0", repr(towards))
    from_deg, steady = math.degrees(math.atan2(-east, -north)) % 360.0, min(mean, most)
    share = share_in_plane(north, east, up)
    return Wind(mean_mps=steady * share, from_deg=from_deg, gust_mps=(most - steady) * share)


def _speed(document: Located, path: Place, value: Any) -> float:
    number = _number(document, path, value)
    if number < 0.0:
        raise _refused(document, path, "a speed of 0 or more", repr(value))
    return number


def share_in_plane(x: float, y: float, z: float) -> float:
    """Return how much of a vector lies in the plane, 0 to 1; 1 for one that does as a whole. Not all may be 0."""
    if not z:
        return 1.0
    greatest = max(abs(x), abs(y), abs(z))  # squares of greater numbers would have no end
    return math.hypot(x / greatest, y / greatest) / math.hypot(x / greatest, y / greatest, z / greatest)


# ---- writing ------------------------------------------------------------------------------------------------------


def to_document(test_case: TestCase, plan_name: str = "") -> dict[str, Any]:
    """Return the document of a test case; reading it again with the same mission gives an equal test case.

    `plan_name` is the file the mission is written to; a test case that was read from a document keeps the place named
    there, unless its file has another name.
    Raises Refused where the source it names is none.
    """
    document = _source(test_case.source) if test_case.source else _fresh()
    located = Located(document, "")
    robot = dict(_section(located, *ROBOT_WORDS))
    document[_spelling(document, ROBOT_WORDS)] = robot
    mission = test_case.scenario.mission
    if mission is None:
        robot.pop("mission_file", None)
    else:
        named = robot.get("mission_file") if test_case.source else None
        if not isinstance(named, str) or PurePath(named).name != (plan_name or PurePath(named).name):
            robot["mission_file"] = plan_name or f"{mission.name}.plan"
    simulation = _section(located, "simulation") or document.setdefault("simulation", {}) or {}
    document["simulation"] = simulation
    if not test_case.source or _obstacles(located, simulation.get("obstacles")) != test_case.scenario.obstacles:
        simulation["obstacles"] = [_box_out(box) for box in test_case.scenario.obstacles]
    _write_ours(document, test_case)
    return document


def _source(text: str) -> dict[str, Any]:
    """Return the document a test case was read from; raises Refused where it is none: it may come from anywhere."""
    document = parse_json(text, "source", "test case")
    if not isinstance(document, dict):
        raise Refused("source", where="test case", expected="a mapping", got=type(document).__name__)
    return document


def _fresh() -> dict[str, Any]:
    return {
        "robot": {"port": "ros", "params": dict(_PARAMS), "mission_file": ""},
        "simulation": {"simulator": "ros", "speed": 1, "headless": True, "obstacles": []},
        "mission": {"commands": [dict(command) for command in _COMMANDS]},
    }


def _spelling(document: dict[str, Any], words: tuple[str, ...]) -> str:
    return next((word for word in words if word in document), words[0])


def _box_out(box: Obstacle) -> dict[str, Any]:
    return {
        "size": {"l": box.length_m, "w": box.width_m, "h": box.height_m},
        "position": {"x": box.x_m, "y": box.y_m, "z": box.z_m, "r": box.rotation_deg},
    }


def _write_ours(document: dict[str, Any], test_case: TestCase) -> None:
    """Put what the document does not say already into it, leaving out what is as usual.

    Wind and limit are said in the words of `simulation` in any case, so that Aerialist flies the same, and under
    `saflite` only where those words are read as another number, if by the last digit, or have none for it.
    """
    scenario, located = test_case.scenario, Located(document, "")
    ours = Ours(
        rng_seed=test_case.rng_seed,
        target=test_case.target,
        start=scenario.start,
        wind=scenario.wind,
        time_limit_s=scenario.time_limit_s,
        stimuli=test_case.stimuli,
        heading_deg=test_case.heading_deg,
        twin=test_case.twin,
    )
    simulation = document["simulation"]
    if _wind(located, simulation) != scenario.wind:
        _write_wind(simulation, scenario.wind)
    if _time_limit_s(located, simulation) != scenario.time_limit_s:
        simulation["timeout"] = math.ceil(scenario.time_limit_s)  # Aerialist takes whole seconds, and 0 as no limit
    if _in_force(located, simulation) == ours:
        return
    usual = Ours(wind=_wind(located, simulation), time_limit_s=_time_limit_s(located, simulation))
    plain, full = msgspec.to_builtins(usual), msgspec.to_builtins(ours)
    block = {word: value for word, value in full.items() if value != plain[word]}
    if block:
        document[OURS] = block
    else:
        document.pop(OURS, None)


def _write_wind(simulation: dict[str, Any], wind: Wind) -> None:
    """Say a wind in the competition's words, none where nothing blows; what the words said before is another wind."""
    if not wind.mean_mps and not wind.gust_mps:
        simulation.pop("wind", None)
        return
    from_rad = math.radians(wind.from_deg if wind.mean_mps >= 0.0 else wind.from_deg + 180.0)
    simulation["wind"] = {
        "velocity_mean": abs(wind.mean_mps),
        "velocity_max": abs(wind.mean_mps) + max(0.0, wind.gust_mps),
        "direction": [-math.cos(from_rad), -math.sin(from_rad), 0.0],
    }
