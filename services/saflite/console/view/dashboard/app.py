"""The web application: pages, parts, a stream of figures (server-sent events), orders."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import suppress
from typing import Literal

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware
from starlette.requests import ClientDisconnect, Request
from starlette.responses import (
    FileResponse,
    HTMLResponse,
    PlainTextResponse,
    RedirectResponse,
    Response,
    StreamingResponse,
)
from starlette.routing import Route
from starlette.types import ASGIApp

from saflite.console.view.dashboard import access, pages
from saflite.console.view.dashboard.access import COOKIE, ORDER_HEADER, Address, Role, Tokens, role_of
from saflite.console.view.dashboard.assets import SCRIPT, STYLE
from saflite.console.view.dashboard.source import Source
from saflite.contract import wire
from saflite.contract.bounds import Count, Text
from saflite.contract.errors import FarmError, Refused

EVERY_S = 1.0
BODY_BYTES_MAX, BODY_S = 4096, 10.0
Next = Callable[[Request], Awaitable[Response]]
IsOurs = Callable[[Address, Address], bool]
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; connect-src 'self'; "
        "img-src 'self' data:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Order(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the page may ask of the farm."""

    verb: Literal["pause", "resume", "stop", "budget", "scorer", "shadow"]
    text: Text = ""
    number: Count = 0


class _Guard(BaseHTTPMiddleware):
    """Lets in who may see; a token in the address becomes a cookie, so that it stands in no history."""

    def __init__(self, app: ASGIApp, tokens: Tokens, is_ours: IsOurs) -> None:
        super().__init__(app)
        self._tokens, self._is_ours = tokens, is_ours

    async def dispatch(self, request: Request, call_next: Next) -> Response:
        """Answer, or refuse."""
        bearer = request.headers.get("authorization", "").removeprefix("Bearer ")
        asked = request.query_params.get("token", "")
        role = role_of(
            self._tokens, request.headers.get("host", ""), asked or bearer or request.cookies.get(COOKIE, "")
        )
        if not self._tokens and not self._is_held_by_us(request):
            return PlainTextResponse("another user's: a token is needed (--tokens)\n", 403)
        if role is None:
            words = "a token is needed: open /?token=TOKEN" if self._tokens else "not by this name: use 127.0.0.1"
            return PlainTextResponse(f"{words}\n", 401 if self._tokens else 403)
        response: Response
        if asked:
            response = RedirectResponse(f"/{request.url.path.lstrip('/')}", 303)  # never to another host
            if self._tokens:  # else it is none, and any text
                response.set_cookie(COOKIE, asked, httponly=True, samesite="strict")
        else:
            request.state.role = role
            response = await call_next(request)
        for name, value in HEADERS.items():
            response.headers.setdefault(name, value)
        return response

    def _is_held_by_us(self, request: Request) -> bool:
        client, server = request.scope.get("client"), request.scope.get("server")
        return client is not None and server is not None and self._is_ours(tuple(client), tuple(server))


def application(
    sources: Sequence[Source],
    tokens: Tokens,
    *,
    every_s: float = EVERY_S,
    is_ours: IsOurs = access.is_ours,
    ending: asyncio.Event | None = None,
) -> Starlette:
    """Return the application over the campaigns.

    Without `tokens` whoever asks by a loopback name, from a socket that `is_ours`, is an operator. Streams end once
    `ending` is set: a server waits for them before it stops.
    """
    site = _Site(sources, every_s, ending or asyncio.Event())
    run = "/run/{run}"  # no number: what is too long for one would be no page that is not there, but a fault
    routes = [
        Route("/", site.home),
        Route("/assets/{name}", site.asset),
        Route(f"{run}/", site.run),
        Route(f"{run}/part/{{name}}", site.part),
        Route(f"{run}/find/{{name}}", site.find),
        Route(f"{run}/recordings/{{name}}", site.recording),
        Route(f"{run}/events", site.events),
        Route(f"{run}/order", site.order, methods=["POST"]),
    ]
    return Starlette(
        routes=routes,
        middleware=[Middleware(_Guard, tokens=tokens, is_ours=is_ours)],
        exception_handlers={FarmError: _told, KeyError: _unknown},
    )


def _told(_request: Request, fault: Exception) -> Response:
    return PlainTextResponse(f"{fault}\n", 404 if isinstance(fault, Refused) else 503)


