"""Our local planner as the companion computer of a real PX4, which has none of its own.

It flies the way-points in OFFBOARD, by set-points of position, velocity and heading, and hands back for the landing.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Mission
from saflite.flight.autopilots.px4.legs import Legs, Point
from saflite.flight.autopilots.px4.modes import OFFBOARD
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import Client
from saflite.flight.planner.follower import Follower
from saflite.flight.planner.local_planner import LocalPlanner

PLAN_EVERY_TICKS = 5  # 10 Hz
LOCAL_NED, ACCELERATION, YAW_RATE = 1, 0b000111000000, 0b100000000000  # frame; parts of a set-point to leave out
BEFORE_TICKS = 50  # PX4 enters OFFBOARD only where set-points have come for a while


class Companion(Legs):
    """Leads by set-points round the boxes."""

    _follower: Follower

    def __init__(self, mission: Mission, boxes: NDArray[np.float64], vehicle: Vehicle, client: Client) -> None:
        super().__init__(mission, vehicle, client)
        self._planner = LocalPlanner(boxes)
        self._set_point: Point = (0.0, 0.0, 0.0)
        self._yaw_rad = 0.0
        self._ticks = 0

    @property
    def _led(self) -> bool:
        return self._ticks > BEFORE_TICKS

    def _begin(self, here: Point, speed: Point) -> None:
        self._follower = Follower(here, speed)

    def _leg(self, here: Point) -> None:
        self._follower.leg(self._previous, self._goal, here)

    def _lead(self, time_s: float, step_s: float, here: Point, speed: Point) -> None:
        if self._ticks % PLAN_EVERY_TICKS == 0:
            self._plan(time_s, here, speed)
        self._send(self._follower.step(here, self._set_point, step_s))
        self._ticks += 1
        if self._ticks == BEFORE_TICKS:
            self._order(OFFBOARD, 0)

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
