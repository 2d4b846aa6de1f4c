"""Serving the dashboard: which runs, where it listens."""

from __future__ import annotations

import re
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from saflite.console.view import out
from saflite.contract.errors import Refused

if TYPE_CHECKING:
    from saflite.console.view.dashboard.access import Tokens
    from saflite.console.view.dashboard.source import Source

ENDPOINT = re.compile(r"(tcp|tls|unixsock-stream)/")
RUNS_MAX = 100
ENDING_S = 5
"""What is being asked of a farm or made of a page may take so long after Ctrl-C."""


def is_endpoint(text: str) -> bool:
    """Return whether an argument names an endpoint, not a folder."""
    return ENDPOINT.match(text) is not None


def run_folders(folder: Path) -> list[Path]:
    """Return the run folders meant by one: itself, or those in it, the newest 100; raises Refused if there are none."""
    from saflite.campaign.storage.store import store_file

    if store_file(folder).exists():
        return [folder]
    found = [path.parent for path in (store_file(one) for one in folder.glob("*/")) if path.exists()]
    if not found:
        raise Refused("run folder", where=str(folder), expected="a run, or a folder of runs", got="neither")
    return sorted(found, key=lambda path: store_file(path).stat().st_mtime)[-RUNS_MAX:]


def serve(sources: Sequence[Source], host: str, port: int, tokens: Tokens) -> int:
    """Serve until Ctrl-C; raises Refused where nobody can listen there."""
    import asyncio
    import logging

    import uvicorn

    from saflite.console.view.dashboard.app import application
    from saflite.console.view.dashboard.connections import BACKLOG, bounded

    ending = asyncio.Event()

    class Server(uvicorn.Server):
        """Ends the streams of open pages before it waits for their requests to end."""

        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            ending.set()
            logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)  # what is cut off now is no error
            await super().shutdown(sockets)

    listener = _listener(host, port)
    place = f"[{host}]" if ":" in host else host
    hint = "   open it with ?token=TOKEN" if tokens else ""
    out.line(f"dashboard  http://{place}:{listener.getsockname()[1]}/{hint}   (Ctrl-C ends it; runs go on)")
    out.flush()
    app = application(sources, tokens, ending=ending)
    # no proxy_headers: who asks is the address of the socket (`access.is_ours`), not what a header says of it
    # no warnings: they are of requests that are none, and whoever reaches the address can make any number of them
    config = uvicorn.Config(
        app,
        http=bounded(),
        backlog=BACKLOG,
        log_level="error",
        timeout_graceful_shutdown=ENDING_S,
        ws="none",
        proxy_headers=False,
    )
    try:
        Server(config).run(sockets=[listener])
    except KeyboardInterrupt:
        out.line()
    return 0


def _listener(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen()  # before the address is told: who reads it may connect at once
    except OSError as fault:
        listener.close()
        raise Refused("--port", expected="one that is free", got=f"{host}:{port}, {fault}") from fault
    return listener
