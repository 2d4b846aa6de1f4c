"""A bridge whose farm is elsewhere: one thread fetches events as they come, another has the receiver take them.

Neither waits for the other. What was fetched waits on disk (`runtime/waiting_events.py`), so that the farm may end
while the receiver is away, and the receiver be told by another bridge once this one has ended.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import msgspec

from saflite.console.run_data.embargo import ToldFaults, for_others
from saflite.contract.cloud_event import told_as
from saflite.contract.errors import FarmError, Unavailable
from saflite.contract.events import Event, ViolationFound
from saflite.runtime.client import ANSWER_S, FarmClient
from saflite.runtime.clock import WallClock
from saflite.runtime.waiting_events import WaitingEvents
from saflite.runtime.webhook import Cursor, WaitingClock, Webhook, read_cursor

AWAY_S = 1.0  # between looks for a farm that is away
DRAIN_S = 0.2  # between looks whether all was taken
LEAVE_S = 1.0  # how long an answer of the receiver is waited for at the end
RECEIVER_S = 300.0  # how long a receiver that takes nothing is waited for once the campaign has ended


class Bridge(NamedTuple):
    """What goes where: the kinds of events told (all if empty), the receiver, and the file that says how far it is.

    Once the campaign has ended, a receiver that takes nothing for `receiver_s` is not waited for any longer.
    """

    kinds: frozenset[str]
    webhook: Webhook
    cursor_file: Path
    receiver_s: float = RECEIVER_S


class Stopped(FarmError):
    """Whoever waits need not go on."""


class StoppableClock(WallClock):
    """The machine's time; who waits by it is woken for good by `stop`."""

    def __init__(self) -> None:
        self._stopped = threading.Event()

    def stop(self) -> None:
        """Wake who waits, now and later."""
        self._stopped.set()

    def sleep_s(self, duration_s: float) -> None:
        """Wait; raises Stopped once it was stopped."""
        if self._stopped.wait(duration_s):
            raise Stopped

    def wait_s(self, ended: threading.Event, duration_s: float) -> None:
        """Wait for something to end, at most so long."""
        ended.wait(duration_s)


class GivenUp(FarmError):
    """The campaign has ended and the receiver took nothing for too long."""


class PatientClock:
    """A clock; who waits by it for a receiver does so without end until the campaign has ended, and then for a while.

    `at_end` returns the last event that was taken, None before the campaign's end.
    """

    def __init__(self, clock: WaitingClock, at_end: Callable[[], int | None], patience_s: float) -> None:
        self._clock, self._at_end, self._patience_s = clock, at_end, patience_s
        self._at: int | None = None
        self._since_s = 0.0

    def monotonic_s(self) -> float:
        """Return seconds since some start."""
        return self._clock.monotonic_s()

    def unix_s(self) -> float:
        """Return seconds since 1970."""
        return self._clock.unix_s()

    def sleep_s(self, duration_s: float) -> None:
        """Wait, no longer than patience lasts; raises GivenUp where it is at its end."""
        at, now_s = self._at_end(), self.monotonic_s()
        if at is None or at != self._at:
            self._at, self._since_s = at, now_s
        left_s = float("inf") if at is None else self._since_s + self._patience_s - now_s
        if left_s <= 0.0:
            raise GivenUp
        self._clock.sleep_s(min(duration_s, left_s))


def relay(
    connect: Callable[[], FarmClient],
    bridge: Bridge,
    clock: StoppableClock,
    say: Callable[[str], None],
    patience_s: float,
) -> None:
    """Fetch and deliver until the campaign has ended and all is taken.

    Raises:
        Refused: the receiver or the farm will never do.
        Unavailable: neither has the farm answered nor the receiver taken anything for `patience_s`, or the campaign has
            ended and the receiver took nothing for as long as the bridge waits for it.
    """
    waiting, over, faults = WaitingEvents(bridge.cursor_file, bridge.kinds), False, ToldFaults()
    try:
        for event in waiting.kept():
            faults.take(event)
        with _Delivery(bridge.webhook, waiting, faults, clock) as delivery:
            _Fetching(connect, bridge, waiting, faults, delivery, clock, say).run(patience_s)
            ended_s = clock.monotonic_s()
            while waits := waiting.waits:
                delivery.check()
                if clock.monotonic_s() - max(ended_s, delivery.took_s) >= bridge.receiver_s:
                    raise Unavailable(untaken(waits, bridge, f"wait in {waiting.file}"))
                clock.wait_s(delivery.ended, DRAIN_S)
        over = True
    finally:
        waiting.close(over=over)


