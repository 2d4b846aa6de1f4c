"""What stands around in a recording: boxes, safety shells, the mission, the path flown, the closest point."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
from foxglove_schemas_protobuf.CylinderPrimitive_pb2 import CylinderPrimitive
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.SpherePrimitive_pb2 import SpherePrimitive
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import NDArray

from saflite.contract.test_case import Obstacle
from saflite.recorder import frames

SAFE_DISTANCE_M = 1.5  # the competition's soft limit; the shell drawn around every box
_BOX = (0.55, 0.57, 0.62, 0.9)
_SHELL = (0.95, 0.65, 0.15, 0.18)
_MISSION = (0.25, 0.55, 0.95, 1.0)
_PATH = (0.2, 0.75, 0.45, 1.0)
_BODY = (0.15, 0.17, 0.2, 1.0)
_TOO_CLOSE = (0.9, 0.2, 0.25, 1.0)

Rgba = tuple[float, float, float, float]
Place = tuple[float, float, float]  # north, east, up in metres


def scene(stamp: Timestamp, entities: Iterable[SceneEntity]) -> SceneUpdate:
    """Return the entities as one update; they stay until replaced."""
    update = SceneUpdate()
    for entity in entities:
        entity.timestamp.CopyFrom(stamp)
        entity.frame_id = frames.MAP
        update.entities.append(entity)
    return update


def obstacles(boxes: Sequence[Obstacle]) -> list[SceneEntity]:
    """Return one entity per box: the box as it is seen, its safety shell, its number."""
    return [_obstacle(number, box) for number, box in enumerate(boxes, start=1)]


def _obstacle(number: int, box: Obstacle) -> SceneEntity:
    entity = SceneEntity(id=f"obstacle-{number}")
    rotation = frames.turned(math.pi / 2 - math.radians(box.rotation_deg))
    middle = frames.pose(box.x_m, box.y_m, box.z_m + box.height_m / 2, rotation)
    entity.cubes.append(_cube(middle, box.length_m, box.width_m, box.height_m, _BOX))
    grown = 2 * SAFE_DISTANCE_M
    entity.cubes.append(_cube(middle, box.length_m + grown, box.width_m, box.height_m, _SHELL))
    entity.cubes.append(_cube(middle, box.length_m, box.width_m + grown, box.height_m, _SHELL))
    for along, across in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        entity.cylinders.append(_corner(box, along * box.length_m / 2, across * box.width_m / 2))
    label = frames.pose(box.x_m, box.y_m, box.z_m + box.height_m + 1.0)
    entity.texts.append(TextPrimitive(pose=label, billboard=True, font_size=1.5, color=_colour(_BOX), text=str(number)))
    return entity


def _cube(middle: Pose, length_m: float, width_m: float, height_m: float, rgba: Rgba) -> CubePrimitive:
    return CubePrimitive(pose=middle, size=Vector3(x=length_m, y=width_m, z=height_m), color=_colour(rgba))


def _corner(box: Obstacle, along_m: float, across_m: float) -> CylinderPrimitive:
    turn = math.radians(box.rotation_deg)
    x_m = box.x_m + along_m * math.cos(turn) - across_m * math.sin(turn)
    y_m = box.y_m + along_m * math.sin(turn) + across_m * math.cos(turn)
    return CylinderPrimitive(
        pose=frames.pose(x_m, y_m, box.z_m + box.height_m / 2),
        size=Vector3(x=2 * SAFE_DISTANCE_M, y=2 * SAFE_DISTANCE_M, z=box.height_m),
        bottom_scale=1.0,
        top_scale=1.0,
        color=_colour(_SHELL),
    )


def mission(places: Sequence[Place]) -> list[SceneEntity]:
    """Return the mission's line and way-points; nothing for a flight without a mission."""
    if not places:
        return []
    entity = SceneEntity(id="mission")
    entity.lines.append(_line(places, _MISSION, 0.15))
    for place in places:
        size = Vector3(x=0.8, y=0.8, z=0.8)
        entity.spheres.append(SpherePrimitive(pose=frames.pose(*place), size=size, color=_colour(_MISSION)))
    return [entity]


def path(track: NDArray[np.float32], distance_m: NDArray[np.float32] | None) -> list[SceneEntity]:
    """Return the path flown, shape (n, 3) north, east, up; red where closer than the safe distance."""
    if len(track) < 2:
        return []
    entity = SceneEntity(id="path")
    line = _line([(float(x), float(y), float(z)) for x, y, z in track], _PATH, 0.2)
    if distance_m is not None:
        for metres in distance_m:
            line.colors.append(_colour(_TOO_CLOSE if metres < SAFE_DISTANCE_M else _PATH))
    entity.lines.append(line)
    return [entity]


def closest(place: Place, text: str) -> SceneEntity:
    """Return a marker where the vehicle came closest, with a text."""
    entity = SceneEntity(id="closest")
    size = Vector3(x=1.0, y=1.0, z=1.0)
    entity.spheres.append(SpherePrimitive(pose=frames.pose(*place), size=size, color=_colour(_TOO_CLOSE)))
    label = frames.pose(place[0], place[1], place[2] + 2.0)
    entity.texts.append(TextPrimitive(pose=label, billboard=True, font_size=1.2, color=_colour(_TOO_CLOSE), text=text))
    return entity


def vehicle(stamp: Timestamp) -> SceneEntity:
    """Return the vehicle itself, fixed to its own frame: a body, four rotors, a mark for the nose."""
    entity = SceneEntity(id="vehicle", timestamp=stamp, frame_id=frames.VEHICLE, frame_locked=True)
    entity.cubes.append(_cube(frames.pose(0.0, 0.0, 0.0), 0.35, 0.2, 0.12, _BODY))
    nose = frames.pose(0.0, 0.25, 0.0)
    entity.cubes.append(_cube(nose, 0.15, 0.06, 0.06, _TOO_CLOSE))
    for forward, left in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        rotor = CylinderPrimitive(
            pose=frames.pose(0.25 * left, 0.25 * forward, 0.05),
            size=Vector3(x=0.3, y=0.3, z=0.03),
            bottom_scale=1.0,
            top_scale=1.0,
            color=_colour(_BODY),
        )
        entity.cylinders.append(rotor)
    return entity


def _line(places: Iterable[Place], rgba: Rgba, thickness_m: float) -> LinePrimitive:
    line = LinePrimitive(type=LinePrimitive.LINE_STRIP, pose=frames.pose(0.0, 0.0, 0.0), thickness=thickness_m)
    line.points.extend(frames.point(*place) for place in places)
    line.color.CopyFrom(_colour(rgba))
    return line


def _colour(rgba: Rgba) -> Color:
    red, green, blue, alpha = rgba
    return Color(r=red, g=green, b=blue, a=alpha)
