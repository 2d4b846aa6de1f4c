"""A target opened in this very process, for checks, tests and measurements; campaigns fly in a sandbox."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from saflite.contract.flight import FlightRecord
from saflite.contract.service import Cancelled
from saflite.contract.target import Session, TargetModule
from saflite.contract.test_case import TestCase
from saflite.runtime.clock import WallClock
from saflite.simulator_worker.registry import load_target
from saflite.simulator_worker.slots import take_slot
from saflite.simulator_worker.twins import check_twin, with_twin

DEADLINE_S = 300.0


@contextmanager
def opened(target: TargetModule) -> Iterator[Session]:
    """Open a session in a slot of its own, and leave nothing behind.

    Raises:
        Unavailable: the target cannot be brought up here.
    """
    held = take_slot()
    try:
        session = target.open(held.info.slot(WallClock()))
        try:
            yield session
        finally:
            session.close()
    finally:
        held.release()


def fly_once(test_case: TestCase, cancelled: Cancelled = lambda: False) -> FlightRecord:
    """Fly a test case once on its target, which is found by its place.

    Raises:
        Refused: the target cannot fly it.
        Unavailable: the target cannot be brought up here, or the flight was cancelled.
    """
    target = load_target(test_case.target.name)
    target.check(test_case)
    check_twin(target.describe(), test_case)
    with opened(target) as session:
        record = session.fly(test_case, DEADLINE_S, cancelled)
        return with_twin(target.describe(), test_case, record, lambda case: session.fly(case, DEADLINE_S, cancelled))
