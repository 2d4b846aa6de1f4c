"""Who may see the dashboard, who may give orders: tokens by role; without them the user who serves it, and root.

Without tokens only this machine's own names are answered to, so that no page of another site reaches a run by a name
that it makes point here (DNS rebinding). Orders need a header that no form of another site can send.
"""

from __future__ import annotations

import hmac
import ipaddress
import os
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Literal

from saflite.contract.errors import Refused
from saflite.contract.outside import read_text

Role = Literal["viewer", "operator"]
Tokens = Mapping[str, Role]
TOKEN_LENGTH_MIN = 16
COOKIE, ORDER_HEADER = "saflite", "x-saflite"
OWN_NAMES = ("localhost", "127.0.0.1", "[::1]")


def read_tokens(path: Path) -> dict[str, Role]:
    """Return the tokens in a file, one a line, `viewer` before one that may give no orders.

    Raises:
        Refused: there is no such file, it has no token, or one is shorter than 16 characters.
    """
    found: dict[str, Role] = {}
    for line in read_text(path, "tokens").splitlines():
        words = line.split()
        if not words or line.startswith("#"):
            continue
        role: Role = "viewer" if words[0] == "viewer" and len(words) == 2 else "operator"
        if len(words) > 2 or (len(words) == 2 and words[0] not in ("viewer", "operator")):
            raise Refused("tokens", where=str(path), expected="`viewer TOKEN` or `operator TOKEN` a line", got="others")
        if len(words[-1]) < TOKEN_LENGTH_MIN:
            expected = f"{TOKEN_LENGTH_MIN} characters or more"
            raise Refused("token", where=str(path), expected=expected, got=f"{len(words[-1])}")
        found[words[-1]] = role
    if not found:
        fix = "openssl rand -hex 16 > FILE makes one"
        raise Refused("tokens", where=str(path), expected="a token a line", got="none", fix=fix)
    return found


def check_address(host: str, tokens: Tokens) -> None:
    """Raise Refused for an address that others can reach without a token being asked for."""
    if not tokens and not is_loopback(host):
        fix = "--tokens FILE, a token a line (openssl rand -hex 16 > FILE)"
        raise Refused("--host", expected="a loopback address, or tokens", got=host, fix=fix)


def is_loopback(host: str) -> bool:
    """Return whether only this machine reaches an address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def is_ours(host: str, port: int) -> bool:
    """Return whether the socket of this machine at an address is this user's or root's, as the kernel lists it."""
    table, family = ("tcp6", socket.AF_INET6) if ":" in host else ("tcp", socket.AF_INET)
    try:
        words = socket.inet_pton(family, host)
        lines = Path(f"/proc/net/{table}").read_text(encoding="ascii").splitlines()[1:]
    except OSError:
        return False
    place = "".join(words[at : at + 4][::-1].hex() for at in range(0, len(words), 4)).upper()
    owners = {int(fields[7]) for fields in map(str.split, lines) if fields[1] == f"{place}:{port:04X}"}
    return bool(owners) and owners <= {os.getuid(), 0}


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
