"""Missions: QGroundControl `.plan` files read and written without loss, way-points in the local frame, built-ins.

The local frame is azimuthal equidistant about the planned home position (sphere of 6,371,000 m, as PX4 projects):
x north, y east, z up, metres.
"""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import msgspec

from saflite.contract import wire
from saflite.contract.bounds import Word
from saflite.contract.errors import Refused
from saflite.contract.outside import parse_json, read_text
from saflite.contract.test_case import Mission, MissionItem, Plain

EARTH_RADIUS_M = 6_371_000.0
NAV_LAST = 95  # MAV_CMD up to this fly somewhere, those after it do something or wait
MISSIONS_DIR = Path(__file__).parent / "missions"
MISSION_YAW_DEG = 90.0  # the competition's vehicle stands nose east

WaypointKind = Literal["takeoff", "waypoint", "land", "return"]

_KINDS: dict[int, WaypointKind] = {16: "waypoint", 19: "waypoint", 82: "waypoint", 22: "takeoff", 21: "land"}
_PLACES_BESIDE: dict[int, WaypointKind] = {17: "waypoint", 18: "waypoint", 84: "takeoff", 85: "land"}
_RETURN, _HOLD_S_FIRST = 20, {16, 19}
_NOT_FLOWN = {17: "loiter for ever", 18: "loiter turns", 84: "VTOL take-off", 85: "VTOL landing", 177: "jump"}
_FRAME_ABSOLUTE, _FRAME_RELATIVE = {0, 5}, {3, 6, 10, 11}
ITEM_KEYS = {"autoContinue", "command", "doJumpId", "frame", "params", "type"}
ITEMS_EXTRA = "_items_extra"  # in `plan_extra`: what items hold beyond plain values, by index


class Waypoint(NamedTuple):
    """A place to go to in the local frame; `hold_s` is how long to stay there."""

    kind: WaypointKind
    x_m: float
    y_m: float
    z_m: float
    hold_s: float = 0.0


# ---- reading ------------------------------------------------------------------------------------------------------


def load_plan(path: Path, name: str = "") -> Mission:
    """Return the mission in a `.plan` file, named after the file; raises Refused if it is missing or is no plan."""
    return parse_plan(read_text(path, "mission plan"), str(path), name or path.stem)


def parse_plan(text: str, where: str, name: str = "mission") -> Mission:
    """Return the mission in the text of a QGroundControl `.plan`.

    Everything the file holds is kept. Raises Refused naming `where` and the key for text that is no plan, for
    ComplexItems (surveys and the like) and for items without the seven parameters.
    """
    document = _read_json(text, where)
    mission = document.get("mission")
    if document.get("fileType") != "Plan" or not isinstance(mission, dict):
        got = f"fileType {document.get('fileType')!r}, keys {', '.join(sorted(document)) or 'none'}"
        raise Refused("mission plan", where=where, expected='a QGroundControl plan (fileType "Plan")', got=got)
    home = _numbers(mission.get("plannedHomePosition"), 3, "plannedHomePosition", where)
    raw_items = mission.get("items")
    if not isinstance(raw_items, list) or not raw_items:
        raise Refused("mission.items", where=where, expected="a list with at least one item", got=raw_items)
    items: list[MissionItem] = []
    nested: dict[str, Any] = {}
    for index, raw in enumerate(raw_items):
        item, deep = _parse_item(raw, f"mission.items[{index}]", where)
        items.append(item)
        if deep:
            nested[str(index)] = deep
    rest = {**document, "mission": {k: v for k, v in mission.items() if k not in ("items", "plannedHomePosition")}}
    if nested:
        rest[ITEMS_EXTRA] = nested
    return Mission(
        name=name,
        home_lat_deg=home[0],
        home_lon_deg=home[1],
        home_alt_m=home[2],
        items=tuple(items),
        plan_extra=json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False),
    )


def _read_json(text: str, where: str) -> dict[str, Any]:
    document = parse_json(text, "mission plan", where)
    if not isinstance(document, dict):
        raise Refused("mission plan", where=where, expected="a JSON object", got=type(document).__name__)
    return document


def _numbers(value: Any, count: int, key: str, where: str) -> list[float]:
    good = isinstance(value, list) and len(value) == count
    if not good or not all(isinstance(number, int | float) and not isinstance(number, bool) for number in value):
        raise Refused(f"mission.{key}", where=where, expected=f"a list of {count} numbers", got=value)
    return [float(number) for number in value]


