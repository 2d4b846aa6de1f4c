"""What the simulator's own process does: keeps one session of a target open and flies test cases on it.

Started by `sandbox.py` as `python -m saflite.runtime.simulator FD PARENT_PID`. It leads its own process group, dies
with the worker, and keeps the interpreter lock of the simulator away from the worker's heartbeats. Trouble of the
target's own code ends the process: the worker then counts the flight as lost, and says what raised where it can.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from saflite.contract.clock import Clock
from saflite.contract.errors import FarmError, Refused, Unavailable
from saflite.contract.flight import FlightRecord, pack_trace, readable, trace_digest
from saflite.contract.outside_code import Raised, of_outside
from saflite.contract.service import Cancelled
from saflite.contract.target import ForkingSession, Session, TargetModule
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import TestCase
from saflite.simulator_worker import agreement, own_network
from saflite.simulator_worker.messages import (
    Cancel,
    FlightReply,
    FlightRequest,
    Opened,
    OpenRequest,
    Ready,
    Setup,
    Trouble,
    send,
    to_simulator,
)
from saflite.simulator_worker.prefixes import Prefixes
from saflite.simulator_worker.registry import builds_here, describe_target, is_outside, load_target
from saflite.simulator_worker.twins import check_twin, with_twin


class _Open(NamedTuple):
    """The session at hand. `prefixes` flies from snapshots, None where the target holds none."""

    info: TargetInfo
    target: TargetModule
    session: Session
    prefixes: Prefixes | None


def serve(pipe: Connection, clock: Clock) -> None:
    """Serve the worker until it closes the socket."""
    try:
        setup = to_simulator(pipe)
        assert isinstance(setup, Setup), f"expected Setup, got {type(setup).__name__}"
        send(pipe, Ready(builds=builds_here([Path(name) for name in setup.target_files])))
        simulator = Simulator(pipe, clock, setup)
        try:
            while True:
                simulator.answer()
        finally:
            simulator.close()
    except EOFError:
        return


class Simulator:
    """One slot and the session open in it."""

    def __init__(self, pipe: Connection, clock: Clock, setup: Setup) -> None:
        self._pipe, self._setup = pipe, setup
        self._slot = setup.slot.slot(clock)
        self._files = tuple(Path(name) for name in setup.target_files)
        self._open: _Open | None = None
        self._alone = False

    def answer(self) -> None:
        """Take one request and answer it; raises EOFError when the worker is gone."""
        request = to_simulator(self._pipe)
        if isinstance(request, OpenRequest):
            send(self._pipe, self._opened(request.target))
        elif isinstance(request, FlightRequest):
            send(self._pipe, self._flown(request))

    def close(self) -> None:
        """Close the session."""
        if self._open is not None:
            if self._open.prefixes is not None:
                self._open.prefixes.close()
            self._open.session.close()
            self._open = None

    # -- opening --------------------------------------------------------------------------------------------------

    def _opened(self, name: str) -> Opened:
        self.close()
        try:
            with of_outside("target", name, outside=is_outside(name)):
                opened = self._open = self._bring_up(name)
        except Raised as fault:
            return Opened(trouble="unavailable", message=str(fault))
        except Refused as fault:
            return Opened(trouble="refused", message=str(fault))
        except Unavailable as fault:
            return Opened(trouble="unavailable", message=str(fault))
        wrong = [*agreement.own_contradictions(opened.info), *agreement.session_lacks(opened.session)]
        if describe_target(name, self._files) != opened.info:
            wrong.append("describe() says something else each time")
        if wrong:
            return Opened(build=opened.info.build, trouble="contradicted", message="; ".join(wrong))
        return Opened(build=opened.info.build, repeats=opened.info.repeats == "bitwise")

    def _bring_up(self, name: str) -> _Open:
        target, info = load_target(name, self._files), describe_target(name, self._files)
        if info.missing:
            raise Unavailable(f"target {name}: {info.missing}")
        for leftover in self._slot.folder.iterdir():  # of the session before
            shutil.rmtree(leftover) if leftover.is_dir() and not leftover.is_symlink() else leftover.unlink()
        if getattr(target, "own_network", False) and not self._alone:
            self._alone = own_network.enter()
        session = target.open(self._slot)
        most = self._setup.snapshots_max
        if info.snapshots and most > 0 and isinstance(session, ForkingSession):
            return _Open(info, target, session, Prefixes(session, self._slot.clock, most))
        return _Open(info, target, session, None)

    # -- flying ---------------------------------------------------------------------------------------------------

    def _flown(self, request: FlightRequest) -> FlightReply:
        assert self._open is not None, "a flight was asked of a simulator without a session"
        name = self._open.info.name
        try:
            with of_outside("target", name, outside=is_outside(name)):
                record = self._fly(self._open, request)
        except Raised as fault:
            return _unflown(request, "raised", str(fault))
        except Refused as fault:
            return _unflown(request, "refused", str(fault))
        except Unavailable as fault:
            return _unflown(request, "unavailable", str(fault))
        except _Contradicted as fault:
            return _unflown(request, "contradicted", str(fault))
        return _reply(request, self._open.info.build, record)

    def _fly(self, opened: _Open, request: FlightRequest) -> FlightRecord:
        test_case, info = request.test_case, opened.info
        if test_case.target.build not in ("", info.build):
            fix = "`saflite regress RUN` flies the finds of a run on the build that is here"
            raise Refused(f"build of target {info.name}", expected=test_case.target.build, got=info.build, fix=fix)
        opened.target.check(test_case)
        check_twin(info, test_case)

        asked = False

        def cancelled() -> bool:
            nonlocal asked
            while not asked and self._pipe.poll():
                message = to_simulator(self._pipe)
                asked = isinstance(message, Cancel) and message.number == request.number
            return asked

        shares = request.share and opened.prefixes is not None and not request.twice
        flying = opened.prefixes if shares and opened.prefixes is not None else opened.session
        record = flying.fly(test_case, request.deadline_s, cancelled)
        wrong = list(agreement.contradictions(info, test_case, record))
        if request.twice and not wrong and _repeatable(opened.session, test_case):
            wrong = list(_repeated(opened.session, request, record, cancelled))
        if wrong:
            raise _Contradicted("; ".join(wrong))
        return with_twin(info, test_case, record, lambda case: flying.fly(case, request.deadline_s, cancelled))


class _Contradicted(FarmError):
    """The target does not do what it says of itself."""


def _repeatable(session: Session, test_case: TestCase) -> bool:
    """Whether a session means this test case, too, when its target says that flights repeat bit by bit."""
    told = getattr(session, "repeatable", None)
    return told is None or bool(told(test_case))


def _repeated(session: Session, request: FlightRequest, record: FlightRecord, cancelled: Cancelled) -> Iterator[str]:
    again = session.fly(request.test_case, request.deadline_s, cancelled)
    for difference in agreement.differences(record, again):
        yield f"describe() says that flights repeat bit by bit, but of two flights of one test case: {difference}"


def _unflown(request: FlightRequest, trouble: Trouble, message: str) -> FlightReply:
    return FlightReply(number=request.number, trouble=trouble, message=message)


def _reply(request: FlightRequest, build: str, record: FlightRecord) -> FlightReply:
    record = readable(record)
    trace = record.trace
    return FlightReply(
        number=request.number,
        ending=record.ending,
        trace=b"" if trace is None else pack_trace(trace),
        trace_digest="" if trace is None else trace_digest(trace),
        simulated_s=0.0 if trace is None else trace.duration_s,
        message=record.message,
        build=build,
        delivered=record.delivered,
        artefacts=dict(record.artefacts),
    )
