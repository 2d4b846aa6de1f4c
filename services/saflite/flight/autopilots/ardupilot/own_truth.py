"""Truth of a flight on the binary's own physics: its simulator says it over MAVLink, 50 times a second.

It is that of the tick before, as all that is said is. The simulator sets a vehicle on the ground upright and at rest,
however it came down; its word on the touch-down tells a crash, by the limits of our world (`native/world.c`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any

from saflite.flight.autopilots.ardupilot.telemetry import RATES_HZ, Telemetry
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.mission import to_local
from saflite.flight.world.state import CRASHED

OWN_RATES_HZ: dict[str, float] = {**RATES_HZ, "SIM_STATE": 50.0}
SINK_MAX_MPS, UPRIGHT = 3.5, 0.64  # the second a cosine
FLOWN_M = 0.5
_TOUCH_DOWN = re.compile(r"SIM Hit ground at (-?[\d.]+) m/s")


class OwnTruth(Telemetry):
    """Takes the truth, too, from what the simulator says."""

    def __init__(self, vehicle: Vehicle, parameters: Mapping[str, float], home: tuple[float, float, float]) -> None:
        super().__init__(vehicle, parameters, home, OWN_RATES_HZ)
        self.told = False  # whether the build says it: 4.1-dev does not
        self._flew = False  # "taken off" would not do: it ends where the motors are stopped in the air

    def _sim_state(self, message: Any) -> None:
        self.told = True
        x_m, y_m = to_local(message.lat_int * 1e-7, message.lon_int * 1e-7, self._home[0], self._home[1])
        axes = ("roll", "pitch", "yaw")
        degrees = {name: math.degrees(getattr(message, name)) for name in axes}
        for axis, rate_rps in zip(axes, (message.xgyro, message.ygyro, message.zgyro), strict=True):
            self.vehicle.set(**{f"{axis}_rate_rps": rate_rps, f"{axis}_rate_dps": math.degrees(rate_rps)})
        self.vehicle.set(
            x_m=x_m,
            y_m=y_m,
            altitude_m=message.alt - self._home[2],
            vx_mps=message.vn,
            vy_mps=message.ve,
            climb_mps=-message.vd,
            roll_rad=message.roll,
            pitch_rad=message.pitch,
            yaw_rad=message.yaw,
            roll_deg=degrees["roll"],
            pitch_deg=degrees["pitch"],
            yaw_deg=degrees["yaw"] % 360.0,
            force_x_mps2=message.xacc,
            force_y_mps2=message.yacc,
            force_z_mps2=message.zacc,
        )
        self._flew |= self.vehicle["altitude_m"] > FLOWN_M

    def _statustext(self, message: Any) -> None:
        super()._statustext(message)
        touched = _TOUCH_DOWN.match(self.texts[-1].text)
        board = self.vehicle
        if touched is None or not self._flew:
            return
        upright = math.cos(board["roll_rad"]) * math.cos(board["pitch_rad"])
        if float(touched[1]) > SINK_MAX_MPS or upright < UPRIGHT:
            board["world_state"] = CRASHED
