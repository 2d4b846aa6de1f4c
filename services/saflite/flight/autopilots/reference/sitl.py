"""Serve the reference vehicle over MAVLink, so that a ground station or an SDK can fly it (`saflite sitl`)."""

from __future__ import annotations

from collections.abc import Callable

from saflite.contract.clock import Clock
from saflite.contract.test_case import Scenario, StartState, Target, TestCase
from saflite.flight.autopilots.reference.autopilot import TICK_S
from saflite.flight.autopilots.reference.flight import ReferenceFlight
from saflite.flight.autopilots.reference.linked import LinkedReference
from saflite.flight.mavlink import serve as serving
from saflite.flight.mavlink.ports import open_port
from saflite.flight.mavlink.server import MavlinkServer


def on_the_ground() -> TestCase:
    """Return the vehicle a ground station finds: disarmed, standing, nothing wrong."""
    start = StartState(mode="STABILIZE", altitude_m=0.0, armed=False)
    return TestCase(target=Target(), scenario=Scenario(start=start), rng_seed=1)


class Session:
    """A flight with a MAVLink server; a reboot ordered by the ground station starts it anew."""

    tick_s = TICK_S

    def __init__(self, test_case: TestCase) -> None:
        self._test_case = test_case
        self._begin()

    def _begin(self) -> None:
        self.flight = ReferenceFlight(self._test_case)
        self.flight.bring_up()
        self.server = MavlinkServer(LinkedReference(self.flight.autopilot, self._order_restart))
        self._restart = False

    def _order_restart(self) -> None:
        self._restart = True

    def feed(self, received: bytes) -> None:
        """Take what came in."""
        self.server.feed(received)

    def step(self) -> bytes:
        """Fly 20 ms, return what to send."""
        self.flight.tick()
        self.server.tick(self.flight.ticks)
        data = self.server.take()
        if self._restart:
            self._begin()
        return data


def serve(
    endpoint: str,
    clock: Clock,
    *,
    test_case: TestCase | None = None,
    speed: float = 1.0,
    stop: Callable[[], bool] = lambda: False,
    ready: Callable[[str], None] = lambda name: None,
) -> None:
    """Fly and answer until `stop` says so.

    Args:
        endpoint: see `mavlink.ports`.
        clock: paces the simulation.
        test_case: parameters, settings, start, wind and boxes of the vehicle; default: `on_the_ground()`.
        speed: simulated seconds per second, 0 as fast as possible.
        stop: asked every 20 ms of simulated time.
        ready: called with the bound endpoint before the first step.

    Raises:
        Refused: the endpoint or the test case is wrong.
        Unavailable: the port is taken or JSBSim is missing.
    """
    port = open_port(endpoint)
    try:
        session = Session(test_case or on_the_ground())
        ready(port.name)
        serving.serve(session, port, clock, speed, stop)
    finally:
        port.close()
