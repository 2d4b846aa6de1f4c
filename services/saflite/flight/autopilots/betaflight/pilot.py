"""A pilot who sees the vehicle: takes off, keeps it over its place, and lets go of a stick that the test case takes."""

from __future__ import annotations

import math

from saflite.flight.autopilots.betaflight.configuration import HOVER_US
from saflite.flight.autopilots.betaflight.switches import CENTRE_US, IDLE_US, PITCH, ROLL, THROTTLE, YAW
from saflite.flight.autopilots.betaflight.vehicle import Vehicle

CLIMB_MAX_MPS, DESCENT_MAX_MPS = 3.0, 1.5
CLIMB_PER_M, US_PER_MPS, US_PER_MPS2 = 1.0, 90.0, 8.0
LEAN_PER_M, LEAN_PER_MPS, LEAN_MAX_DEG, US_PER_DEG = 2.0, 5.0, 15.0, 8.3
YAW_US_PER_DEG, YAW_MAX_US = 2.0, 60.0
STEP_S = 0.02


class Pilot:
    """Moves the sticks so that the vehicle stays at (0, 0, `altitude_m`) heading north."""

    def __init__(self, vehicle: Vehicle, altitude_m: float) -> None:
        self._vehicle, self.altitude_m = vehicle, altitude_m
        self.taken: set[int] = set()
        self._trim_us = 0.0

    def move(self, height_held: bool, place_held: bool) -> None:
        """Move each stick that is the pilot's; a height or place that the autopilot holds needs no hand."""
        self._throttle(height_held)
        roll_deg, pitch_deg = (0.0, 0.0) if place_held else self._lean()
        self._put(ROLL, CENTRE_US + US_PER_DEG * roll_deg)
        self._put(PITCH, CENTRE_US + US_PER_DEG * pitch_deg)
        off_deg = (self._vehicle["yaw_deg"] + 180.0) % 360.0 - 180.0
        turn_us = 0.0 if place_held else min(YAW_MAX_US, max(-YAW_MAX_US, -YAW_US_PER_DEG * off_deg))
        self._put(YAW, CENTRE_US + turn_us)

    def _throttle(self, height_held: bool) -> None:
        if height_held:
            self._put(THROTTLE, HOVER_US)
            return
        board = self._vehicle
        wanted_mps = CLIMB_PER_M * (self.altitude_m - board["altitude_m"])
        off_mps = min(CLIMB_MAX_MPS, max(-DESCENT_MAX_MPS, wanted_mps)) - board["climb_mps"]
        self._trim_us = min(80.0, max(-80.0, self._trim_us + US_PER_MPS2 * off_mps * STEP_S))
        self._put(THROTTLE, min(1800.0, max(1150.0, HOVER_US + self._trim_us + US_PER_MPS * off_mps)))

    def _lean(self) -> tuple[float, float]:
        """Return roll (right) and nose-down angles against the way to the place, degrees."""
        board = self._vehicle
        north = -LEAN_PER_M * board["x_m"] - LEAN_PER_MPS * board["vx_mps"]
        east = -LEAN_PER_M * board["y_m"] - LEAN_PER_MPS * board["vy_mps"]
        size = math.hypot(north, east)
        share = min(1.0, LEAN_MAX_DEG / size) if size else 1.0
        cos_yaw, sin_yaw = math.cos(board["yaw_rad"]), math.sin(board["yaw_rad"])
        return share * (east * cos_yaw - north * sin_yaw), share * (north * cos_yaw + east * sin_yaw)

    def _put(self, channel: int, pulse_us: float) -> None:
        if channel not in self.taken:
            self._vehicle[f"rc_{channel}"] = float(round(pulse_us))


def hands_off(vehicle: Vehicle) -> None:
    """Centre the sticks, throttle down, all switches off."""
    for channel in range(1, 17):
        vehicle[f"rc_{channel}"] = CENTRE_US if channel in (ROLL, PITCH, YAW) else IDLE_US