def untaken(count: int, bridge: Bridge, kept: str) -> str:
    """Return in words that a receiver was given up; `kept` says where what it did not take is."""
    cursor = read_cursor(bridge.cursor_file)
    events = "1 event" if count == 1 else f"{count} events"
    return (
        f"the campaign has ended and the receiver took nothing for {bridge.receiver_s:g} s: {events} after number "
        f"{0 if cursor is None else cursor.seq} {kept}; the same command goes on, --receiver-patience waits longer"
    )


class _Delivery:
    """The thread that has the receiver take what waits; leaving the `with` ends it."""

    def __init__(self, webhook: Webhook, waiting: WaitingEvents, faults: ToldFaults, clock: StoppableClock) -> None:
        self._webhook, self._waiting, self._faults, self._clock = webhook, waiting, faults, clock
        self._fault: BaseException | None = None
        self.took_s = clock.monotonic_s()  # when the receiver took something last
        self.ended = threading.Event()
        self.asked = threading.Event()  # the farm was asked once for what was told before
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> _Delivery:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._clock.stop()
        self._thread.join(LEAVE_S)

    def check(self) -> None:
        """Raise what ended the thread, if something did."""
        if self._fault is not None:
            raise self._fault

    def _run(self) -> None:
        try:
            while True:
                self._clock.sleep_s(0.0)
                if (found := self._waiting.first(DRAIN_S)) is not None:
                    event, cursor = found
                    if not self._faults.knows(event) and not self.asked.is_set():
                        self._clock.sleep_s(DRAIN_S)
                        continue
                    self._webhook.deliver(self._for_others(event), cursor)
                    self._waiting.taken(event)
                    self.took_s = self._clock.monotonic_s()
        except Stopped:
            return
        except BaseException as fault:  # noqa: BLE001 (raised again where the bridge waits)
            self._fault = fault
        finally:
            self.ended.set()

    def _for_others(self, event: Event) -> Event:
        """Return an event as it may leave; a find counts as private where not all before it is known."""
        if isinstance(event.fact, ViolationFound) and not self._faults.knows(event):
            return for_others(event, (event.fact.violation.test_case,))
        return for_others(event, self._faults)


