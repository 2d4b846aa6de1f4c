"""Mission items as the autopilot flies them."""

from __future__ import annotations

from typing import Literal, NamedTuple

from saflite.contract.errors import Refused
from saflite.contract.test_case import Mission, MissionItem
from saflite.flight.mission import to_local

Kind = Literal["takeoff", "waypoint", "land", "return", "loiter", "speed", "yaw", "delay", "jump", "skip"]
KINDS: dict[int, Kind] = {
    16: "waypoint",
    82: "waypoint",
    19: "waypoint",
    17: "loiter",
    20: "return",
    21: "land",
    22: "takeoff",
    93: "delay",
    112: "delay",
    115: "yaw",
    177: "jump",
    178: "speed",
}
SKIPPED = {201, 202, 203, 205, 206, 530, 531, 2000, 2001, 2500, 2501, 179, 181, 183, 189, 211}


class Item(NamedTuple):
    """One item: a place (north, east, height above home) or a number (speed, heading, seconds, item to jump to).

    A heading that is `relative` is a turn from where the nose points, to the left if negative.
    """

    kind: Kind
    place: tuple[float, float, float] | None = None
    hold_s: float = 0.0
    number: float = 0.0
    relative: bool = False


def understand(mission: Mission) -> tuple[Item, ...]:
    """Return the items of a mission; raises Refused for one this autopilot cannot fly."""
    items: list[Item] = []
    last = (0.0, 0.0, 0.0)
    for index, raw in enumerate(mission.items):
        item = _item(mission, raw, last, f"mission {mission.name}, item {index}")
        last = item.place or last
        items.append(item)
    return tuple(items)


def _item(mission: Mission, raw: MissionItem, last: tuple[float, float, float], where: str) -> Item:
    numbers = [value or 0.0 for value in raw.params]
    kind = KINDS.get(raw.command, "skip")
    if kind == "skip" and raw.command not in SKIPPED:
        expected = f"one of {', '.join(map(str, sorted(set(KINDS) | SKIPPED)))}"
        raise Refused("mission command", where=where, expected=expected, got=raw.command)
    if kind in ("takeoff", "waypoint", "land", "loiter"):
        north, east = last[:2]
        if raw.params[4] and raw.params[5]:
            north, east = to_local(numbers[4], numbers[5], mission.home_lat_deg, mission.home_lon_deg)
        up_m = last[2] if raw.params[6] is None else numbers[6] - (mission.home_alt_m if raw.frame in (0, 5) else 0.0)
        return Item(kind, (north, east, up_m), hold_s=numbers[0] if raw.command in (16, 19, 82) else 0.0)
    if kind == "jump":
        return Item(kind, hold_s=numbers[1], number=numbers[0] - 1.0)
    if kind == "speed":
        return Item(kind if numbers[0] <= 1 else "skip", number=numbers[1])
    if kind == "delay":
        return Item(kind, number=max(0.0, numbers[0]))
    if kind == "yaw":
        relative = numbers[3] > 0.0
        return Item(kind, number=-numbers[0] if relative and numbers[2] < 0.0 else numbers[0], relative=relative)
    return Item(kind)
