"""The blackboard of a flight with ArduPilot (`native/lockstep.h`)."""

from __future__ import annotations

import ctypes
import socket
from functools import cache

from saflite.flight.autopilots.external import vehicle
from saflite.flight.autopilots.external.vehicle import LockstepVehicle
from saflite.flight.native_library import python_library


@cache
def _library() -> ctypes.PyDLL:
    library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
    library.lockstep_connect.argtypes = [pointer, number, number, number, number]
    library.lockstep_await.argtypes = [pointer]
    library.lockstep_moved.argtypes = [pointer]
    return library


class Vehicle(LockstepVehicle):
    """World of one flight, and the links to the ArduPilot that flies in it."""

    WHOLE, PARTS = "lockstep", ("world", "lockstep")

    def connect(self, udp: socket.socket, tcp: socket.socket, *, own_physics: bool = False) -> int:
        """Fly with the autopilot at the other end from now on; return what came of its first outputs.

        Where it has physics of its own, ours stands still: `run` lets it run its frames, and whoever hears its
        telemetry writes the truth.
        """
        _library().lockstep_connect(self.address, udp.fileno(), tcp.fileno(), vehicle.SILENT_MS, int(own_physics))
        return int(_library().lockstep_await(self.address))

    def moved(self) -> None:
        """Go on with what lies behind the same numbers of open files now."""
        _library().lockstep_moved(self.address)
