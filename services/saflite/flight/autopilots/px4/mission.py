"""Missions as PX4 takes them."""

from __future__ import annotations

import msgspec

from saflite.contract.test_case import Mission, MissionItem
from saflite.flight.mission import NAV_LAST

PLACELESS = frozenset({20, 93})  # MAV_CMD that fly, but to no place told: NAV_RETURN_TO_LAUNCH, NAV_DELAY
FRAME_MISSION = 2  # MAV_FRAME: the item is at no place


def as_taken(mission: Mission) -> Mission:
    """Return the mission with what is at no place told so, as QGroundControl writes it.

    In a frame with a place PX4 1.17 refuses a change of speed, a delay or a jump, and with it the whole mission.
    """
    return msgspec.structs.replace(mission, items=tuple(map(_framed, mission.items)))


def _framed(item: MissionItem) -> MissionItem:
    placeless = item.command in PLACELESS or (item.command > NAV_LAST and not any(item.params[4:]))
    return msgspec.structs.replace(item, frame=FRAME_MISSION) if placeless else item
