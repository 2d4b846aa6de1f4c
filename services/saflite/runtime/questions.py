"""Questions to the books as they come over the bus: read and held to their key, and answered in their form."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from saflite.bus.access import check_speaker
from saflite.bus.base import Request
from saflite.contract import wire
from saflite.contract.control import Answer, AnswerJson, Control
from saflite.contract.errors import Refused
from saflite.contract.events import Event
from saflite.contract.join import Join

T = TypeVar("T", bound=msgspec.Struct)


def encoded(request: Request, message: msgspec.Struct) -> bytes:
    """Return an answer in the form of its question; past events that are asked for in JSON are told in JSON."""
    if not wire.is_json(request.payload):
        return wire.encode(message)
    if isinstance(message, Answer):
        events = tuple(wire.decode(data, Event) for data in message.events)
        message = AnswerJson(accepted=message.accepted, message=message.message, status=message.status, events=events)
    return wire.encode_json(message)


def read(request: Request, kind: type[T], owner_of: Callable[[str], str | None]) -> T:
    """Return the message of a request; raises Refused unless it says what its key and the asker's certificate say.

    `owner_of` tells by which key a worker joined; whoever joins has not yet, and is held to the name alone.
    A question for work that came with a result has to be of the same worker and stage.
    """
    in_json = kind is Control and wire.is_json(request.payload)
    message = wire.decode_json(request.payload, kind) if in_json else wire.decode(request.payload, kind)
    place = request.key.rpartition("/")[2]
    said = getattr(message, "stage", getattr(message, "verb", place))
    if said != place:
        raise Refused("key", expected=f"one that ends in {said}, as the message says", got=place[:80])
    worker = getattr(message, "worker", request.peer)
    check_speaker(request.peer, worker, None if kind is Join else owner_of(worker))
    ask = getattr(message, "ask", None)
    if ask is not None and (ask.worker, ask.stage) != (worker, place):
        got = f"{ask.worker[:80]} for {ask.stage}"
        raise Refused("ask", expected=f"{worker} for {place}, as the result it came with", got=got)
    return message
