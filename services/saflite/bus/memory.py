"""The bus in memory, on a virtual clock: one thread, deterministic, stepped by whoever owns the time.

Carries bytes only, so every message is really encoded. Nothing is delivered inside a call: each hop is a delivery
with a due time, taken out in order by `MemoryNetwork.step`.
"""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Hashable
from typing import Literal

from saflite.bus.base import Inbox, Presence, Reply, Request, Sample, matches

Hop = Literal["question", "answer", "fact", "presence"]
HISTORY = 1000  # facts per key kept for late followers, as the Zenoh bus keeps them


class MemoryNetwork:
    """All participants, what is under way between them, and the virtual time."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._members: dict[str, MemoryBus] = {}
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._count = 0
        self._history: dict[str, deque[bytes]] = {}

    def connect(self, name: str) -> MemoryBus:
        """Return a new participant's bus; a name may be used again after `close` or `crash`."""
        assert name not in self._members, f"{name} is already on the bus"
        bus = self._members[name] = MemoryBus(name, self)
        return bus

    def crash(self, name: str) -> None:
        """Take a participant away as a kill does: nothing it held answers any more, its tokens vanish."""
        member = self._members.get(name)
        if member is not None:
            member.close()

    def step(self) -> bool:
        """Make the next delivery and move the clock to it; False if nothing is under way."""
        if not self._due:
            return False
        due_s, _, action = heapq.heappop(self._due)
        self.now_s = max(self.now_s, due_s)
        action()
        return True

    def run_until(self, until_s: float) -> None:
        """Make every delivery due up to `until_s` and set the clock to it."""
        while self._due and self._due[0][0] <= until_s:
            self.step()
        self.now_s = max(self.now_s, until_s)

    def later(self, delay_s: float, action: Callable[[], None]) -> None:
        """Run `action` after `delay_s` of virtual time."""
        self._count += 1
        heapq.heappush(self._due, (self.now_s + delay_s, self._count, action))

    def send(self, hop: Hop, source: str, destination: str, action: Callable[[], None]) -> None:
        """Bring one message from one participant to another, as often and as late as `delays_s` says."""
        for delay_s in self.delays_s(hop, source, destination):
            self.later(delay_s, action)

    def delays_s(self, hop: Hop, source: str, destination: str) -> tuple[float, ...]:
        """Return after what delays the message arrives: once and at once here; the faulty network knows others."""
        return (0.0,)

    def members(self) -> list[MemoryBus]:
        """Return the participants, in the order they came."""
        return list(self._members.values())

    def server_of(self, key: str) -> MemoryBus | None:
        """Return who serves `key`, None if nobody does."""
        return next((member for member in self._members.values() if member.inbox_for(key) is not None), None)

    def is_member(self, bus: MemoryBus) -> bool:
        """Return whether `bus` is still on the network."""
        return self._members.get(bus.name) is bus

    def leave(self, bus: MemoryBus) -> None:
        """Take `bus` off the network."""
        if self.is_member(bus):
            del self._members[bus.name]

    def remember(self, key: str, payload: bytes) -> None:
        """Keep a fact for late followers."""
        self._history.setdefault(key, deque(maxlen=HISTORY)).append(payload)

    def past(self, pattern: str) -> list[Sample]:
        """Return the facts kept on keys matching `pattern`."""
        return [Sample(key, fact) for key, facts in self._history.items() if matches(pattern, key) for fact in facts]


class MemoryRequest:
    """A question in memory."""

    damaged = ""

    def __init__(self, key: str, payload: bytes, sender: str, answer: Callable[[bytes | None, str], None]) -> None:
        self.key, self.payload, self.sender = key, payload, sender
        self.peer = ""
        self._answer = answer

    def reply(self, payload: bytes) -> None:
        """Send the answer on its way."""
        assert isinstance(payload, bytes), "the bus carries bytes"
        self._answer(payload, "")

    def refuse(self, text: str) -> None:
        """Send a refusal on its way."""
        self._answer(None, text)


class _Question:
    """An `ask` under way: whichever comes first, an answer or the end of its time, settles it."""

    def __init__(self, tag: Hashable, inbox: Inbox) -> None:
        self._tag, self._inbox, self._settled = tag, inbox, False

    def settle(self, payload: bytes | None, refused: str = "") -> None:
        """Hand the reply over, once."""
        if not self._settled:
            self._settled = True
            self._inbox(Reply(self._tag, payload, refused))


