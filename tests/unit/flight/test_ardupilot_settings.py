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


def test_groups_are_opened_by_their_switches_and_by_what_a_flight_starts_with() -> None:
    known = {"CHUTE_ENABLED": 0.0, "BATT_MONITOR": 0.0, "PRX1_TYPE": 0.0, "RTL_ALT": 1500.0, "FS_THR_ENABLE": 0.0}
    assert settings.opening(known) == {"CHUTE_ENABLED": 1, "FS_THR_ENABLE": 1, "BATT_MONITOR": 4, "PRX1_TYPE": 2}
