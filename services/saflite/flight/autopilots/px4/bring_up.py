"""From a binary to a PX4 that answers: folder, process, links, first outputs."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from select import select
from socket import AF_INET, IPPROTO_TCP, SO_REUSEADDR, SOCK_STREAM, SOL_SOCKET, TCP_NODELAY, socket

import numpy as np
from numpy.typing import NDArray

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.external import aircraft
from saflite.flight.autopilots.external.aircraft import HOME
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.link import CENTRE_US, LOOPBACK, LOW_US, TICK_STEPS, LockstepPort, bound_udp
from saflite.flight.autopilots.external.place import FailedBringUp, Place, outside
from saflite.flight.autopilots.external.process import Process
from saflite.flight.autopilots.external.vehicle import GONE, OK
from saflite.flight.autopilots.px4.binary import AIRFRAME, START_UP, start_up_of
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import Client

PORTS_NEEDED = 3
SIMULATOR, GROUND, VEHICLE = range(3)  # places among the ports
CALL_S, FIRST_OUTPUTS_S = 60.0, 30.0  # wall, simulated
STARTED = "Startup script returned"
STEPS_PER_MESSAGE = 2  # as `native/hil.c`
LOOK_S, LOOKS_ALIKE, LOOKS_MAX = 0.0005, 2, 1000
CHANNELS = 8
SCRIPTS = {
    "px4-rc.mavlinksim": """#!/bin/sh
param set MAV_SYS_ID 1
param set-default EKF2_GPS_DELAY 10
param set-default EKF2_MULTI_IMU 1
param set-default SENS_IMU_MODE 1
simulator_mavlink start -c {simulator}
""",
    "px4-rc.mavlink": """#!/bin/sh
mavlink start -u {vehicle} -o {ground} -t {host} -r 4000000 -m minimal
""",
}
"""Start-up files of ours in place of those of the same names: one inertial unit, the slot's ports, one link."""


class Aircraft(aircraft.Aircraft):
    """A running PX4 in its world, and the link to it; raises as the class above.

    Args:
        parameters: what it starts with beyond its own defaults, as text.
        boxes: obstacles, shape (k, 8).
        home: latitude, longitude in degrees, height above sea in metres.
        rng_seed: of the sensors' noise.
        before_tick: called before each step of 20 ms while anything waits on the link.
    """

    process: Process

    def __init__(
        self,
        binary: Binary,
        place: Place,
        parameters: Mapping[str, str],
        boxes: NDArray[np.float64],
        *,
        home: tuple[float, float, float] = HOME,
        yaw_deg: float = 0.0,
        rng_seed: int = 0,
        before_tick: Callable[[], None] = lambda: None,
    ) -> None:
        import_module("pymavlink.dialects.v20.ardupilotmega")  # now: later, PX4's start-up would run on meanwhile
        self.pulses_us = [CENTRE_US] * CHANNELS
        self.pulses_us[2] = LOW_US
        self._binary, self._parameters, self._home, self._before_tick = binary, parameters, home, before_tick
        super().__init__(Vehicle(boxes, yaw_deg, rng_seed), place, "px4", PORTS_NEEDED)

    def _bring_up(self, opened: ExitStack) -> None:
        binary, ports = self._binary.path, self._place.ports
        self._lay_out(start_up_of(binary))
        server = opened.enter_context(_listening(ports[SIMULATOR]))
        udp = opened.enter_context(bound_udp(ports[GROUND]))
        opened.callback(self._remove_names)
        command = [str(binary), "-i", str(self._instance), "-d", "-w", str(self.folder)]
        environment = _environment(self._parameters)
        self.process = self._started(opened, Process(command, self.folder, environment=environment, realtime=True))
        self.vehicle.connect(opened.enter_context(self._called(server)), udp, self._home)
        self._wait_for_outputs()

        def send(data: bytes) -> None:
            udp.sendto(data, (LOOPBACK, ports[VEHICLE]))

        def before() -> None:
            self._before_tick()
            self.vehicle.set_pulses(self.pulses_us)

        self.client = Client(self.clock, LockstepPort(self.vehicle, send, before))

    @property
    def _instance(self) -> int:
        """Names its socket and lock file, which lie where all users' do; ports are given by our start-up files."""
        return self._place.ports[0]

    def _lay_out(self, start_up: Path) -> None:
        """Make its folder: its own start-up files by links, but for those that start links."""
        scripts = self.folder / "etc" / START_UP
        scripts.mkdir(parents=True)
        for there, here in ((start_up, scripts.parent), (start_up / START_UP, scripts)):
            for path in there.iterdir():
                if path.name not in (START_UP, *SCRIPTS):
                    (here / path.name).symlink_to(path)
        ports = self._place.ports
        for name, text in SCRIPTS.items():
            words = text.format(simulator=ports[SIMULATOR], vehicle=ports[VEHICLE], ground=ports[GROUND], host=LOOPBACK)
            (scripts / name).write_text(words)

    def _called(self, server: socket) -> socket:
        """Return the link it calls us on."""
        server.settimeout(0.2)
        for _ in range(round(CALL_S / 0.2)):
            try:
                made, _ = server.accept()
            except TimeoutError:
                self.process.listen()
                if self.process.gone:
                    raise FailedBringUp(self.process.how_it_ended()) from None
                continue
            made.setsockopt(IPPROTO_TCP, TCP_NODELAY, 1)
            return made
        raise FailedBringUp(f"it did not call the simulator within {CALL_S:.0f} s")

    def _wait_for_outputs(self) -> None:
        """Run until it gives motor commands and its start-up files are done, at a whole tick.

        Meanwhile its clock must not go on while it works, or waits for a disk: each flight would start in its own way.
        """
        step = 0
        while not self.vehicle.answers or STARTED not in self.process.console or step % TICK_STEPS:
            self._let_work()
            came = self.vehicle.run(STEPS_PER_MESSAGE)
            step += STEPS_PER_MESSAGE
            if came != OK or self.process.gone:
                raise FailedBringUp(self.trouble(came if came != OK else GONE))
            if self.clock.monotonic_s() > FIRST_OUTPUTS_S:
                raise FailedBringUp(f"no motor commands within {FIRST_OUTPUTS_S:.0f} simulated s")

    def _let_work(self) -> None:
        """Wait until it waits for us."""
        still = 0
        for _ in range(LOOKS_MAX):
            still = still + 1 if self.process.still else 0
            if still == LOOKS_ALIKE:
                return
            select([], [], [], LOOK_S)

    def logs(self) -> dict[str, bytes]:
        """Return the ULog files it wrote, by name, oldest first."""
        found = sorted((self.folder / "log").rglob("*.ulg"), key=lambda path: path.stat().st_mtime_ns)
        return {path.name: path.read_bytes() for path in found}

    def _remove_names(self) -> None:
        for path in outside(self._instance):
            path.unlink(missing_ok=True)


def _environment(parameters: Mapping[str, str]) -> dict[str, str]:
    number, _, model = AIRFRAME.partition("_")
    return {
        "PATH": os.defpath,
        "PX4_SIM_MODEL": model,
        "PX4_SYS_AUTOSTART": number,
        **{f"PX4_PARAM_{name}": text for name, text in parameters.items()},
    }


def _listening(port: int) -> socket:
    made = socket(AF_INET, SOCK_STREAM)
    made.setsockopt(SOL_SOCKET, SO_REUSEADDR, 1)
    try:
        made.bind((LOOPBACK, port))
        made.listen(1)
    except OSError as fault:
        made.close()
        raise Unavailable(f"port {port}: {fault}") from fault
    return made
