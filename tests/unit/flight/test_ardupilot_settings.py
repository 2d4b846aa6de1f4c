"""Which of ArduPilot's settings the trace shows."""

from __future__ import annotations

import numpy as np
import pytest

from saflite.flight.autopilots.ardupilot import settings
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle


def test_every_setting_shown_has_its_slot() -> None:
    vehicle = Vehicle(np.zeros((0, 8)), 0.0)
    settings.show(vehicle, {name: 7.0 for shown in settings.SHOWN.values() for name in shown.names})
    for slot, shown in settings.SHOWN.items():
        assert vehicle[slot] == pytest.approx(7.0 * shown.scale), slot
