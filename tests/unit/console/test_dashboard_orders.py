"""Orders to the dashboard that do not come whole."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest
from starlette.requests import Request

from saflite.console.view.dashboard import app


@pytest.mark.parametrize("then", ["gone", "silent"])
def test_an_order_that_does_not_come_is_a_word_and_no_fault(then: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who left while it was read had the server print a traceback, who said nothing held his connection for ever."""
    monkeypatch.setattr(app, "BODY_S", 0.01)
    told = list[Any]()
    parts = [{"type": "http.request", "body": b"{", "more_body": True}]
    parts += [{"type": "http.disconnect"}] * (then == "gone")

    async def receive() -> Any:
        if not parts:
            await asyncio.Event().wait()
        return parts.pop(0)

    async def send(message: Any) -> None:
        told.append(message)

    async def ask() -> None:
        site = app._Site([cast(Any, None)], 1.0, asyncio.Event())
        scope = {"type": "http", "method": "POST", "headers": [(b"x-saflite", b"1")], "path_params": {"run": "0"}}
        request = Request({**scope, "state": {"role": "operator"}}, receive)
        await (await site.order(request))(request.scope, receive, send)

    asyncio.run(ask())
    assert told[0]["status"] == 400
