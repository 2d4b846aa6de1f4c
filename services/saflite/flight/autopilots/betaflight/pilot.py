"""A pilot who sees the vehicle: takes off, keeps it over its place, and lets go of a stick that the test case takes."""

from __future__ import annotations

from saflite.flight.autopilots.betaflight.configuration import HOVER_US
from saflite.flight.autopilots.betaflight.switches import CENTRE_US, IDLE_US, PITCH, ROLL, YAW
from saflite.flight.autopilots.betaflight.vehicle import Vehicle


class Pilot:
    """Moves the sticks so that the vehicle stays at (0, 0, `altitude_m`) heading north (`native/pilot.c`)."""

    def __init__(self, vehicle: Vehicle, altitude_m: float) -> None:
        self._vehicle, self.altitude_m = vehicle, altitude_m
        self.taken: set[int] = set()

    def move(self) -> None:
        """Move each stick that is the pilot's; a height or place that the autopilot holds needs no hand."""
        self._vehicle.move_sticks(self.altitude_m, HOVER_US, sum(1 << channel - 1 for channel in self.taken))


def hands_off(vehicle: Vehicle) -> None:
    """Centre the sticks, throttle down, all switches off."""
    for channel in range(1, 17):
        vehicle[f"rc_{channel}"] = CENTRE_US if channel in (ROLL, PITCH, YAW) else IDLE_US
