"""How much of a ULog file the library may unfold and keep: a few bytes can ask for more than any memory holds."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

FIELDS_MAX = 500_000
"""Of all subscriptions of a log together; logs of flights have some thousand."""
NESTED_MAX = 16
KEPT_MAX, MESSAGES_MAX = 2**20, 2**25
_KEPT = frozenset(b"ACFILMOPQR")  # all kinds but data and marks
_KNOWN = _KEPT | frozenset(b"BDS")
_UNKNOWN_BYTES_MAX = 10_000  # of a message of a kind that the library does not know; a longer one it takes for damage


class TooMany(Exception):
    """More messages than any log has; no ValueError, after which the library reads on."""


def bounded() -> Any:
    """Return the reader for one log; it raises ValueError before the formats subscribed to unfold to too many fields.

    The library makes an object of each field of each subscription, arrays and formats in formats unfolded: six formats
    of a hundred each of the next are some 300 bytes and 10^12 fields. It keeps some 300 bytes for each message but
    those with data; of more than `KEPT_MAX` of them, or `MESSAGES_MAX` of any, TooMany is raised.
    """
    from pyulog import ULog

    left, kept, others = FIELDS_MAX, KEPT_MAX, MESSAGES_MAX

    class Header(ULog._MessageHeader):  # type: ignore[misc]  # the library has no types
        msg_size: int

        def initialize(self, data: bytes) -> None:
            nonlocal kept, others
            super().initialize(data)
            if self.msg_size > _UNKNOWN_BYTES_MAX and self.msg_type not in _KNOWN:
                self.msg_size = 0  # damage to the library, too, but it would read all of it and then go on one byte on
            if self.msg_type in _KEPT:
                kept -= 1
            others -= 1
            if kept < 0 or others < 0:
                raise TooMany(KEPT_MAX if kept < 0 else MESSAGES_MAX)

    class Subscription(ULog._MessageAddLogged):  # type: ignore[misc]  # the library has no types
        def _parse_format(self, formats: Mapping[str, Any]) -> None:
            nonlocal left
            left -= _fields(self.message_name, formats, ULog._UNPACK_TYPES, {})
            if left < 0:
                raise ValueError(f"formats that unfold to more than {FIELDS_MAX} fields")
            super()._parse_format(formats)

    return type("Bounded", (ULog,), {"_MessageAddLogged": Subscription, "_MessageHeader": Header})


def _fields(name: str, formats: Mapping[str, Any], plain: Container[str], known: dict[str, int], depth: int = 0) -> int:
    """Return how many fields a format unfolds to, one at least."""
    if depth > NESTED_MAX:
        raise ValueError(f"formats nested deeper than {NESTED_MAX}")
    if name not in known:
        known[name] = 1 + sum(
            max(1, many) * (1 if kind in plain else _fields(kind, formats, plain, known, depth + 1))
            for kind, many, _ in formats[name].fields
        )
    return known[name]
