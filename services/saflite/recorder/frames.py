"""From the competition's frame to the right-handed one Foxglove draws in.

The competition's frame (x north, y east, z up) is left-handed. Recordings use `map`: x east, y north, z up (ENU), the
origin at take-off; the body frame is x forward, y left, z up (REP 103).
"""

from __future__ import annotations

import math

from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

MAP, VEHICLE = "map", "vehicle"


def point(x_m: float, y_m: float, z_m: float) -> Point3:
    """Return a place given north, east, up."""
    return Point3(x=y_m, y=x_m, z=z_m)


def turned(turn_rad: float) -> Quaternion:
    """Return a turn about the vertical, counter-clockwise seen from above."""
    return Quaternion(x=0.0, y=0.0, z=math.sin(turn_rad / 2), w=math.cos(turn_rad / 2))


def heading(yaw_deg: float) -> float:
    """Return the turn in radians, counter-clockwise from east, of a compass heading."""
    return math.radians(90.0 - yaw_deg)


def attitude(roll_deg: float, pitch_deg: float, yaw_deg: float) -> Quaternion:
    """Return the rotation body (forward, left, up) to map of an attitude in aircraft angles (pitch up positive).

    All numbers are NaN where an angle is no finite number.
    """
    if not all(map(math.isfinite, (roll_deg, pitch_deg, yaw_deg))):
        return Quaternion(x=math.nan, y=math.nan, z=math.nan, w=math.nan)
    roll, pitch, yaw = math.radians(roll_deg) / 2, -math.radians(pitch_deg) / 2, heading(yaw_deg) / 2
    cr, sr, cp, sp, cy, sy = (
        math.cos(roll),
        math.sin(roll),
        math.cos(pitch),
        math.sin(pitch),
        math.cos(yaw),
        math.sin(yaw),
    )
    x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    z, w = cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy
    return Quaternion(x=_coarse(x), y=_coarse(y), z=_coarse(z), w=_coarse(w))


def _coarse(part: float) -> float:
    """Return a part of a rotation to 1/32768, about 0.004 degrees: short binary fractions pack well."""
    return round(part * 32768) / 32768


def pose(x_m: float, y_m: float, z_m: float, rotation: Quaternion | None = None) -> Pose:
    """Return a pose given north, east, up."""
    place = Vector3(x=y_m, y=x_m, z=z_m)
    return Pose(position=place, orientation=rotation or Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
