"""The TCP port of a simulated vehicle outlives peers that vanish while they are let in."""

from __future__ import annotations

import errno
import socket

import pytest

from saflite.flight.mavlink.ports import TcpPort


@pytest.mark.parametrize("why", [errno.ECONNABORTED, errno.EMFILE, errno.EAGAIN])
def test_a_peer_that_cannot_be_let_in_costs_the_others_nothing(why: int, monkeypatch: pytest.MonkeyPatch) -> None:
    port = TcpPort("127.0.0.1", 0)
    host, _, number = port.name.removeprefix("tcp:").rpartition(":")
    try:
        with socket.create_connection((host, int(number)), timeout=5.0) as first:
            port.exchange(b"", 5.0)
            first.sendall(b"hello")
            with monkeypatch.context() as broken, socket.create_connection((host, int(number)), timeout=5.0):
                broken.setattr(socket.socket, "accept", _failing(why))
                assert _all_of(port, 5) == b"hello"
            assert port.exchange(b"", 5.0) == b"", "the second one is let in, or gone again"
    finally:
        port.close()


def _failing(why: int) -> object:
    def accept(_: socket.socket) -> object:
        raise OSError(why, "accept")

    return accept


def _all_of(port: TcpPort, length: int) -> bytes:
    data = b""
    for _ in range(1000):
        data += port.exchange(b"", 0.01)
        if len(data) >= length:
            break
    return data
