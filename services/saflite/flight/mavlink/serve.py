"""Serve a simulated vehicle on a MAVLink link, paced by the clock handed in."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from saflite.contract.clock import Clock
from saflite.flight.mavlink.ports import Port

BEHIND_MAX_S = 0.5  # a simulation later than this gives up catching up


class Session(Protocol):
    """A simulated vehicle that is stepped; `tick_s` is how long a step takes it."""

    tick_s: float

    def feed(self, received: bytes) -> None:
        """Take what came in, without flying on."""
        ...

    def step(self) -> bytes:
        """Fly on by `tick_s` and return what to send."""
        ...


def serve(session: Session, port: Port, clock: Clock, speed: float, stop: Callable[[], bool]) -> None:
    """Fly and answer until `stop` says so, asked at every step.

    Args:
        session: what flies.
        port: where its ground stations are; not closed.
        clock: paces the simulation.
        speed: simulated seconds per second, 0 as fast as possible.
        stop: see above.
    """
    due_s, data = clock.monotonic_s(), b""
    while not stop():
        now_s = clock.monotonic_s()
        wait_s = max(0.0, due_s - now_s) if speed > 0.0 else 0.0
        session.feed(port.exchange(data, wait_s))
        data = b""
        if speed > 0.0 and clock.monotonic_s() < due_s:
            continue
        data = session.step()
        late_s = now_s - due_s
        due_s = now_s if late_s > BEHIND_MAX_S else due_s + (session.tick_s / speed if speed > 0.0 else 0.0)
