"""Our local planner as the companion computer of a real PX4, which has none of its own.

PX4 takes off by its own mission; then the companion flies the way-points in OFFBOARD, by set-points of position,
velocity and heading, and hands back for the landing. It orders each mode once: whoever orders another has the vehicle.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Mission
from saflite.flight.autopilots.px4.modes import AUTO, LAND, OFFBOARD, RETURN
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import CUSTOM_MODE, DO_SET_MODE, Client
from saflite.flight.mission import Waypoint, waypoints
from saflite.flight.planner.follower import Follower
from saflite.flight.planner.local_planner import LocalPlanner

Point = tuple[float, float, float]
TAKEOFF = 22  # MAV_CMD_NAV_TAKEOFF
PLAN_EVERY_TICKS = 5  # 10 Hz
LOCAL_NED, ACCELERATION, YAW_RATE = 1, 0b000111000000, 0b100000000000  # frame; parts of a set-point to leave out
NEAR_M, LEVEL_M = 2.0, 1.0  # a way-point counts as reached
BEFORE_TICKS = 50  # PX4 enters OFFBOARD only where set-points have come for a while


class Companion:
    """Flies the way-points of a mission; `tick` before each step of 20 ms."""

    def __init__(self, mission: Mission, boxes: NDArray[np.float64], vehicle: Vehicle, client: Client) -> None:
        lifts = [number for number, item in enumerate(mission.items) if item.command == TAKEOFF]
        self._from_item = 1.0 + max(lifts, default=-1)
        self._places = [place for place in waypoints(mission) if place.kind != "takeoff"]
        self._planner = LocalPlanner(boxes)
        self._vehicle, self._client = vehicle, client
        self._follower: Follower | None = None
        self._goal = self._previous = self._set_point = (0.0, 0.0, 0.0)
        self._yaw_rad = 0.0
        self._ticks = 0
        self._done = False

    def tick(self, time_s: float, step_s: float) -> None:
        """Send the set-point of now, once PX4's own take-off is over; order what comes after the last way-point."""
        told = self._client.latest.get("LOCAL_POSITION_NED")
        airborne = self._vehicle["mission_item"] >= self._from_item and self._vehicle["armed"] != 0.0
        if self._done or told is None or (not airborne and self._follower is None):
            return
        here, speed = (told.x, told.y, -told.z), (told.vx, told.vy, -told.vz)
        if self._follower is None:
            self._follower, self._goal = Follower(here, speed), here
            self._next(here)
        if self._ticks % PLAN_EVERY_TICKS == 0:
            self._plan(time_s, here, speed)
        self._send(self._follower.step(here, self._set_point, step_s))
        self._ticks += 1
        if self._ticks == BEFORE_TICKS:
            self._order(OFFBOARD, 0)
        if self._ticks > BEFORE_TICKS and self._arrived(here):
            self._next(here)

    def _next(self, here: Point) -> None:
        """Begin the next leg, or hand over where there is none."""
        assert self._follower is not None
        if not self._places:
            self._done = True
            self._order(AUTO, LAND)
            return
        place = self._places.pop(0)
        if place.kind == "return":
            self._done = True
            self._order(AUTO, RETURN)
            return
        self._previous, self._goal = self._goal, _goal(place, self._goal)
        self._follower.leg(self._previous, self._goal, here)

    def _arrived(self, here: Point) -> bool:
        """Within the radius or past the way-point, at about its height."""
        goal, previous = self._goal, self._previous
        leg = (goal[0] - previous[0], goal[1] - previous[1])
        along = (here[0] - previous[0]) * leg[0] + (here[1] - previous[1]) * leg[1]
        length2 = leg[0] ** 2 + leg[1] ** 2
        near = math.hypot(goal[0] - here[0], goal[1] - here[1]) < NEAR_M
        return (near or (length2 > 1e-6 and along > length2)) and abs(goal[2] - here[2]) < LEVEL_M

    def _plan(self, time_s: float, here: Point, speed: Point) -> None:
        board = self._vehicle
        truth = (board["x_m"], board["y_m"], board["altitude_m"])  # the camera sees the world from there
        self._planner.inputs[:] = (time_s, *here, *speed, board["yaw_rad"], *self._goal, *self._previous, *truth)
        north, east, height, self._yaw_rad = self._planner.step()[:4].tolist()
        self._set_point = (north, east, height)

    def _send(self, trajectory: list[float]) -> None:
        north, east, up, speed_n, speed_e, climb = trajectory
        self._client.mav.set_position_target_local_ned_send(
            0,
            1,
            1,
            LOCAL_NED,
            ACCELERATION | YAW_RATE,
            *(north, east, -up),
            *(speed_n, speed_e, -climb),
            *(0.0, 0.0, 0.0),
            self._yaw_rad,
            0.0,
        )

    def _order(self, main: int, sub: int) -> None:
        numbers: list[Any] = [CUSTOM_MODE, main, sub, 0, 0, 0, 0]
        self._client.mav.command_long_send(1, 1, DO_SET_MODE, 0, *numbers)


def _goal(place: Waypoint, before: Point) -> Point:
    """Return where to fly: to the place of a landing at the height of the way-point before it."""
    return (place.x_m, place.y_m, before[2] if place.kind == "land" else place.z_m)
