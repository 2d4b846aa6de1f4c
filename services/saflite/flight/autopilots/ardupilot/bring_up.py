"""From a binary to an ArduCopter that answers: process, links, first outputs."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from pathlib import Path
from socket import socket

import numpy as np
from numpy.typing import NDArray

from saflite.contract.config import environment_of_program
from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.ardupilot import gate
from saflite.flight.autopilots.ardupilot.binary import options_of
from saflite.flight.autopilots.ardupilot.gate import Fork, Gate
from saflite.flight.autopilots.ardupilot.link import Radio, called_tcp
from saflite.flight.autopilots.ardupilot.settings import as_file
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.autopilots.external import aircraft
from saflite.flight.autopilots.external.aircraft import HOME
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.link import LockstepPort, bound_udp
from saflite.flight.autopilots.external.place import FailedBringUp, Place
from saflite.flight.autopilots.external.process import ForkedProcess, Process
from saflite.flight.autopilots.external.vehicle import OK, SILENT
from saflite.flight.mavlink.client import Client

PORTS_NEEDED = 14
SIMULATOR, RECEIVER, INWARD, BEACON = 10, 11, 12, 13  # places among the ports; the serial links take the first ten
DEFAULTS_FILE = "start.parm"
START_TIME_S = 1_700_000_000  # the calendar begins here in every flight
RATE_HZ = 400
LISTEN_S, HEARTBEAT_S = 20.0, 30.0
WORLD_MODEL, OWN_MODEL = "JSON:127.0.0.1", "x"
UNGATED = "its own physics cannot be held between frames: linked statically, or never looking for its parent"


def command(
    binary: Binary, ports: range, home: tuple[float, float, float], yaw_deg: float, model: str = WORLD_MODEL
) -> list[str]:
    """Return the command line: JSON backend or its own physics, the slot's ports only, one link that is waited for."""
    options = options_of(binary)
    begins = ("--start-time", str(START_TIME_S)) if options.start_time else ()
    return [
        str(binary.path),
        *("--model", model, "--speedup", "1000", "--rate", str(RATE_HZ), "--wipe"),
        *(*begins, "--defaults", DEFAULTS_FILE),
        *("--home", f"{home[0]:.7f},{home[1]:.7f},{home[2]:.2f},{yaw_deg:.1f}"),
        *("--base-port", str(ports[0]), options.link, "tcp:0:wait"),
        *("--sim-port-out", str(ports[SIMULATOR]), "--sim-port-in", str(ports[INWARD])),
        *("--rc-in-port", str(ports[RECEIVER]), "--irlock-port", str(ports[BEACON])),
    ]


class Aircraft(aircraft.Aircraft):
    """A running ArduCopter in its world, and the link to it; raises as the class above.

    Args:
        parameters: what it starts with beyond its own defaults.
        boxes: obstacles, shape (k, 8).
        home: latitude, longitude in degrees, height above sea in metres.
        before_tick: called before each step of 20 ms while anything waits on the link.
        own_physics: it flies on its own physics, not in our world.
    """

    def __init__(
        self,
        binary: Binary,
        place: Place,
        parameters: Mapping[str, float],
        boxes: NDArray[np.float64],
        home: tuple[float, float, float] = HOME,
        yaw_deg: float = 0.0,
        before_tick: Callable[[], None] = lambda: None,
        *,
        own_physics: bool = False,
    ) -> None:
        self._parameters, self._before_tick, self._own_physics = parameters, before_tick, own_physics
        self._command = command(binary, place.ports, home, yaw_deg, OWN_MODEL if own_physics else WORLD_MODEL)
        super().__init__(Vehicle(boxes, yaw_deg), place, "ardupilot", PORTS_NEEDED)

    def _bring_up(self, opened: ExitStack) -> None:
        ports = self._place.ports
        (self.folder / DEFAULTS_FILE).write_text(as_file(self._parameters))
        self.radio = opened.enter_context(closing(Radio(ports[RECEIVER])))
        self.pulses_us = self.radio.pulses_us
        self.gate = self._gate(opened)
        port = ports[SIMULATOR]
        self._physics = self.gate.channel if self._own_physics else opened.enter_context(bound_udp(port))
        environment, keeps = environment_of_program(**self.gate.environment), (self.gate.theirs.fileno(),)
        process = Process(
            self._command, self.folder, environment=environment, keeps=keeps, age_max_s=self._place.age_max_s
        )
        self.gate.theirs.close()
        self.process = self._started(opened, process)
        self._tcp = opened.enter_context(_called(process, ports[0]))
        came = self.vehicle.connect(self._physics, self._tcp, own_physics=self._own_physics)
        if came != OK:
            raise FailedBringUp(UNGATED if self._own_physics and came == SILENT else self.trouble(came))

        def before() -> None:
            self._before_tick()
            self.radio.send()

        self.client = Client(self.clock, LockstepPort(self.vehicle, self._tcp.sendall, before))

    def _gate(self, opened: ExitStack) -> Gate:
        """Return the gate that is preloaded into the process.

        Raises:
            Unavailable: it was not built.
        """
        if not gate.LIBRARY.is_file():
            raise Unavailable(f"{gate.LIBRARY.name}, preloaded into ArduPilot, is not built: scripts/setup")
        ports = self._place.ports
        log = self._parameters.get("LOG_BACKEND_TYPE") != 0.0
        simulator, receiver = ports[SIMULATOR], ports[RECEIVER]
        made = Gate(own_physics=self._own_physics, log=log, physics_port=simulator, receiver_port=receiver)
        opened.callback(made.close)
        return made

    @property
    def files(self) -> tuple[int, ...]:
        """What must stay open in a fork of this process until it has taken up a fork of the autopilot."""
        return (self._tcp.fileno(), self._physics.fileno(), self.radio.fileno(), self.gate.channel.fileno())

    def take_up(self, fork: Fork, said: str) -> None:
        """In a fork of this process: go on with a fork of the autopilot; the other and its folder are not ours.

        Args:
            fork: of the autopilot; its files are ours from now on.
            said: what the autopilot had printed.
        """
        channel, link, receiver = self.gate.channel.fileno(), self._tcp.fileno(), self.radio.fileno()
        pairs = [(fork.channel, channel), (fork.link, link), (fork.receiver, receiver)]
        if fork.physics is not None:
            pairs.append((fork.physics, self._physics.fileno()))
        for given, kept in pairs:
            os.dup2(given.fileno(), kept, inheritable=False)
        console = os.dup(fork.console)
        fork.leave()
        self.vehicle.moved()
        self.process = ForkedProcess(fork.pid, console, said)
        self._opened = ExitStack()
        self._opened.callback(self.process.end)

    def logs(self) -> list[Path]:
        """Return the DataFlash logs it wrote, by name."""
        return sorted((self.folder / "logs").glob("*.BIN"))


def _called(process: Process, port: int) -> socket:
    if not process.wait_for_words("Waiting for connection", LISTEN_S):
        raise FailedBringUp(process.how_it_ended() if process.gone else f"silent for {LISTEN_S:.0f} s at its start")
    return called_tcp(port)
