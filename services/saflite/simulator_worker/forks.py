"""Snapshots of flights by forking the process that flies them: held at a moment, flown on from any number of times.

Each snapshot is a process that waits: the session's own, or forked from that of an earlier moment. To fly on, it forks
once more, ahead of the order, and the fork flies to the end and sends the record. So the processes form a tree whose
parents hold earlier moments than their children. Everyone dies with its parent, and ends when the session lets go of
its socket.

For simulators that live in the session's process and run one thread.
"""

from __future__ import annotations

import os
import socket
import traceback
from collections.abc import Callable, Collection
from contextlib import AbstractContextManager, suppress
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.reduction import recv_handle, send_handle
from typing import NamedTuple, Protocol

import msgspec

from saflite.contract import wire
from saflite.contract.errors import FarmError, Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target import Snapshot
from saflite.contract.test_case import TestCase
from saflite.simulator_worker.prefixes import agree_until_s
from saflite.simulator_worker.processes import die_with_parent

POLL_S = 0.02
AFTER_S = 0.003  # of wall time that a flight begins alone, before the fork for the next is made
BROKEN = 70


class HeldFlight(Protocol):
    """A flight that can stop at a moment and go on. `files` are open files that a fork of it needs."""

    def forking(self) -> AbstractContextManager[None]:
        """Return what a fork of this process is made in: other processes of the flight are forked beside it.

        The fork itself never leaves it.
        """
        ...

    @property
    def files(self) -> Collection[int]:
        """Open files that it goes on with; all others are closed in a fork."""
        ...

    def take_up(self) -> None:
        """In a fork: take up what was forked beside it, if that was not done yet."""
        ...

    def close(self) -> None:
        """End what it started; it goes on no more."""
        ...

    def fly_to(self, test_case: TestCase, at_s: float, cancelled: Cancelled) -> bool:
        """Fly a test case with the same past until just before what is due at `at_s`; False if it ends before."""
        ...

    def fly_on(self, test_case: TestCase, cancelled: Cancelled) -> FlightRecord | None:
        """Fly a test case with the same past to its end; None if it cannot be from here."""
        ...


class _Order(msgspec.Struct, frozen=True):
    """Said to a snapshot's process, with a socket for the answer: hold at `hold_at_s`, or (None) fly to the end."""

    test_case: TestCase
    hold_at_s: float | None


class _Held(msgspec.Struct, frozen=True):
    """Whether the flight is held: it is not if it ended before."""

    there: bool


class _Node(NamedTuple):
    """A snapshot as its session knows it. `pid` is 0 and `parent` a handle where it was forked from another one."""

    snapshot: Snapshot
    test_case: TestCase
    pipe: Connection
    pid: int
    parent: int


_ENCODER = msgspec.msgpack.Encoder()


class Forks:
    """The snapshots of one session. `begin` brings a flight to its start state."""

    def __init__(self, begin: Callable[[TestCase], HeldFlight]) -> None:
        self._begin = begin
        self._nodes: dict[int, _Node] = {}
        self._count = 0

    def hold(self, test_case: TestCase, at_s: float, stop: Cancelled) -> Snapshot:
        """Fly up to `at_s`, from the latest snapshot on the way there, and hold.

        Raises:
            Unavailable: the flight ends before, was stopped, or a process died.
        """
        base = self._latest(test_case, at_s)
        try:
            pipe, pid = self._order(base, _Order(test_case, at_s))
        except BrokenPipeError as fault:
            if base is not None:
                self.drop(base.snapshot)
            raise Unavailable(f"no snapshot at {at_s:g} s: the process of the one before it died") from fault
        try:
            data = _answer(pipe, stop)
            if data is None:
                raise Unavailable(f"no snapshot at {at_s:g} s: its process died")
            if not wire.unpack(data, _Held).there:
                raise Unavailable(f"no snapshot at {at_s:g} s: the flight ends before")
        except Unavailable:
            _let_go(pipe, pid)
            raise
        self._count += 1
        parent = 0 if base is None else base.snapshot.handle
        self._nodes[self._count] = _Node(Snapshot(self._count, at_s), test_case, pipe, pid, parent)
        return self._nodes[self._count].snapshot

    def fly_from(self, snapshot: Snapshot, test_case: TestCase, stop: Cancelled) -> FlightRecord | None:
        """Fly on from a snapshot; None where that cannot be: it is gone, or the flight had ended before.

        Raises:
            Unavailable: it was stopped.
        """
        node = self._nodes.get(snapshot.handle)
        if node is None or agree_until_s(node.test_case, test_case) < snapshot.at_s:
            return None
        try:
            pipe, pid = self._order(node, _Order(test_case, None))
        except OSError:
            self.drop(snapshot)
            return None
        try:
            data = _answer(pipe, stop)
        finally:
            _let_go(pipe, pid)
        return None if data is None else wire.unpack(data, FlightRecord | None)

    def drop(self, snapshot: Snapshot) -> None:
        """Let go of a snapshot and those held on from it."""
        node = self._nodes.pop(snapshot.handle, None)
        if node is None:
            return
        for later in [other.snapshot for other in self._nodes.values() if other.parent == snapshot.handle]:
            self.drop(later)
        _let_go(node.pipe, node.pid)

    def close(self) -> None:
        """Let go of all."""
        for node in list(self._nodes.values()):
            self.drop(node.snapshot)

    def _latest(self, test_case: TestCase, at_s: float) -> _Node | None:
        usable = [
            node
            for node in self._nodes.values()
            if node.snapshot.at_s <= min(at_s, agree_until_s(node.test_case, test_case))
        ]
        return max(usable, key=lambda node: node.snapshot.at_s, default=None)

    def _order(self, base: _Node | None, order: _Order) -> tuple[Connection, int]:
        """Have a process forked that does the order; return the socket it answers on, and its id if it is our child."""
        ours, theirs = socket.socketpair()
        pid = 0
        with theirs:
            try:
                if base is None:
                    pid = _fork({theirs.fileno()}, partial(self._first, order, theirs.fileno()))
                else:
                    _send(base.pipe, order, theirs.fileno())
            except OSError:
                ours.close()
                raise
        return Connection(ours.detach()), pid

    def _first(self, order: _Order, handle: int) -> None:
        pipe = Connection(handle)
        _obey(self._begin(order.test_case), order, pipe)


