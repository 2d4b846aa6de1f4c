"""The blackboard of a flight with ArduPilot: world and lockstep in one native loop (`native/lockstep.h`)."""

from __future__ import annotations

import ctypes
import socket
from functools import cache

import numpy as np
from numpy.typing import NDArray

from saflite.flight.blackboard import Blackboard
from saflite.flight.native_library import python_library
from saflite.flight.world.jsbsim_world import World

OK, GONE, SILENT, ALIEN = range(4)
SILENT_MS = 10_000  # of wall time without an answer: the autopilot hangs
HEARD_MAX = 1 << 20


@cache
def _library() -> ctypes.PyDLL:
    library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
    library.lockstep_connect.argtypes = [pointer, number, number, number]
    library.lockstep_run.argtypes = [pointer, number]
    library.lockstep_heard.argtypes = [pointer, ctypes.c_char_p]
    library.lockstep_await.argtypes = [pointer]
    return library


class Vehicle(Blackboard):
    """World of one flight, and the links to the autopilot that flies in it.

    Raises:
        Unavailable: JSBSim or the native library is missing.
    """

    WHOLE, PARTS = "lockstep", ("world", "lockstep")

    def __init__(self, boxes: NDArray[np.float64], yaw_deg: float) -> None:
        self._library = _library()
        super().__init__()
        self.world = World(0.0, yaw_deg, boxes, steps_per_state=1, memory=self.part("world"))
        self._into = ctypes.create_string_buffer(HEARD_MAX)

    def connect(self, udp: socket.socket, tcp: socket.socket) -> int:
        """Fly with the autopilot at the other end from now on; return what came of its first outputs."""
        self._library.lockstep_connect(self.address, udp.fileno(), tcp.fileno(), SILENT_MS)
        return int(self._library.lockstep_await(self.address))

    def run(self, steps: int) -> int:
        """Run steps of 2.5 ms; return OK, GONE, SILENT or ALIEN. Stops early when the world has crashed."""
        return int(self._library.lockstep_run(self.address, steps))

    def heard(self) -> bytes:
        """Take what the autopilot said over MAVLink."""
        count = int(self._library.lockstep_heard(self.address, self._into))
        return ctypes.string_at(self._into, count)
