"""Events over HTTP: signed, tried again while the receiver is away, given up where it says never."""

from __future__ import annotations

import base64
import hashlib
import hmac
import os
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import httpx
import msgspec
import pytest

from saflite.contract.cloud_event import CloudEvent
from saflite.contract.errors import Refused
from saflite.contract.events import Event, FaultSeen
from saflite.runtime import webhook as webhook_module
from saflite.runtime.webhook import (
    RETRY_MAX_S,
    Cursor,
    Webhook,
    check_url,
    keep_cursor,
    read_cursor,
    read_secret,
    shown_url,
)

EVENT = Event(seq=7, at_unix_s=1.7e9, fact=FaultSeen(where="here", message="a\nb"))
CURSOR = Cursor(campaign="night", begun_unix_s=1.6e9, seq=6)
SECRET = b"0123456789abcdef"


class _Clock:
    def __init__(self) -> None:
        self.now_s = 1.7e9

    def monotonic_s(self) -> float:
        return self.now_s

    def unix_s(self) -> float:
        return self.now_s

    def sleep_s(self, duration_s: float) -> None:
        assert duration_s <= RETRY_MAX_S
        self.now_s += duration_s


def _delivered(answers: list[int | Exception], secret: bytes = b"") -> list[httpx.Request]:
    """Deliver one event to a receiver that answers so, in turn."""
    got: list[httpx.Request] = []

    def receive(request: httpx.Request) -> httpx.Response:
        got.append(request)
        answer = answers[len(got) - 1]
        if isinstance(answer, Exception):
            raise answer
        return httpx.Response(answer)

    webhook = Webhook("http://there/finds", _Clock(), secret, httpx.MockTransport(receive))
    webhook.deliver(EVENT, CURSOR)
    webhook.close()
    return got


def test_an_event_is_told_as_a_cloud_event_and_signed() -> None:
    (request,) = _delivered([204], SECRET)
    told = msgspec.json.decode(request.content, type=CloudEvent)
    assert told.data == EVENT
    assert (told.specversion, told.type, told.source) == ("1.0", "saflite.fault", "/saflite/night")
    assert (told.id, told.sequence) == ("night-1600000000-7-74ecd9b0", "000000000007")
    assert told.time == "2023-11-14T22:13:20.000000+00:00"
    signed = f"{request.headers['webhook-id']}.{request.headers['webhook-timestamp']}.".encode() + request.content
    mac = base64.b64encode(hmac.new(SECRET, signed, hashlib.sha256).digest()).decode()
    assert request.headers["webhook-signature"] == f"v1,{mac}"
    assert "webhook-signature" not in _delivered([200])[0].headers


def test_it_is_sent_again_under_the_same_id_until_it_is_taken() -> None:
    away = httpx.ConnectError("refused")
    got = _delivered([500, away, 429, httpx.ReadTimeout("late"), 408, 503, 503, 503, 503, 503, 200])
    assert len(got) == 11
    assert len({request.headers["webhook-id"] for request in got}) == 1


def test_a_receivers_cookies_are_not_kept() -> None:
    """Each answer may set hundreds: they were kept as long as the bridge, and sent with each event."""
    got: list[httpx.Request] = []

    def receive(request: httpx.Request) -> httpx.Response:
        got.append(request)
        return httpx.Response(503 if len(got) < 5 else 200, headers={"set-cookie": f"a{len(got)}={'x' * 4000}"})

    webhook = Webhook("http://there/finds", _Clock(), transport=httpx.MockTransport(receive))
    webhook.deliver(EVENT, CURSOR)
    webhook.deliver(EVENT, CURSOR)
    assert [request.headers.get("cookie") for request in got] == [None] * 6
    assert not list(webhook._client.cookies.jar)
    webhook.close()


@pytest.mark.parametrize("code", [301, 400, 404, 410])
def test_a_receiver_that_never_takes_it_ends_the_bridge(code: int) -> None:
    with pytest.raises(Refused, match=f"HTTP {code} for event 7"):
        _delivered([code])


@pytest.mark.parametrize("place", ["data:x", "http://[::1", "http://there:x/", "http://elsewhere/", "//", ":"])
def test_where_a_receiver_would_send_an_event_is_not_read(place: str) -> None:
    """The client works out a redirect's address though it does not follow it, and breaks over some: no answer then."""
    asked: list[httpx.Request] = []

    def receive(request: httpx.Request) -> httpx.Response:
        asked.append(request)
        return httpx.Response(302 if len(asked) == 1 else 200, headers={"location": place})

    webhook = Webhook("http://there/finds", _Clock(), transport=httpx.MockTransport(receive))
    with pytest.raises(Refused, match="HTTP 302 for event 7"):
        webhook.deliver(EVENT, CURSOR)
    webhook.close()
    assert [str(request.url) for request in asked] == ["http://there/finds"]