# ---- the session's side -------------------------------------------------------------------------------------------


def _answer(pipe: Connection, stop: Cancelled) -> bytes | None:
    """Return what the process at the other end sends, None if it dies before; raises Unavailable once stopped."""
    while True:
        if stop():  # before the first look, too: what was cancelled from the start may be done by then
            raise Unavailable("flight cancelled")
        if pipe.poll(POLL_S):
            break
    try:
        return pipe.recv_bytes()
    except (EOFError, OSError):
        return None


def _let_go(pipe: Connection, pid: int) -> None:
    """Have the process at the other end of the socket end, and wait for it if it is our child."""
    pipe.close()
    if pid:
        with suppress(ChildProcessError):
            os.waitpid(pid, 0)


# ---- in the forks -------------------------------------------------------------------------------------------------


def _fork(files: Collection[int], act: Callable[[], None]) -> int:
    """Fork a process that does `act` with no open files but `files`; return its id."""
    parent = os.getpid()
    pid = os.fork()
    if pid:
        return pid
    code = BROKEN
    try:
        die_with_parent(parent)
        _close_all_but(files)
        act()
        code = 0
    except (FarmError, EOFError, BrokenPipeError):  # said again by the flight from the start that takes our place
        code = 0
    finally:
        try:
            if code:
                traceback.print_exc()
        finally:  # nothing may lead a fork back to where its parent goes on
            os._exit(code)


def _obey(flight: HeldFlight, order: _Order, pipe: Connection) -> None:
    """Fly to the end and send the record, or hold where the order says."""
    if order.hold_at_s is None:
        pipe.send_bytes(_ENCODER.encode(flight.fly_on(order.test_case, pipe.poll)))
        return
    there = flight.fly_to(order.test_case, order.hold_at_s, pipe.poll)
    pipe.send_bytes(_ENCODER.encode(_Held(there)))
    if there:
        _hold(flight, order.test_case, pipe)


def _hold(flight: HeldFlight, test_case: TestCase, pipe: Connection) -> None:
    """Have orders done, each by a fork made ahead of it; end with the socket or a fork that fails, after all forks."""
    while _taken(flight, test_case, pipe):
        _reap(os.WNOHANG)
    pipe.close()
    flight.close()
    _reap(0)


def _taken(flight: HeldFlight, test_case: TestCase, pipe: Connection) -> bool:
    """Fork for the next order and wait until that has come; False if none comes any more or the fork died before."""
    here, there = socket.socketpair()
    ours, theirs = Connection(here.detach()), Connection(there.detach())
    with ours:
        with theirs, flight.forking():
            _fork({pipe.fileno(), theirs.fileno(), *flight.files}, partial(_do_next, flight, test_case, pipe, theirs))
        try:
            ours.recv_bytes()
        except EOFError:
            return False
        ours.poll(AFTER_S)  # or until the fork has ended
    return True


def _do_next(flight: HeldFlight, test_case: TestCase, pipe: Connection, taken: Connection) -> None:
    """In a fork: get ready, wait for the next order on the socket that is shared with the one held, say so, do it."""
    flight.take_up()
    _rehearse(test_case)
    order, answer = _next(pipe)
    pipe.close()
    taken.send_bytes(b"")
    _obey(flight, order, answer)


def _next(pipe: Connection) -> tuple[_Order, Connection]:
    """Wait for an order; return it and the socket for its answer."""
    return wire.unpack(pipe.recv_bytes(), _Order), Connection(recv_handle(pipe))


def _send(pipe: Connection, order: _Order, answer: int) -> None:
    """Send an order with a socket for its answer."""
    pipe.send_bytes(_ENCODER.encode(order))
    send_handle(pipe, answer, 0)


def _rehearse(test_case: TestCase) -> None:
    """Take an order from ourselves: the memory that this touches is copied now, not when the order comes."""
    ends = [Connection(end.detach()) for end in socket.socketpair()]
    with ends[0], ends[1]:
        _send(ends[0], _Order(msgspec.structs.replace(test_case, stimuli=()), None), ends[0].fileno())
        _next(ends[1])[1].close()


def _reap(options: int) -> None:
    """Take leave of the forks that have ended (WNOHANG), or of all once they have (0)."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, options)[0]:
            pass


def _close_all_but(kept: Collection[int]) -> None:
    for name in os.listdir("/proc/self/fd"):
        if int(name) > 2 and int(name) not in kept:
            with suppress(OSError):  # the listing's own
                os.close(int(name))
