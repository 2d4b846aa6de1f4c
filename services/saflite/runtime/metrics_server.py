"""A small HTTP server for metrics, in the process that keeps the farm: strangers cost it no more than so many threads.

Whoever reaches the address can open connections and say nothing, or a byte now and then, for ever. Where there are too
many, the one that has been open longest is ended: an answer takes milliseconds.
"""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

CONNECTIONS_MAX = 16
SILENT_S = 10.0


class _Handler(WSGIRequestHandler):
    timeout = SILENT_S  # of each read and write

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 (as the class above names it)
        """Say nothing."""


class BoundedServer(ThreadingMixIn, WSGIServer):
    """Answers each connection in a thread of its own, at most `CONNECTIONS_MAX` at a time.

    Raises:
        OSError: the address is in use, or none of this machine.
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = 4 * CONNECTIONS_MAX

    def __init__(self, host: str, port: int) -> None:
        self._held: list[socket.socket] = []
        self._lock = threading.Lock()
        self.address_family, *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        super().__init__((host, port), _Handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Have a thread answer; end the connection that has been open longest where there are too many."""
        with self._lock:
            self._held.append(request)
            if len(self._held) > CONNECTIONS_MAX:
                with suppress(OSError):
                    self._held.pop(0).shutdown(socket.SHUT_RDWR)  # its thread closes it
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        with self._lock, suppress(ValueError):
            self._held.remove(request)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing: whoever asked has gone, or said nothing."""
