"""One after the other: processes that come to a router which lets few in at a time."""

from __future__ import annotations

import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from saflite.contract.config import cache_root
from saflite.contract.ids import short_id


@contextmanager
def in_turn(folder: Path) -> Iterator[None]:
    """Wait until no other process is in here with the same folder; the kernel ends the turn of one that dies.

    Raises:
        OSError: the folder cannot be made or opened.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


@contextmanager
def in_turn_to(endpoint: str) -> Iterator[None]:
    """Wait until no other process of this user on this machine is in here with the same endpoint.

    Whatever placed them (a launcher here, `saflite worker`, actors of Ray), they meet in this user's own folder; who
    can have none waits for nobody. Homes may be shared, and networks apart: who cannot reach a router must not hold up
    those of another machine or network who can.
    """
    network = ""
    with suppress(OSError):
        network = os.readlink("/proc/self/ns/net")
    group = short_id(f"{endpoint}\n{socket.gethostname()}\n{network}".encode())
    with ExitStack() as held:
        with suppress(OSError):
            held.enter_context(in_turn(cache_root() / "turns" / group))
        yield
