"""What a binary says of its parameters: asked once over MAVLink, then remembered under the binary's digest."""

from __future__ import annotations

import logging
import os
import re
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import msgspec

from saflite.contract import wire
from saflite.contract.errors import Unavailable
from saflite.flight.mavlink.client import Client

log = logging.getLogger(__name__)

HEARTBEAT_S, ASK_S, AGAIN_S = 30.0, 30.0, 2.0  # simulated
PARAMETERS_MAX = 10_000
"""ArduCopter has some 1,400, PX4 as many."""
MISSED_MAX = 100
"""Of those asked for again; a vehicle that tells none of so many tells no others."""
_NAME = re.compile(r"[A-Za-z0-9_]{1,16}")
VERSION = 3


class Row(msgspec.Struct, frozen=True):
    """One parameter: its value before anything is set, and its MAV_PARAM_TYPE."""

    value: float
    kind: int


class Listing(msgspec.Struct, frozen=True, kw_only=True):
    """All parameters of a binary by name."""

    binary: str
    version: int = VERSION
    parameters: dict[str, Row]

    @property
    def values(self) -> dict[str, float]:
        """The value of each parameter before anything is set."""
        return {name: row.value for name, row in self.parameters.items()}

    @property
    def types(self) -> dict[str, int]:
        """The MAV_PARAM_TYPE of each parameter."""
        return {name: row.kind for name, row in self.parameters.items()}


def known(folder: Path, digest: str) -> Listing | None:
    """Return what `folder` remembers of the binary with this digest, None where it was never asked."""
    path = _file(folder, digest)
    found = _read(path, path.stat().st_mtime_ns) if path.is_file() else None
    return found if found is not None and found.binary == digest else None


def listed(client: Client) -> dict[str, Row]:
    """Return all parameters of the vehicle at the other end of a link; raises Unavailable if it does not tell them."""
    if not client.wait_for_heartbeat(HEARTBEAT_S):
        raise Unavailable(f"no heartbeat within {HEARTBEAT_S:.0f} simulated s")
    rows: dict[int, tuple[str, Row]] = {}
    count = 0

    def told(message: Any) -> bool:
        nonlocal count
        if message.get_type() == "PARAM_VALUE" and message.param_index < 65535:
            _check(message.param_id, message.param_count)
            count = message.param_count
            rows[message.param_index] = (message.param_id, _row(client, message))
        return 0 < count <= len(rows)

    client.mav.param_request_list_send(1, 1)
    client.wait(told, ASK_S)
    missed = 0
    for index in [index for index in range(count) if index not in rows]:
        client.mav.param_request_read_send(1, 1, b"", index)
        client.wait(told, AGAIN_S)
        missed += index not in rows
        if missed > MISSED_MAX:
            break
    if not count or len(rows) < count:
        raise Unavailable(f"told {len(rows)} of {count} parameters")
    return dict(sorted(rows.values()))


def _check(name: str, count: int) -> None:
    """Raise Unavailable for what no autopilot says: names go into files and variables, each of them is asked for."""
    if _NAME.fullmatch(name) is None:
        raise Unavailable(f"told a parameter by no name: {name[:80]!r}")
    if count > PARAMETERS_MAX:
        raise Unavailable(f"told of {count} parameters, more than {PARAMETERS_MAX}")


def _row(client: Client, message: Any) -> Row:
    return Row(client.decoded(message.param_value, message.param_type), int(message.param_type))


def _file(folder: Path, digest: str) -> Path:
    return folder / f"{digest[:32]}.json"


@cache
def _read(path: Path, changed_ns: int) -> Listing | None:
    try:
        found = wire.unpack_json(path.read_bytes(), Listing)
    except (*wire.UNREADABLE, OSError):
        return None
    return found if found.version == VERSION else None


def remember(folder: Path, found: Listing) -> None:
    """Keep what a binary said; where nothing can be kept, it is asked again next time."""
    path = _file(folder, found.binary)
    partial = path.with_suffix(f".{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(msgspec.json.encode(found))
        partial.replace(path)
    except OSError as fault:
        log.warning("what the autopilot says of its parameters is not kept (SAFLITE_CACHE names a place): %s", fault)
        with suppress(OSError):
            partial.unlink(missing_ok=True)