def _parse_item(raw: Any, key: str, where: str) -> tuple[MissionItem, dict[str, Any]]:
    """Return the item and what it holds beyond plain values."""
    if not isinstance(raw, dict):
        raise Refused(key, where=where, expected="an object", got=type(raw).__name__)
    kind = raw.get("type", "SimpleItem")
    if kind != "SimpleItem":
        fix = "convert it to plain way-points in QGroundControl first"
        got = f"{kind} {raw.get('complexItemType', '')}".strip()
        raise Refused(key, where=where, expected="a SimpleItem (one MAVLink command)", got=got, fix=fix)
    command, frame, jump_id = raw.get("command"), raw.get("frame", 3), raw.get("doJumpId", 0)
    for word, value in (("command", command), ("frame", frame), ("doJumpId", jump_id)):
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= 65535:
            raise Refused(f"{key}.{word}", where=where, expected="a whole number 0..65535", got=value)
    auto = raw.get("autoContinue", True)
    if not isinstance(auto, bool):
        raise Refused(f"{key}.autoContinue", where=where, expected="true or false", got=auto)
    params = raw.get("params")
    if not isinstance(params, list) or len(params) != 7 or not all(_is_number_or_none(value) for value in params):
        raise Refused(f"{key}.params", where=where, expected="a list of 7 numbers or null", got=params)
    rest = {k: v for k, v in raw.items() if k not in ITEM_KEYS}
    plain = {k: v for k, v in rest.items() if _is_plain(k, v)}
    item = MissionItem(
        command=int(command or 0),
        frame=frame,
        params=tuple(None if value is None else float(value) for value in params),
        auto_continue=auto,
        jump_id=jump_id,
        extra=plain,
    )
    return item, {k: v for k, v in rest.items() if k not in plain}


def _is_number_or_none(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300)


def _is_plain(key: str, value: Any) -> bool:
    """Return whether the value fits `MissionItem.extra`; anything deeper, longer or larger is kept in `plan_extra`."""
    try:
        wire.convert({key: value}, dict[Word, Plain | None])
    except msgspec.ValidationError:
        return False
    return True


# ---- writing ------------------------------------------------------------------------------------------------------


def dump_plan(mission: Mission) -> str:
    """Return the mission as the text of a QGroundControl `.plan`; reading it again gives the same mission.

    Raises Refused where what is kept beside the items is none of a plan: a mission may come from anywhere.
    """
    document, head, nested = _kept(mission)
    defaults: dict[str, Any] = {"cruiseSpeed": 15, "firmwareType": 12, "hoverSpeed": 5, "vehicleType": 2, "version": 2}
    outer: dict[str, Any] = {
        "fileType": "Plan",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "groundStation": "QGroundControl",
        "rallyPoints": {"points": [], "version": 2},
        "version": 1,
    }
    if len(document) == 1 and not head:  # made by us, not read from a file
        document |= outer
        head |= defaults
    head["plannedHomePosition"] = [_short(v) for v in (mission.home_lat_deg, mission.home_lon_deg, mission.home_alt_m)]
    head["items"] = [_dump_item(item) | nested.get(str(index), {}) for index, item in enumerate(mission.items)]
    return json.dumps(document, indent=4, sort_keys=True, ensure_ascii=False) + "\n"


def _kept(mission: Mission) -> tuple[dict[str, Any], dict[str, Any], dict[str, dict[str, Any]]]:
    """Return what a mission keeps of its plan: the document, its part on the mission, what items hold nested."""
    where = f"mission {mission.name}"
    document = _read_json(mission.plan_extra, where)
    nested, head = document.pop(ITEMS_EXTRA, {}), document.setdefault("mission", {})
    parts = (head, nested, *(nested.values() if isinstance(nested, dict) else ()))
    if not all(isinstance(part, dict) for part in parts):
        raise Refused("mission.plan_extra", where=where, expected="the rest of a plan", got="something else")
    return document, head, nested


def _dump_item(item: MissionItem) -> dict[str, Any]:
    raw: dict[str, Any] = {
        "type": "SimpleItem",
        "command": item.command,
        "frame": item.frame,
        "params": [None if value is None else _short(value) for value in item.params],
        "autoContinue": item.auto_continue,
    }
    if item.jump_id:
        raw["doJumpId"] = item.jump_id
    return raw | item.extra


def _short(number: float) -> float | int:
    return int(number) if number == int(number) and abs(number) < 2**53 else number


# ---- the local frame ----------------------------------------------------------------------------------------------


def to_local(lat_deg: float, lon_deg: float, home_lat_deg: float, home_lon_deg: float) -> tuple[float, float]:
    """Return (x_m, y_m) of a geographic point as seen from home (azimuthal equidistant, Snyder 1987, section 25)."""
    lat, lat0 = math.radians(lat_deg), math.radians(home_lat_deg)
    dlon = math.radians(lon_deg - home_lon_deg)
    north = math.cos(lat0) * math.sin(lat) - math.sin(lat0) * math.cos(lat) * math.cos(dlon)
    east = math.cos(lat) * math.sin(dlon)
    cos_angle = math.sin(lat0) * math.sin(lat) + math.cos(lat0) * math.cos(lat) * math.cos(dlon)
    sine = math.hypot(north, east)
    scale = EARTH_RADIUS_M * (math.atan2(sine, cos_angle) / sine if sine > 0 else 1.0)
    return north * scale, east * scale


