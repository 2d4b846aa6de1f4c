"""MAVLink to an autopilot in lockstep: waiting on it steps the simulation, and its clock is simulated time."""

from __future__ import annotations

import socket
from collections.abc import Callable

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.external.vehicle import ALIEN, GONE, OK, SILENT, LockstepVehicle
from saflite.flight.world.state import CRASHED, STEP_S

LOOPBACK = "127.0.0.1"
CENTRE_US, LOW_US = 1500, 1000
TICK_STEPS = 8
TICK_S = TICK_STEPS * STEP_S
CRASHED_BEFORE = 100  # the world stands still, and so does the clock
WORDS = {
    CRASHED_BEFORE: "the world has crashed",
    GONE: "the autopilot is gone",
    SILENT: "the autopilot hangs",
    ALIEN: "the autopilot says too much at once",
}


class Stopped(Exception):
    """The autopilot does not go on; `came` says how (`vehicle.GONE` and so on)."""

    def __init__(self, came: int) -> None:
        super().__init__(WORDS.get(came, "the world failed"))
        self.came = came


class SimulatedClock:
    """A clock that tells the world's time, from power-up."""

    def __init__(self, vehicle: LockstepVehicle) -> None:
        self._vehicle = vehicle

    def monotonic_s(self) -> float:
        """Return simulated time since power-up."""
        return round(self._vehicle["step"] * STEP_S, 6)

    def unix_s(self) -> float:
        """Return the same: the autopilot's calendar is told at its start."""
        return self.monotonic_s()


class LockstepPort:
    """A MAVLink port whose waiting steps the simulation, a tick at a time; see `mavlink.ports.Port`.

    Args:
        vehicle: what is stepped and heard.
        send: gives bytes to the autopilot; OSError where it is gone.
        before_tick: called before each tick.
    """

    name = "lockstep"

    def __init__(
        self, vehicle: LockstepVehicle, send: Callable[[bytes], object], before_tick: Callable[[], None]
    ) -> None:
        self._vehicle, self._send, self._before = vehicle, send, before_tick

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        """Send, step a tick if there is to be waited at all, receive.

        Raises:
            Stopped: the autopilot is gone or hangs, or the world has crashed.
        """
        if data:
            try:
                self._send(data)
            except OSError as fault:
                raise Stopped(GONE) from fault
        if wait_s > 0.0:
            if self._vehicle["world_state"] == CRASHED:
                raise Stopped(CRASHED_BEFORE)
            self._before()
            came = self._vehicle.run(TICK_STEPS)
            if came != OK:
                raise Stopped(came)
        return self._vehicle.heard()

    def close(self) -> None:
        """Its sockets are whose it was made by."""


def bound_udp(port: int) -> socket.socket:
    """Return a socket for the autopilot's outputs; raises Unavailable where another has the port."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        made.bind((LOOPBACK, port))
    except OSError as fault:
        made.close()
        raise Unavailable(f"port {port}: {fault}") from fault
    return made
