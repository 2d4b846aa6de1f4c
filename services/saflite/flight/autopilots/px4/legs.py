"""Who flies a mission's way-points beside a real PX4: it takes off by its own mission, is led, and lands by itself.

Each mode is ordered once: whoever orders another has the vehicle.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

from saflite.contract.test_case import Mission
from saflite.flight.autopilots.px4.modes import AUTO, LAND, RETURN
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import CUSTOM_MODE, DO_SET_MODE, Client
from saflite.flight.mission import Waypoint, waypoints

Point = tuple[float, float, float]
TAKEOFF = 22  # MAV_CMD_NAV_TAKEOFF
NEAR_M, LEVEL_M = 2.0, 1.0  # a way-point counts as reached


class Legs(ABC):
    """The way-points after the take-off, one after the other; `tick` before each step of 20 ms."""

    def __init__(self, mission: Mission, vehicle: Vehicle, client: Client) -> None:
        lifts = [number for number, item in enumerate(mission.items) if item.command == TAKEOFF]
        self._from_item = 1.0 + max(lifts, default=-1)
        self._places = [place for place in waypoints(mission) if place.kind != "takeoff"]
        self._vehicle, self._client = vehicle, client
        self._goal = self._previous = (0.0, 0.0, 0.0)
        self._begun = False
        self._last: tuple[int, int] | None = None  # the mode to hand over to, once there is no way-point left
        self._rest_ticks = 0

    def tick(self, time_s: float, step_s: float) -> None:
        """Lead the vehicle, once its own take-off is over; order what comes after the last way-point."""
        told = self._client.latest.get("LOCAL_POSITION_NED")
        airborne = self._vehicle["mission_item"] >= self._from_item and self._vehicle["armed"] != 0.0
        if self._last is not None:
            self._hand_over(*self._last)
        elif told is not None and (airborne or self._begun):
            self._fly(time_s, step_s, told)

    def _fly(self, time_s: float, step_s: float, told: Any) -> None:
        here, speed = (told.x, told.y, -told.z), (told.vx, told.vy, -told.vz)
        if not self._begun:
            self._begun, self._goal = True, here
            self._begin(here, speed)
            self._next(here)
        self._lead(time_s, step_s, here, speed)
        if self._led and self._arrived(here):
            self._next(here)

    @abstractmethod
    def _begin(self, here: Point, speed: Point) -> None:
        """Take over, at a place (north, east, height above home, m) and a speed."""

    @abstractmethod
    def _lead(self, time_s: float, step_s: float, here: Point, speed: Point) -> None:
        """Say where to fly now."""

    @property
    @abstractmethod
    def _led(self) -> bool:
        """Whether the vehicle is being led by now."""

    def _leg(self, here: Point) -> None:  # noqa: B027  (not everybody minds)
        """Begin the leg from `_previous` to `_goal`."""

    def _let_go(self) -> int:
        """Let go; return after how many ticks PX4 may be told to land or return."""
        return 0

    def _hand_over(self, main: int, sub: int) -> None:
        if self._rest_ticks == 0:
            self._order(main, sub)
        self._rest_ticks -= 1

    def _next(self, here: Point) -> None:
        """Begin the next leg, or hand over where there is none."""
        place = self._places.pop(0) if self._places else None
        if place is None or place.kind == "return":
            self._last = (AUTO, LAND if place is None else RETURN)
            self._rest_ticks = self._let_go()
            return
        self._previous, self._goal = self._goal, _goal(place, self._goal)
        self._leg(here)

    def _arrived(self, here: Point) -> bool:
        """Within the radius or past the way-point, at about its height."""
        goal, previous = self._goal, self._previous
        leg = (goal[0] - previous[0], goal[1] - previous[1])
        along = (here[0] - previous[0]) * leg[0] + (here[1] - previous[1]) * leg[1]
        length2 = leg[0] ** 2 + leg[1] ** 2
        near = math.hypot(goal[0] - here[0], goal[1] - here[1]) < NEAR_M
        return (near or (length2 > 1e-6 and along > length2)) and abs(goal[2] - here[2]) < LEVEL_M

    def _order(self, main: int, sub: int) -> None:
        numbers: list[Any] = [CUSTOM_MODE, main, sub, 0, 0, 0, 0]
        self._client.mav.command_long_send(1, 1, DO_SET_MODE, 0, *numbers)


def _goal(place: Waypoint, before: Point) -> Point:
    """Return where to fly: to the place of a landing at the height of the way-point before it."""
    return (place.x_m, place.y_m, before[2] if place.kind == "land" else place.z_m)
