"""The local obstacle planner after PX4-Avoidance (compiled, `flight/native/planner.h`), one call per tick.

Layout of the arrays handed to C (`IN_*`, `OUT_*` below are the indices; x north, y east, z up in metres from the
take-off point, yaw in radians in compass sense):

    in   time, position 3, velocity 3, yaw, goal 3, previous goal 3, true position of the camera 3
    out  position set-point 3, yaw set-point, metres ahead, state (0 path, 1 straight, 2 at goal), points, path nodes
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from saflite.flight.planner.native import block, library, rows
from saflite.flight.planner.settings import PlannerSettings, packed

IN_TIME, IN_POSITION, IN_VELOCITY, IN_YAW = 0, slice(1, 4), slice(4, 7), 7
IN_GOAL, IN_PREVIOUS, IN_TRUE, IN_COUNT = slice(8, 11), slice(11, 14), slice(14, 17), 17
OUT_POSITION, OUT_YAW, OUT_AHEAD, OUT_STATE, OUT_POINTS, OUT_PATH, OUT_COUNT = slice(0, 3), 3, 4, 5, 6, 7, 8
CELL_DEG = 6
SHAPE = (180 // CELL_DEG, 360 // CELL_DEG)


class LocalPlanner:
    """One vehicle's planner: remembers what it saw and lays the next set-point.

    Write `inputs`, call `step`, read `outputs`; both arrays are reused. Deterministic: equal calls, equal answers.
    """

    def __init__(self, boxes: NDArray[np.float64], settings: PlannerSettings | None = None) -> None:
        self._boxes = rows(boxes, 8)
        self._state = block()
        self._step = library().planner_step
        self.inputs = np.zeros(IN_COUNT)
        self.outputs = np.zeros(OUT_COUNT)
        library().planner_init(self._state.ctypes.data, packed(settings or PlannerSettings()).ctypes.data)
        self._arguments = (
            self._state.ctypes.data,
            self.inputs.ctypes.data,
            self._boxes.ctypes.data,
            len(self._boxes),
            self.outputs.ctypes.data,
        )

    def step(self) -> NDArray[np.float64]:
        """Look, plan if it is time, and return `outputs`."""
        self._step(*self._arguments)
        return self.outputs

    def path(self) -> NDArray[np.float32]:
        """Return the path in force, (nodes, 3): the vehicle's place when it was made, then every node."""
        points = np.zeros((64, 3), dtype=np.float32)
        return points[: library().planner_path(self._state.ctypes.data, points.ctypes.data, len(points))]


def cast(
    eye_m: NDArray[np.float64], yaw_rad: float, boxes: NDArray[np.float64], settings: PlannerSettings | None = None
) -> NDArray[np.float32]:
    """Return the points the camera sees, (n, 3), thinned to one per 2 degree cell."""
    state, packed_boxes, eye = block(), rows(boxes, 8), np.ascontiguousarray(eye_m, dtype=np.float64)
    points = np.zeros((4096, 3), dtype=np.float32)
    library().planner_init(state.ctypes.data, packed(settings or PlannerSettings()).ctypes.data)
    count = library().planner_probe_cast(
        state.ctypes.data,
        eye.ctypes.data,
        yaw_rad,
        packed_boxes.ctypes.data,
        len(packed_boxes),
        points.ctypes.data,
        len(points),
    )
    return points[:count]


def histogram(points: NDArray[np.float32], eye_m: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the mean distance per 6 degree cell, (30, 60): elevation from -90, azimuth from -180; 0 where empty."""
    state, cloud, eye = block(), np.ascontiguousarray(points, dtype=np.float32), np.ascontiguousarray(eye_m)
    mean_m = np.zeros(SHAPE, dtype=np.float32)
    library().planner_init(state.ctypes.data, packed(PlannerSettings()).ctypes.data)
    library().planner_probe_histogram(
        state.ctypes.data, cloud.ctypes.data, len(cloud), eye.ctypes.data, mean_m.ctypes.data
    )
    return mean_m


def costs(
    points: NDArray[np.float32],
    eye_m: NDArray[np.float64],
    velocity_mps: NDArray[np.float64],
    goal_m: NDArray[np.float64],
    line_point_m: NDArray[np.float64],
    settings: PlannerSettings | None = None,
) -> NDArray[np.float32]:
    """Return the cost of every direction, (30, 60), as the tree search sees it from `eye_m`."""
    state, cloud = block(), np.ascontiguousarray(points, dtype=np.float32)
    vectors = [np.ascontiguousarray(v, dtype=np.float64) for v in (eye_m, velocity_mps, goal_m, line_point_m)]
    matrix = np.zeros(SHAPE, dtype=np.float32)
    library().planner_init(state.ctypes.data, packed(settings or PlannerSettings()).ctypes.data)
    library().planner_probe_costs(
        state.ctypes.data, cloud.ctypes.data, len(cloud), *(v.ctypes.data for v in vectors), matrix.ctypes.data
    )
    return matrix
