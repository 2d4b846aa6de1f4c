"""Truth of a flight on PX4's own physics (SIH): it says it over MAVLink, 50 times a second, with its motor commands.

It is that of a tick before, as all that is said is. SIH stops what falls on the ground at once, however it came down;
the last word before tells a crash, by the limits of our world (`native/world.c`). Boxes are ours: its physics feels
none, so the first contact ends the flight.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from saflite.flight.autopilots.px4.telemetry import RATES_HZ, Telemetry
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.mavlink.client import Client
from saflite.flight.mission import to_local
from saflite.flight.world.state import CRASHED

TOLD_HZ = 50.0
OWN_RATES_HZ: dict[str, float] = {**RATES_HZ, "HIL_STATE_QUATERNION": TOLD_HZ, "HIL_ACTUATOR_CONTROLS": TOLD_HZ}
SINK_MAX_MPS, UPRIGHT = 3.5, 0.64  # the second a cosine
LOW_M, FLOWN_M = 0.05, 0.5
ARMED, MOTORS = 128, 4
_AXES = ("roll", "pitch", "yaw")


class OwnTruth(Telemetry):
    """Takes the truth, too, from what the simulator inside says."""

    def __init__(
        self, vehicle: Vehicle, client: Client, parameters: Mapping[str, float], home: tuple[float, float, float]
    ) -> None:
        super().__init__(vehicle, client, parameters, home, OWN_RATES_HZ)
        self._own = vehicle
        self._flew = False  # "taken off" would not do: it ends where the motors are stopped in the air

    def _hil_state_quaternion(self, message: Any) -> None:
        board = self._own
        sank_mps, was_upright = -board["climb_mps"], math.cos(board["roll_rad"]) * math.cos(board["pitch_rad"])
        was_low = board["altitude_m"] <= LOW_M
        x_m, y_m = to_local(message.lat * 1e-7, message.lon * 1e-7, self._home[0], self._home[1])
        angles = dict(zip(_AXES, euler(message.attitude_quaternion), strict=True))
        rates = dict(zip(_AXES, (message.rollspeed, message.pitchspeed, message.yawspeed), strict=True))
        board.set(**{f"{axis}_rad": angle for axis, angle in angles.items()})
        board.set(**{f"{axis}_rate_rps": rate for axis, rate in rates.items()})
        board.set(x_m=x_m, y_m=y_m, altitude_m=message.alt * 1e-3 - self._home[2])
        board.set(vx_mps=message.vx * 1e-2, vy_mps=message.vy * 1e-2, climb_mps=-message.vz * 1e-2)
        board.follow()
        self._flew |= board["altitude_m"] > FLOWN_M
        touched = self._flew and board["altitude_m"] <= LOW_M and not was_low
        if touched and (sank_mps > SINK_MAX_MPS or was_upright < UPRIGHT):
            board["world_state"] = CRASHED

    def _hil_actuator_controls(self, message: Any) -> None:
        armed = message.mode & ARMED != 0
        given = [control if armed and control > 0.0 else 0.0 for control in message.controls[:MOTORS]]
        self._own.set(**{f"command_{number}": value for number, value in enumerate(given, 1)})
        self._own.set(armed=float(armed), throttle=sum(given) / MOTORS)


def euler(quaternion: tuple[float, float, float, float]) -> tuple[float, float, float]:
    """Return roll, pitch and yaw in rad of a rotation from body to north, east, down (w, x, y, z)."""
    w, x, y, z = quaternion
    pitch = math.asin(min(1.0, max(-1.0, 2.0 * (w * y - z * x))))
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        pitch,
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )
