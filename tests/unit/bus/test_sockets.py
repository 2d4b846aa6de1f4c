"""Connections that Zenoh opened end at once when they are closed."""

from __future__ import annotations

import os
import socket
import struct
from pathlib import Path

from saflite.bus.sockets import end_at_once

LINGER = struct.pack("ii", 1, 10)
"""As Zenoh says it of each of its connections."""


def _waits(connection: socket.socket) -> bool:
    return bool(struct.unpack("ii", connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8))[0])


def test_no_connection_waits_once_it_was_looked_at(tmp_path: Path) -> None:
    listening = socket.create_server(("127.0.0.1", 0))
    client = socket.create_connection(listening.getsockname())
    served, _ = listening.accept()
    with listening, client, served, (tmp_path / "books").open("wb"):
        served.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER)
        before = os.listdir("/proc/self/fd")
        told = end_at_once(())
        assert os.listdir("/proc/self/fd") == before
        assert not _waits(served)
        assert os.fstat(served.fileno()).st_ino in told
        assert os.fstat(client.fileno()).st_ino not in told, "it may be told to wait later: Zenoh does so after a while"
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER)
        assert end_at_once(told) >= {os.fstat(one.fileno()).st_ino for one in (served, client)}
        assert not _waits(client)
        client.sendall(b"still")
        client.close()
        assert served.recv(8) == b"still", "what was on its way comes all the same"
    assert not end_at_once(told) & told, "those that are gone are forgotten"
