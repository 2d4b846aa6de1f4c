"""Messages as bytes: MessagePack, validated on arrival with the path of the fault, unknown fields ignored."""

from __future__ import annotations

from functools import cache
from typing import Any, TypeVar

import msgspec

from saflite.contract.errors import Refused

MESSAGE_BYTES_MAX = 32 * 2**20

T = TypeVar("T")
_ENCODER = msgspec.msgpack.Encoder(order="deterministic")


@cache
def _decoder(kind: Any) -> Any:
    return msgspec.msgpack.Decoder(kind)


def encode(message: msgspec.Struct) -> bytes:
    """Return the message as MessagePack; equal messages give equal bytes."""
    return _ENCODER.encode(message)


def decode(data: bytes, kind: type[T]) -> T:
    """Return the message in `data`.

    Raises:
        Refused: `data` is too long, is no MessagePack, or does not fit `kind`; the text holds the path of the fault.
    """
    if len(data) > MESSAGE_BYTES_MAX:
        raise Refused(kind.__name__, expected=f"at most {MESSAGE_BYTES_MAX} bytes", got=f"{len(data)} bytes")
    hashable: Any = kind
    try:
        message: T = _decoder(hashable).decode(data)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as fault:
        raise Refused(kind.__name__, expected="a valid message", got=str(fault)) from fault
    return message
