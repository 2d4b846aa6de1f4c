"""What a competition document says and no flight here heeds, in words for the user: kept, but not flown.

Unknown words are one kind (Aerialist of another version may know them), the other are known ones that would change the
flight. Where a box stands leaves no room for either: unknown words there are refused in `document`.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator
from typing import Any

from saflite.contract.test_case import Mission, TestCase, Wind
from saflite.flight.competition.document import OURS, PLAN_WORDS, ROBOT_WORDS, of_simulation, share_in_plane
from saflite.flight.competition.yaml_text import Located
from saflite.flight.competition.yaml_text import Path as Place

TOLD_MAX = 20
_SHOWN = 80  # characters of a word of the document
_HOME_DEG = 1e-6  # a home nearer than this, some 0.1 m, is the same
_WIND_FLOWN = ("velocity_mean", "velocity_max", "direction")
_WIND_NOT_FLOWN = (
    *("velocity_variance", "direction_variance", "gust_start", "gust_duration", "gust_direction"),
    *("gust_velocity_mean", "gust_velocity_max", "gust_velocity_variance", "gust_direction_variance"),
)
_WHERE_ONLY = ("gust_start", "gust_direction")  # when and where to a gust blows, if one does
WORDS: dict[str, tuple[str, ...]] = {
    "": (*ROBOT_WORDS, "simulation", *PLAN_WORDS, "assertion", "agent", OURS),
    **dict.fromkeys(ROBOT_WORDS, ("port", "params", "params_file", "mission_file")),
    "simulation": (
        *("simulator", "world", "speed", "headless", "obstacles", "home_position", "timeout", "wind"),
        "world_file_name",  # of older versions
    ),
    "simulation.wind": (*_WIND_FLOWN, *_WIND_NOT_FLOWN),
    **dict.fromkeys(PLAN_WORDS, ("commands", "commands_file", "speed", "waypoints")),
    "assertion": ("log_file", "variable", "expectation"),
    "agent": ("engine", "count", "path", "id"),
}
"""The words of Aerialist's format by the place they stand in."""


def remarks(document: Located, case: TestCase) -> tuple[str, ...]:
    """Return a line, with the place, for all that a document says in vain, up to `TOLD_MAX`.

    `case` is the test case that was read from it.
    """
    mission = case.scenario.mission
    found = [
        *_unknown(document),
        *_twice(document, case),
        *_world(document, mission),
        *_plan(document),
        *_wind(document),
    ]
    more = len(found) - TOLD_MAX
    return (*found[:TOLD_MAX], *([f"{document.where}: and {more} more of this kind"] if more > 0 else ()))


def _unknown(document: Located) -> Iterator[str]:
    told = 0
    for place, known in WORDS.items():
        path = tuple(place.split(".")) if place else ()
        for word in _mapping(document, path):
            if word not in known:
                told += 1
                near = _near(document, place, word[:_SHOWN]) if told <= TOLD_MAX else ""  # looking takes a millisecond
                ask = f"; did you mean `{near}`?" if near else ""
                yield f"{document.at_key((*path, word))}: `{_named(place, word)}` is unknown and not flown{ask}"


def _near(document: Located, place: str, word: str) -> str:
    """Return the known word most like an unknown one, with its place: itself of another place, or one of its own."""
    places = sorted(WORDS, key=lambda other: bool(other) and other.partition(".")[0] not in document.data)
    for other in places:
        if word in WORDS[other]:
            return _named(other, word)
    for other in (place, *places):
        for near in difflib.get_close_matches(word, WORDS[other], 1):
            return _named(other, near)
    return ""


def _named(place: str, word: str) -> str:
    return (f"{place}." if place else "") + (word if len(word) <= _SHOWN else f"{word[:_SHOWN]}...")


def _mapping(document: Located, path: Place) -> dict[str, Any]:
    part: Any = document.data
    for word in path:
        part = part.get(word) if isinstance(part, dict) else None
    return part if isinstance(part, dict) else {}


def _twice(document: Located, case: TestCase) -> Iterator[str]:
    """What is said in two ways: the current spelling goes before that of 2024, and what is ours before both."""
    for words in (ROBOT_WORDS, PLAN_WORDS):
        both = [word for word in words if document.data.get(word) is not None]
        if len(both) > 1:
            yield f"{document.at_key((both[1],))}: `{both[1]}` is not read, since `{both[0]}` is there, too"
    (wind, limit_s), flown = of_simulation(document), case.scenario
    same = {"wind": _alike(wind, flown.wind), "timeout": math.ceil(limit_s) == math.ceil(flown.time_limit_s)}
    for word, ours in (("wind", "wind"), ("timeout", "time_limit_s")):
        if not same[word] and _mapping(document, ("simulation",)).get(word) is not None:
            place = document.at_key(("simulation", word))
            yield f"{place}: `simulation.{word}` is not flown, since `{OURS}.{ours}` goes before it"