def _unknown(_request: Request, _fault: Exception) -> Response:
    return PlainTextResponse("there is no such run\n", 404)


class _Site:
    """What answers the routes. Plain functions run in threads: they read the books and ask the farm."""

    def __init__(self, sources: Sequence[Source], every_s: float, ending: asyncio.Event) -> None:
        self._sources = {str(number): source for number, source in enumerate(sources)}
        self._every_s, self._ending = every_s, ending

    def _source(self, request: Request) -> Source:
        return self._sources[request.path_params["run"]]

    def home(self, request: Request) -> Response:
        """All runs; the one there is."""
        if len(self._sources) == 1:
            return RedirectResponse("/run/0/", 303)
        return HTMLResponse(pages.of_all(list(self._sources.values()), request.state.role))

    def asset(self, request: Request) -> Response:
        """Style and script."""
        kinds = {"style.css": (STYLE, "text/css"), "script.js": (SCRIPT, "text/javascript")}
        if request.path_params["name"] not in kinds:
            return PlainTextResponse("no such file\n", 404)
        text, kind = kinds[request.path_params["name"]]
        return Response(text, media_type=kind)

    def run(self, request: Request) -> Response:
        """One run."""
        source, number, role = self._source(request), int(request.path_params["run"]), request.state.role
        return HTMLResponse(pages.of_run(number, source, role, alone=len(self._sources) == 1))

    def part(self, request: Request) -> Response:
        """A part of its page."""
        return HTMLResponse(self._source(request).part(request.path_params["name"]))

    def find(self, request: Request) -> Response:
        """One find."""
        return HTMLResponse(self._source(request).find(request.path_params["name"], public=_public(request)))

    def recording(self, request: Request) -> Response:
        """A recording."""
        path = self._source(request).file(request.path_params["name"], public=_public(request))
        return FileResponse(path) if path is not None else PlainTextResponse("no such recording\n", 404)

    def events(self, request: Request) -> Response:
        """Figures every second, the table of finds whenever it changes."""
        stream = self._stream(request, self._source(request))
        return StreamingResponse(stream, media_type="text/event-stream")

    async def _stream(self, request: Request, source: Source) -> AsyncIterator[str]:
        told: tuple[int, str] | None = None
        while not self._ending.is_set() and not await request.is_disconnected():
            figures = await run_in_threadpool(source.figures)
            yield f"data: {msgspec.json.encode(figures).decode()}\n\n"
            if told is None or told[0] != figures.version:
                table = pages.finds(await run_in_threadpool(source.violations, public=_public(request)))
                if told is None or told[1] != table:  # the first one, too: finds may have come since the page was made
                    yield f"event: finds\ndata: {msgspec.json.encode(table).decode()}\n\n"
                told = (figures.version, table)
            with suppress(TimeoutError):
                await asyncio.wait_for(self._ending.wait(), self._every_s)

    async def order(self, request: Request) -> Response:
        """Hand an order on, if whoever asks is an operator."""
        role: Role = request.state.role
        if role != "operator" or ORDER_HEADER not in request.headers:
            return _answer(403, "orders need the role operator")
        try:
            order = wire.unpack_json(await _body(request), Order)
            answer = await run_in_threadpool(self._source(request).order, order.verb, order.text, order.number)
        except (*wire.UNREADABLE, FarmError, TimeoutError, ClientDisconnect) as fault:
            return _answer(400, str(fault) or "an order that does not come")
        return _answer(200, answer.message, accepted=answer.accepted)


async def _body(request: Request) -> bytes:
    """Return what was sent; raises Refused as soon as it is more than any order, TimeoutError if it does not come."""
    sent = b""
    async with asyncio.timeout(BODY_S):  # a byte now and then would hold a connection for ever
        async for part in request.stream():
            sent += part
            if len(sent) > BODY_BYTES_MAX:
                raise Refused("order", expected=f"at most {BODY_BYTES_MAX} bytes", got="more")
    return sent


def _public(request: Request) -> bool:
    """Return whether findings of memory safety are kept back: from all who may only see."""
    return bool(request.state.role != "operator")


def _answer(code: int, message: str, *, accepted: bool = False) -> Response:
    text = msgspec.json.encode({"accepted": accepted, "message": message})
    return Response(text, code, media_type="application/json")
