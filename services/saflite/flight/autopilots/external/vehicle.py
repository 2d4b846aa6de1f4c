"""The blackboard of a flight in lockstep with an autopilot in another process: world and links in one native loop."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from saflite.flight.blackboard import Blackboard
from saflite.flight.native_library import python_library
from saflite.flight.world.jsbsim_world import World

OK, GONE, SILENT, ALIEN = range(4)
SILENT_MS = 10_000  # of wall time without an answer: the autopilot hangs
HEARD_MAX = 1 << 20


class LockstepVehicle(Blackboard):
    """World of one flight, and the links to the autopilot that flies in it.

    For a struct called `bridge` the library offers, beyond what `Blackboard` asks for, `bridge_run`, `bridge_heard`.

    Args:
        boxes: obstacles, shape (k, 8).
        yaw_deg: heading at the start.

    Raises:
        Unavailable: JSBSim or the native library is missing.
    """

    def __init__(self, boxes: NDArray[np.float64], yaw_deg: float) -> None:
        library, pointer = python_library(), ctypes.c_void_p
        super().__init__()
        self._run = getattr(library, f"{self.WHOLE}_run")
        self._run.argtypes = [pointer, ctypes.c_int]
        self._heard = getattr(library, f"{self.WHOLE}_heard")
        self._heard.argtypes = [pointer, ctypes.c_char_p]
        self.world = World(0.0, yaw_deg, boxes, steps_per_state=1, memory=self.part("world"))
        self._into = ctypes.create_string_buffer(HEARD_MAX)

    def run(self, steps: int) -> int:
        """Run steps of 2.5 ms; return OK, GONE, SILENT or ALIEN. Stops early when the world has crashed."""
        return int(self._run(self.address, steps))

    def heard(self) -> bytes:
        """Take what the autopilot said over MAVLink."""
        count = int(self._heard(self.address, self._into))
        return ctypes.string_at(self._into, count)
