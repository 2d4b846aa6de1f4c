"""The local planner as the autopilot sees it: from goals to set-points (PX4-Avoidance's place beside the autopilot).

The camera looks at the world from the true position; the planner itself works in the estimated frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saflite.flight.autopilots.reference.vehicle import Vehicle
from saflite.flight.planner.follower import Follower
from saflite.flight.planner.local_planner import LocalPlanner
from saflite.flight.planner.settings import PlannerSettings

Point = tuple[float, float, float]
FRESH_S = 0.5  # a trajectory not flown for longer starts anew
_TRUTH = ("x_m", "y_m", "altitude_m")


class Avoidance:
    """Set-points between way-points.

    Args:
        board: the vehicle's blackboard.
        boxes: obstacles, (k, 8).
        settings: the planner's numbers; the same as the kinematic vehicle's.
    """

    def __init__(self, board: Vehicle, boxes: NDArray[np.float64], settings: PlannerSettings | None = None) -> None:
        self._planner = LocalPlanner(boxes, settings or PlannerSettings())
        self._in, self._out = self._planner.inputs, self._planner.outputs
        self._board = board
        self._truth = [Vehicle.slots()[name] for name in _TRUTH]
        self._follower: Follower | None = None
        self._leg: tuple[Point, Point] | None = None
        self._followed_s = -1e9

    def set_point(self, time_s: float, goal: Point, previous: Point) -> tuple[float, float, float, float]:
        """Return where to fly now: north, east, height above home (m) and heading (rad)."""
        board, row = self._board, self._in
        at = board.at
        row[:] = (
            time_s,
            board["est_n"],
            board["est_e"],
            board["altitude_est_m"],
            board["est_vn"],
            board["est_ve"],
            board["climb_est_mps"],
            board["est_yaw"],
            *goal,
            *previous,
            *(at[slot] for slot in self._truth),
        )
        self._planner.step()
        north, east, height, yaw = self._out[:4].tolist()
        return north, east, height, yaw

    def follow(self, time_s: float, set_point: Point, goal: Point, previous: Point, step_s: float) -> list[float]:
        """Return the trajectory's position (m) and velocity (m/s) towards the set-point, as PX4's auto task does."""
        board = self._board
        here = (board["est_n"], board["est_e"], board["altitude_est_m"])
        if self._follower is None or time_s - self._followed_s > FRESH_S:
            self._follower = Follower(here, (board["est_vn"], board["est_ve"], board["climb_est_mps"]))
            self._leg = None
        if self._leg != (previous, goal):
            self._leg = (previous, goal)
            self._follower.leg(previous, goal, here)
        self._followed_s = time_s
        return self._follower.step(here, set_point, step_s)
