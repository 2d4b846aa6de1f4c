"""The dashboard's address is told only once somebody listens there."""

from __future__ import annotations

import re
import socket

import pytest
import uvicorn

from saflite.console.operations import serving
from saflite.console.view import out


def test_who_reads_the_address_may_connect_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def told(line: str = "") -> None:
        if found := re.search(r"http://127\.0\.0\.1:(\d+)/", line):
            with socket.create_connection(("127.0.0.1", int(found.group(1))), timeout=5.0):
                asked.append(int(found.group(1)))

    def closed(server: uvicorn.Server, sockets: list[socket.socket]) -> None:
        for one in sockets:
            one.close()

    monkeypatch.setattr(out, "line", told)
    monkeypatch.setattr(uvicorn.Server, "run", closed)
    assert serving.serve([], "127.0.0.1", 0, {}) == 0
    assert len(asked) == 1
