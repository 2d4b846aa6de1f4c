"""A machine that goes without a word (no power, no network) keeps nobody else waiting."""

from __future__ import annotations

import queue
import subprocess
import sys
import time
from pathlib import Path

import pytest
from network_namespace import NetworkNamespace
from test_joining import network  # noqa: F401 (fixture)
from test_keys import CAMPAIGN, _free_port

from saflite.bus import keyring
from saflite.bus.base import Happening, Reply
from saflite.bus.private_socket import PrivateSocket
from saflite.bus.questions import ZenohRequest
from saflite.bus.zenoh import Gate, ZenohBus, open_client, open_router
from saflite.contract import topics

pytestmark = pytest.mark.live

LINKS, GIVEN_UP_S = 6, 8.0
HOLD = """
import pathlib, sys, time
from saflite.bus import keyring
from saflite.bus.zenoh import open_client
keys = keyring.peer_credentials(pathlib.Path(sys.argv[2]), time.time())
held = [open_client(f"lab-{n}", sys.argv[1], patience_s=10.0, keys=keys) for n in range(int(sys.argv[3]))]
print("there", flush=True)
time.sleep(600)
"""


def test_links_that_end_without_a_word_keep_nobody_else_waiting(
    tmp_path: Path,
    network: NetworkNamespace,  # noqa: F811
) -> None:
    keyring.init(tmp_path / "keys", [network.host_ip], now_s=time.time())
    lab = keyring.add(tmp_path / "keys", "lab", ["worker"], now_s=time.time())
    credentials = keyring.farm_credentials(tmp_path / "keys", time.time())
    gate = Gate(f"tls/{network.host_ip}:{_free_port()}", credentials, keyring.read_register(tmp_path / "keys"))
    with PrivateSocket() as private:
        router = open_router("books", private.endpoint, gate=gate)
        here = open_client("here", private.endpoint)
        router.serve(topics.control(CAMPAIGN, "status"), _answer)
        hold = [*network.prefix, sys.executable, "-c", HOLD, gate.endpoint, str(lab), str(LINKS)]
        with subprocess.Popen(hold, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "there\n"
            time.sleep(2.0)  # longer than the router takes to see them
            network.cut()
            waited_s = [_waited_s(here) for _ in range(round(GIVEN_UP_S / 0.1))]
            process.kill()
        here.close()
        router.close()
    assert max(waited_s) < 1.0, waited_s


def _answer(request: Happening) -> None:
    assert isinstance(request, ZenohRequest)
    request.reply(b"here")


def _waited_s(bus: ZenohBus) -> float:
    """Return how long an answer took, and ask no more than ten times a second."""
    inbox: queue.SimpleQueue[Happening] = queue.SimpleQueue()
    asked_s = time.monotonic()
    bus.ask(topics.control(CAMPAIGN, "status"), b"", 1, inbox.put, 30.0)
    reply = inbox.get(timeout=60.0)
    assert isinstance(reply, Reply)
    waited_s = time.monotonic() - asked_s
    time.sleep(max(0.0, 0.1 - waited_s))
    return waited_s
