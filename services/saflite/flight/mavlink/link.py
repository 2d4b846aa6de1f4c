"""Serve the reference vehicle over MAVLink, so that a ground station or an SDK can fly it (`saflite sitl`).

Endpoints: `tcp:HOST:PORT` waits for ground stations, `udp:HOST:PORT` answers whoever writes to it, `udpout:HOST:PORT`
talks to one. The simulation is paced by the clock handed in; `speed` 0 runs as fast as it can.
"""

from __future__ import annotations

import logging
import selectors
import socket
from collections.abc import Callable
from typing import Protocol

from saflite.contract.clock import Clock
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.test_case import Scenario, StartState, Target, TestCase
from saflite.flight.autopilots.reference.autopilot import TICK_S
from saflite.flight.autopilots.reference.flight import ReferenceFlight
from saflite.flight.mavlink.server import MavlinkServer

log = logging.getLogger(__name__)

READ_BYTES, CLIENTS_MAX, BACKLOG_BYTES = 65536, 8, 1 << 20
BEHIND_MAX_S = 0.5  # a simulation later than this gives up catching up


class Port(Protocol):
    """Where bytes come from and go to."""

    name: str

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        """Send `data` to everyone connected and return what came in, waiting at most `wait_s`."""
        ...

    def close(self) -> None:
        """Close all sockets."""
        ...


class TcpPort:
    """A TCP server for up to eight ground stations; one that does not read is dropped."""

    def __init__(self, host: str, port: int) -> None:
        self._selector = selectors.DefaultSelector()
        self._server = _bound(socket.SOCK_STREAM, host, port)
        self._server.listen()
        self._server.setblocking(False)
        self._selector.register(self._server, selectors.EVENT_READ)
        self._waiting: dict[socket.socket, bytearray] = {}
        self.name = "tcp:{}:{}".format(*self._server.getsockname()[:2])

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        """Send, accept, receive."""
        for client in tuple(self._waiting):
            self._send(client, data)
        received = bytearray()
        for key, _ in self._selector.select(wait_s):
            if key.fileobj is self._server:
                self._accept()
            elif isinstance(key.fileobj, socket.socket):
                received += self._receive(key.fileobj)
        return bytes(received)

    def _accept(self) -> None:
        client, address = self._server.accept()
        if len(self._waiting) >= CLIENTS_MAX:
            client.close()
            return
        client.setblocking(False)
        self._selector.register(client, selectors.EVENT_READ)
        self._waiting[client] = bytearray()
        log.info("ground station %s connected", address)

    def _send(self, client: socket.socket, data: bytes) -> None:
        backlog = self._waiting[client]
        backlog += data
        try:
            while backlog:
                del backlog[: client.send(backlog)]
        except BlockingIOError:
            if len(backlog) > BACKLOG_BYTES:
                self._drop(client)
        except OSError:
            self._drop(client)

    def _receive(self, client: socket.socket) -> bytes:
        try:
            data = client.recv(READ_BYTES)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._drop(client)
        return data

    def _drop(self, client: socket.socket) -> None:
        if self._waiting.pop(client, None) is not None:
            self._selector.unregister(client)
            client.close()

    def close(self) -> None:
        """Close all sockets."""
        for client in tuple(self._waiting):
            self._drop(client)
        self._selector.close()
        self._server.close()


class UdpPort:
    """UDP, either waiting for ground stations or talking to one."""

    def __init__(self, host: str, port: int, *, out: bool) -> None:
        self._socket = (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) if out else _bound(socket.SOCK_DGRAM, host, port)
        )
        self._socket.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._socket, selectors.EVENT_READ)
        self._peers: list[tuple[str, int]] = [(host, port)] if out else []
        bound = (host, port) if out else self._socket.getsockname()[:2]
        self.name = f"{'udpout' if out else 'udp'}:{bound[0]}:{bound[1]}"

    def exchange(self, data: bytes, wait_s: float) -> bytes:
        """Send to every peer heard so far, receive."""
        for peer in self._peers:
            for start in range(0, len(data), 1200):
                self._send(data[start : start + 1200], peer)
        received = bytearray()
        while self._selector.select(wait_s):
            wait_s = 0.0
            try:
                part, peer = self._socket.recvfrom(READ_BYTES)
            except OSError:
                break
            if peer not in self._peers:
                self._peers = [*self._peers, peer][-CLIENTS_MAX:]
            received += part
        return bytes(received)

    def _send(self, data: bytes, peer: tuple[str, int]) -> None:
        try:
            self._socket.sendto(data, peer)
        except OSError as fault:
            log.debug("cannot reach %s: %s", peer, fault)

    def close(self) -> None:
        """Close the socket."""
        self._selector.close()
        self._socket.close()


def open_port(endpoint: str) -> Port:
    """Return the port for an endpoint; raises Refused for a malformed one, Unavailable if it cannot be bound."""
    kind, _, rest = endpoint.partition(":")
    host, _, number = rest.rpartition(":")
    if kind not in ("tcp", "udp", "udpout") or not host or not number.isdigit() or int(number) > 65535:
        raise Refused("endpoint", expected="tcp:HOST:PORT, udp:HOST:PORT or udpout:HOST:PORT", got=repr(endpoint))
    if kind == "tcp":
        return TcpPort(host, int(number))
    return UdpPort(host, int(number), out=kind == "udpout")


def _bound(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET, kind)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((host, port))
    except OSError as fault:
        made.close()
        raise Unavailable(f"{host}:{port}: {fault}") from fault
    return made


def on_the_ground() -> TestCase:
    """Return the vehicle a ground station finds: disarmed, standing, nothing wrong."""
    start = StartState(mode="STABILIZE", altitude_m=0.0, armed=False)
    return TestCase(target=Target(), scenario=Scenario(start=start), rng_seed=1)


class Session:
    """A flight with a MAVLink face; a reboot ordered by the ground station starts it anew."""

    def __init__(self, test_case: TestCase) -> None:
        self._test_case = test_case
        self._begin()

    def _begin(self) -> None:
        self.flight = ReferenceFlight(self._test_case)
        self.flight.bring_up()
        self.server = MavlinkServer(self.flight.autopilot, self._order_restart)
        self._restart = False

    def _order_restart(self) -> None:
        self._restart = True

    def step(self, received: bytes) -> bytes:
        """Take what came in, fly 20 ms, return what to send."""
        self.server.feed(received)
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
        endpoint: see the module.
        clock: paces the simulation.
        test_case: parameters, defects, start, wind and boxes of the vehicle; default: `on_the_ground()`.
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
        due_s, data = clock.monotonic_s(), b""
        while not stop():
            now_s = clock.monotonic_s()
            wait_s = max(0.0, due_s - now_s) if speed > 0.0 else 0.0
            received = port.exchange(data, wait_s)
            data = b""
            if speed > 0.0 and clock.monotonic_s() < due_s:
                session.server.feed(received)
                continue
            data = session.step(received)
            late_s = now_s - due_s
            due_s = now_s if late_s > BEHIND_MAX_S else due_s + (TICK_S / speed if speed > 0.0 else 0.0)
    finally:
        port.close()