def to_geographic(x_m: float, y_m: float, home_lat_deg: float, home_lon_deg: float) -> tuple[float, float]:
    """Return (lat_deg, lon_deg) of a local point, NaN where it is at no finite place; the inverse of `to_local`."""
    angle = math.hypot(x_m, y_m) / EARTH_RADIUS_M
    if not math.isfinite(angle):
        return math.nan, math.nan
    if angle == 0:
        return home_lat_deg, home_lon_deg
    lat0, bearing = math.radians(home_lat_deg), math.atan2(y_m, x_m)
    sin_lat = math.sin(lat0) * math.cos(angle) + math.cos(lat0) * math.sin(angle) * math.cos(bearing)
    run = math.cos(lat0) * math.cos(angle) - math.sin(lat0) * math.sin(angle) * math.cos(bearing)
    dlon = math.atan2(math.sin(angle) * math.sin(bearing), run)
    return math.degrees(math.asin(max(-1.0, min(1.0, sin_lat)))), home_lon_deg + math.degrees(dlon)


def waypoints(mission: Mission) -> tuple[Waypoint, ...]:
    """Return the places the mission flies to, in order, metres from home, where there is nothing else to it.

    Items without a place (camera, speed, gimbal, ...) are left out; a missing position means "where the last one
    was". Raises Refused for items that are more than a place (jumps, turns, VTOL) and for unknown altitude frames.
    """
    for index, item in enumerate(mission.items):
        where = f"mission {mission.name}, item {index}"
        if item.command in _NOT_FLOWN:
            expected = "take-off, way-point, land or return"
            raise Refused("mission item", where=where, expected=expected, got=_NOT_FLOWN[item.command])
        if item.command in _KINDS and item.params[6] is not None:
            _check_frame(item.frame, where)
    places = places_of(mission)
    if not places:
        raise Refused("mission", where=mission.name, expected="at least one place to fly to", got="none")
    return places


def only_places(mission: Mission) -> bool:
    """Return whether there is nothing to a mission but places to fly to, in order: `waypoints` takes it."""
    try:
        return bool(waypoints(mission))
    except Refused:
        return False


def places_of(mission: Mission) -> tuple[Waypoint, ...]:
    """Return the places of any mission, to draw it or to tell of it: once each, however often a jump leads there."""
    places: list[Waypoint] = []
    x_m, y_m, z_m = 0.0, 0.0, 0.0
    for item in mission.items:
        if item.command == _RETURN:
            x_m, y_m = 0.0, 0.0
            places.append(Waypoint("return", x_m, y_m, 0.0))
            continue
        kind = (_KINDS | _PLACES_BESIDE).get(item.command)
        if kind is None:
            continue
        hold_s, lat, lon, alt = item.params[0], item.params[4], item.params[5], item.params[6]
        if lat and lon:
            x_m, y_m = to_local(lat, lon, mission.home_lat_deg, mission.home_lon_deg)
        if alt is not None:
            z_m = alt - mission.home_alt_m if item.frame in _FRAME_ABSOLUTE else alt
        places.append(Waypoint(kind, x_m, y_m, z_m, (hold_s or 0.0) if item.command in _HOLD_S_FIRST else 0.0))
    return tuple(places)


def _check_frame(frame: int, where: str) -> None:
    if frame not in _FRAME_RELATIVE | _FRAME_ABSOLUTE:
        raise Refused("altitude frame", where=where, expected="0 (absolute) or 3 (relative)", got=frame)


# ---- built-in missions --------------------------------------------------------------------------------------------


def mission_names() -> tuple[str, ...]:
    """Return the names of the built-in missions; a name with `standin` is not an official one."""
    return tuple(sorted(path.stem for path in MISSIONS_DIR.glob("*.plan")))


@cache
def builtin_mission(name: str) -> Mission:
    """Return a built-in mission; raises Refused naming the ones there are."""
    path = MISSIONS_DIR / f"{name}.plan"
    if name not in mission_names():
        raise Refused("mission", expected=f"one of {', '.join(mission_names())} or a .plan file", got=repr(name))
    return load_plan(path)


def find_mission(name_or_path: str, base: Path | None = None) -> Mission:
    """Return a built-in mission by name, or the one in a `.plan` file (relative to `base` if given)."""
    if name_or_path.endswith(".plan"):
        path = Path(name_or_path)
        return load_plan(path if base is None or path.is_absolute() else base / path)
    return builtin_mission(name_or_path)
