"""What a range sensor all round would see of the boxes, as the autopilot takes it: OBSTACLE_DISTANCE, 72 sectors."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

SECTORS, SECTOR_DEG = 72, 5
RANGE_CM, NEAR_CM = 3000, 20
EVERY_TICKS = 5  # 10 Hz
FRAME_BODY = 12  # MAV_FRAME_BODY_FRD
LASER = 0


def distances_cm(boxes: NDArray[np.float64], place: tuple[float, float, float], yaw_rad: float) -> list[int]:
    """Return the way to the nearest box in each sector, centimetres; one more than the range where there is none.

    Args:
        boxes: shape (k, 8), as `flight.geometry.boxes_array` gives them.
        place: north, east, altitude of the sensor, metres.
        yaw_rad: heading; sector 0 looks forward, the next ones to the right.
    """
    clear = [RANGE_CM + 1] * SECTORS
    seen = boxes[(boxes[:, 6] <= place[2]) & (boxes[:, 7] >= place[2])] if len(boxes) else boxes
    if not len(seen):
        return clear
    angles = yaw_rad + np.radians(SECTOR_DEG * np.arange(SECTORS))
    way_m = np.min([_way(box, place, np.cos(angles), np.sin(angles)) for box in seen], axis=0)
    found = np.clip(np.round(100.0 * np.minimum(way_m, 1e4)), NEAR_CM, RANGE_CM + 1)
    return [int(value) for value in found]


def _way(
    box: NDArray[np.float64], place: tuple[float, float, float], north: NDArray[np.float64], east: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the way along each ray to one box, inf where it misses (slab method in the frame of the box)."""
    dx, dy, cos, sin = place[0] - box[0], place[1] - box[1], box[4], box[5]
    enter, leave = np.full(len(north), 0.0), np.full(len(north), math.inf)
    for start, slope, half in (
        (dx * cos + dy * sin, north * cos + east * sin, box[2]),
        (dy * cos - dx * sin, east * cos - north * sin, box[3]),
    ):
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (-half - start) / slope, (half - start) / slope
        beside = np.abs(slope) < 1e-12
        low = np.where(beside, -math.inf if abs(start) <= half else math.inf, np.minimum(one, two))
        high = np.where(beside, math.inf if abs(start) <= half else -math.inf, np.maximum(one, two))
        enter, leave = np.maximum(enter, low), np.minimum(leave, high)
    return np.where(enter <= leave, enter, math.inf)


def send(
    mav: Any, time_s: float, boxes: NDArray[np.float64], place: tuple[float, float, float], yaw_rad: float
) -> None:
    """Queue one scan on a pymavlink link."""
    mav.obstacle_distance_send(
        round(time_s * 1e6),
        LASER,
        distances_cm(boxes, place, yaw_rad),
        SECTOR_DEG,
        NEAR_CM,
        RANGE_CM,
        float(SECTOR_DEG),
        0.0,
        FRAME_BODY,
    )
