"""Keys stay with the hosts their owner named, redirects are not followed, endless answers end."""

from __future__ import annotations

import asyncio
import gzip
import socket
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor

import httpx
import pytest

from saflite.contract.config import ScorerConfig
from saflite.contract.errors import FarmError, Refused, Unavailable
from saflite.scorer_pool.key_hosts import host_of, hosts_named_by, may_have_key, with_key_hosts
from saflite.scorer_pool.llm.chat import Question
from saflite.scorer_pool.llm.http import ANSWER_BYTES_MAX, LINE_BYTES_MAX, BoundedTransport
from saflite.scorer_pool.models.ollama import OllamaChat
from saflite.scorer_pool.models.openai import OpenAIChat
from saflite.scorer_pool.registry import check_label

QUESTION = Question([{"role": "user", "content": "?"}], {"type": "object"}, 100)


@pytest.mark.parametrize(
    ("url", "host"),
    [
        ("http://a/v1", "a:80"),
        ("https://a", "a:443"),
        ("a:11434", "a:11434"),
        ("http://u@a:8/x", "a:8"),
        ("http://", ""),
    ],
)
def test_hosts(url: str, host: str) -> None:
    assert host_of(url) == host


@pytest.mark.parametrize("label", ["openai:m@https://ana:secret@host/v1", "ollama:m@ana:secret@host", "openai:m"])
def test_no_address_with_a_password_is_told(label: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A label stands in events, reports and exports, and the address of a server in the digest of its model."""
    monkeypatch.setenv("OPENAI_BASE_URL", "https://ana:secret@host/v1")
    with pytest.raises(Refused, match="an address without a name or password") as told:
        check_label(label)
    assert "secret" not in str(told.value)


def test_only_named_hosts_may_have_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SAFLITE_KEY_HOSTS", "gpu.example:8000, api.example")
    for good in ("http://gpu.example:8000/v1", "https://api.example/v1", "https://api.openai.com/v1"):
        assert may_have_key(good, "https://api.openai.com/v1")
    for bad in ("http://gpu.example:8001", "https://api.example.evil.test", "http://api.openai.com/v1", "x"):
        assert not may_have_key(bad, "https://api.openai.com/v1")


def test_a_campaign_adds_the_hosts_its_labels_name_and_no_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SAFLITE_KEY_HOSTS", "api.example")
    scorer = ScorerConfig(
        model="openai:m@https://gpu.example/v1",
        shadow=("ollama:mistral:7b@box:11434", "gap", "openai:gpt", "openai:m@"),
    )
    assert hosts_named_by(scorer) == ("https://gpu.example:443", "box:11434")
    set_there = with_key_hosts(hosts_named_by(scorer))
    assert set_there == {"SAFLITE_KEY_HOSTS": "api.example,https://gpu.example:443,box:11434"}
    monkeypatch.setenv("SAFLITE_KEY_HOSTS", set_there["SAFLITE_KEY_HOSTS"])
    for good in ("https://gpu.example/v2", "http://box:11434", "https://api.example"):
        assert may_have_key(good, "https://api.openai.com/v1")
    assert not may_have_key("https://evil.test/v1", "https://api.openai.com/v1")
    for plain in ("http://gpu.example:443/v1", "http://api.example:443", "http://api.openai.com:443/v1"):
        assert not may_have_key(plain, "https://api.openai.com/v1"), "a key would go through the net in the clear"
    monkeypatch.delenv("SAFLITE_KEY_HOSTS")
    assert with_key_hosts(hosts_named_by(ScorerConfig())) == {}


class Wire:
    """Keeps the requests that would have gone out, and answers as told."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *answers: httpx.Response) -> None:
        self.sent: list[httpx.Request] = []
        self.answers = list(answers)

        async def handle(transport: httpx.AsyncHTTPTransport, request: httpx.Request) -> httpx.Response:
            self.sent.append(request)
            return self.answers.pop(0)

        monkeypatch.setattr(httpx.AsyncHTTPTransport, "handle_async_request", handle)


def elsewhere(place: str = "http://evil.test/") -> httpx.Response:
    return httpx.Response(307, headers={"location": place}, stream=Parts())


class Parts(httpx.AsyncByteStream):
    def __init__(self, *parts: bytes) -> None:
        self.parts, self.read = parts, 0

    async def __aiter__(self) -> AsyncIterator[bytes]:
        for part in self.parts:
            self.read += len(part)
            yield part


@pytest.mark.parametrize("url", ["http://evil.test/v1", "http://127.0.0.1:9/v1"])
def test_a_server_named_over_the_bus_gets_no_key(url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    monkeypatch.setenv("OLLAMA_API_KEY", "secret")
    wire = Wire(monkeypatch, elsewhere(), elsewhere())
    for chat in (OpenAIChat(f"m@{url}"), OllamaChat(f"m@{url}")):
        with pytest.raises(FarmError):
            asyncio.run(chat.ask(QUESTION))
    assert [request.headers.get("authorization") for request in wire.sent] == [None, None]


def test_the_users_own_server_gets_the_key_and_no_redirect_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    wire = Wire(monkeypatch, elsewhere())
    with pytest.raises(Unavailable, match="307"):
        asyncio.run(OpenAIChat("m").ask(QUESTION))
    assert [str(request.url.host) for request in wire.sent] == ["api.openai.com"]
    assert wire.sent[0].headers["authorization"] == "Bearer secret"


@pytest.mark.parametrize("place", ["data:x", "http://[::1", "http://there:x/", "http://xn--a/", "//xn--", "http://"])
def test_where_a_redirect_leads_is_not_even_worked_out(place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A web client does so though it follows none, and breaks over some."""
    wire = Wire(monkeypatch, elsewhere(place), elsewhere(place))
    for chat in (OpenAIChat("m@http://there/v1"), OllamaChat("m@there:11434")):
        with pytest.raises(Unavailable, match="307"):
            asyncio.run(chat.ask(QUESTION))
    assert {request.url.host for request in wire.sent} == {"there"}


@pytest.mark.parametrize(
    "host", ["xn--a", "xn--", f"{'a' * 300}.b", "[::1", "a:b", "there\x00", "127.0.0.1:65536", "127.0.0.1:-1"]
)
def test_an_address_that_is_none_makes_a_fault_with_a_name(host: str) -> None:
    for make in (lambda: OpenAIChat(f"m@http://{host}/v1"), lambda: OllamaChat(f"m@{host}")):
        with pytest.raises(FarmError):
            asyncio.run(make().ask(QUESTION))


@pytest.mark.parametrize("packed", ["gzip", "gzip, gzip", "deflate", "br", "zstd", "GZIP", "x-gzip"])
def test_a_packed_answer_is_not_unpacked(packed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = gzip.compress(gzip.compress(bytes(2**26)))
    answers = [httpx.Response(200, headers={"content-encoding": packed}, stream=Parts(bomb)) for _ in range(2)]
    wire = Wire(monkeypatch, *answers)
    for chat in (OpenAIChat("m"), OllamaChat("m")):
        with pytest.raises(FarmError, match="packed"):
            asyncio.run(chat.ask(QUESTION))
    assert {request.headers["accept-encoding"] for request in wire.sent} == {"identity"}
    assert all(not answer.stream.read for answer in answers if isinstance(answer.stream, Parts))


def test_a_model_servers_cookies_are_not_kept() -> None:
    sent: list[httpx.Request] = []

    def answer(request: httpx.Request) -> httpx.Response:
        sent.append(request)
        return httpx.Response(200, headers=[("set-cookie", f"a{len(sent)}={number}") for number in range(3)])

    async def ask() -> None:
        async with httpx.AsyncClient(transport=BoundedTransport(httpx.MockTransport(answer))) as client:
            for _ in range(3):
                await client.get("http://there")

    asyncio.run(ask())
    assert [request.headers.get("cookie") for request in sent] == [None] * 3


@pytest.mark.parametrize(("part", "limit"), [(b"x" * 65536, LINE_BYTES_MAX), (b"x" * 65535 + b"\n", ANSWER_BYTES_MAX)])
def test_endless_answers_end(part: bytes, limit: int) -> None:
    stream = Parts(*[part] * 1000)

    async def read() -> None:
        transport = BoundedTransport(httpx.MockTransport(lambda request: httpx.Response(200, stream=stream)))
        async with httpx.AsyncClient(transport=transport) as client, client.stream("GET", "http://a") as response:
            async for _ in response.aiter_bytes():
                pass

    with pytest.raises(httpx.ReadError, match="longer"):
        asyncio.run(read())
    assert stream.read <= limit + len(part)


def test_no_proxy_of_the_environment_sees_a_question_or_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """A proxy of the environment, which a web client goes to by itself, hears of the first question, no other."""
    monkeypatch.setenv("OPENAI_API_KEY", "secret")
    with socket.create_server(("127.0.0.1", 0)) as proxy, socket.create_server(("127.0.0.1", 0)) as server:
        server_at, proxy_at = (f"127.0.0.1:{one.getsockname()[1]}" for one in (server, proxy))
        monkeypatch.setenv("SAFLITE_KEY_HOSTS", server_at)
        for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "http_proxy", "https_proxy", "all_proxy"):
            monkeypatch.setenv(name, f"http://{proxy_at}")
        monkeypatch.setenv("NO_PROXY", "")
        server.settimeout(30.0)
        proxy.settimeout(0.2)
        with pytest.raises(httpx.ReadTimeout):
            httpx.get(f"http://{server_at}", timeout=0.2)
        proxy.accept()[0].close()
        with ThreadPoolExecutor(1) as asking:
            asked = asking.submit(_fails, OpenAIChat(f"m@http://{server_at}/v1"))
            link = server.accept()[0]
            assert b"Bearer secret" in link.recv(65536)
            link.close()
            asked.result()
        with pytest.raises(TimeoutError):
            proxy.accept()


def _fails(chat: OpenAIChat) -> None:
    with pytest.raises(FarmError):
        asyncio.run(chat.ask(QUESTION))
