"""Somebody with a key who reads nothing of what they are told: they keep nobody waiting but themselves.

Their link runs through a small TCP proxy that stops reading, and says that it may be silent for long, as hostile
software would; their questions say that a full link is to be waited for.
"""

from __future__ import annotations

import json
import queue
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import zenoh

from saflite.bus import keyring
from saflite.bus.base import Happening, Reply, seal
from saflite.bus.links import config_of
from saflite.bus.private_socket import PrivateSocket
from saflite.bus.questions import ZenohRequest
from saflite.bus.zenoh import Gate, ZenohBus, open_client, open_router
from saflite.contract import topics

pytestmark = pytest.mark.live

CAMPAIGN = "night"
KEY = topics.control(CAMPAIGN, "events")
LONG = bytes(2**18)
PROMPT_S = 0.5  # without the threads that send: 5 s for each link, again and again


class Stalled:
    """A TCP proxy that hands on what its client says, and stops taking what the router says when told to."""

    def __init__(self, port: int) -> None:
        self.stall = threading.Event()
        self._port, self._server = port, socket.create_server(("127.0.0.1", 0))
        self._open: list[socket.socket] = [self._server]
        self.endpoint = f"tls/127.0.0.1:{self._server.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        try:
            near, _ = self._server.accept()
        except OSError:
            return
        far = socket.socket()
        far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        far.connect(("127.0.0.1", self._port))
        self._open += [near, far]
        threading.Thread(target=self._pump, args=(near, far, threading.Event()), daemon=True).start()
        threading.Thread(target=self._pump, args=(far, near, self.stall), daemon=True).start()

    def _pump(self, source: socket.socket, sink: socket.socket, stall: threading.Event) -> None:
        try:
            while not stall.is_set() and (data := source.recv(65536)):
                sink.sendall(data)
        except OSError:
            return

    def close(self) -> None:
        """Close both ends."""
        for one in self._open:
            one.close()


class Farm(NamedTuple):
    bus: ZenohBus
    port: int
    keys: Path
    asked: queue.SimpleQueue[Happening]

    def stalled(self) -> tuple[Stalled, zenoh.Session]:
        """Return the viewer's session through a proxy."""
        proxy = Stalled(self.port)
        settings = zenoh.Config()
        tls = keyring.peer_credentials(self.keys / "peers" / "eve", time.time()).tls()
        config = {**config_of("client", proxy.endpoint), "transport/link/tls": tls, "transport/link/tx/lease": 600_000}
        for name, value in {**config, "connect/timeout_ms": 10_000}.items():
            settings.insert_json5(name, json.dumps(value))
        return proxy, zenoh.open(settings)

    def longest_answer_s(self, count: int, payload: bytes) -> float:
        """Answer what was asked, so often; return how long the slowest answer kept this thread."""
        longest_s = 0.0
        for _ in range(count):
            request = self.asked.get(timeout=20.0)
            assert isinstance(request, ZenohRequest)
            began_s = time.monotonic()
            request.reply(payload)
            del request
            longest_s = max(longest_s, time.monotonic() - began_s)
        return longest_s


@pytest.fixture
def farm(tmp_path: Path) -> Iterator[Farm]:
    keys = tmp_path / "keys"
    keyring.init(keys, [], now_s=time.time())
    for name in ("eve", "ana"):
        keyring.add(keys, name, ["viewer"], now_s=time.time())
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    with PrivateSocket() as private:
        gate = Gate(f"tls/127.0.0.1:{port}", keyring.farm_credentials(keys, time.time()), keyring.read_register(keys))
        bus = open_router("books", private.endpoint, gate=gate)
        asked: queue.SimpleQueue[Happening] = queue.SimpleQueue()
        bus.serve(KEY, asked.put)
        yield Farm(bus, port, keys, asked)
        bus.close()


def _on(handler: Callable[[Any], None]) -> Any:
    return zenoh.handlers.Callback(handler, indirect=False)


def _ask(session: zenoh.Session, count: int) -> None:
    for _ in range(count):
        session.get(
            f"by/eve/{KEY}",
            _on(lambda _: None),
            payload=b"",
            attachment=seal(KEY, "eve", b""),
            timeout=600.0,
            congestion_control=zenoh.CongestionControl.BLOCK,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
        )


def _honest_s(farm: Farm) -> float:
    """Return how long another key waits for an answer, connecting included."""
    began_s = time.monotonic()
    credentials = keyring.peer_credentials(farm.keys / "peers" / "ana", time.time())
    bus = open_client("ana", f"tls/127.0.0.1:{farm.port}", patience_s=10.0, keys=credentials)
    answers: queue.SimpleQueue[Happening] = queue.SimpleQueue()
    bus.ask(KEY, b"", "one", answers.put, 10.0)
    while True:
        request = farm.asked.get(timeout=10.0)
        assert isinstance(request, ZenohRequest)
        if request.peer == "ana":
            break
    request.reply(LONG)
    reply = answers.get(timeout=10.0)
    bus.close()
    assert isinstance(reply, Reply)
    assert reply.payload == LONG
    return time.monotonic() - began_s


def test_who_does_not_read_answers_keeps_only_itself_waiting(farm: Farm) -> None:
    proxy, session = farm.stalled()
    proxy.stall.set()
    _ask(session, 100)
    assert farm.longest_answer_s(100, LONG) < PROMPT_S
    again, another = farm.stalled()
    again.stall.set()
    _ask(another, 100)
    assert farm.longest_answer_s(100, LONG) < PROMPT_S
    _ask(another, 100)  # asked, and never answered: that nothing comes is said to the asker, too
    for _ in range(100):
        began_s = time.monotonic()
        farm.asked.get(timeout=20.0)
        assert time.monotonic() - began_s < PROMPT_S
    _ask(another, 20)
    assert _honest_s(farm) < 10 * PROMPT_S
    proxy.close()
    again.close()


def test_who_does_not_read_facts_keeps_nobody_waiting(farm: Farm) -> None:
    proxy, session = farm.stalled()
    heard = threading.Event()
    key = topics.event(CAMPAIGN, "flown")
    session.declare_subscriber(key, _on(lambda _: heard.set()))
    for _ in range(100):  # until it follows
        farm.bus.announce(key, b"a fact")
        if heard.wait(0.1):
            break
    assert heard.is_set()
    proxy.stall.set()
    longest_s = 0.0
    for _ in range(200):
        began_s = time.monotonic()
        farm.bus.announce(key, LONG)
        longest_s = max(longest_s, time.monotonic() - began_s)
    assert longest_s < PROMPT_S
    assert _honest_s(farm) < 10 * PROMPT_S
    proxy.close()


def test_the_past_that_the_router_itself_keeps_is_told_to_no_key(farm: Farm) -> None:
    """It was told by the threads that read all links: one key that did not read stopped the farm, 5 s for each link."""
    farm.bus.announce(topics.event(CAMPAIGN, "flown"), b"a fact")
    past = f"saflite/{topics.PROTOCOL}/{CAMPAIGN}/event/*/@adv/**"
    until_s = time.monotonic() + 10.0
    while _told_of(farm.bus._session, past) != [b"a fact"]:  # a thread of its own announces
        assert time.monotonic() < until_s
    proxy, session = farm.stalled()
    assert _told_of(session, past) == []
    proxy.close()


def _told_of(session: zenoh.Session, key: str) -> list[bytes]:
    anywhere, anything = zenoh.QueryTarget.ALL, zenoh.ReplyKeyExpr.ANY
    replies = session.get(key, target=anywhere, accept_replies=anything, timeout=2.0)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
