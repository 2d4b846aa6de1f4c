"""A running autopilot in its world. All that is opened for it is closed with it, also when bring-up fails."""

from __future__ import annotations

import logging
import shutil
from abc import ABC, abstractmethod
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.outside import LOG_BYTES_MAX, read_bytes
from saflite.flight.autopilots.external.link import WORDS, SimulatedClock
from saflite.flight.autopilots.external.place import Place
from saflite.flight.autopilots.external.process import ForkedProcess, Process
from saflite.flight.autopilots.external.vehicle import GONE, LockstepVehicle
from saflite.flight.mavlink.client import Client
from saflite.flight.world.jsbsim_world import HOME_ALT_M, HOME_LAT_DEG, HOME_LON_DEG

log = logging.getLogger(__name__)

HOME = (HOME_LAT_DEG, HOME_LON_DEG, HOME_ALT_M)


class Aircraft(ABC):
    """A running autopilot and the link to it.

    Args:
        vehicle: the world it flies in.
        place: where it may live.
        name: of its folder there.
        ports_needed: how many ports it binds.

    Raises:
        Unavailable: it cannot be started, or its ports are taken.
        FailedBringUp: it ended, or does not answer.
    """

    process: Process | ForkedProcess
    client: Client
    pulses_us: list[int]
    """Of the radio's channels, sticks first."""

    def __init__(self, vehicle: LockstepVehicle, place: Place, name: str, ports_needed: int) -> None:
        if len(place.ports) < ports_needed:
            raise Unavailable(f"a slot with {ports_needed} ports is needed, this one has {len(place.ports)}")
        self.vehicle: Any = vehicle
        self.clock = SimulatedClock(vehicle)
        self.folder = place.folder / name
        self._place = place
        with ExitStack() as opened:
            opened.callback(shutil.rmtree, self.folder, ignore_errors=True)
            shutil.rmtree(self.folder, ignore_errors=True)
            self.folder.mkdir(parents=True)
            self._bring_up(opened)
            self._opened = opened.pop_all()

    @abstractmethod
    def _bring_up(self, opened: ExitStack) -> None:
        """Start the process and link up with it; all that has to be closed goes onto `opened`."""

    @abstractmethod
    def logs(self) -> list[Path]:
        """Return the logs it wrote, the last one last."""

    def _started(self, opened: ExitStack, process: Process) -> Process:
        opened.callback(process.end)
        return process

    def trouble(self, came: int) -> str:
        """Return in words how it ended, where it does not go on."""
        return self.process.how_it_ended() if came == GONE else WORDS.get(came, "the world failed")

    def artefacts(self, log_name: str) -> tuple[tuple[str, bytes], ...]:
        """Return its console, and its last log under a name; none where that is a link, or no file of a log's size."""
        logs = [path for path in self.logs() if not path.is_symlink()]
        kept = (("console.txt", self.process.console.encode()),)
        try:
            return (*kept, (log_name, read_bytes(logs[-1], "autopilot's log", LOG_BYTES_MAX))) if logs else kept
        except Refused as fault:
            log.warning("%s", fault)
            return kept

    def close(self) -> None:
        """End the process and everything of it; may be called twice."""
        self._opened.close()
