"""A simulator in a child process, with deadlines, reaped with everything it started.

The child lives for many flights (starting one costs a good part of a second) and is replaced after `RECYCLE_FLIGHTS`.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path

from saflite.contract import wire
from saflite.contract.clock import Clock
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase
from saflite.simulator_worker.child import FlightReply, FlightRequest, Ready
from saflite.simulator_worker.processes import adopt_orphans, children, kill_strays, signal_group

log = logging.getLogger(__name__)

RECYCLE_FLIGHTS = 1000
BRING_UP_S = 30.0
POLL_S = 0.05
CANCEL_GRACE_S = 1.0  # a cancelled flight that has not ended by then is killed
TERM_GRACE_S = 0.5


class Sandbox:
    """One simulator process at a time. Used from one thread."""

    def __init__(self, clock: Clock, target_files: Sequence[Path] = ()) -> None:
        self._clock, self._files = clock, tuple(target_files)
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._flights = 0
        adopt_orphans()
        self._bystanders = set(children(os.getpid()))

    def targets(self) -> tuple[str, ...]:
        """Return the targets the child can fly, starting it; raises Unavailable if it does not come up."""
        pipe = self._start()
        if not pipe.poll(BRING_UP_S):
            self.kill()
            raise Unavailable(f"simulator process said nothing for {BRING_UP_S:.0f} s after its start")
        try:
            return wire.decode(pipe.recv_bytes(), Ready).targets
        except (EOFError, OSError) as fault:
            raise Unavailable(f"simulator process did not come up: {self.kill(has_died=True)}") from fault

    def fly(self, test_case: TestCase, wall_limit_s: float, cancelled: Cancelled) -> FlightReply:
        """Fly once; `wedged` past `wall_limit_s`, `lost` if the process died, `infra` if it never came up.

        Raises:
            Refused: the target cannot fly this test case.
            Unavailable: cancelled before it ended.
        """
        try:
            pipe = self._running()
        except Unavailable as fault:
            return FlightReply(number=0, ending="infra", message=str(fault))
        self._flights += 1
        try:
            pipe.send_bytes(wire.encode(FlightRequest(number=self._flights, test_case=test_case)))
            reply = self._wait(pipe, wall_limit_s, cancelled)
        except (EOFError, OSError):
            return FlightReply(
                number=self._flights, ending="lost", message=f"simulator process died: {self.kill(has_died=True)}"
            )
        self._tidy()
        if reply.trouble == "refused":
            raise Refused("test case", expected="one the target can fly", got=reply.message)
        return reply

    def close(self) -> None:
        """End the child."""
        self.kill()

    # -- one flight -----------------------------------------------------------------------------------------------

    def _wait(self, pipe: Connection, wall_limit_s: float, cancelled: Cancelled) -> FlightReply:
        deadline_s = self._clock.monotonic_s() + wall_limit_s
        while not pipe.poll(POLL_S):
            if cancelled():
                self._cancel(pipe)
                raise Unavailable("flight cancelled")
            if self._clock.monotonic_s() >= deadline_s:
                message = f"no end after {wall_limit_s:.1f} s of wall time: {self.kill()}"
                return FlightReply(number=self._flights, ending="wedged", message=message)
        return wire.decode(pipe.recv_bytes(), FlightReply)

    def _cancel(self, pipe: Connection) -> None:
        pipe.send_bytes(wire.encode(FlightRequest(number=self._flights)))
        if pipe.poll(CANCEL_GRACE_S):
            pipe.recv_bytes()
        else:
            self.kill()

    def _tidy(self) -> None:
        """Kill what the flight left behind, and the child itself when it has flown often enough."""
        process = self._process
        strays = kill_strays(self._bystanders | ({process.pid} if process is not None else set()))
        if strays:
            log.warning("flight left %d processes behind; killed", len(strays))
        if self._flights >= RECYCLE_FLIGHTS:
            self.kill()

    # -- the child ------------------------------------------------------------------------------------------------

    @staticmethod
    def _ending_of(process: subprocess.Popen[bytes]) -> int | None:
        try:
            return process.wait(TERM_GRACE_S)
        except subprocess.TimeoutExpired:
            return None

    def _running(self) -> Connection:
        if self._process is not None and self._process.poll() is not None:
            self.kill()
        if self._pipe is None:
            self.targets()
        assert self._pipe is not None
        return self._pipe

    def _start(self) -> Connection:
        self.kill()
        ours, theirs = socket.socketpair()
        command = [sys.executable, "-m", "saflite.simulator_worker.child", str(theirs.fileno()), str(os.getpid())]
        self._process = subprocess.Popen(
            [*command, *(str(path) for path in self._files)],
            pass_fds=[theirs.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # JSBSim chatters there
            start_new_session=True,
        )
        theirs.close()
        self._pipe = Connection(ours.detach())
        self._flights = 0
        return self._pipe

    def kill(self, *, has_died: bool = False) -> str:
        """End the child, its process group and its orphans; return in words how the child had ended.

        `has_died` says that its end of the pipe is closed, so that its own ending is about to show.
        """
        process, self._process = self._process, None
        if self._pipe is not None:
            self._pipe.close()
            self._pipe = None
        if process is None:
            return "not running"
        died = self._ending_of(process) if has_died else process.poll()
        signal_group(process.pid, signal.SIGTERM)
        try:
            process.wait(TERM_GRACE_S)
        except subprocess.TimeoutExpired:
            log.info("simulator process %d ignores SIGTERM", process.pid)
        signal_group(process.pid, signal.SIGKILL)
        process.wait()
        kill_strays(self._bystanders)
        return "killed" if died is None else _words(died)


def _words(code: int) -> str:
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
