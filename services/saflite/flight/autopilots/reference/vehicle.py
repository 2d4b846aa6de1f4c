"""The reference's blackboard: world, sensors, estimator and control in one native loop, shared with the modes.

`board["est_n"]` reads and writes a slot of any of the three native structs (`native/vehicle.h`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from saflite.flight.native_library import Board, Memory, python_library, slot_names, struct_size
from saflite.flight.sensors.sensors import Sensors
from saflite.flight.world.jsbsim_world import World
from saflite.flight.world.state import STEP_S

STEPS_PER_STATE = 8
PARTS = ("world", "sensors", "vehicle")  # of the native struct


@cache
def _library() -> ctypes.PyDLL:
    library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
    library.vehicle_offset.restype = ctypes.c_size_t
    library.vehicle_record.argtypes = [pointer, pointer, pointer, number, number, number]
    library.vehicle_run.argtypes = [pointer, number]
    library.vehicle_rows.argtypes = [pointer]
    library.vehicle_align.argtypes = [pointer]
    return library


@cache
def slots() -> dict[str, int]:
    """Return name to index of every slot, in doubles from the start of the native struct."""
    library = _library()
    found = {
        name: library.vehicle_offset(part) // 8 + place
        for part, prefix in enumerate(PARTS)
        for place, name in enumerate(slot_names(prefix))
    }
    assert len(found) == sum(len(slot_names(prefix)) for prefix in PARTS), "a slot is listed twice"
    return found


class Vehicle(Board):
    """One flight's blackboard and recorder.

    Args:
        rng_seed: the test case's; sensors draw from streams of their own.
        boxes: obstacles, shape (k, 8), as `flight.geometry.boxes_array` gives them.
        altitude_m: where it starts, above the ground; 0 stands.
        yaw_deg: heading at the start.

    Raises:
        Unavailable: JSBSim or the native library is missing.
    """

    def __init__(
        self, rng_seed: int, boxes: NDArray[np.float64], altitude_m: float = 0.0, yaw_deg: float = 0.0
    ) -> None:
        self._library = _library()
        super().__init__(ctypes.create_string_buffer(struct_size("vehicle")), slots())
        self.world = World(altitude_m, yaw_deg, boxes, steps_per_state=STEPS_PER_STATE, memory=self._part(0))
        self.sensors = Sensors(rng_seed, self._part(1))
        self._rows = np.zeros((0, 0), np.float32)
        self._columns = np.zeros(0, np.int32)
        self.record_names: tuple[str, ...] = ()

    def _part(self, part: int) -> Memory:
        offset = self._library.vehicle_offset(part)
        return (ctypes.c_char * struct_size(PARTS[part])).from_buffer(self._memory, offset)

    # -- running --------------------------------------------------------------------------------------------------

    def align(self) -> None:
        """Take the truth on the board as believed."""
        self._library.vehicle_align(self.address)

    def run(self, steps: int) -> None:
        """Run `steps` physics steps of 2.5 ms with sensors, estimator and control."""
        self._library.vehicle_run(self.address, steps)

    # -- the trace ------------------------------------------------------------------------------------------------

    def record(self, names: Sequence[str], row_limit: int, step_s: float) -> None:
        """Record the slots `names` every `step_s` from now on, at most `row_limit` rows, the first at once."""
        self.record_names = tuple(names)
        self._columns = np.array([self._slots[name] for name in names], np.int32)
        self._rows = np.empty((row_limit, len(names)), np.float32)
        steps = round(step_s / STEP_S)
        places = (self._rows.ctypes.data, self._columns.ctypes.data)
        self._library.vehicle_record(self.address, *places, len(names), row_limit, steps)

    def columns(self) -> dict[str, bytes]:
        """Return what was recorded: each name's samples as little-endian float32."""
        count = self._library.vehicle_rows(self.address)
        table = np.ascontiguousarray(self._rows[:count].T, dtype="<f4")
        return {name: table[i].tobytes() for i, name in enumerate(self.record_names)}