def test_the_cursor_is_kept_whole_and_others_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "cursor"
    assert read_cursor(path) is None
    keep_cursor(path, CURSOR)
    assert read_cursor(path) == CURSOR
    path.write_bytes(b"\xff{")
    with pytest.raises(Refused, match="--cursor"):
        read_cursor(path)


def test_a_secret_is_plain_or_base64_and_long_enough(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    path.touch(0o600)
    path.write_text("whsec_" + base64.b64encode(SECRET).decode() + "\n")
    assert read_secret(path) == SECRET
    path.write_bytes(SECRET)
    assert read_secret(path) == SECRET
    for bad in (b"", b"short", b"whsec_!!!", b"\xff" * 20):
        path.write_bytes(bad)
        with pytest.raises(Refused, match="--secret"):
            read_secret(path)


@pytest.mark.parametrize("odd", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), Path.mkdir])
def test_files_that_are_none_are_refused_at_once(odd: Callable[[Path], None], tmp_path: Path) -> None:
    odd(tmp_path / "odd")
    with pytest.raises(Refused, match="--secret"):
        read_secret(tmp_path / "odd")
    with pytest.raises(Refused, match="--cursor"):
        read_cursor(tmp_path / "odd")


def test_a_link_beside_the_cursor_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "other").write_text("precious")
    for name in ("cursor", "cursor.part"):
        (tmp_path / name).symlink_to(tmp_path / "other")
    keep_cursor(tmp_path / "cursor", CURSOR)
    assert (tmp_path / "other").read_text() == "precious"
    assert read_cursor(tmp_path / "cursor") == CURSOR


def test_secrets_in_the_address_are_not_told() -> None:
    url = "https://user:secret@there:8443/hooks/secret?token=secret"
    assert shown_url(url) == "https://there:8443/..."
    webhook = Webhook(url, _Clock(), b"", httpx.MockTransport(lambda request: httpx.Response(404)))
    with pytest.raises(Refused) as refused:
        webhook.deliver(EVENT, CURSOR)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    "url",
    [
        *("", "there", "ftp://there/x", "http://", "http://[::1", "file:///etc/passwd", "http://["),
        # none that the client could ask
        *("http://xn--a/", "http://xn--/", "http://there:65536/", "http://there..x/", f"http://{'a' * 64}/"),
    ],
)
def test_what_is_no_web_server_is_refused(url: str) -> None:
    with pytest.raises(Refused, match="--webhook"):
        check_url(url)


@pytest.mark.parametrize("url", ["ana:secret@there/hook", "ftp://ana:secret@there", "http://ana:secret@[/x?t=secret"])
def test_what_is_refused_is_not_told(url: str) -> None:
    with pytest.raises(Refused) as refused:
        check_url(url)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    "url", ["http://there", "https://a.b-c.example:8443/x", "http://[::1]:80/x", "http://bücher.example"]
)
def test_what_is_one_is_taken(url: str) -> None:
    assert check_url(url) == url


def test_a_receiver_whose_answer_never_ends_is_given_up_and_asked_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Interim answers without end, or a byte now and then, start the client's own timeout again and again."""
    monkeypatch.setattr(webhook_module, "ANSWER_S", 0.05)
    monkeypatch.setattr(webhook_module, "CONNECT_S", 0.05)
    over, asked = threading.Event(), []

    def receive(request: httpx.Request) -> httpx.Response:
        asked.append(request)
        if len(asked) < 3:
            assert over.wait(20.0)
        return httpx.Response(200)

    webhook = Webhook("http://there/finds", _Clock(), transport=httpx.MockTransport(receive))
    webhook.deliver(EVENT, CURSOR)
    over.set()
    webhook.close()
    assert len(asked) == 3
    assert [record.message.rpartition(": ")[2] for record in caplog.records] == ["no whole answer within 0 s"] * 2


def test_no_proxy_of_the_environment_sees_an_event(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as proxy:
        monkeypatch.setenv("HTTP_PROXY", f"http://127.0.0.1:{proxy.getsockname()[1]}")
        monkeypatch.setenv("NO_PROXY", "")
        proxy.settimeout(0.2)
        with pytest.raises(httpx.ReadTimeout):
            httpx.get("http://127.0.0.1:9", timeout=0.2)
        proxy.accept()[0].close()  # as a web client would
        webhook = Webhook("http://127.0.0.1:9/finds", _Clock())
        with pytest.raises(httpx.ConnectError):
            webhook._client.post("http://127.0.0.1:9/finds", content=b"{}", timeout=5.0)
        webhook.close()
        with pytest.raises(TimeoutError):
            proxy.accept()
