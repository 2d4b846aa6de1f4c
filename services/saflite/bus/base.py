"""What every bus can do, in queue style: nothing is called back, happenings are put into an inbox.

A bus call never waits for the other side. Whatever comes of it later (a question, an answer, a fact, somebody's
presence) is given to the inbox handed in; the inbox only appends to a queue, because a reader that stalls inside a
bus callback loses data silently.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Hashable
from typing import NamedTuple, Protocol


class Reply(NamedTuple):
    """What came of a question, once per `ask`.

    `payload` None means nobody answered (no such service, it died, time is up): ask again, it never means "no work".
    `refused` holds the answerer's words where it could not read the question.
    """

    tag: Hashable
    payload: bytes | None
    refused: str = ""


class Sample(NamedTuple):
    """A fact that was announced."""

    key: str
    payload: bytes


class Presence(NamedTuple):
    """A liveliness token appeared or vanished."""

    key: str
    present: bool


class Request(Protocol):
    """A question waiting for its answer; may be kept and answered later (long poll), once."""

    @property
    def key(self) -> str:
        """The key it was asked on."""
        ...

    @property
    def payload(self) -> bytes:
        """The question, not decoded."""
        ...

    @property
    def sender(self) -> str:
        """The name the asking bus was opened with; not proven."""
        ...

    @property
    def peer(self) -> str:
        """The name the asker's certificate proves; empty where none is needed: it is the farm's own user."""
        ...

    @property
    def damaged(self) -> str:
        """In words, how the question differs from what was sent; empty if it arrived whole."""
        ...

    def reply(self, payload: bytes) -> None:
        """Answer. A second answer and an answer nobody waits for any more do no harm."""
        ...

    def refuse(self, text: str) -> None:
        """Say that the question cannot be read."""
        ...


Happening = Request | Reply | Sample | Presence
Inbox = Callable[[Happening], None]


class Bus(Protocol):
    """One participant's end of the bus. Used from one thread."""

    @property
    def name(self) -> str:
        """The name given to it; sent with each question."""
        ...

    def serve(self, pattern: str, inbox: Inbox) -> None:
        """Let questions on keys matching `pattern` arrive in `inbox` as `Request`."""
        ...

    def ask(self, key: str, payload: bytes, tag: Hashable, inbox: Inbox, timeout_s: float) -> None:
        """Ask a question; exactly one `Reply` with `tag` arrives in `inbox`, within `timeout_s`."""
        ...

    def announce(self, key: str, payload: bytes) -> None:
        """Publish a fact; late followers are given the recent past."""
        ...

    def tell(self, key: str, payload: Callable[[], bytes]) -> None:
        """Publish a fact to those who follow its key now; `payload` is only called if there are any."""
        ...

    def follow(self, pattern: str, inbox: Inbox) -> None:
        """Let facts on keys matching `pattern` arrive as `Sample`, recent past first; gaps and doubles may occur."""
        ...

    def appear(self, key: str) -> None:
        """Declare a liveliness token: it vanishes when this participant dies or leaves."""
        ...

    def watch(self, pattern: str, inbox: Inbox) -> None:
        """Let tokens matching `pattern` arrive as `Presence`, those already there first."""
        ...

    def renew(self) -> None:
        """Connect anew and declare again what was; where that fails, all stays as it is. May be called from any thread.

        For who is not answered any more: a link can look alive and carry nothing (Zenoh's issue 2806).
        """
        ...

    def close(self) -> None:
        """Leave; tokens vanish at once. Never hangs for longer than 3 s."""
        ...


def seal(key: str, name: str, payload: bytes) -> bytes:
    """Return what travels beside a message so that damage shows: a CRC-32 over key, sender and payload, the sender."""
    return b"%08x" % _checksum(key, name.encode(), payload) + name.encode()


def unseal(key: str, attachment: bytes | None, payload: bytes) -> tuple[str, str]:
    """Return the sender's name and, in words, how the message is damaged (empty if it is whole)."""
    if attachment is None:
        return "?", "message without a seal"
    name = attachment[_SEAL_DIGITS:]
    whole = attachment[:_SEAL_DIGITS] == b"%08x" % _checksum(key, name, payload)
    return name.decode(errors="replace"), "" if whole else "message damaged on its way"


_SEAL_DIGITS = 8


def _checksum(key: str, name: bytes, payload: bytes) -> int:
    return zlib.crc32(payload, zlib.crc32(b"%b\0%b" % (key.encode(), name)))


def matches(pattern: str, key: str) -> bool:
    """Return whether `key` lies in the set `pattern` names: `*` is one chunk, `**` any number of chunks."""
    return _chunks_match(pattern.split("/"), key.split("/"))


def _chunks_match(pattern: list[str], key: list[str]) -> bool:
    if not pattern:
        return not key
    if pattern[0] == "**":
        return any(_chunks_match(pattern[1:], key[start:]) for start in range(len(key) + 1))
    return bool(key) and pattern[0] in ("*", key[0]) and _chunks_match(pattern[1:], key[1:])
