"""The reference's blackboard: world, sensors, estimator and control in one native loop, shared with the modes.

`board["est_n"]` reads and writes a slot of any of the three native structs (`native/vehicle.h`).
"""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np
from numpy.typing import NDArray

from saflite.flight.blackboard import Blackboard
from saflite.flight.native_library import python_library
from saflite.flight.sensors.sensors import Sensors
from saflite.flight.world.jsbsim_world import World

STEPS_PER_STATE = 8


@cache
def _library() -> ctypes.PyDLL:
    library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
    library.vehicle_run.argtypes = [pointer, number]
    library.vehicle_align.argtypes = [pointer]
    return library


class Vehicle(Blackboard):
    """One flight's blackboard and recorder.

    Args:
        rng_seed: the test case's; sensors draw from streams of their own.
        boxes: obstacles, shape (k, 8), as `flight.geometry.boxes_array` gives them.
        altitude_m: where it starts, above the ground; 0 stands.
        yaw_deg: heading at the start.

    Raises:
        Unavailable: JSBSim or the native library is missing.
    """

    WHOLE, PARTS = "vehicle", ("world", "sensors", "vehicle")

    def __init__(
        self, rng_seed: int, boxes: NDArray[np.float64], altitude_m: float = 0.0, yaw_deg: float = 0.0
    ) -> None:
        self._library = _library()
        super().__init__()
        self.world = World(altitude_m, yaw_deg, boxes, steps_per_state=STEPS_PER_STATE, memory=self.part("world"))
        self.sensors = Sensors(rng_seed, self.part("sensors"))

    # -- running --------------------------------------------------------------------------------------------------

    def align(self) -> None:
        """Take the truth on the board as believed."""
        self._library.vehicle_align(self.address)

    def run(self, steps: int) -> None:
        """Run `steps` physics steps of 2.5 ms with sensors, estimator and control."""
        self._library.vehicle_run(self.address, steps)
