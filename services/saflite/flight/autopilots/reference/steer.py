"""What modes ask of the control loops (`native/control.c`), in words. Angles in radians, frame north-east, SI units."""

from __future__ import annotations

from saflite.flight.autopilots.reference.vehicle import Vehicle

XY_NONE, XY_VELOCITY, XY_POSITION = 0, 1, 2
Z_THROTTLE, Z_CLIMB, Z_ALTITUDE = 0, 1, 2
ANGLES, RATES = 0, 1
YAW_RATE, YAW_ANGLE = 0, 1


def position(board: Vehicle, north_m: float, east_m: float, speed_max_mps: float) -> None:
    """Go to a place in the plane and stay there."""
    board.set(want_xy=XY_POSITION, want_attitude=ANGLES, set_n=north_m, set_e=east_m, set_vn=0.0, set_ve=0.0)
    board["speed_max"] = speed_max_mps


def velocity(board: Vehicle, north_mps: float, east_mps: float) -> None:
    """Fly at a speed over ground."""
    board.set(want_xy=XY_VELOCITY, want_attitude=ANGLES, set_vn=north_mps, set_ve=east_mps)


def angles(board: Vehicle, roll_rad: float, pitch_rad: float) -> None:
    """Hold an attitude; the position drifts."""
    board.set(want_xy=XY_NONE, want_attitude=ANGLES, set_roll=roll_rad, set_pitch=pitch_rad)


def rates(board: Vehicle, roll_rps: float, pitch_rps: float, yaw_rps: float) -> None:
    """Turn at body rates."""
    board.set(want_xy=XY_NONE, want_attitude=RATES, set_p=roll_rps, set_q=pitch_rps, set_r=yaw_rps)


def altitude(
    board: Vehicle, target_m: float, climb_max_mps: float, descent_max_mps: float, climb_mps: float = 0.0
) -> None:
    """Reach and hold a height above home; `climb_mps` is how fast the target itself moves."""
    board.set(want_z=Z_ALTITUDE, set_altitude=target_m, set_climb=climb_mps)
    board.set(climb_max=climb_max_mps, descent_max=descent_max_mps)


def climb(board: Vehicle, rate_mps: float) -> None:
    """Climb (or sink, negative) at a rate, whatever the height."""
    board.set(want_z=Z_CLIMB, set_climb=rate_mps)


def throttle(board: Vehicle, share: float) -> None:
    """Set the collective directly, 0..1."""
    board.set(want_z=Z_THROTTLE, set_throttle=share)


def yaw_rate(board: Vehicle, rate_rps: float) -> None:
    """Turn at a rate, clockwise positive."""
    board.set(want_yaw=YAW_RATE, set_r=rate_rps)


def heading(board: Vehicle, heading_rad: float) -> None:
    """Turn to a heading."""
    board.set(want_yaw=YAW_ANGLE, set_yaw=heading_rad)
