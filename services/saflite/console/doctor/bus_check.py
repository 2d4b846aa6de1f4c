"""One question and its answer over the real bus, for the doctor."""

from __future__ import annotations

import queue

from saflite.bus.base import Happening, Reply, Request
from saflite.contract.errors import Unavailable

ANSWER_S = 3.0


def round_trip() -> float:
    """Return how long a question and its answer took on a router of our own, milliseconds; raises Unavailable."""
    from saflite.bus.private_socket import PrivateSocket
    from saflite.bus.zenoh import open_client, open_router
    from saflite.runtime.clock import WallClock

    socket, clock = PrivateSocket(), WallClock()
    asked: queue.SimpleQueue[Happening] = queue.SimpleQueue()
    answered: queue.SimpleQueue[Happening] = queue.SimpleQueue()
    router = open_router("doctor-router", socket.endpoint)
    client = open_client("doctor", socket.endpoint, patience_s=6.0)
    try:
        router.serve("saflite/doctor", asked.put)
        began_s = clock.monotonic_s()
        client.ask("saflite/doctor", b"ping", 0, answered.put, ANSWER_S)
        _question(asked).reply(b"pong")
        reply = _within(answered)
        if not isinstance(reply, Reply) or reply.payload != b"pong":
            raise Unavailable("the bus gave no answer")
        return 1000.0 * (clock.monotonic_s() - began_s)
    finally:
        client.close()
        router.close()
        socket.close()


def _question(inbox: queue.SimpleQueue[Happening]) -> Request:
    happening = _within(inbox)
    if isinstance(happening, tuple):
        raise Unavailable("the bus brought something else than the question")
    return happening


def _within(inbox: queue.SimpleQueue[Happening]) -> Happening:
    try:
        return inbox.get(timeout=ANSWER_S)
    except queue.Empty as fault:
        raise Unavailable(f"nothing arrived over the bus within {ANSWER_S:g} s") from fault
