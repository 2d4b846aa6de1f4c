"""Connections to the dashboard: so many and no more, whoever holds them.

Whoever reaches the address can open one, before anybody asks who that is. One that says nothing for long is ended, and
where there are too many, the one that has waited longest: who has something to ask asks at once. Where none waits, the
oldest is ended, so that nobody keeps others out by streams and downloads that he leaves open.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict

from uvicorn.protocols.http.h11_impl import H11Protocol

CONNECTIONS_MAX = 200
"""Far fewer than the files a process may have open."""
BACKLOG = 100
"""Taken from the kernel at once, before any of them is looked at."""
SILENT_S = 10.0
"""From the connection to the end of the first request's head."""


def bounded(connections_max: int = CONNECTIONS_MAX, silent_s: float = SILENT_S) -> type[H11Protocol]:
    """Return the protocol of one server: its connections are bounded together."""
    held: OrderedDict[_Bounded, None] = OrderedDict()

    class Bounded(_Bounded):
        _held, _most, _silent_s = held, connections_max, silent_s

    return Bounded


class _Bounded(H11Protocol):
    _held: OrderedDict[_Bounded, None]
    _most: int
    _silent_s: float

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a connection, and end the one that has waited longest where there are too many."""
        super().connection_made(transport)
        self._held[self] = None
        self._silence = self.loop.call_later(self._silent_s, self._end_silent)
        if len(self._held) > self._most:
            oldest = next(iter(self._held))  # where all are answered: a page whose stream ends asks for it again
            waiting = next((one for one in self._held if not one.is_answering and one is not self), oldest)
            del self._held[waiting]
            waiting.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget it."""
        self._silence.cancel()
        self._held.pop(self, None)
        super().connection_lost(exc)

    @property
    def is_answering(self) -> bool:
        """Whether a request of it is being answered."""
        cycle = self.cycle
        return cycle is not None and not cycle.response_complete

    @property
    def _has_asked(self) -> bool:
        return self.cycle is not None

    def _end_silent(self) -> None:
        if not self._has_asked:
            self.transport.abort()
