"""ArduPilot as a target needs it."""

from __future__ import annotations

import numpy as np

from saflite.flight.autopilots.ardupilot.binary import BINARIES
from saflite.flight.autopilots.ardupilot.bring_up import Aircraft
from saflite.flight.autopilots.ardupilot.check import check_test_case
from saflite.flight.autopilots.ardupilot.describe import describe
from saflite.flight.autopilots.ardupilot.flight import ArduPilotFlight
from saflite.flight.autopilots.external.adapter import Adapter
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.place import Place


def _powered_up(binary: Binary, place: Place) -> Aircraft:
    return Aircraft(binary, place, {}, np.zeros((0, 8)))


ADAPTER = Adapter(BINARIES, describe, check_test_case, ArduPilotFlight, _powered_up)
