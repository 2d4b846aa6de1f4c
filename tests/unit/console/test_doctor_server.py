"""`saflite doctor` asks whatever stands where a model server is looked for, and says what it found, whatever it is."""

from __future__ import annotations

import gzip
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import pytest

from saflite.console.doctor import checks

OK = b"HTTP/1.1 200 OK\r\n"
WHOLE = OK + b"connection: close\r\n\r\n"
MIB = bytes(2**20)


@contextmanager
def _server(*parts: bytes, without_end: bool = False) -> Iterator[str]:
    """Give the address of a server that answers so; `without_end`: the last part again and again."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with suppress(OSError):
                link = server.accept()[0]
                with link:
                    link.recv(65536)
                    for part in parts:
                        link.sendall(part)
                    while without_end:
                        link.sendall(parts[-1])

        serving = threading.Thread(target=serve, daemon=True)
        serving.start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
        with suppress(OSError):
            server.shutdown(socket.SHUT_RDWR)  # nobody came
    serving.join(20.0)
    assert not serving.is_alive()


def test_models_are_named() -> None:
    with _server(WHOLE, b'{"models": [{"name": "b", "size": 1}, {"name": "a\\u001b"}]}') as place:
        found = checks._ollama(place)
    assert found == ("model server", "ok", f"http://{place}: a\x1b, b")


@pytest.mark.parametrize(
    "said",
    [
        *(b'{"models": null}', b'{"models": [1]}', b'{"models": [{"name": null}]}', b'{"models": {"a": 1}}', b"[]"),
        *(
            b"{",
            b"\xff",
            b"[" * 100_000,
            b'{"models": [' + b"1" * 100_000 + b"]}",
            b'{"models": [{"name": "\\ud800"}]}',
        ),
        b'{"models": [{"name": "%s"}]}' % (b"x" * 2_000),
    ],
)
def test_an_answer_that_lists_no_models_is_none(said: bytes) -> None:
    with _server(WHOLE, said) as place:
        found = checks._ollama(place)
    assert (found.what, found.state) == ("model server", "note")
    assert found.text.startswith(f"none at http://{place} (")


@pytest.mark.parametrize(
    "parts",
    [
        (OK + b"content-encoding: gzip\r\n\r\n", gzip.compress(MIB)),
        (WHOLE, MIB),
        (OK + b"x: ", b"x"),
        (b"HTTP/1.1 100 Continue\r\n\r\n",),
    ],
    ids=["packed", "large", "one header", "interim answers"],
)
def test_an_answer_without_end_ends(parts: tuple[bytes, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "ANSWER_S", 0.5)
    with _server(*parts, without_end=True) as place:
        assert checks._ollama(place).state == "note"


@pytest.mark.parametrize("place", ["data:x", "http://[::1", "http://there:x/"])
def test_where_it_would_send_us_is_not_read(place: str) -> None:
    with _server(f"HTTP/1.1 302 Found\r\nlocation: {place}\r\ncontent-length: 0\r\n\r\n".encode()) as server:
        assert checks._ollama(server).state == "note"


@pytest.mark.parametrize(
    "place", ["[::1", "http://\x00", "x://y", "http://", "a b", "\udcff", "xn--a", "127.0.0.1:65536"]
)
def test_an_address_that_is_none_is_told(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OLLAMA_HOST", "127.0.0.1:9")
    assert checks._ollama(place).state == "note"


def test_no_proxy_of_the_environment_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as proxy:
        monkeypatch.setenv("HTTP_PROXY", f"http://127.0.0.1:{proxy.getsockname()[1]}")
        monkeypatch.setenv("NO_PROXY", "")
        monkeypatch.setattr(checks, "ANSWER_S", 0.5)
        assert checks._ollama("127.0.0.1:9").state == "note"
        proxy.setblocking(False)
        with pytest.raises(BlockingIOError):
            proxy.accept()