class MemoryBus:
    """One participant's end of the bus in memory."""

    def __init__(self, name: str, network: MemoryNetwork) -> None:
        self.name = name
        self._network = network
        self._served: list[tuple[str, Inbox]] = []
        self._followed: list[tuple[str, Inbox]] = []
        self._watched: list[tuple[str, Inbox]] = []
        self._tokens: list[str] = []

    def serve(self, pattern: str, inbox: Inbox) -> None:
        """See `Bus.serve`."""
        self._served.append((pattern, inbox))

    def inbox_for(self, key: str) -> Inbox | None:
        """Return where questions on `key` go, None if this participant does not serve it."""
        return next((inbox for pattern, inbox in self._served if matches(pattern, key)), None)

    def ask(self, key: str, payload: bytes, tag: Hashable, inbox: Inbox, timeout_s: float) -> None:
        """See `Bus.ask`."""
        assert isinstance(payload, bytes), "the bus carries bytes"
        question = _Question(tag, self._mine(inbox))
        self._network.later(timeout_s, lambda: question.settle(None))
        server = self._network.server_of(key)
        if server is None:
            self._network.later(0.0, lambda: question.settle(None))
            return

        def answer(data: bytes | None, refused: str) -> None:
            if self._network.is_member(server):
                self._network.send("answer", server.name, self.name, lambda: question.settle(data, refused))

        def arrive() -> None:
            target = server.inbox_for(key) if self._network.is_member(server) else None
            if target is not None:
                target(MemoryRequest(key, payload, self.name, answer))

        self._network.send("question", self.name, server.name, arrive)

    def announce(self, key: str, payload: bytes) -> None:
        """See `Bus.announce`."""
        assert isinstance(payload, bytes), "the bus carries bytes"
        self._network.remember(key, payload)
        for member in self._network.members():
            for inbox in member.followers(key):
                deliver = _delivery(inbox, Sample(key, payload))
                self._network.send("fact", self.name, member.name, deliver)

    def tell(self, key: str, payload: Callable[[], bytes]) -> None:
        """See `Bus.tell`."""
        inboxes = [(member, inbox) for member in self._network.members() for inbox in member.followers(key)]
        data = payload() if inboxes else b""
        for member, inbox in inboxes:
            self._network.send("fact", self.name, member.name, _delivery(inbox, Sample(key, data)))

    def followers(self, key: str) -> list[Inbox]:
        """Return the inboxes of this participant that follow `key`."""
        return [self._mine(inbox) for pattern, inbox in self._followed if matches(pattern, key)]

    def follow(self, pattern: str, inbox: Inbox) -> None:
        """See `Bus.follow`."""
        self._followed.append((pattern, inbox))
        for sample in self._network.past(pattern):
            self._network.later(0.0, _delivery(self._mine(inbox), sample))

    def appear(self, key: str) -> None:
        """See `Bus.appear`."""
        self._tokens.append(key)
        self._tell(key, True)

    def watch(self, pattern: str, inbox: Inbox) -> None:
        """See `Bus.watch`."""
        self._watched.append((pattern, inbox))
        for member in self._network.members():
            for key in member.tokens(pattern):
                self._network.later(0.0, _delivery(self._mine(inbox), Presence(key, True)))

    def tokens(self, pattern: str) -> list[str]:
        """Return this participant's tokens matching `pattern`."""
        return [key for key in self._tokens if matches(pattern, key)]

    def watchers(self, key: str) -> list[Inbox]:
        """Return the inboxes of this participant that watch `key`."""
        return [self._mine(inbox) for pattern, inbox in self._watched if matches(pattern, key)]

    def renew(self) -> None:
        """See `Bus.renew`: nothing is connected here."""

    def close(self) -> None:
        """See `Bus.close`."""
        tokens, self._tokens = self._tokens, []
        self._network.leave(self)
        for key in tokens:
            self._tell(key, False)

    def _tell(self, key: str, present: bool) -> None:
        for member in self._network.members():
            for inbox in member.watchers(key):
                deliver = _delivery(inbox, Presence(key, present))
                self._network.send("presence", self.name, member.name, deliver)

    def _mine(self, inbox: Inbox) -> Inbox:
        """Return `inbox` guarded: the dead receive nothing."""

        def guarded(happening: Request | Reply | Sample | Presence) -> None:
            if self._network.is_member(self):
                inbox(happening)

        return guarded


def _delivery(inbox: Inbox, happening: Sample | Presence) -> Callable[[], None]:
    return lambda: inbox(happening)
