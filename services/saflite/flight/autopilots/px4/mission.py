"""Missions as PX4 takes them."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from saflite.contract.test_case import Mission, MissionItem
from saflite.flight.mission import NAV_LAST

DO_JUMP = 177
PLACELESS = frozenset({20, 93})  # MAV_CMD that fly, but to no place told: NAV_RETURN_TO_LAUNCH, NAV_DELAY
PLACED = frozenset({16, 17, 18, 19, 21, 22, 82})  # MAV_CMD that fly to a place, or where they are without one
FRAME_MISSION = 2  # MAV_FRAME: the item is at no place


def as_taken(mission: Mission) -> Mission:
    """Return the mission as QGroundControl sends it to PX4: what is at no place told so, jumps counted from 0.

    In a frame with a place PX4 1.17 refuses a change of speed, a delay or a jump, and with it the whole mission. Plans
    count items from 1, as autopilots do that hold home as item 0; PX4 holds none. A latitude and longitude of 0, 0 are
    a place off Africa to PX4; to our vehicle and to ArduPilot they say where the item before is, which is told instead.
    """
    return msgspec.structs.replace(mission, items=tuple(_counted(_framed(item)) for item in _placed(mission)))


def _placed(mission: Mission) -> Iterator[MissionItem]:
    """Yield the items, those without a place at that of the item before them, the first at home."""
    last: tuple[float | None, ...] = (mission.home_lat_deg, mission.home_lon_deg)
    for item in mission.items:
        params = item.params
        if item.command in PLACED and params[4:6] == (0.0, 0.0):
            params = (*params[:4], *last, params[6])
        elif item.command in PLACED:
            last = params[4:6]
        yield msgspec.structs.replace(item, params=params)


def _framed(item: MissionItem) -> MissionItem:
    placeless = item.command in PLACELESS or (item.command > NAV_LAST and not any(item.params[4:]))
    return msgspec.structs.replace(item, frame=FRAME_MISSION) if placeless else item


def _counted(item: MissionItem) -> MissionItem:
    first, *rest = item.params
    if item.command != DO_JUMP or first is None:
        return item
    return msgspec.structs.replace(item, params=(first - 1.0, *rest))
