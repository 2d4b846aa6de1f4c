"""How many connections a key may have at the router: Zenoh bounds those of all together, not those of a certificate.

Zenoh tells of each link whose certificate it showed and where it leads, and ends none. So what is too much is ended
below it: the connection is shut down, as if the other side had gone.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Collection, Iterable
from contextlib import suppress

from saflite.bus.links import SESSIONS_MAX
from saflite.bus.sockets import numbers, taken

LINKS_MAX = SESSIONS_MAX // 3  # of a key: more than a farm can have workers (1,000), and others have room besides

Address = tuple[str, int]


def surplus(links: Iterable[tuple[str, str]], most: int, none_of: Collection[str] = ()) -> dict[str, list[Address]]:
    """Return where the connections lead that are more than a key may have, by key.

    Args:
        links: common name of the certificate, empty without one, and the other end (`tls/HOST:PORT`) of each.
        most: how many each may have; those named first stay.
        none_of: keys that are to lose all of theirs.
    """
    counts: dict[str, int] = {}
    more: dict[str, list[Address]] = {}
    for shown, end in links:
        key = shown.partition("~")[0]
        counts[key] = counts.get(key, 0) + 1
        if key and (counts[key] > most or key in none_of):
            more.setdefault(key, []).append(_address(end))
    return more


def shut(ends: Collection[Address]) -> int:
    """Shut down this process's connections that lead to these ends; returns how many there were."""
    found = 0
    for number, _ in numbers() if ends else ():
        with suppress(OSError), taken(number) as connection:  # not connected, or closed meanwhile
            found += _shut_one(connection, ends)
    return found


def _shut_one(connection: socket.socket, ends: Collection[Address]) -> bool:
    if connection.family not in (socket.AF_INET, socket.AF_INET6):
        return False  # others have names of other shapes, or none
    host, port = connection.getpeername()[:2]
    leads_there = (str(ipaddress.ip_address(host.partition("%")[0])), port) in ends
    if leads_there:
        connection.shutdown(socket.SHUT_RDWR)
    return leads_there


def _address(end: str) -> Address:
    host, _, port = end.partition("/")[2].rpartition(":")
    return str(ipaddress.ip_address(host.strip("[]").partition("%")[0])), int(port)
