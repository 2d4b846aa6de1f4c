"""Questions on Zenoh's bus: one that came and waits for its answer, and one that was asked."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Hashable
from functools import partial

import zenoh

from saflite.bus.access import split
from saflite.bus.base import Inbox, Reply, seal, unseal
from saflite.bus.sending import Senders

log = logging.getLogger(__name__)


class ZenohRequest:
    """A question that came over Zenoh; holding it keeps the asker waiting, also of a slow reader nobody else.

    What a name proven by a certificate is told, that nothing more comes included, is sent by the thread of that name.
    """

    def __init__(self, query: zenoh.Query, name: str, senders: Senders) -> None:
        self._query: zenoh.Query | None = query
        self._name, self._senders = name, senders
        self._asked = str(query.key_expr)
        self.peer, self.key = split(self._asked)
        self.payload = query.payload.to_bytes() if query.payload is not None else b""
        self.sender, self.damaged = unseal(self.key, attached(query), self.payload)

    def __del__(self) -> None:
        self._end(0, lambda _: None)  # its end is said to the asker, too

    def reply(self, payload: bytes) -> None:
        """Answer, once."""
        seal_of = seal(self.key, self._name, payload)
        # not express: what says that nothing more comes follows at once, and one packet carries both
        self._end(len(payload), lambda query: query.reply(self._asked, payload, attachment=seal_of, express=False))

    def refuse(self, text: str) -> None:
        """Answer that the question cannot be read."""
        self._end(len(text), lambda query: query.reply_err(text.encode()))

    def _end(self, size_bytes: int, say: Callable[[zenoh.Query], None]) -> None:
        query, self._query = self._query, None
        if query is None:
            return
        end = partial(end_of, query, say, self.key)
        if not self.peer:
            end()
        elif not self._senders.send(self.peer, size_bytes, end):
            log.info("answer on %s not delivered: %s does not read what it is told", self.key, self.peer)


def end_of(query: zenoh.Query, say: Callable[[zenoh.Query], None], key: str) -> None:
    """Say the last word to a question; an asker that is gone is no trouble of ours."""
    try:
        say(query)
        query.drop()  # type: ignore[no-untyped-call]
    except zenoh.ZError as fault:
        log.info("answer on %s not delivered: %s", key, fault)


class Question:
    """An `ask` under way: the first reply settles it, and so does Zenoh's word that none will come."""

    def __init__(self, tag: Hashable, inbox: Inbox) -> None:
        self._tag, self._inbox = tag, inbox
        self._settled = threading.Lock()

    def on_reply(self, reply: zenoh.Reply) -> None:
        """Take a reply (Zenoh's thread)."""
        sample = reply.ok
        if sample is not None:
            payload = sample.payload.to_bytes()
            _, damaged = unseal(split(str(sample.key_expr))[1], attached(sample), payload)
            self._settle(None if damaged else payload, "")
            return
        text = reply.err.payload.to_bytes().decode(errors="replace") if reply.err is not None else ""
        self._settle(None, "" if text == "Timeout" else text)

    def refuse(self, words: str) -> None:
        """Settle a question that cannot be sent."""
        self._settle(None, words)

    def on_drop(self) -> None:
        """Take note that no more replies come (Zenoh's thread)."""
        self._settle(None, "")

    def _settle(self, payload: bytes | None, refused: str) -> None:
        if self._settled.acquire(blocking=False):
            self._inbox(Reply(self._tag, payload, refused))


def attached(message: zenoh.Query | zenoh.Sample) -> bytes | None:
    """Return what travels beside a message."""
    return message.attachment.to_bytes() if message.attachment is not None else None
