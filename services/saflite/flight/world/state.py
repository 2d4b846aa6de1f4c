"""The truth of the world at one moment, as `native/world.h` lists it."""

from __future__ import annotations

from typing import NamedTuple

STEP_S = 0.0025
STANDING, FLYING, CRASHED, FROZEN = 0.0, 1.0, 2.0, 3.0


class WorldState(NamedTuple):
    """Rates and forces are fresh at every step, the rest every `steps_per_state` steps.

    Positions count from the take-off point: x north, y east, altitude up; body axes are forward, right, down. Forces
    are what an accelerometer in the centre of gravity feels. `world_state` is STANDING, FLYING, CRASHED or FROZEN.
    """

    roll_rate_rps: float
    pitch_rate_rps: float
    yaw_rate_rps: float
    force_x_mps2: float
    force_y_mps2: float
    force_z_mps2: float
    x_m: float
    y_m: float
    altitude_m: float
    vx_mps: float
    vy_mps: float
    climb_mps: float
    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    time_s: float
    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    roll_rate_dps: float
    pitch_rate_dps: float
    yaw_rate_dps: float
    obstacle_distance_m: float
    contact: float
    world_state: float
    command_1: float
    command_2: float
    command_3: float
    command_4: float
    motor_1: float
    motor_2: float
    motor_3: float
    motor_4: float
    motor_failed: float
    motor_failed_share: float
    chute_released: float
    step: float
