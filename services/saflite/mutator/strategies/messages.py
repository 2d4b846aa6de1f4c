"""Serial messages, well formed and not: numbers from the protocol's table; payloads of the right size, short, long.

For targets that take `MSP`, `MSP2` (a number, then payload bytes) and `SERIAL_BYTES` as commands; frames sent as bytes
have some of them changed. A message that was part of a violation is drawn less often from then on.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import ClassVar, NamedTuple

import msgspec
import numpy as np

from saflite.contract.errors import Refused
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Origin, Stimulus, TestCase
from saflite.contract.work import Outcome
from saflite.mutator.strategy import Chosen, Option, Options, Proposes, Settings

TABLE = Path(__file__).parent.parent / "data" / "msp_messages.csv"
VERSION_1, VERSION_2, RAW = "MSP", "MSP2", "SERIAL_BYTES"
VERSION_1_MAX, PAYLOAD_1_MAX, PAYLOAD_2_MAX = 255, 255, 600
SIZES = (0, 1, 2, 3, 4, 5, 6, 8, 9, 12, 16, 20, 24, 32, 48, 64, 96, 128, 192, 193, 224, 255)
EDGES = (0, 1, 2, 127, 128, 254, 255)
FOUND_WEIGHT = 0.3
WEIGHT_MIN = 1e-9  # what was found a thousand times can still be drawn, so that there is always something to draw
GAP_S = 0.1
Rng = np.random.Generator


class Message(NamedTuple):
    """One row of the table; `size` is -1 where it is not known."""

    number: int
    name: str
    role: str
    size: int


@cache
def message_table() -> tuple[Message, ...]:
    """Return the messages of the protocol."""
    with TABLE.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return tuple(
        Message(int(row["number"]), row["name"], row["role"], int(row["bytes"]) if row["bytes"] else -1) for row in rows
    )


class Strategy:
    """Draws every test case anew; what it learns is which messages were part of a violation."""

    proposes: ClassVar[Proposes] = "stimuli"
    options: ClassVar[Options] = {
        "messages_max": Option(4, "greatest number of messages in a test case", 1, 50),
        "sets": Option(0.8, "share of messages that set something", 0, 1),
        "havoc": Option(0.15, "share of frames sent as bytes with some of them changed", 0, 1),
        "second": Option(0.3, "share of messages framed as version 2", 0, 1),
        "start_s": Option(0.2, "time of the first message", 0, 60),
        "never": Option([68.0, 250.0], "numbers that are never sent: restart, save"),
    }

    def __init__(self, template: TestCase, settings: Settings, policies: tuple[str, ...], target: TargetInfo) -> None:
        """Read the settings; raises Refused for a bad one, or a target that takes no messages."""
        self._chosen = Chosen(settings, self.options)
        if template.scenario.start is None:
            raise Refused("strategy", expected="a campaign with a start state", got="none")
        takes = {entry.name for entry in target.inputs if entry.kind == "command"}
        if VERSION_1 not in takes:
            raise Refused("strategy", expected="a target that takes MSP messages", got=f"{target.name}, which does not")
        self._template = template
        never = set(self._chosen.numbers("never"))
        self._messages = tuple(row for row in message_table() if row.number not in never)
        if len({row.role == "set" for row in self._messages}) < 2:
            expected = "messages left that set something, and others"
            raise Refused("strategy setting never", expected=expected, got=f"{len(never)} numbers")
        self._weights = {row.number: 1.0 for row in self._messages}

    def tell(self, outcomes: Sequence[Outcome]) -> None:
        """Draw what was part of a violation less often."""
        for outcome in outcomes:
            if outcome.violated:
                for stimulus in outcome.test_case.stimuli:
                    number = int(stimulus.values[0]) if stimulus.values else -1
                    if stimulus.name != RAW and number in self._weights:
                        self._weights[number] = max(WEIGHT_MIN, FOUND_WEIGHT * self._weights[number])

    def ask(self, count: int, rng: Rng) -> list[TestCase]:
        """Return `count` fresh sequences of messages."""
        return [self._one(rng) for _ in range(count)]

    def _one(self, rng: Rng) -> TestCase:
        at_s, stimuli = self._chosen.real("start_s"), []
        for _ in range(int(rng.integers(1, self._chosen.whole("messages_max") + 1))):
            stimuli.append(msgspec.structs.replace(self._stimulus(rng), at_s=round(at_s, 3)))
            at_s += GAP_S
        origin = Origin(strategy="messages", note="fresh")
        return msgspec.structs.replace(self._template, stimuli=tuple(stimuli), origin=origin)

    def _stimulus(self, rng: Rng) -> Stimulus:
        role = "set" if rng.random() < self._chosen.real("sets") else "other"
        rows = [row for row in self._messages if (row.role == "set") == (role == "set")]
        weights = np.array([self._weights[row.number] for row in rows])
        message = rows[int(rng.choice(len(rows), p=weights / weights.sum()))]
        payload = _payload(rng, message)
        if rng.random() < self._chosen.real("havoc"):
            return Stimulus(at_s=0.0, kind="command", name=RAW, values=_numbers(_havoc(rng, _frame(message, payload))))
        second = message.number > VERSION_1_MAX or rng.random() < self._chosen.real("second")
        kept = payload if second else payload[:PAYLOAD_1_MAX]
        name = VERSION_2 if second else VERSION_1
        return Stimulus(at_s=0.0, kind="command", name=name, values=(float(message.number), *_numbers(kept)))


def _payload(rng: Rng, message: Message) -> bytes:
    size = message.size if message.size >= 0 and rng.random() < 0.6 else int(rng.choice(SIZES))
    if rng.random() < 0.1:
        size = int(rng.integers(0, PAYLOAD_2_MAX))
    ways = (
        lambda: rng.integers(0, 256, size),
        lambda: rng.choice(EDGES, size),
        lambda: rng.integers(0, 6, size),
        lambda: np.full(size, rng.choice(EDGES)),
    )
    return bytes(int(byte) for byte in ways[int(rng.integers(len(ways)))]())


def _frame(message: Message, payload: bytes) -> bytes:
    """Return a version 1 frame; its length byte wraps where the payload is too long for one."""
    body = bytes((len(payload) & 255, message.number & 255)) + payload
    total = 0
    for byte in body:
        total ^= byte
    return b"$M<" + body + bytes((total,))


def _havoc(rng: Rng, data: bytes) -> bytes:
    """Return bytes with a few of them changed, put in, taken out, or the end cut off."""
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        at, byte, way = int(rng.integers(len(changed) + 1)), int(rng.integers(256)), int(rng.integers(4))
        if way == 0:
            changed[at : at + 1] = bytes((byte,))
        elif way == 1:
            changed[at:at] = bytes((byte,)) * int(rng.integers(1, 40))
        elif way == 2:
            del changed[at : at + 1]
        elif len(changed) > 6:
            del changed[at:]
        changed = changed or bytearray(b"$")
    return bytes(changed)


def _numbers(data: bytes) -> tuple[float, ...]:
    return tuple(float(byte) for byte in data)
