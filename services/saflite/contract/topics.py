"""THE table of topics: key, message types, delivery class, who publishes, who reads.

Keys are `saflite/2/{campaign}/...`. Delivery classes:

    leased      query with a long poll; work is handed out under a lease
    committed   query answered only after the books have committed
    announced   advanced publisher with history; the books can send it again from any sequence number
    alive       liveliness token, dropped when its session dies
    asked       query answered at once
    lossy       plain publication, may drop

Beside each message travels its seal, as Zenoh attachment: eight hexadecimal digits, the CRC-32 of key, a zero byte,
sender and payload, followed by the sender's name. The books refuse a question whose seal is missing or does not fit.
"""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import msgspec

from saflite.contract.control import Answer, Control
from saflite.contract.errors import Refused
from saflite.contract.events import Event
from saflite.contract.work import Ask, Grant, Heartbeat, Orders, Receipt, Report, Stage

PROTOCOL = 2
Delivery = Literal["leased", "committed", "announced", "alive", "asked", "lossy"]


class Topic(NamedTuple):
    """One row of the table. `answer` is None where nothing is answered."""

    pattern: str
    message: type[msgspec.Struct] | None
    answer: type[msgspec.Struct] | None
    delivery: Delivery
    publisher: str
    readers: str


TOPICS: tuple[Topic, ...] = (
    Topic("work/{stage}", Ask, Grant, "leased", "workers", "books"),
    Topic("result/{stage}", Report, Receipt, "committed", "workers", "books"),
    Topic("beat/{stage}", Heartbeat, Orders, "asked", "workers", "books"),
    Topic("control/{verb}", Control, Answer, "asked", "console", "books"),
    Topic("event/{kind}", Event, None, "announced", "books", "anyone"),
    Topic("alive/{stage}/{worker}", None, None, "alive", "workers", "books"),
)

STAGES: tuple[Stage, ...] = get_args(Stage)


def prefix(campaign: str) -> str:
    """Return the key all topics of a campaign begin with; raises Refused for a name Zenoh keys cannot hold."""
    if not campaign or not all(char.isalnum() or char in "-_." for char in campaign):
        raise Refused("campaign name", expected="letters, digits, '-', '_' or '.'", got=repr(campaign))
    return f"saflite/{PROTOCOL}/{campaign}"


def work(campaign: str, stage: Stage) -> str:
    """Return the key on which work of a stage is asked for."""
    return f"{prefix(campaign)}/work/{stage}"


def result(campaign: str, stage: Stage) -> str:
    """Return the key on which results of a stage are handed in."""
    return f"{prefix(campaign)}/result/{stage}"


def beat(campaign: str, stage: Stage) -> str:
    """Return the key on which workers of a stage send heartbeats."""
    return f"{prefix(campaign)}/beat/{stage}"


def control(campaign: str, verb: str) -> str:
    """Return the key on which an operator's order is given."""
    return f"{prefix(campaign)}/control/{verb}"


def event(campaign: str, kind: str) -> str:
    """Return the key on which facts of a kind are announced; `*` for all."""
    return f"{prefix(campaign)}/event/{kind}"


def alive(campaign: str, stage: str, worker: str) -> str:
    """Return the key of a worker's liveliness token."""
    return f"{prefix(campaign)}/alive/{stage}/{worker}"
