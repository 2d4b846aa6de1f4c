"""What a QGroundControl `.plan` says and no flight here heeds, in words for the user: kept, but not flown.

The speeds of a plan (`cruiseSpeed`, `hoverSpeed`) are none of it: QGroundControl estimates times by them and sends them
to no vehicle; a speed to be flown is an item (MAV_CMD_DO_CHANGE_SPEED). `firmwareType` changes no item either.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from typing import Any

from saflite.contract.errors import Refused
from saflite.contract.outside import parse_json
from saflite.contract.test_case import Mission
from saflite.flight.mission import ITEM_KEYS, ITEMS_EXTRA

TOLD_MAX = 20
LOOKED_AT_MAX = 500
"""Unknown words that are held against those of the format; each takes a tenth of a millisecond."""

_SHOWN = 80  # characters of a word of the file
MULTICOPTERS = (0, 2, 3, 13, 14, 15, 29, 35, 43)  # MAV_TYPE: generic, four rotors, coaxial, six, eight, three, ...
_OUTER = ("fileType", "geoFence", "groundStation", "mission", "rallyPoints", "version")
_HEAD = (
    *("cruiseSpeed", "firmwareType", "globalPlanAltitudeMode", "hoverSpeed"),
    *("items", "plannedHomePosition", "vehicleType", "version"),
)
_ITEM = (*sorted(ITEM_KEYS), "AMSLAltAboveTerrain", "Altitude", "AltitudeMode")


def plan_remarks(mission: Mission, where: str) -> tuple[str, ...]:
    """Return a line for all that the plan of a mission says in vain, up to `TOLD_MAX`; `where` is its file.

    A mission may come from anywhere: nothing is told of one that keeps no plan.
    """
    try:
        outer = _mapping(parse_json(mission.plan_extra, "mission plan", where))
    except Refused:
        return ()
    head, nested = _mapping(outer.get("mission")), _mapping(outer.pop(ITEMS_EXTRA, None))
    found = [*_known(outer, head, mission), *_misspelt(outer, head, nested, mission)]
    more = len(found) - TOLD_MAX
    told = (*found[:TOLD_MAX], *([f"and {more} more of this kind"] if more > 0 else ()))
    return tuple(f"{where}: {words}" for words in told)


def _mapping(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _known(outer: dict[str, Any], head: dict[str, Any], mission: Mission) -> Iterator[str]:
    fence = [key for key, value in _mapping(outer.get("geoFence")).items() if key != "version" and value]
    if fence:
        named = ", ".join(key[:_SHOWN] for key in fence[:3])
        yield f"`geoFence` ({named}) is not flown: fences here are those of parameters"
    if _mapping(outer.get("rallyPoints")).get("points"):
        yield "`rallyPoints` are not flown: a return leads home"
    kind = head.get("vehicleType", 2)
    if isinstance(kind, int) and kind not in MULTICOPTERS:
        yield f"`mission.vehicleType` {kind} is no multicopter, and one flies it"
    waiting = [index for index, item in enumerate(mission.items) if not item.auto_continue]
    if waiting:
        yield f"`autoContinue` false of {_items(waiting)} is not flown: the next item follows at once"


def _items(indexes: list[int]) -> str:
    more = f" and {len(indexes) - 1} more" if len(indexes) > 1 else ""
    return f"mission.items[{indexes[0]}]{more}"


def _misspelt(outer: dict[str, Any], head: dict[str, Any], nested: dict[str, Any], mission: Mission) -> Iterator[str]:
    """Words that are nearly one of the format's, or stand elsewhere than it: others are notes, as plans may hold."""
    of_items: dict[str, list[int]] = {}
    for index, item in enumerate(mission.items):
        for word in (*item.extra, *_mapping(nested.get(str(index)))):
            of_items.setdefault(word, []).append(index)
    words: list[tuple[str, str, tuple[str, ...]]] = [
        *((f"`{word[:_SHOWN]}`", word, _OUTER) for word in outer),
        *((f"`mission.{word[:_SHOWN]}`", word, _HEAD) for word in head),
        *((f"`{word[:_SHOWN]}` of {_items(indexes)}", word, _ITEM) for word, indexes in of_items.items()),
    ]
    unknown = [(named, word, known) for named, word, known in words if word not in known]
    for named, word, known in unknown[:LOOKED_AT_MAX]:
        near = _near(word[:_SHOWN], known)
        if near:
            yield f"{named} is unknown and not flown; did you mean `{near}`?"


def _near(word: str, known: tuple[str, ...]) -> str:
    for prefix, words in (("", _OUTER[1:-1]), ("mission.", _HEAD[:-1])):
        if word in words:
            return prefix + word
    return next(iter(difflib.get_close_matches(word, known, 1)), "")
