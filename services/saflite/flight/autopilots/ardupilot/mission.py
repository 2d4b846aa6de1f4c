"""Missions as ArduCopter takes them."""

from __future__ import annotations

import msgspec

from saflite.contract.test_case import Mission, MissionItem

SET_CAMERA_MODE, CONDITION_DELAY = 530, 112
REFUSED = frozenset({SET_CAMERA_MODE})
"""Commands that ArduCopter refuses in a mission, and with them the whole of it, though they move nothing."""


def as_taken(mission: Mission) -> Mission:
    """Return the mission with a delay of 0 s in place of what only concerns the camera; items keep their numbers."""
    items = tuple(_nothing(item) if item.command in REFUSED else item for item in mission.items)
    return msgspec.structs.replace(mission, items=items)


def _nothing(item: MissionItem) -> MissionItem:
    return msgspec.structs.replace(item, command=CONDITION_DELAY, params=(0, 0, 0, 0, 0, 0, 0))
