"""A target for fault tests: the reference target, except where a test case is told or drawn to misbehave.

`target.parameters`: `SOAK_FAULT` picks one fault for the test case, `SOAK_SHARE` lets that share of test cases (drawn
from their identity, so that it is always the same ones) crash or hang the simulator.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import msgspec
import numpy as np

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.flight import FlightRecord, Trace
from saflite.contract.rng import derive
from saflite.contract.service import Cancelled
from saflite.contract.target import Session, Slot
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import DEFAULT_TARGET, TestCase, draw_key
from saflite.simulator_worker.targets import reference

FLY, CRASH, HANG, NO_BRING_UP, REFUSE, BROKEN, STRAY, SLOW, QUIET = range(9)
SLEEPER = [sys.executable, "-c", "import signal, time; signal.signal(15, signal.SIG_IGN); time.sleep(600)"]


def describe() -> TargetInfo:
    """Say what the reference target says, under another name, and that flights repeat."""
    return msgspec.structs.replace(reference.describe(), name="soak", snapshots=False)


def check(test_case: TestCase) -> None:
    """Take everything."""


def open(slot: Slot) -> SoakSession:  # noqa: A001  (the name that the contract gives it)
    """Return a session."""
    return SoakSession(reference.open(slot))


class SoakSession:
    """Flies on the reference target, or misbehaves."""

    def __init__(self, session: Session) -> None:
        self._session = session

    def fly(self, test_case: TestCase, deadline_s: float, cancelled: Cancelled) -> FlightRecord:
        """Fly on the reference target, or misbehave."""
        fault = int(test_case.target.parameters.get("SOAK_FAULT", FLY)) or _drawn(test_case)
        if fault == FLY:
            return self._session.fly(_plain(test_case), deadline_s, cancelled)
        _misbehave(fault)
        while fault == SLOW and not cancelled():
            time.sleep(0.01)
        column = np.full(10, 9.0, dtype="<f4").tobytes()
        return FlightRecord("completed", Trace(step_s=0.1, signals=dict.fromkeys(describe().signals, column)))

    def close(self) -> None:
        """Close the reference session."""
        self._session.close()


def _misbehave(fault: int) -> None:
    if fault == CRASH:
        os.kill(os.getpid(), signal.SIGSEGV)
    if fault == HANG:
        _hang()
    if fault == NO_BRING_UP:
        raise Unavailable("the simulator does not come up")
    if fault == REFUSE:
        raise Refused("test case", expected="another", got="this one")
    assert fault != BROKEN, "our own code broke"
    if fault == STRAY:
        subprocess.Popen(["/bin/sh", "-c", "setsid sleep 600 & exit 0"]).wait()


def _plain(test_case: TestCase) -> TestCase:
    """Return the test case as the reference target knows it."""
    parameters = {name: value for name, value in test_case.target.parameters.items() if not name.startswith("SOAK_")}
    target = msgspec.structs.replace(test_case.target, name=DEFAULT_TARGET, parameters=parameters)
    return msgspec.structs.replace(test_case, target=target)


def _drawn(test_case: TestCase) -> int:
    share = test_case.target.parameters.get("SOAK_SHARE", 0.0)
    draw = float(derive(0, "soak", draw_key(test_case)).random())
    if draw < share / 2:
        return CRASH
    return HANG if draw < share else FLY


def _hang() -> None:
    """Ignore SIGTERM, and leave a grandchild in a session of its own that does too."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    subprocess.Popen(SLEEPER, start_new_session=True)
    while True:
        time.sleep(60)
