"""Messages as bytes: MessagePack, validated on arrival with the path of the fault, unknown fields ignored."""

from __future__ import annotations

import os
import threading
from typing import Any, TypeVar, overload

import msgspec

from saflite.contract.errors import Refused

MESSAGE_BYTES_MAX = 32 * 2**20
UNREADABLE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
"""What decoders raise for bytes of others: not what was expected, no UTF-8, nested without end."""

T = TypeVar("T")
_LEARNING = threading.Lock()
os.register_at_fork(  # a child must not inherit it held by a thread that it does not have
    before=_LEARNING.acquire, after_in_parent=_LEARNING.release, after_in_child=_LEARNING.release
)
_DECODERS: dict[tuple[Any, Any], Any] = {}
_ENCODER = msgspec.msgpack.Encoder(order="deterministic")


def _decoder(make: Any, kind: Any) -> Any:
    """Return a decoder of a type, made by one thread at a time.

    While msgspec learns a type for the first time it runs Python; another thread that meets the type half learnt
    then reads at address 0 (msgspec 0.22; `tests/unit/contract/test_threads.py`). So nothing else in the farm has
    msgspec learn a type: whoever reads or converts does it here.
    """
    known = _DECODERS.get((make, kind))
    if known is not None:
        return known
    with _LEARNING:
        return _DECODERS.setdefault((make, kind), make(kind))


@overload
def unpack(data: bytes, kind: type[T]) -> T: ...
@overload
def unpack(data: bytes, kind: Any) -> Any: ...
def unpack(data: bytes, kind: Any) -> Any:
    """Return what MessagePack `data` holds as a type; raises one of `UNREADABLE`. For bytes of our own."""
    return _decoder(msgspec.msgpack.Decoder, kind).decode(data)


@overload
def unpack_json(data: bytes | str, kind: type[T]) -> T: ...
@overload
def unpack_json(data: bytes | str, kind: Any) -> Any: ...
def unpack_json(data: bytes | str, kind: Any) -> Any:
    """Return what JSON `data` holds as a type; raises one of `UNREADABLE`."""
    return _decoder(msgspec.json.Decoder, kind).decode(data)


@overload
def convert(data: Any, kind: type[T], *, strict: bool = True) -> T: ...
@overload
def convert(data: Any, kind: Any, *, strict: bool = True) -> Any: ...
def convert(data: Any, kind: Any, *, strict: bool = True) -> Any:
    """Return plain data as a type; raises msgspec.ValidationError. Not `strict`: texts may stand for numbers."""
    _decoder(msgspec.msgpack.Decoder, kind)  # the type is learnt now
    return msgspec.convert(data, kind, strict=strict)


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
    try:
        return unpack(data, kind)
    except UNREADABLE as fault:
        raise Refused(name, expected="a valid message", got=str(fault)) from fault


def is_json(data: bytes) -> bool:
    """Return whether a message is a JSON object; none of ours in MessagePack begins so."""
    return data[:1] == b"{"


def encode_json(message: msgspec.Struct) -> bytes:
    """Return the message as JSON."""
    return msgspec.json.encode(message)


def decode_json(data: bytes, kind: type[T]) -> T:
    """Return the message in JSON `data`; raises Refused as `decode` does."""
    try:
        return unpack_json(data, kind)
    except UNREADABLE as fault:
        raise Refused(kind.__name__, expected="a valid message", got=str(fault)) from fault


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
