"""From the planner's set-point to trajectory set-points as PX4 1.12's auto task makes them (`native/follower.h`).

Between the planner (10 Hz) and the position controller (50 Hz or more): call `step` at the controller's rate and fly
`velocity + position gain x (position - estimate)`.
"""

from __future__ import annotations

import ctypes

from saflite.flight.planner.native import library
from saflite.flight.planner.settings import VehicleSettings

Point = tuple[float, float, float]
Vector = ctypes.c_double * 3
ERROR_MAX_M = 2.0  # MPC_XY_ERR_MAX: a trajectory this far ahead of the vehicle waits


class Follower:
    """The trajectory of one vehicle, x north, y east, z up. Plain C arrays: a step must cost next to nothing."""

    def __init__(self, at_m: Point, velocity_mps: Point, settings: VehicleSettings | None = None) -> None:
        use = settings or VehicleSettings()
        self._accept_m = use.accept_m
        self._limits = (ctypes.c_double * 8)(
            use.acceleration_mps2,
            use.jerk_mps3,
            use.speed_max_mps,
            use.up_max_mps,
            use.down_max_mps,
            use.accept_m,
            ERROR_MAX_M,
            use.turn_lock,
        )
        self._state = (ctypes.c_double * 16)()
        self._start, self._goal, self._at, self._set_point = (Vector() for _ in range(4))
        self._step = library().follower_step
        self._at[:], self._goal[:] = list(at_m), list(velocity_mps)
        library().follower_start(self._state, self._at, self._goal)

    def leg(self, start_m: Point, goal_m: Point, at_m: Point) -> None:
        """Begin the leg from `start_m` to `goal_m`; the vehicle is estimated at `at_m`."""
        self._start[:], self._goal[:], self._at[:] = list(start_m), list(goal_m), list(at_m)
        library().follower_leg(self._state, self._start, self._goal, self._at, self._accept_m)

    def step(self, at_m: Point, set_point_m: Point, step_s: float) -> list[float]:
        """Advance by `step_s` towards the planner's set-point; return trajectory position (m) and velocity (m/s)."""
        self._at[:], self._set_point[:] = list(at_m), list(set_point_m)
        self._step(self._state, self._limits, self._start, self._goal, self._at, self._set_point, step_s)
        return self._state[:6]
