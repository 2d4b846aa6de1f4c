"""The dashboard's server under connections that nobody honest holds: it goes on answering, and says nothing of them."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator, Awaitable, Callable

import uvicorn
from starlette.applications import Starlette
from starlette.responses import PlainTextResponse, StreamingResponse
from starlette.routing import Route

from saflite.console.view.dashboard.connections import BACKLOG, bounded

ASK = b"GET / HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n"
Talk = Callable[[int], Awaitable[None]]


def _served(talk: Talk, connections_max: int, silent_s: float) -> None:
    """Talk to a server at the port it listens on."""

    async def both() -> None:
        listener = socket.create_server(("127.0.0.1", 0))
        routes = [
            Route("/", lambda _: PlainTextResponse("here")),
            Route("/stream", lambda _: StreamingResponse(_endless())),
        ]
        app = Starlette(routes=routes)
        config = uvicorn.Config(
            app, http=bounded(connections_max, silent_s), backlog=BACKLOG, log_level="error", lifespan="off"
        )
        server = uvicorn.Server(config)
        serving = asyncio.ensure_future(server.serve(sockets=[listener]))
        try:
            await asyncio.wait_for(talk(listener.getsockname()[1]), 60)
        finally:
            server.should_exit = server.force_exit = True
            await serving

    asyncio.run(both())


async def _endless() -> AsyncIterator[str]:
    yield "data"
    await asyncio.Event().wait()


async def _opened(port: int) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    return await asyncio.open_connection("127.0.0.1", port)


def test_more_connections_than_may_be_end_those_that_wait_longest() -> None:
    async def talk(port: int) -> None:
        held = []
        for number in range(30):
            reader, writer = await _opened(port)
            if number % 2:
                writer.write(b"GET / HTTP/1.1\r\nX: ")  # and never the rest
            held.append((reader, writer))
        reader, writer = await _opened(port)
        writer.write(ASK)
        assert b"here" in await reader.read()
        ended = [await one.read() for one, _ in held[:26]]  # 31 in all, 5 may be
        assert ended == [b""] * 26
        for _, writer in held:
            writer.close()

    _served(talk, connections_max=5, silent_s=600.0)


def test_answers_without_end_keep_nobody_out() -> None:
    """Whoever may only see could hold as many streams as there may be connections: nobody got in to stop the farm."""

    async def talk(port: int) -> None:
        held = []
        for _ in range(12):
            reader, writer = await _opened(port)
            writer.write(ASK.replace(b"GET /", b"GET /stream"))
            assert b"200 OK" in await reader.readline()
            held.append((reader, writer))
        reader, writer = await _opened(port)
        writer.write(ASK)
        assert b"here" in await reader.read()
        for _, writer in held:
            writer.close()

    _served(talk, connections_max=5, silent_s=600.0)


def test_who_says_nothing_is_ended() -> None:
    async def talk(port: int) -> None:
        for said in (b"", b"GET / HTTP/1.1\r\nX: "):
            reader, writer = await _opened(port)
            writer.write(said)
            assert await reader.read() == b""
            writer.close()

    _served(talk, connections_max=5, silent_s=0.05)
