"""All kinds of messages and files that are made wrong, and who is given them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Protocol, TypeVar

import numpy as np
from answers import LABELS, Answers
from files import KINDS as FILES
from files import Files
from mutations import Edit, changed, drawn, encoded, torn
from peer import TAGS, Peer, Said, read
from told import KINDS as TOLD
from told import Told
from works import STAGES, Works

from saflite.contract import topics, wire
from saflite.contract.errors import Refused

VALID_SHARE = 0.3  # sent as they are, so that the campaign goes on
TORN_SHARE = 0.05
UNREAD = 4  # read by the decoder alone, for each that is sent
LOOK_EVERY = 100
ROUND_SHORT = 3  # flights until there is the next round to propose
FILE = "file "


class Fuzzed(Protocol):
    """One kind of message and whoever is told it."""

    def step(self) -> int:
        """Say something; returns how many wrong messages that were. Raises what nobody may raise."""
        ...

    def close(self) -> None:
        """Check what is left behind."""
        ...


class Sayer(Fuzzed, Protocol):
    """A kind of which single messages can be said."""

    def say(self, edits: list[Edit]) -> None:
        """Say a message with certain places changed. Raises what nobody may raise."""
        ...


class Messages:
    """Messages of one kind to the books, from a valid peer."""

    def __init__(self, kind: str, rng: np.random.Generator) -> None:
        self.kind, self.rng, self.number = kind, rng, 0
        self._peer: Peer | None = None

    def step(self) -> int:
        """Say a valid message, or a wrong one."""
        self.number += 1
        self._peer = self._peer or self._new_peer()
        said = self._peer.valid(self.kind, self.number)
        if said is None:
            self.close()
            return 0
        wrong = self.rng.random() >= VALID_SHARE
        payload = encoded(drawn(said.message, self.rng)[0] if wrong else said.message)
        payload = torn(payload, self.rng) if wrong and self.rng.random() < TORN_SHARE else payload
        unread = self._unread(said) if wrong else 0
        self._say(said, payload, wrong=wrong)
        return int(wrong) + unread

    def _new_peer(self) -> Peer:
        record = "all" if self.kind == "Report recorded" else "violations"
        return Peer(record, ROUND_SHORT) if self.kind == "Report mutated" else Peer(record)

    def _unread(self, said: Said) -> int:
        """Have the decoder alone read wrong messages: it refuses most, and those cost the books no lease here."""
        kind = MESSAGES[self.kind.partition(" ")[0]]
        for _ in range(UNREAD):
            payload = encoded(drawn(said.message, self.rng)[0])
            with suppress(Refused):
                wire.decode(payload, kind)
        return UNREAD

    def say(self, edits: list[Edit]) -> None:
        """Say a message with certain places changed."""
        self._peer = self._peer or self._new_peer()
        said = self._peer.valid(self.kind, 0)
        assert said is not None, "a new campaign has ended"
        message = said.message
        for edit in edits:
            message = changed(message, edit)
        self._say(said, encoded(message), wrong=True)

    def _say(self, said: Said, payload: bytes, *, wrong: bool) -> None:
        assert self._peer is not None
        reply = self._peer.send(said.key, payload)
        if reply is not None and reply.payload is not None:
            read(said.key, reply.payload)
        if wrong:
            self._peer.settle(said)
        if self.number % LOOK_EVERY == 0:
            self._peer.books.validate()
            self._peer.look()

    def close(self) -> None:
        """End the campaign and look at what it left."""
        peer, self._peer = self._peer, None
        if peer is not None:
            peer.close()


def _maker(make: Callable[[str, np.random.Generator], T], name: str) -> Callable[[np.random.Generator], T]:
    return lambda rng: make(name, rng)


T = TypeVar("T", bound=Fuzzed)
MESSAGES = {row.message.__name__: row.message for row in topics.TOPICS if row.message is not None}
TO_BOOKS = (
    *("Join", "Ask", "Heartbeat", "Control", "BlobOpen", "BlobGet", "BlobPut"),
    *(f"Report {tag}" for tag in TAGS),
)
SAYERS: dict[str, Callable[[np.random.Generator], Sayer]] = {
    **{kind: _maker(Messages, kind) for kind in TO_BOOKS},
    **{f"told {kind}": _maker(Told, kind) for kind in TOLD},
    **{f"work {kind}": _maker(Works, kind) for kind in (*STAGES, "fly")},
}
KINDS: dict[str, Callable[[np.random.Generator], Fuzzed]] = {
    **SAYERS,
    **{f"answer {server}": _maker(Answers, server) for server in LABELS},
    **{f"{FILE}{kind}": _maker(Files, kind) for kind in FILES},
}
