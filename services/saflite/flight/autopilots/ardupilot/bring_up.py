"""From a binary to a vehicle that answers: process, links, first outputs. All ends with `Aircraft.close`."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from socket import socket

import numpy as np
from numpy.typing import NDArray

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.ardupilot.link import Radio, called_tcp
from saflite.flight.autopilots.ardupilot.settings import as_file
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.autopilots.external.link import WORDS, LockstepPort, SimulatedClock, bound_udp
from saflite.flight.autopilots.external.place import FailedBringUp, Place
from saflite.flight.autopilots.external.process import Process
from saflite.flight.autopilots.external.vehicle import GONE, OK
from saflite.flight.mavlink.client import Client
from saflite.flight.world.jsbsim_world import HOME_ALT_M, HOME_LAT_DEG, HOME_LON_DEG

PORTS_NEEDED = 14
SIMULATOR, RECEIVER, INWARD, BEACON = 10, 11, 12, 13  # places among the ports; the serial links take the first ten
DEFAULTS_FILE = "start.parm"
START_TIME_S = 1_700_000_000  # the calendar begins here in every flight
RATE_HZ = 400
LISTEN_S, HEARTBEAT_S = 20.0, 30.0
HOME = (HOME_LAT_DEG, HOME_LON_DEG, HOME_ALT_M)


def command(binary: Path, ports: range, home: tuple[float, float, float], yaw_deg: float) -> list[str]:
    """Return the command line: JSON backend, the slot's ports only, one link that is waited for."""
    return [
        str(binary),
        *("--model", "JSON:127.0.0.1", "--speedup", "1000", "--rate", str(RATE_HZ), "--wipe"),
        *("--start-time", str(START_TIME_S), "--defaults", DEFAULTS_FILE),
        *("--home", f"{home[0]:.7f},{home[1]:.7f},{home[2]:.2f},{yaw_deg:.1f}"),
        *("--base-port", str(ports[0]), "--serial0", "tcp:0:wait"),
        *("--sim-port-out", str(ports[SIMULATOR]), "--sim-port-in", str(ports[INWARD])),
        *("--rc-in-port", str(ports[RECEIVER]), "--irlock-port", str(ports[BEACON])),
    ]


class Aircraft:
    """A running autopilot in its world, and the link to it.

    Args:
        parameters: what it starts with beyond its own defaults.
        boxes: obstacles, shape (k, 8).
        home: latitude, longitude in degrees, height above sea in metres.
        before_tick: called before each step of 20 ms while anything waits on the link.

    Raises:
        Unavailable: it cannot be started, or its ports are taken.
        FailedBringUp: it ended, or does not answer.
    """

    def __init__(
        self,
        binary: Path,
        place: Place,
        parameters: Mapping[str, float],
        boxes: NDArray[np.float64],
        home: tuple[float, float, float] = HOME,
        yaw_deg: float = 0.0,
        before_tick: Callable[[], None] = lambda: None,
    ) -> None:
        if len(place.ports) < PORTS_NEEDED:
            raise Unavailable(f"a slot with {PORTS_NEEDED} ports is needed, this one has {len(place.ports)}")
        self.vehicle = Vehicle(boxes, yaw_deg)
        self.clock = SimulatedClock(self.vehicle)
        self.folder = place.folder / "ardupilot"
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        (self.folder / DEFAULTS_FILE).write_text(as_file(parameters))
        self.radio = Radio(place.ports[RECEIVER])
        self._udp, self._tcp = bound_udp(place.ports[SIMULATOR]), None
        try:
            self.process = Process(command(binary, place.ports, home, yaw_deg), self.folder)
        except Unavailable:
            self._udp.close()
            self.radio.close()
            raise
        try:
            self._tcp = self._called(place)
            came = self.vehicle.connect(self._udp, self._tcp)
            if came != OK:
                raise FailedBringUp(self.trouble(came))
        except BaseException:
            self.close()
            raise

        def before() -> None:
            before_tick()
            self.radio.send()

        self.client = Client(self.clock, LockstepPort(self.vehicle, self._tcp.sendall, before))

    def _called(self, place: Place) -> socket:
        if not self.process.wait_for_words("Waiting for connection", LISTEN_S):
            why = self.process.how_it_ended() if self.process.gone else f"silent for {LISTEN_S:.0f} s at its start"
            raise FailedBringUp(why)
        return called_tcp(place.ports[0])

    def trouble(self, came: int) -> str:
        """Return in words how it ended, where it does not go on."""
        return self.process.how_it_ended() if came == GONE else WORDS.get(came, "the world failed")

    def logs(self) -> dict[str, bytes]:
        """Return the DataFlash logs it wrote, by name."""
        return {path.name: path.read_bytes() for path in sorted((self.folder / "logs").glob("*.BIN"))}

    def close(self) -> None:
        """End the process and everything of it; may be called twice."""
        self.process.end()
        self._udp.close()
        self.radio.close()
        if self._tcp is not None:
            self._tcp.close()
        shutil.rmtree(self.folder, ignore_errors=True)
