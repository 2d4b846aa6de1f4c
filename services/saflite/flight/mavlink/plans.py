"""What a ground station can upload: the mission, the points of a fence, rally points (MAV_MISSION_TYPE 0, 1, 2).

Item 0 of the mission is home, as with ArduPilot; fence and rally points have no such item. The vehicle flies missions
only: fence and rally points are kept and given back as they came, and it says that it heeds neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from saflite.contract.test_case import Mission, MissionItem
from saflite.flight.mavlink.items import home_item
from saflite.flight.mavlink.vehicle import LinkedVehicle

MISSION, FENCE, RALLY = 0, 1, 2
RETURN_POINT, INCLUSION, EXCLUSION, CIRCLE_IN, CIRCLE_OUT, RALLY_POINT = 5000, 5001, 5002, 5003, 5004, 5100
FENCE_COMMANDS = frozenset((RETURN_POINT, INCLUSION, EXCLUSION, CIRCLE_IN, CIRCLE_OUT))
CORNERS_MIN = 3


class Plan(Protocol):
    """Items that go up and down as one."""

    @property
    def count(self) -> int:
        """How many items a download has."""
        ...

    @property
    def current(self) -> int:
        """The item being flown or next; -1 where none is flown."""
        ...

    def item(self, index: int) -> MissionItem | None:
        """Return an item, None if there is none."""
        ...

    def takes(self, command: int) -> bool:
        """Return whether an item may have this command."""
        ...

    def store(self, items: Sequence[MissionItem]) -> str:
        """Put what was uploaded in the place of what was there; return why not."""
        ...


class MissionPlan:
    """The mission of the vehicle, with home as its item 0."""

    def __init__(self, vehicle: LinkedVehicle) -> None:
        self._vehicle = vehicle

    @property
    def count(self) -> int:
        """Items with home; 0 without a mission."""
        mission = self._vehicle.mission
        return len(mission.items) + 1 if mission is not None else 0

    @property
    def current(self) -> int:
        """The item being flown or next, counted with home."""
        return self._vehicle.mission_index + 1

    def item(self, index: int) -> MissionItem | None:
        """Return an item, None if there is none."""
        mission = self._vehicle.mission
        if index == 0:
            return home_item(*self._vehicle.origin)
        if mission is None or not 1 <= index <= len(mission.items):
            return None
        return mission.items[index - 1]

    def takes(self, command: int) -> bool:
        """Every command is tried: the vehicle refuses what it cannot fly."""
        return True

    def store(self, items: Sequence[MissionItem]) -> str:
        """Load the mission without its home item; return why the vehicle does not take it."""
        lat_deg, lon_deg, altitude_m = self._vehicle.origin
        flown = tuple(items[1:])
        mission = Mission(
            name="uploaded", home_lat_deg=lat_deg, home_lon_deg=lon_deg, home_alt_m=altitude_m, items=flown
        )
        return self._vehicle.load_mission(mission if flown else None)


class KeptPlan:
    """Fence or rally points: kept, not heeded."""

    current = -1

    def __init__(self, vehicle: LinkedVehicle, kind: int) -> None:
        self._vehicle, self._kind = vehicle, kind
        self._items: tuple[MissionItem, ...] = ()

    @property
    def count(self) -> int:
        """How many items there are."""
        return len(self._items)

    def item(self, index: int) -> MissionItem | None:
        """Return an item, None if there is none."""
        return self._items[index] if 0 <= index < len(self._items) else None

    def takes(self, command: int) -> bool:
        """Return whether it is a point of a fence, or a rally point."""
        return command in FENCE_COMMANDS if self._kind == FENCE else command == RALLY_POINT

    def store(self, items: Sequence[MissionItem]) -> str:
        """Keep the points; return why not: a polygon without all its corners, a circle without a radius."""
        why = broken_fence(items) if self._kind == FENCE else ""
        if why:
            return why
        self._items = tuple(items)
        if items:
            self._vehicle.say(
                "Fence is kept, not heeded" if self._kind == FENCE else "Rally kept, not heeded", "warning"
            )
        return ""


def broken_fence(items: Sequence[MissionItem]) -> str:
    """Return what is wrong with a fence, empty if nothing is.

    A polygon is a run of corners of one kind, each of which tells in its first number how many there are.
    """
    left, told, kind = 0, 0, 0
    for item in items:
        number = item.params[0] or 0.0
        if left and (item.command, number) != (kind, told):
            return f"Fence: {left} of {told} corners missing"
        if left:
            left -= 1
        elif item.command in (INCLUSION, EXCLUSION):
            if number != int(number) or number < CORNERS_MIN:
                return f"Fence: polygon of {number:g} corners"
            kind, told, left = item.command, int(number), int(number) - 1
        elif item.command in (CIRCLE_IN, CIRCLE_OUT) and number <= 0.0:
            return f"Fence: circle of radius {number:g}"
    return f"Fence: {left} of {told} corners missing" if left else ""
