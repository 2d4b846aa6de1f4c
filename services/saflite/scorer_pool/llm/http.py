"""What every model server is asked through: keys for trusted hosts only, no redirects, answers of bounded size.

The address of a server may come over the bus, from whoever may order another scorer. So a key is sent only where the
user's own settings name the host: the default server of its kind, or `SAFLITE_KEY_HOSTS` (comma-separated
`host[:port]`), to which `saflite run` adds the hosts that the user's campaign file names.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from urllib.parse import urlsplit

import httpx

from saflite.contract.config import environment

KEY_HOSTS = "SAFLITE_KEY_HOSTS"
ANSWER_BYTES_MAX = 16 * 2**20
LINE_BYTES_MAX = 2 * 2**20
_PORTS = {"http": 80, "https": 443}


def host_of(url: str) -> str:
    """Return `host:port` of an address, empty if it has none; an address without a scheme counts as http."""
    try:
        parts = urlsplit(url if "://" in url else f"http://{url}")
        port = parts.port or _PORTS.get(parts.scheme, 0)
    except ValueError:
        return ""
    return f"{parts.hostname}:{port}" if parts.hostname else ""


def may_have_key(url: str, default_url: str) -> bool:
    """Return whether a key may be sent to `url`: it is the user's default server or one of `SAFLITE_KEY_HOSTS`."""
    named = [part.strip() for part in environment(KEY_HOSTS).split(",") if part.strip()]
    trusted = {host_of(default_url), *(host_of(name) for name in named)}
    trusted |= {host_of(f"https://{name}") for name in named if "://" not in name}
    return host_of(url) in trusted - {""}


class BoundedTransport(httpx.AsyncBaseTransport):
    """Ends an answer that is longer, or has a longer line, than any honest one, before it fills the memory."""

    def __init__(self, inner: httpx.AsyncBaseTransport | None = None) -> None:
        self._inner = inner or httpx.AsyncHTTPTransport()

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        """Pass the request on and watch what comes back."""
        response = await self._inner.handle_async_request(request)
        assert isinstance(response.stream, httpx.AsyncByteStream), "an asynchronous client has asynchronous streams"
        response.stream = _Bounded(response.stream)
        return response

    async def aclose(self) -> None:
        """Close the transport underneath."""
        await self._inner.aclose()


class _Bounded(httpx.AsyncByteStream):
    def __init__(self, inner: httpx.AsyncByteStream) -> None:
        self._inner = inner

    async def __aiter__(self) -> AsyncIterator[bytes]:
        whole = line = 0
        async for part in self._inner:
            whole += len(part)
            end = part.rfind(b"\n")
            line = line + len(part) if end < 0 else len(part) - end - 1
            if whole > ANSWER_BYTES_MAX or line > LINE_BYTES_MAX:
                raise httpx.ReadError("an answer longer than any honest one")
            yield part

    async def aclose(self) -> None:
        await self._inner.aclose()
