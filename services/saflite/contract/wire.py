"""Messages as bytes: MessagePack, validated on arrival with the path of the fault, unknown fields ignored."""

from __future__ import annotations

import threading
from functools import cache
from typing import Any, TypeVar

import msgspec

from saflite.contract.errors import Refused

MESSAGE_BYTES_MAX = 32 * 2**20
UNREADABLE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
"""What decoders raise for bytes of others: not what was expected, no UTF-8, nested without end."""

T = TypeVar("T")
_LEARNING = threading.Lock()
_ENCODER = msgspec.msgpack.Encoder(order="deterministic")


@cache
def _made(make: Any, kind: Any) -> Any:
    return make(kind)


def _decoder(make: Any, kind: Any) -> Any:
    """Return a decoder of a type, made by one thread at a time.

    While msgspec learns a type for the first time it runs Python; another thread that meets the type half learnt
    then reads at address 0 (msgspec 0.22; `tests/unit/contract/test_threads.py`).
    """
    with _LEARNING:
        return _made(make, kind)


def encode(message: msgspec.Struct) -> bytes:
    """Return the message as MessagePack; equal messages give equal bytes."""
    return _ENCODER.encode(message)


def decode(data: bytes, kind: type[T]) -> T:
    """Return the message in `data`.

    Raises:
        Refused: `data` is too long, is no MessagePack, or does not fit `kind`; the text holds the path of the fault.
    """
    name = getattr(kind, "__name__", "message")
    if len(data) > MESSAGE_BYTES_MAX:
        raise Refused(name, expected=f"at most {MESSAGE_BYTES_MAX} bytes", got=f"{len(data)} bytes")
    hashable: Any = kind
    try:
        message: T = _decoder(msgspec.msgpack.Decoder, hashable).decode(data)
    except UNREADABLE as fault:
        raise Refused(name, expected="a valid message", got=str(fault)) from fault
    return message


def is_json(data: bytes) -> bool:
    """Return whether a message is a JSON object; none of ours in MessagePack begins so."""
    return data[:1] == b"{"


def encode_json(message: msgspec.Struct) -> bytes:
    """Return the message as JSON."""
    return msgspec.json.encode(message)


def decode_json(data: bytes, kind: type[T]) -> T:
    """Return the message in JSON `data`; raises Refused as `decode` does."""
    hashable: Any = kind
    try:
        message: T = _decoder(msgspec.json.Decoder, hashable).decode(data)
    except UNREADABLE as fault:
        raise Refused(kind.__name__, expected="a valid message", got=str(fault)) from fault
    return message


def checked(message: T, kind: Any) -> T:
    """Return a message as whoever it is sent to will read it; for what code from outside has made.

    Raises:
        Refused: it cannot be sent, or does not fit `kind`; the text holds the path of the fault.
    """
    try:
        data = _ENCODER.encode(message)
    except (UnicodeEncodeError, OverflowError, TypeError, RecursionError) as fault:
        name = getattr(kind, "__name__", type(message).__name__)
        raise Refused(name, expected="a message that can be sent", got=str(fault)) from fault
    read: T = decode(data, kind)
    return read
