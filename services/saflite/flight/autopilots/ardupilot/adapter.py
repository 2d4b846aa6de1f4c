"""ArduPilot as a target needs it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.ardupilot.binary import BINARIES, names_threads
from saflite.flight.autopilots.ardupilot.bring_up import Aircraft
from saflite.flight.autopilots.ardupilot.check import check_test_case
from saflite.flight.autopilots.ardupilot.describe import describe
from saflite.flight.autopilots.ardupilot.flight import ArduPilotFlight
from saflite.flight.autopilots.ardupilot.held_flight import HeldFlight
from saflite.flight.autopilots.ardupilot.settings import opening, without_log
from saflite.flight.autopilots.external.adapter import Adapter
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.place import Place


def _powered_up(binary: Binary, place: Place, parameters: Mapping[str, float]) -> Aircraft:
    return Aircraft(binary, place, parameters, np.zeros((0, 8)))


def _forkable(test_case: TestCase) -> bool:
    """Whether nothing of it runs in a thread: neither its log nor, where there are obstacles, BendyRuler."""
    return without_log(test_case) and not test_case.scenario.obstacles


def _repeatable(test_case: TestCase, binary: Binary) -> bool:
    """Whether nothing that flies it runs by wall time: where there are obstacles, BendyRuler must get its turns."""
    return not test_case.scenario.obstacles or names_threads(binary)


ADAPTER = Adapter(
    BINARIES, describe, check_test_case, ArduPilotFlight, _powered_up, HeldFlight, _forkable, opening, _repeatable
)
