"""A simulator in a process of its own, with deadlines, reaped with everything it started.

The process opens a target once and flies many test cases on it (bringing one up costs a good part of a second, a real
autopilot several); it is replaced after `RECYCLE_FLIGHTS`.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from saflite.contract.clock import Clock
from saflite.contract.config import environment_with, own_python
from saflite.contract.endings import how_ended
from saflite.contract.errors import Refused, RefusedElsewhere, Unavailable
from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase
from saflite.simulator_worker.messages import (
    Cancel,
    FlightReply,
    FlightRequest,
    FromSimulator,
    Opened,
    OpenRequest,
    Ready,
    Setup,
    flights_in,
    from_simulator,
    send,
)
from saflite.simulator_worker.processes import (
    adopt_orphans,
    children,
    kill_strays,
    signal_group,
    starved_s,
)
from saflite.simulator_worker.slots import HeldSlot, take_slot

log = logging.getLogger(__name__)

PROGRAM = "saflite.runtime.simulator"
SNAPSHOTS_MAX = 12
RECYCLE_FLIGHTS = 1000
BRING_UP_S = 30.0
STARVED_LIMIT = 20.0  # times that, on a machine that has no core for it
POLL_S = 0.25  # how late an order to stop may be heard; a flight that ends is heard at once
OVERTIME_S = 1.0  # a session that keeps its deadline itself has this long to say what it saw
CANCEL_GRACE_S = 1.0  # a cancelled flight that has not ended by then is killed
CLOSE_GRACE_S = 1.0  # for a session to close itself
TERM_GRACE_S = 0.5


class SandboxConfig(NamedTuple):
    """`snapshots_max` bounds the snapshots held to fly on from, 0 for none. `verify`: the first flight of a target that
    says it repeats bit by bit is flown twice, and compared."""

    target_files: Sequence[Path] = ()
    snapshots_max: int = SNAPSHOTS_MAX
    verify: bool = False


class Sandbox:
    """One slot of this host and one simulator process at a time in it. Used from one thread."""

    def __init__(self, clock: Clock, config: SandboxConfig) -> None:
        self._clock, self._config = clock, config
        self._slot: HeldSlot | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._flights = 0
        self._target, self._opened = "", Opened()
        self._verified: set[str] = set()
        self._contradicted: dict[str, str] = {}
        adopt_orphans()
        self._bystanders = set(children(os.getpid()))

    def builds(self) -> dict[str, str]:
        """Return the targets that can fly here and their builds; raises Unavailable if no process comes up."""
        return self._begin(_never)

    def _begin(self, cancelled: Cancelled) -> dict[str, str]:
        self._start()
        ready = self._answer(BRING_UP_S, "its start", cancelled)
        assert isinstance(ready, Ready), f"expected Ready, got {type(ready).__name__}"
        return ready.builds

    def fly(
        self, test_case: TestCase, wall_limit_s: float, cancelled: Cancelled, *, share: bool = False
    ) -> FlightReply:
        """Fly once; `wedged` past `wall_limit_s`, `lost` if the process died, `infra` if it never came up.

        Args:
            share: it may begin from a snapshot of an earlier flight that began the same.

        Raises:
            Refused: the target cannot fly this test case, or does not do what it says of itself.
            Unavailable: cancelled before it ended.
        """
        name = test_case.target.name
        self._check_agreement(name)
        try:
            pipe, opened = self._ready_for(name, cancelled)
        except Unavailable as fault:
            if cancelled():
                raise
            return FlightReply(number=0, ending="infra", message=str(fault))
        self._flights += 1
        twice = self._config.verify and opened.repeats and name not in self._verified
        request = FlightRequest(
            number=self._flights, test_case=test_case, deadline_s=wall_limit_s, twice=twice, share=share
        )
        try:
            send(pipe, request)
            reply = self._wait(pipe, flights_in(request) * wall_limit_s, cancelled)
        except (EOFError, OSError):
            message = f"simulator process died: {self.kill(has_died=True)}"
            return FlightReply(number=self._flights, ending="lost", message=message, build=opened.build)
        self._tidy()
        if reply.trouble == "raised":  # what its session is now, nobody knows
            self.kill(has_died=False)
            return FlightReply(number=self._flights, ending="lost", message=reply.message, build=opened.build)
        if reply.trouble == "refused":
            raise RefusedElsewhere("test case", reply.message)
        if reply.trouble == "contradicted":
            self._contradicted[name] = reply.message
            self._check_agreement(name)
        if reply.trouble == "none":
            self._verified.add(name)
        return reply

    def close(self) -> None:
        """End the process and leave nothing behind: no process, no port, no file."""
        self._end()
        if self._slot is not None:
            self._slot.release()
            self._slot = None

    # -- one flight -----------------------------------------------------------------------------------------------

    def _check_agreement(self, name: str) -> None:
        if name in self._contradicted:
            expected = "flights that agree with what describe() says"
            raise Refused(f"target {name}", expected=expected, got=self._contradicted[name])

    def _wait(self, pipe: Connection, wall_limit_s: float, cancelled: Cancelled) -> FlightReply:
        deadline_s = self._clock.monotonic_s() + wall_limit_s + OVERTIME_S
        while not pipe.poll(POLL_S):
            if cancelled():
                self._cancel(pipe)
                raise Unavailable("flight cancelled")
            if self._clock.monotonic_s() >= deadline_s:
                message = f"no end after {wall_limit_s:.1f} s of wall time: {self.kill()}"
                return FlightReply(number=self._flights, ending="wedged", message=message, build=self._opened.build)
        reply = from_simulator(pipe)
        assert isinstance(reply, FlightReply), f"expected FlightReply, got {type(reply).__name__}"
        return reply

    def _cancel(self, pipe: Connection) -> None:
        send(pipe, Cancel(number=self._flights))
        if pipe.poll(CANCEL_GRACE_S):
            from_simulator(pipe)
        else:
            self.kill()

    def _tidy(self) -> None:
        """Kill what the flight left behind, and replace the process when it has flown often enough."""
        process = self._process
        strays = kill_strays(self._bystanders | ({process.pid} if process is not None else set()))
        if strays:
            log.warning("flight left %d processes behind; killed", len(strays))
        if self._flights >= RECYCLE_FLIGHTS:
            self._end()

    # -- the process ----------------------------------------------------------------------------------------------

    def _ready_for(self, name: str, cancelled: Cancelled) -> tuple[Connection, Opened]:
        """Return the socket of a process with a session of the target open, and what it said when it was opened.

        Raises:
            Refused: there is no such target, or what it says of itself makes no sense.
            Unavailable: the process or the session does not come up, or was cancelled before it did.
        """
        if self._process is not None and self._process.poll() is not None:
            self.kill()
        if self._target not in ("", name):
            self._end()  # it may have left the network, which another target may need
        if self._pipe is None:
            self._begin(cancelled)
        assert self._pipe is not None
        if self._target != name:
            self._open(self._pipe, name, cancelled)
        return self._pipe, self._opened

    def _open(self, pipe: Connection, name: str, cancelled: Cancelled) -> None:
        self._target = ""
        send(pipe, OpenRequest(target=name))
        opened = self._answer(BRING_UP_S, f"target {name} was opened", cancelled)
        assert isinstance(opened, Opened), f"expected Opened, got {type(opened).__name__}"
        if opened.trouble == "unavailable":
            raise Unavailable(opened.message)
        if opened.trouble == "contradicted":
            self._contradicted[name] = opened.message
            self._check_agreement(name)
        if opened.trouble == "refused":
            raise Refused(f"target {name}", expected="one that can be opened", got=opened.message)
        self._target, self._opened = name, opened

    def _start(self) -> None:
        self._end()
        slot = self._slot = self._slot or take_slot()
        slot.empty()
        ours, theirs = socket.socketpair()
        self._process = subprocess.Popen(
            [*own_python(PROGRAM), str(theirs.fileno()), str(os.getpid())],
            pass_fds=[theirs.fileno(), *slot.files],  # the slot is taken until the process, too, is gone
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # JSBSim chatters there
            start_new_session=True,
            env=environment_with(OPENBLAS_NUM_THREADS="1"),  # a process of one thread can be forked, and shares no core
        )
        theirs.close()
        self._pipe = Connection(ours.detach())
        self._flights = 0
        files = tuple(str(path) for path in self._config.target_files)
        send(self._pipe, Setup(slot=slot.info, target_files=files, snapshots_max=self._config.snapshots_max))

    def _answer(self, patience_s: float, since: str, cancelled: Cancelled) -> FromSimulator:
        """Return the next message of the process; raises Unavailable, with it ended, if none comes or it is cancelled.

        What it waits for a core does not count: else many that come up at once kill each other for being slow, begin
        anew and never come up.
        """
        assert self._pipe is not None
        assert self._process is not None
        pid, began_s = self._process.pid, self._clock.monotonic_s()
        starved_before_s, passed_s, limit_s = starved_s(pid), 0.0, patience_s
        try:
            while passed_s < limit_s:
                if self._pipe.poll(min(POLL_S, limit_s - passed_s)):
                    return from_simulator(self._pipe)
                if cancelled():
                    self.kill()
                    raise Unavailable("flight cancelled while its simulator came up")
                passed_s = self._clock.monotonic_s() - began_s
                limit_s = min(patience_s + starved_s(pid) - starved_before_s, STARVED_LIMIT * patience_s)
        except (EOFError, OSError) as fault:
            raise Unavailable(f"simulator process did not come up: {self.kill(has_died=True)}") from fault
        self.kill()
        raise Unavailable(f"simulator process said nothing for {passed_s:.0f} s after {since}")

    def _end(self) -> None:
        """Let the process close its session and end by itself; kill what is left."""
        if self._process is not None and self._pipe is not None:
            self._pipe.close()
            self._pipe = None
            _ending_of(self._process, CLOSE_GRACE_S)
        self.kill()

    def kill(self, *, has_died: bool = False) -> str:
        """End the process, its group and its orphans; return in words how it had ended.

        `has_died` says that its end of the pipe is closed, so that its own ending is about to show.
        """
        process, self._process = self._process, None
        self._target = ""
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        if process is None:
            return "not running"
        died = _ending_of(process, TERM_GRACE_S) if has_died else process.poll()
        signal_group(process.pid, signal.SIGTERM)
        if _ending_of(process, TERM_GRACE_S) is None:
            log.info("simulator process %d ignores SIGTERM", process.pid)
        signal_group(process.pid, signal.SIGKILL)
        process.wait()
        kill_strays(self._bystanders)
        return "killed" if died is None else how_ended(died)


def _never() -> bool:
    return False


def _ending_of(process: subprocess.Popen[bytes], patience_s: float) -> int | None:
    try:
        return process.wait(patience_s)
    except subprocess.TimeoutExpired:
        return None
