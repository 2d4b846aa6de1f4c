"""A key has so many connections and no more."""

from __future__ import annotations

import fcntl
import os
import socket
import subprocess
import sys
from pathlib import Path

from saflite.bus.crowds import LINKS_MAX, shut, surplus
from saflite.bus.links import SESSIONS_MAX
from saflite.campaign.engine.worker_registry import WORKERS_MAX


def test_what_is_too_much_is_counted_by_key_whatever_its_certificate() -> None:
    links = [(f"lab~{number:016x}", f"tls/10.0.0.1:{40_000 + number}") for number in range(5)]
    links += [("eve~0", "tls/[2001:db8::1]:1"), ("eve~0", "tls/[fe80::1%2]:2"), ("", "unixsock-stream/x")] * 2
    assert surplus(links, 3) == {
        "lab": [("10.0.0.1", 40_003), ("10.0.0.1", 40_004)],
        "eve": [("fe80::1", 2)],
    }
    assert surplus(links, 5) == {}
    assert len(surplus(links, 5, {"lab"})["lab"]) == 5, "all of it"


def test_a_key_may_have_all_workers_of_a_farm_and_leaves_room_for_others() -> None:
    assert WORKERS_MAX < LINKS_MAX <= SESSIONS_MAX / 2


def test_looking_for_connections_leaves_everything_else_as_it_was(tmp_path: Path) -> None:
    """Each look left a second number of every file and pipe behind, the next one of those too."""
    listening = socket.create_server(("127.0.0.1", 0))
    client = socket.create_connection(listening.getsockname())
    served, end = listening.accept()
    pair, netlink = socket.socketpair(), socket.socket(socket.AF_NETLINK, socket.SOCK_RAW)
    with listening, client, served, pair[0], pair[1], netlink, (tmp_path / "books").open("wb") as file:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # as SQLite does; gone once any number of the file is closed
        before = os.listdir("/proc/self/fd")
        assert shut([("127.0.0.1", end[1] + 1 if end[1] < 65_535 else 1)]) == 0
        assert os.listdir("/proc/self/fd") == before
        assert shut([end]) == 1
        assert os.listdir("/proc/self/fd") == before
        assert client.recv(1) == b"", "shut"
        again = "import fcntl, sys; fcntl.lockf(open(sys.argv[1], 'r+b'), fcntl.LOCK_EX | fcntl.LOCK_NB)"
        assert (
            subprocess.run([sys.executable, "-c", again, file.name], capture_output=True, check=False).returncode != 0
        )
