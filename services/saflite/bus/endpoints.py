"""Endpoints: where a router listens and clients connect. Which of them others can reach, too."""

from __future__ import annotations

import ipaddress
import os
import re
import socket
from pathlib import Path
from typing import NamedTuple

from saflite.contract.errors import Refused

UNIX_PATH_BYTES_MAX = 107  # sockaddr_un
HOST_CHARS_MAX = 253  # RFC 1035
_LABEL = r"[A-Za-z0-9-]{1,63}"
_HOST = rf"(?:{_LABEL}\.)*{_LABEL}\.?"
_TCP = re.compile(rf"(?P<link>tcp|tls)/(?:\[(?P<six>[0-9A-Fa-f:.]+)\]|(?P<host>{_HOST})):(?P<port>\d{{1,5}})")
_UNIX = re.compile(r"unixsock-stream/(?P<path>[^?#]+)")
EXPECTED = "tls/HOST:PORT, tcp/HOST:PORT or unixsock-stream/PATH"


class Endpoint(NamedTuple):
    """A place to meet. `host` is empty for a Unix socket, `port` 0 then."""

    text: str
    host: str
    port: int

    @property
    def is_closed(self) -> bool:
        """Whether the system keeps other users out: on a Unix socket. Loopback is open to all users of the machine."""
        return not self.host

    @property
    def is_tls(self) -> bool:
        """Whether both ends prove who they are, and nobody between reads along."""
        return self.text.startswith("tls/")

    @property
    def from_here(self) -> str:
        """The endpoint at which a process of this machine reaches a router that listens here."""
        ip = _ip(self.host)
        if ip is None or not ip.is_unspecified:
            return self.text
        return f"{self.text.partition('/')[0]}/{'127.0.0.1' if ip.version == 4 else '[::1]'}:{self.port}"


def parse_endpoint(text: str, argument: str = "endpoint") -> Endpoint:
    """Return the endpoint `text` names; raises Refused for what is none."""
    if (unix := _UNIX.fullmatch(text)) is not None and text.isprintable():  # so no lone surrogate either
        path = str(Path(unix["path"]).absolute())
        if len(os.fsencode(path)) > UNIX_PATH_BYTES_MAX:
            raise Refused(argument, expected=f"a path of at most {UNIX_PATH_BYTES_MAX} bytes", got=path[:120])
        return Endpoint(f"unixsock-stream/{path}", "", 0)
    tcp = _TCP.fullmatch(text)
    host = (tcp["six"] or tcp["host"]) if tcp is not None else ""
    port = int(tcp["port"]) if tcp is not None else 0
    if tcp is None or not 1 <= port <= 65535 or len(host) > HOST_CHARS_MAX or (tcp["six"] and _ip(host) is None):
        raise Refused(argument, expected=EXPECTED, got=repr(text[:120]))
    return Endpoint(text, host, port)


def check_endpoint(text: str, *, insecure: bool, keys: bool = False, argument: str = "endpoint") -> Endpoint:
    """Return the endpoint; `keys` says whether there are any to prove oneself with.

    Raises:
        Refused: it needs keys, or others could reach it, too, and `insecure` does not allow that.
    """
    endpoint = parse_endpoint(text, argument)
    if endpoint.is_tls != keys:
        wanted, got = (
            (f"--keys FOLDER, with {text}", "none") if endpoint.is_tls else ("an endpoint tls/HOST:PORT", repr(text))
        )
        raise Refused("--keys" if endpoint.is_tls else argument, expected=wanted, got=got)
    if not endpoint.is_closed and not endpoint.is_tls and not insecure:
        raise Refused(
            argument,
            expected="a Unix socket: TCP, loopback included, is neither encrypted nor authenticated",
            got=repr(text),
            fix="leave it out for a private socket, use tls/HOST:PORT with --keys (see `saflite keys --help`), "
            "or add --insecure where everybody who reaches it may be trusted",
        )
    return endpoint


def free_endpoint() -> str:
    """Return an endpoint on the loopback interface whose port is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def _ip(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None
