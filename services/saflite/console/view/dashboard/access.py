"""Who may see the dashboard, who may give orders: tokens by role; without them the user who serves it, and root.

Without tokens only this machine's own names are answered to, so that no page of another site reaches a run by a name
that it makes point here (DNS rebinding). Orders need a header that no form of another site can send.
"""

from __future__ import annotations

import hmac
import ipaddress
import os
import socket
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from saflite.contract.errors import Refused
from saflite.contract.outside import read_text

Role = Literal["viewer", "operator"]
Tokens = Mapping[str, Role]
Address = tuple[str, int]
TOKEN_LENGTH_MIN = 16
MADE_BY = "(umask 077; openssl rand -hex 16 > FILE)"
COOKIE, ORDER_HEADER = "saflite", "x-saflite"
ESTABLISHED = "01"
"""The state of a connection that both ends hold, as /proc/net/tcp has it."""
OWN_NAMES = ("localhost", "127.0.0.1", "[::1]")


def read_tokens(path: Path) -> dict[str, Role]:
    """Return the tokens in a file, one a line, `viewer` before one that may give no orders.

    Raises:
        Refused: there is no such file, others can read it, it has no token, or one is shorter than 16 characters
            or not ASCII.
    """
    found: dict[str, Role] = {}
    for line in read_text(path, "tokens", private=True).splitlines():
        words = line.split()
        if not words or line.startswith("#"):
            continue
        role: Role = "viewer" if words[0] == "viewer" and len(words) == 2 else "operator"
        if len(words) > 2 or (len(words) == 2 and words[0] not in ("viewer", "operator")):
            raise Refused("tokens", where=str(path), expected="`viewer TOKEN` or `operator TOKEN` a line", got="others")
        if len(words[-1]) < TOKEN_LENGTH_MIN:
            expected = f"{TOKEN_LENGTH_MIN} characters or more"
            raise Refused("token", where=str(path), expected=expected, got=f"{len(words[-1])}")
        if not words[-1].isascii() or not words[-1].isprintable():  # no cookie or header holds another
            raise Refused("token", where=str(path), expected="printable ASCII", got="other characters")
        found[words[-1]] = role
    if not found:
        fix = f"`{MADE_BY}` makes one"
        raise Refused("tokens", where=str(path), expected="a token a line", got="none", fix=fix)
    return found


def check_address(host: str, tokens: Tokens) -> None:
    """Raise Refused for an address that others can reach without a token being asked for."""
    if not tokens and not is_loopback(host):
        fix = f"--tokens FILE, a token a line: `{MADE_BY}` makes one"
        raise Refused("--host", expected="a loopback address, or tokens", got=host, fix=fix)


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_ours(client: Address, server: Address) -> bool:
    """Return whether this user or root holds the socket of this machine that asks, as the kernel lists it."""
    table = "tcp6" if ":" in client[0] else "tcp"
    try:
        lines = Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:]
        found = owners(lines, client, server)
    except OSError:
        return False
    return bool(found) and found <= {os.getuid(), 0}


def owners(lines: Sequence[str], client: Address, server: Address) -> set[int]:
    """Return the users who hold a connection from `client` to `server`, by lines of /proc/net/tcp or tcp6.

    A socket that is closed, or has no inode, is held by nobody: the kernel lists it under user 0, whoever had it.
    Connections to other places may share the client's address. Raises OSError for a host that is no address.
    """
    ends = [_listed(*client), _listed(*server)]
    rows = (fields for fields in map(str.split, lines) if fields[1:3] == ends)
    return {int(fields[7]) for fields in rows if fields[3] == ESTABLISHED and fields[9] != "0"}


def _listed(host: str, port: int) -> str:
    """Return an address as the kernel lists it: words of four bytes, the last byte first."""
    words = socket.inet_pton(socket.AF_INET6 if ":" in host else socket.AF_INET, host)
    place = "".join(words[at : at + 4][::-1].hex() for at in range(0, len(words), 4)).upper()
    return f"{place}:{port:04X}"


def role_of(tokens: Tokens, host_header: str, given: str) -> Role | None:
    """Return what somebody may do, None for nothing: by the token given, without tokens by the name asked for."""
    if not tokens:
        name = host_header.rpartition(":")[0] if not host_header.endswith("]") and ":" in host_header else host_header
        return "operator" if name in OWN_NAMES else None
    found: Role | None = None
    for token, role in tokens.items():  # all are compared: time tells nothing
        if hmac.compare_digest(token.encode(), given.encode()):
            found = role
    return found
