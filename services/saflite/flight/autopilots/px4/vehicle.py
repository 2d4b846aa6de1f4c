"""The blackboard of a flight with PX4 (`native/hil.h`)."""

from __future__ import annotations

import ctypes
import socket
from collections.abc import Iterable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from saflite.flight.autopilots.external import vehicle
from saflite.flight.autopilots.external.vehicle import LockstepVehicle
from saflite.flight.native_library import python_library
from saflite.flight.sensors.sensors import Sensors


@cache
def _library() -> ctypes.PyDLL:
    library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
    library.px4_connect.argtypes = [pointer, number, number, number, pointer, number]
    library.px4_answers.argtypes = [pointer]
    library.px4_follow.argtypes = [pointer]
    return library


class Vehicle(LockstepVehicle):
    """World and sensors of one flight, and the links to the PX4 that flies in it; parts as `LockstepVehicle`.

    Args:
        rng_seed: of the sensors' noise.
    """

    WHOLE, PARTS = "px4", ("world", "sensors", "px4")

    def __init__(self, boxes: NDArray[np.float64], yaw_deg: float, rng_seed: int) -> None:
        super().__init__(boxes, yaw_deg)
        self.sensors = Sensors(rng_seed, self.part("sensors"))

    def connect(
        self,
        simulator: socket.socket,
        udp: socket.socket,
        home: tuple[float, float, float],
        *,
        own_physics: bool = False,
    ) -> None:
        """Fly with the autopilot at the other end from now on; `home` in degrees and metres above sea.

        Where it has physics of its own, ours stands still: `simulator` is the channel to its gate, `run` lets it run
        its steps, and whoever hears its telemetry writes the truth.
        """
        place, files = (ctypes.c_double * 3)(*home), (simulator.fileno(), udp.fileno())
        _library().px4_connect(self.address, *files, vehicle.SILENT_MS, place, int(own_physics))

    def follow(self) -> None:
        """Tell what follows from a truth that was written into the slots: angles in degrees, distances to boxes."""
        _library().px4_follow(self.address)

    @property
    def answers(self) -> bool:
        """Whether it has given motor commands yet."""
        return bool(_library().px4_answers(self.address))

    def set_pulses(self, pulses_us: Iterable[float]) -> None:
        """Set the radio's channels, from the first."""
        self.set(**{f"rc_{number}": pulse for number, pulse in enumerate(pulses_us, 1)})
