"""A whole avoidance mission flown by a kinematic vehicle under the local planner, in one compiled call.

The cheap simulator behind the scorer model `low_fidelity`: the planner is the one the JSBSim flights use, only the
vehicle is simpler (position gain, limits on speed, acceleration, jerk and yaw rate; first order in height).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.errors import Refused
from saflite.contract.flight import Ending
from saflite.contract.rng import derive_seed
from saflite.flight.planner.native import block, library, rows
from saflite.flight.planner.settings import PlannerSettings, VehicleSettings, packed

NO_OBSTACLE_M = 1000.0
ENDINGS: tuple[Ending, ...] = ("completed", "crashed", "timed_out")
BOXES_MAX = 16
_TRACK_STEP_S = 0.5


class KinematicSettings(NamedTuple):
    """What a kinematic flight is flown with."""

    planner: PlannerSettings = PlannerSettings()
    vehicle: VehicleSettings = VehicleSettings()


class KinematicFlight(NamedTuple):
    """One flight. `track` has rows of t (s), x, y, z (m), yaw (rad), 0.5 s apart; `clearance_m` one distance per box.

    `min_distance_m` is the competition's distance to the nearest box, 1000 where there is none.
    """

    min_distance_m: float
    duration_s: float
    track: NDArray[np.float64]
    ending: Ending
    clearance_m: tuple[float, ...]


@cache
def _state() -> NDArray[np.uint64]:
    return block()


def _check(mission: NDArray[np.float64], boxes: NDArray[np.float64]) -> None:
    if len(mission) < 2 or not np.isfinite(mission).all():
        raise Refused("mission", expected="two or more rows of finite x, y, z", got=f"{len(mission)} rows")
    if len(boxes) > BOXES_MAX or not np.isfinite(boxes).all():
        raise Refused("boxes", expected=f"at most {BOXES_MAX} rows of finite numbers", got=f"{len(boxes)} rows")


def fly_kinematic(
    mission_xyz: NDArray[np.float64],
    boxes: NDArray[np.float64],
    *,
    rng_seed: int = 0,
    settings: KinematicSettings | None = None,
) -> KinematicFlight:
    """Fly a mission and return how near it came to the boxes.

    Args:
        mission_xyz: (n, 3) metres: take-off point with the height to climb to, way-points, landing point.
        boxes: (k, 8) as `flight.geometry.boxes_array` makes them.
        rng_seed: starts the noise (position drift, skipped plans); equal seeds fly bit-equal.
        settings: planner and vehicle; the tuned defaults if left out.

    Raises:
        Refused: too few way-points, too many boxes, or numbers that are not finite.
    """
    mission, obstacles, chosen = rows(mission_xyz, 3), rows(boxes, 8), settings or KinematicSettings()
    _check(mission, obstacles)
    track = np.empty((int(chosen.vehicle.time_limit_s / _TRACK_STEP_S) + 3, 5))
    out = np.zeros(4 + BOXES_MAX)
    planner, vehicle = packed(chosen.planner), packed(chosen.vehicle)
    library().kinematic_fly(
        _state().ctypes.data,
        planner.ctypes.data,
        vehicle.ctypes.data,
        mission.ctypes.data,
        len(mission),
        obstacles.ctypes.data,
        len(obstacles),
        derive_seed(rng_seed, "kinematic"),
        track.ctypes.data,
        len(track),
        out.ctypes.data,
    )
    clearance = tuple(float(value) for value in out[4 : 4 + len(obstacles)])
    return KinematicFlight(float(out[2]), float(out[1]), track[: int(out[3])], ENDINGS[int(out[0])], clearance)
