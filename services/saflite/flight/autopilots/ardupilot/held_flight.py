"""A flight that is held where the autopilot waits for the world, and goes on from there any number of times.

The process that holds it is forked, and the autopilot beside it. What flies on has links of its own, so that nothing of
one flight reaches another.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress

from saflite.contract.errors import Unavailable
from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.ardupilot.flight import ArduPilotFlight
from saflite.flight.autopilots.ardupilot.gate import Fork
from saflite.flight.autopilots.external.link import Stopped
from saflite.flight.autopilots.external.place import FailedBringUp, stay_on_one_core


class HeldFlight(ArduPilotFlight):
    """See `simulator_worker/forks.py`; its folder, ports and autopilot are those of the process that began it."""

    _owner, _said = 0, ""
    _for_fork: Fork | None = None  # the autopilot's, for the fork of this process that is being made

    def begin(self) -> None:
        """Reach the start state, in a process that does nothing else.

        Raises:
            Unavailable: it does not get there; a flight from power-up says what that means.
        """
        stay_on_one_core(self._place)
        self._cancelled = lambda: False
        self._owner = os.getpid()
        try:
            self._aircraft = self._powered_up()
            self._begin(self._aircraft)
            self._said = self._aircraft.process.console
        except (FailedBringUp, Stopped) as fault:
            self.close()
            raise Unavailable(str(fault)) from fault
        except BaseException:
            self.close()
            raise

    @contextmanager
    def forking(self) -> Iterator[None]:
        """Have the autopilot forked while this process is."""
        with suppress(Unavailable):  # the fork finds that out and says so
            self._for_fork = self._aircraft.gate.fork()
        yield
        if self._for_fork is not None:
            self._for_fork.leave()
            self._for_fork = None

    @property
    def files(self) -> Collection[int]:
        """What a fork of this process needs open to go on."""
        return (*self._aircraft.files, *(self._for_fork.files if self._for_fork is not None else ()))

    def take_up(self) -> None:
        """In a fork of the process that held it: go on with a fork of the autopilot.

        Raises:
            Unavailable: the held autopilot cannot be forked, or is gone.
        """
        if self._owner == os.getpid():
            return
        fork, self._for_fork = self._for_fork or self._aircraft.gate.fork(), None
        self._owner = os.getpid()
        self._aircraft.take_up(fork, self._said)

    def fly_to(self, test_case: TestCase, at_s: float, cancelled: Cancelled) -> bool:
        """Fly a test case with the same past until just before what is due at `at_s`; False if it ends before.

        Raises:
            Unavailable: it was cancelled.
        """
        self._follow(test_case, cancelled)
        try:
            while self.time_s < at_s - 1e-9:
                if self._step(self._aircraft) is not None:
                    return False
        except Stopped:
            return False
        return True

    def fly_on(self, test_case: TestCase, cancelled: Cancelled) -> FlightRecord | None:
        """Fly a test case with the same past to its end; None if that flight had ended before this moment.

        Raises:
            Unavailable: it was cancelled.
        """
        self._follow(test_case, cancelled)
        if self._inputs.finished and self._over_s >= self._inputs.last_s:
            self.close()
            return None
        self._ended_s = None
        return self._rest(self._aircraft)

    def close(self) -> None:
        """End the autopilot."""
        if self._aircraft is not None:
            self._aircraft.close()

    def _follow(self, test_case: TestCase, cancelled: Cancelled) -> None:
        self.take_up()
        self._cancelled, self.test_case = cancelled, test_case
        self._inputs.replace(test_case.stimuli)