def _alike(one: Wind, other: Wind) -> bool:
    """Return whether two winds are the same but for rounding, and for what the competition has no words for."""
    return all(
        math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-6) for a, b in zip(_numbers(one), _numbers(other), strict=True)
    )


def _numbers(wind: Wind) -> tuple[float, float, float]:
    from_rad = math.radians(wind.from_deg)
    return wind.mean_mps * math.cos(from_rad), wind.mean_mps * math.sin(from_rad), max(0.0, wind.gust_mps)


def _world(document: Located, mission: Mission | None) -> Iterator[str]:
    simulation = _mapping(document, ("simulation",))
    for word in ("world", "world_file_name"):
        if simulation.get(word) not in (None, "default"):
            place = document.at_key(("simulation", word))
            yield f"{place}: `simulation.{word}` is not flown: boxes on a plain are all there is"
    home = simulation.get("home_position")
    if home is not None and not _is_home(home, mission):
        place = document.at_key(("simulation", "home_position"))
        yield f"{place}: `simulation.home_position` is not flown: a flight begins at the planned home of its mission"


def _plan(document: Located) -> Iterator[str]:
    """What is given during the flight, and files that nobody reads: what they say is not known here."""
    robot, word = (next((w for w in words if w in document.data), words[0]) for words in (ROBOT_WORDS, PLAN_WORDS))
    plan = _mapping(document, (word,))
    if _mapping(document, (robot,)).get("params_file"):
        place = document.at_key((robot, "params_file"))
        yield f"{place}: `{robot}.params_file` is not read: its parameters are not set; `{OURS}.stimuli` can set some"
    if plan.get("commands_file"):
        place = document.at_key((word, "commands_file"))
        yield f"{place}: `{word}.commands_file` is not read: none of its commands is given; see `{OURS}.stimuli`"
    if plan.get("speed") not in (None, 1):
        place = document.at_key((word, "speed"))
        yield f"{place}: `{word}.speed` other than 1 is not flown"
    if plan.get("waypoints"):
        place = document.at_key((word, "waypoints"))
        yield f"{place}: `{word}.waypoints` are not flown: those of the mission file are"
    if any(not _begins(command) for command in _list(plan.get("commands"))):
        place = document.at_key((word, "commands"))
        yield f"{place}: of `{word}.commands` only the order to fly the mission (mode 3) is flown; see `{OURS}.stimuli`"


def _is_home(home: object, mission: Mission | None) -> bool:
    if mission is None or not isinstance(home, list) or len(home) < 2:
        return False
    planned = (mission.home_lat_deg, mission.home_lon_deg)
    return all(
        isinstance(number, int | float) and abs(number - there) <= _HOME_DEG
        for number, there in zip(home, planned, strict=False)
    )


def _list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _begins(command: object) -> bool:
    """Return whether a command only has the mission flown, as all case studies of the competition do."""
    return isinstance(command, dict) and command.get("mode") == 3


def _wind(document: Located) -> Iterator[str]:
    """What of a wind is not flown; that the document was understood says that its numbers are numbers."""
    path = ("simulation", "wind")
    wind = _mapping(document, path)
    mean = wind.get("velocity_mean", 0.0)
    if wind.get("velocity_max", mean) < mean:
        yield f"{document.at_key((*path, 'velocity_max'))}: `velocity_max` is below `velocity_mean`, and caps the wind"
    x, y, z = wind.get("direction", (1, 0, 0))
    if z and (x or y):
        share = share_in_plane(x, y, z)
        place = document.at_key((*path, "direction"))
        yield f"{place}: `direction` is slanted: {share:.0%} of the wind, what blows in the plane, is flown"
    lost = [word for word in _WIND_NOT_FLOWN if word not in _WHERE_ONLY and wind.get(word) not in (None, 0)]
    if lost:
        named, be = ", ".join(f"`{word}`" for word in lost), "is" if len(lost) == 1 else "are"
        gusts = "gusts are those between `velocity_mean` and `velocity_max`"
        yield f"{document.at_key((*path, lost[0]))}: {named} of the wind {be} not flown: {gusts}"
