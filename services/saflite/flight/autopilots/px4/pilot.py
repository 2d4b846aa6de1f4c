"""A pilot who sees no box and flies a mission's way-points by the sticks, in PX4's position mode.

What keeps the vehicle off boxes then is PX4's own collision prevention, told of them by OBSTACLE_DISTANCE. The pilot
turns the nose to the way-point and pushes the stick towards it, whatever the vehicle makes of that.
"""

from __future__ import annotations

import math
from collections.abc import MutableSequence

from saflite.contract.test_case import Mission
from saflite.flight.autopilots.external.link import CENTRE_US
from saflite.flight.autopilots.px4.legs import Legs, Point
from saflite.flight.autopilots.px4.modes import POSITION
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import Client

ROLL, PITCH, THROTTLE, YAW = range(4)
SWING_US = 500
PUSH = 0.7  # of the stick's way; some 5 m/s with PX4's own curve and speed
SLOW_M = 10.0  # from here on with less, in proportion, to a way-point
AHEAD_RAD = 0.35  # turns first while the nose is off by more
TURN, CLIMB = 1.0, 0.25  # share of the stick's way for a radian, and for a metre
REST_TICKS = 50  # a stick that still moves takes over again
PUSH_LEAST = 0.25  # beyond what PX4 takes for a stick at rest


class Pilot(Legs):
    """Leads by the sticks; `pulses_us` are the radio's channels, pitch below the centre is forward."""

    def __init__(self, mission: Mission, pulses_us: MutableSequence[int], vehicle: Vehicle, client: Client) -> None:
        super().__init__(mission, vehicle, client)
        self._pulses_us = pulses_us

    @property
    def _led(self) -> bool:
        return True

    def _begin(self, here: Point, speed: Point) -> None:
        self._order(POSITION, 0)

    def _let_go(self) -> int:
        self._hold(0.0, 0.0, 0.0)
        return REST_TICKS

    def _lead(self, time_s: float, step_s: float, here: Point, speed: Point) -> None:
        north, east, up = (goal - place for goal, place in zip(self._goal, here, strict=True))
        off_rad = math.remainder(math.atan2(east, north) - self._vehicle["yaw_rad"], math.tau)
        push = min(PUSH, max(PUSH_LEAST, PUSH * math.hypot(north, east) / SLOW_M))
        self._hold(push if abs(off_rad) < AHEAD_RAD else 0.0, TURN * off_rad, CLIMB * up)

    def _hold(self, forward: float, right: float, up: float) -> None:
        for stick, share in ((ROLL, 0.0), (PITCH, -forward), (THROTTLE, up), (YAW, right)):
            self._pulses_us[stick] = round(CENTRE_US + SWING_US * min(1.0, max(-1.0, share)))
