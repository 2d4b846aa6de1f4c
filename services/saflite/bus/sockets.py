"""The sockets of this process, also those that Zenoh opened and tells nothing of."""

from __future__ import annotations

import os
import socket
import struct
import threading
from collections.abc import Collection, Iterator
from contextlib import suppress
from stat import S_ISSOCK

LOOK_S = 1.0  # a router gives no link up sooner after it was made: see `LINK_LEASE_MS`
_LINGER = struct.Struct("ii")


def numbers() -> Iterator[tuple[int, int]]:
    """Yield the number of every open socket of this process, and its inode."""
    for number in map(int, os.listdir("/proc/self/fd")):
        with suppress(OSError):  # closed meanwhile
            status = os.fstat(number)
            if S_ISSOCK(status.st_mode):  # a second number of a file of SQLite would end its locks
                yield number, status.st_ino


def taken(number: int) -> socket.socket:
    """Return a socket of this process under a number of its own, which its owner does not miss when it is closed."""
    return socket.socket(fileno=os.dup(number))


def end_at_once(before: Collection[int]) -> set[int]:
    """Have no connection of this process wait for its other end as it is closed; returns which were told so by now.

    Zenoh lets each wait for 10 s where something is still to be sent, and with it the thread that closes it (its issue
    2718). A router has two threads that read: one machine that goes without a word would stop everybody. What is still
    to be sent is sent by the kernel all the same.

    Args:
        before: inodes of those that were told so already.
    """
    told = set[int]()
    for number, inode in numbers():
        with suppress(OSError):
            if inode in before or _told(number):
                told.add(inode)
    return told


def _told(number: int) -> bool:
    with taken(number) as connection:
        waits, _ = _LINGER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size))
        if waits:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))
    return bool(waits)  # one that does not wait may be told to by Zenoh yet


def keep_ending_at_once(over: threading.Event) -> None:
    """Have this process's connections end at once from now on, until `over`."""

    def look() -> None:
        told = end_at_once(())
        while not over.wait(LOOK_S):
            told = end_at_once(told)

    threading.Thread(target=look, name="linger", daemon=True).start()