class _Fetching:
    """Has the events of a farm wait, over its restarts."""

    def __init__(
        self,
        connect: Callable[[], FarmClient],
        bridge: Bridge,
        waiting: WaitingEvents,
        faults: ToldFaults,
        delivery: _Delivery,
        clock: StoppableClock,
        say: Callable[[str], None],
    ) -> None:
        self._connect, self._kinds, self._waiting, self._delivery = connect, bridge.kinds, waiting, delivery
        self._receiver_s, self._over_s = bridge.receiver_s, float("inf")  # since when the campaign is seen to be over
        self._faults, self._say, self._clock = faults, say, clock
        self._heard_s = self._clock.monotonic_s()
        self._told = ""

    def run(self, patience_s: float) -> None:
        """Fetch until the campaign has ended and nothing is left.

        Raises Unavailable after `patience_s` of nothing, or where no more can wait, the campaign is over, and the
        receiver takes nothing.
        """
        away = ""
        while True:
            self._delivery.check()
            try:
                if self._waiting.is_full and self._delivery.asked.is_set():
                    self._look()
                elif self._fetched():
                    return
                else:
                    away = ""
            except Unavailable as fault:
                self._delivery.asked.set()
                if self._waiting.cursor is not None and self._waiting.cursor.end:
                    return  # it had ended when it was heard last
                away = str(fault)
                self._tell(f"nothing is fetched: {away}; {_until(patience_s)}")
            if self._clock.monotonic_s() - max(self._over_s, self._delivery.took_s) >= self._receiver_s:
                words = f"the campaign has ended and the receiver took nothing for {self._receiver_s:g} s"
                raise Unavailable(self._missing(words))
            quiet_s = self._clock.monotonic_s() - max(self._heard_s, self._delivery.took_s)
            if away and quiet_s >= patience_s:
                raise Unavailable(self._missing(f"nothing was fetched for {patience_s:.0f} s: {away}"))
            self._clock.wait_s(self._delivery.ended, AWAY_S)

    def _look(self) -> None:
        """See whether the farm is there and its campaign over, while no more can wait; raises Unavailable."""
        client = self._connect()
        try:
            state = client.status(within_s=ANSWER_S).state
        finally:
            client.close()
        self._on_heard()
        self._over_s = min(self._over_s, self._heard_s) if state == "ended" else float("inf")

    def _fetched(self) -> bool:
        """Have what there is wait, and what comes; True once the campaign has ended."""
        self._over_s = float("inf")
        client = self._connect()
        try:
            if not self._goes_on(client):
                return False
            from_seq = min(self._faults.next_seq, self._waiting.next_seq)  # deaths before tell of finds to come
            for event in client.watch(from_seq, patience_s=ANSWER_S, on_quiet=self._on_quiet):
                self._faults.take(event)
                if event.seq < self._waiting.next_seq:
                    continue
                self._delivery.asked.set()
                if not self._waiting.is_full:
                    self._waiting.add(event)
                self._on_heard()
                if self._waiting.is_full:
                    self._tell(f"{self._waiting.file} is full: the rest is fetched once the receiver took all of it")
                    return False
            self._delivery.asked.set()
            self._waiting.end()
            return True
        finally:
            client.close()

    def _on_heard(self) -> None:
        self._heard_s = self._clock.monotonic_s()
        self._delivery.check()

    def _on_quiet(self) -> None:
        self._on_heard()
        self._delivery.asked.set()
        self._told = ""
        self._waiting.go_on()
        self._waiting.flush()

    def _goes_on(self, client: FarmClient) -> bool:
        """Whether what waits and what was taken is of the run that the farm has now; begins anew where it is not.

        False, too, if it has no events yet, or has to be asked again.
        """
        kept, last = self._waiting.cursor, self._waiting.last
        cursor = place_in(kept, self._kinds, client.campaign, client.event)
        self._on_heard()
        if cursor is None:
            return False
        if kept is None or not _same_place(cursor, kept):
            self._drop(cursor)
        elif last is not None and _told_as(client.event(last.seq)) != told_as(last):
            self._drop(self._waiting.cursor or cursor)  # taken meanwhile, maybe: is that still there?
            return False
        return True

    def _drop(self, cursor: Cursor) -> None:
        self._faults.begin()
        if waits := self._waiting.waits:
            self._say(f"{waits} events that waited are none of this run, or were lost with their commits: not told")
        self._waiting.begin(cursor)

    def _tell(self, words: str) -> None:
        """Say what keeps the bridge from its work, once until it goes on."""
        if words != self._told:
            self._say(words)
        self._told = words

    def _missing(self, why: str) -> str:
        waits = self._waiting.waits
        words = f"; {waits} that were fetched wait in {self._waiting.file} for the receiver" if waits else ""
        return (
            f"{why}; events from number {self._waiting.next_seq} on may be missing{words}; "
            "the same command goes on, and with the run folder instead of --connect it tells all its books hold"
        )


def _until(patience_s: float) -> str:
    return "tried again" + ("" if patience_s == float("inf") else f" until nothing came for {patience_s:.0f} s")


def _same_place(one: Cursor, other: Cursor) -> bool:
    return msgspec.structs.replace(one, kinds=(), end=0) == msgspec.structs.replace(other, kinds=(), end=0)


def _told_as(event: Event | None) -> str:
    return "" if event is None else told_as(event)


def place_in(
    kept: Cursor | None, kinds: frozenset[str], campaign: str, event: Callable[[int], Event | None]
) -> Cursor | None:
    """Return how far this run was told, None if it has no events; another run of the same name begins anew.

    So does one of which not all kinds asked for were told, and one whose event told last is another now, or is not
    there: commits were lost, and their numbers are given again. What is told twice bears the same id, what differs
    another.
    """
    first = event(1)
    if first is None:
        return None
    names = tuple(sorted(kinds))
    begun = Cursor(campaign=campaign, begun_unix_s=first.at_unix_s, kinds=names)
    if kept is None or not kept.covers(kinds):
        return begun
    kept = msgspec.structs.replace(kept, kinds=names, end=0)
    if msgspec.structs.replace(kept, seq=0, told_as="") != begun:
        return begun
    last = event(kept.seq) if kept.told_as else None
    return kept if not kept.told_as or (last is not None and told_as(last) == kept.told_as) else begun
