"""Snapshots of flights by forking the process that flies them: held at a moment, flown on from any number of times.

Each snapshot is a process that waits: the session's own, or forked from that of an earlier moment. To fly on, it forks
once more, and the fork flies to the end and sends the record. So the processes form a tree whose parents hold earlier
moments than their children. Everyone dies with its parent, and ends when the session lets go of its socket.

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

from saflite.contract.errors import FarmError, Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target import Snapshot
from saflite.contract.test_case import TestCase
from saflite.simulator_worker.prefixes import agree_until_s
from saflite.simulator_worker.processes import die_with_parent

POLL_S = 0.02
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
_ORDERS, _HELD = msgspec.msgpack.Decoder(_Order), msgspec.msgpack.Decoder(_Held)
_RECORDS = msgspec.msgpack.Decoder(FlightRecord | None)


class Forks:
    """The snapshots of one session. `begin` brings a flight to its start state."""

    def __init__(self, begin: Callable[[TestCase], HeldFlight]) -> None:
        self._begin = begin
        self._nodes: dict[int, _Node] = {}
        self._count = 0

    def hold(self, test_case: TestCase, at_s: float, stop: Cancelled) -> Snapshot:
        """Fly up to `at_s`, from the latest snapshot on the way there, and hold.

        Raises:
            Unavailable: the flight ends before, or was stopped.
        """
        base = self._latest(test_case, at_s)
        pipe, pid = self._order(base, _Order(test_case, at_s))
        try:
            data = _answer(pipe, stop)
            held = _Held(False) if data is None else _HELD.decode(data)
            if not held.there:
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
        return None if data is None else _RECORDS.decode(data)

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
                    pid = _fork(theirs.fileno(), lambda pipe: _obey(self._begin(order.test_case), order, pipe))
                else:
                    base.pipe.send_bytes(_ENCODER.encode(order))
                    send_handle(base.pipe, theirs.fileno(), 0)
            except OSError:
                ours.close()
                raise
        return Connection(ours.detach()), pid


# ---- the session's side -------------------------------------------------------------------------------------------


def _answer(pipe: Connection, stop: Cancelled) -> bytes | None:
    """Return what the process at the other end sends, None if it dies before; raises Unavailable once stopped."""
    while not pipe.poll(POLL_S):
        if stop():
            raise Unavailable("flight cancelled")
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


def _fork(handle: int, act: Callable[[Connection], None], files: Collection[int] = ()) -> int:
    """Fork a process that does `act` with no open files but the socket `handle` and `files`; return its id."""
    parent = os.getpid()
    pid = os.fork()
    if pid:
        return pid
    code = BROKEN
    try:
        die_with_parent(parent)
        _close_all_but({handle, *files})
        act(Connection(handle))
        code = 0
    except (FarmError, EOFError, BrokenPipeError):  # said again by the flight from the start that takes our place
        code = 0
    finally:
        if code:
            traceback.print_exc()
        os._exit(code)


def _obey(flight: HeldFlight, order: _Order, pipe: Connection) -> None:
    """Fly to the end and send the record, or hold where the order says."""
    if order.hold_at_s is None:
        pipe.send_bytes(_ENCODER.encode(flight.fly_on(order.test_case, pipe.poll)))
        return
    there = flight.fly_to(order.test_case, order.hold_at_s, pipe.poll)
    pipe.send_bytes(_ENCODER.encode(_Held(there)))
    if there:
        _hold(flight, pipe)


def _hold(flight: HeldFlight, pipe: Connection) -> None:
    """Wait for orders, each for a fork of this process; end with the socket, after all forks."""
    while True:
        try:
            order = _ORDERS.decode(pipe.recv_bytes())
            handle = recv_handle(pipe)
        except (EOFError, OSError):
            flight.close()
            break
        with flight.forking():
            _fork(handle, partial(_obey, flight, order), flight.files)
        os.close(handle)
        _reap(os.WNOHANG)
    _reap(0)


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
