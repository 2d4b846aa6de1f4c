"""Missions as PX4 takes them."""

from __future__ import annotations

import msgspec

from saflite.contract.test_case import Mission, MissionItem
from saflite.flight.mission import NAV_LAST

DO_JUMP = 177
PLACELESS = frozenset({20, 93})  # MAV_CMD that fly, but to no place told: NAV_RETURN_TO_LAUNCH, NAV_DELAY
FRAME_MISSION = 2  # MAV_FRAME: the item is at no place


def as_taken(mission: Mission) -> Mission:
    """Return the mission as QGroundControl sends it to PX4: what is at no place told so, jumps counted from 0.

    In a frame with a place PX4 1.17 refuses a change of speed, a delay or a jump, and with it the whole mission. Plans
    count items from 1, as autopilots do that hold home as item 0; PX4 holds none.
    """
    return msgspec.structs.replace(mission, items=tuple(_counted(_framed(item)) for item in mission.items))


def _framed(item: MissionItem) -> MissionItem:
    placeless = item.command in PLACELESS or (item.command > NAV_LAST and not any(item.params[4:]))
    return msgspec.structs.replace(item, frame=FRAME_MISSION) if placeless else item


def _counted(item: MissionItem) -> MissionItem:
    first, *rest = item.params
    if item.command != DO_JUMP or first is None:
        return item
    return msgspec.structs.replace(item, params=(first - 1.0, *rest))
