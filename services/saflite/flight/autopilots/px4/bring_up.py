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
from saflite.flight.autopilots.external.link import (
    CENTRE_US,
    LOOPBACK,
    LOW_US,
    TICK_STEPS,
    LockstepPort,
    Stopped,
    bound_udp,
)
from saflite.flight.autopilots.external.place import FailedBringUp, Place, outside
from saflite.flight.autopilots.external.process import Process
from saflite.flight.autopilots.external.vehicle import GONE, OK, SILENT
from saflite.flight.autopilots.px4.binary import AIRFRAME, OWN_AIRFRAME, START_UP, start_up_of
from saflite.flight.autopilots.px4.gate import Gate
from saflite.flight.autopilots.px4.settings import TUNE
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import Client

PORTS_NEEDED = 3
SIMULATOR, GROUND, VEHICLE = range(3)  # places among the ports
CALL_S, FIRST_OUTPUTS_S = 60.0, 30.0  # wall, simulated
STARTED = "Startup script returned"
STEPS_PER_MESSAGE = 2  # as `native/hil.c`
LOOK_S, LOOKS_ALIKE, LOOKS_MAX = 0.0005, 2, 1000
CHANNELS = 8
RATE = "IMU_INTEG_RATE"
OWN_SCRIPT = "px4-rc.sihsim"
SCRIPTS = {
    OWN_SCRIPT: """#!/bin/sh
param set MAV_SYS_ID 1
param set IMU_INTEG_RATE {rate_hz}
""",
    "px4-rc.mavlinksim": """#!/bin/sh
param set MAV_SYS_ID 1
param set IMU_INTEG_RATE {rate_hz}
param set-default EKF2_GPS_DELAY 10
param set-default EKF2_MULTI_IMU 1
param set-default SENS_IMU_MODE 1
simulator_mavlink start -c {simulator}
""",
    "px4-rc.mavlink": """#!/bin/sh
mavlink start -u {vehicle} -o {ground} -t {host} -r 4000000 -m minimal
""",
}
"""Start-up files of ours in place of those of the same names: one inertial unit, the slot's ports, one link.

That of its own physics goes on with what stands there. The rate is set here: PX4's script sets another default after
the parameters, and a value that was its default then does not last.
"""


class Aircraft(aircraft.Aircraft):
    """A running PX4 in its world, and the link to it; raises as the class above.

    Args:
        parameters: what it starts with beyond its own defaults, as text.
        boxes: obstacles, shape (k, 8).
        home: latitude, longitude in degrees, height above sea in metres.
        rng_seed: of the sensors' noise.
        before_tick: called before each step of 20 ms while anything waits on the link.
        own_physics: it flies on its own physics (SIH), not in our world.
    """

    process: Process
    _hangs = ""
    patient = False
    """Whether time stands still before each tick while anything of it works or waits for a disk."""

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
        own_physics: bool = False,
    ) -> None:
        import_module("pymavlink.dialects.v20.ardupilotmega")  # now: later, PX4's start-up would run on meanwhile
        self.pulses_us = [CENTRE_US] * CHANNELS
        self.pulses_us[2] = LOW_US
        self._binary, self._parameters, self._home, self._before_tick = binary, parameters, home, before_tick
        self._own_physics = own_physics
        super().__init__(Vehicle(boxes, yaw_deg, rng_seed), place, "px4", PORTS_NEEDED)

    def _bring_up(self, opened: ExitStack) -> None:
        self._lay_out(start_up_of(self._binary.path))
        udp = opened.enter_context(bound_udp(self._place.ports[GROUND]))
        opened.callback(self._remove_names)
        simulator = self._on_its_own(opened) if self._own_physics else self._in_our_world(opened)
        self.vehicle.connect(simulator, udp, self._home, own_physics=self._own_physics)
        self._wait_for_outputs()
        vehicle_port = self._place.ports[VEHICLE]

        def send(data: bytes) -> None:
            udp.sendto(data, (LOOPBACK, vehicle_port))

        def before() -> None:
            if thread := self.process.spinning():
                self._hangs = f": its thread {thread} works and never waits"
                raise Stopped(SILENT)
            if self.patient:
                self._let_work()
            self._before_tick()
            self._radio()

        self.client = Client(self.clock, LockstepPort(self.vehicle, send, before))

    def _in_our_world(self, opened: ExitStack) -> socket:
        """Start it; return the link it calls the simulator on."""
        server = opened.enter_context(_listening(self._place.ports[SIMULATOR]))
        self._start(opened, _environment(AIRFRAME, self._parameters))
        return opened.enter_context(self._called(server))

    def _on_its_own(self, opened: ExitStack) -> socket:
        """Start it with the gate preloaded; return the channel to that, where its physics waits."""
        gate = Gate()
        opened.callback(gate.close)
        home = dict(zip(("PX4_HOME_LAT", "PX4_HOME_LON", "PX4_HOME_ALT"), map(repr, self._home), strict=True))
        environment = {**_environment(OWN_AIRFRAME, self._parameters), **home, **gate.environment}
        self._start(opened, environment, (gate.theirs.fileno(),))
        gate.theirs.close()
        gate.greet(self.process, CALL_S)
        return gate.channel

    def _start(self, opened: ExitStack, environment: Mapping[str, str], keeps: tuple[int, ...] = ()) -> None:
        command = [str(self._binary.path), "-i", str(self._instance), "-d", "-w", str(self.folder)]
        age_max_s = self._place.age_max_s
        made = Process(command, self.folder, environment=environment, realtime=True, keeps=keeps, age_max_s=age_max_s)
        self.process = self._started(opened, made)

    def _radio(self) -> None:
        """Say what the pilot's sticks do: by the simulator's link in our world, by MAVLink on its own physics."""
        if not self._own_physics:
            self.vehicle.set_pulses(self.pulses_us)
        elif self.vehicle["rc_silent"] == 0.0:
            self.client.mav.rc_channels_override_send(1, 1, *self.pulses_us)

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
        ports, rate = self._place.ports, {"rate_hz": self._parameters.get(RATE, str(round(TUNE[RATE])))}
        links = {"simulator": ports[SIMULATOR], "vehicle": ports[VEHICLE], "ground": ports[GROUND], "host": LOOPBACK}
        for name, text in SCRIPTS.items():
            there = start_up / START_UP / name
            more = there.read_text() if name == OWN_SCRIPT and there.is_file() else ""
            (scripts / name).write_text(text.format(**links, **rate) + more)

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
        while (
            not (self.vehicle.answers or self._own_physics) or STARTED not in self.process.console or step % TICK_STEPS
        ):
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

    def trouble(self, came: int) -> str:
        """See the class above; one thread may hang while the others answer, and then it is named."""
        return super().trouble(came) + self._hangs

    def logs(self) -> list[Path]:
        """Return the ULog files it wrote, oldest first."""
        return sorted((self.folder / "log").rglob("*.ulg"), key=lambda path: path.lstat().st_mtime_ns)

    def _remove_names(self) -> None:
        for path in outside(self._instance):
            path.unlink(missing_ok=True)


def _environment(airframe: str, parameters: Mapping[str, str]) -> dict[str, str]:
    number, _, model = airframe.partition("_")
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
