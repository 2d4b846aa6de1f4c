"""What every model server is asked through: answers of bounded size."""

from __future__ import annotations

from collections.abc import AsyncIterator

import httpx

ANSWER_BYTES_MAX = 16 * 2**20
LINE_BYTES_MAX = 2 * 2**20
PORT_MAX = 65_535


class BoundedTransport(httpx.AsyncBaseTransport):
    """Ends an answer that is longer, or has a longer line, than any honest one, before it fills the memory.

    Packed answers are neither asked for nor taken; left out are cookies, which a client keeps and sends for good, and
    where a redirect leads: a client works that out though it does not follow it, and breaks over some.
    """

    def __init__(self, inner: httpx.AsyncBaseTransport | None = None) -> None:
        self._inner = inner or httpx.AsyncHTTPTransport()

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        """Pass the request on and watch what comes back."""
        if not 0 <= (request.url.port or 0) <= PORT_MAX:
            raise httpx.ConnectError("no such port")
        request.headers["accept-encoding"] = "identity"
        response = await self._inner.handle_async_request(request)
        response.headers.pop("set-cookie", None)
        response.headers.pop("location", None)
        if response.headers.get("content-encoding", "identity").strip().lower() not in ("", "identity"):
            await response.aclose()  # a small one may unpack to more than any memory holds
            raise httpx.ReadError("a packed answer, which was not asked for")
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
