"""The short form of a flight: named numbers and a track of about one point a second."""

from __future__ import annotations

import math

import numpy as np

from saflite.contract.test_case import TestCase
from saflite.flight.geometry import NO_OBSTACLE_M, boxes_array, distances_to_boxes
from saflite.oracle.behaviour import place_of
from saflite.oracle.signals import FlightSignals

STALL_MPS = 0.3  # slower than this in the plane while up in the air counts as stalled
STALL_ABOVE_M = 2.0
TRACK_STEP_S = 1.0

Track = tuple[tuple[float, float, float, float], ...]


def features_of(test_case: TestCase, signals: FlightSignals) -> dict[str, float]:
    """Return named numbers of a flight; those whose signals are missing are left out, and those
    that come to no finite number.

    duration_s, min_distance_m, closest_time_s, closest_obstacle (index), closest_x_m, closest_y_m, closest_progress
    (share of the path flown before), closest_leg, closest_passed and closest_side (`behaviour.py`), path_length_m,
    stall_s, altitude_max_m, altitude_min_m, climb_max_mps,
    speed_max_mps, tilt_max_deg.
    """
    found = {"duration_s": max(0, signals.samples - 1) * signals.step_s}
    if signals.samples == 0:
        return found
    found.update(_extremes(signals))
    if "x_m" in signals and "y_m" in signals and "altitude_m" in signals:
        found.update(_path(signals))
        found.update(_closest(test_case, signals))
    return {name: value for name, value in found.items() if math.isfinite(value)}


def _extremes(signals: FlightSignals) -> dict[str, float]:
    wanted = {
        "altitude_max_m": ("altitude_m", np.nanmax),
        "altitude_min_m": ("altitude_m", np.nanmin),
        "climb_max_mps": ("climb_mps", np.nanmax),
        "speed_max_mps": ("ground_speed_mps", np.nanmax),
        "tilt_max_deg": ("tilt_deg", np.nanmax),
    }
    known = {name: told for name, told in wanted.items() if told[0] in signals and not np.isnan(signals[told[0]]).all()}
    return {name: float(pick(signals[source])) for name, (source, pick) in known.items()}


def _path(signals: FlightSignals) -> dict[str, float]:
    steps = np.hypot(np.diff(signals["x_m"]), np.diff(signals["y_m"]))
    found = {"path_length_m": float(np.sum(steps, dtype=np.float64))}
    if "ground_speed_mps" in signals:
        still = (signals["ground_speed_mps"] < STALL_MPS) & (signals["altitude_m"] > STALL_ABOVE_M)
        found["stall_s"] = float(np.count_nonzero(still) * signals.step_s)
    return found


def _closest(test_case: TestCase, signals: FlightSignals) -> dict[str, float]:
    distance = signals["obstacle_distance_m"]
    if not test_case.scenario.obstacles:
        return {"min_distance_m": NO_OBSTACLE_M}
    if np.isnan(distance).all():
        return {}
    at = int(np.nanargmin(distance))
    point = np.array([[signals[name][at] for name in ("x_m", "y_m", "altitude_m")]], dtype=np.float64)
    each = distances_to_boxes(point, boxes_array(test_case.scenario.obstacles))[0]
    steps = np.hypot(np.diff(signals["x_m"]), np.diff(signals["y_m"]))
    whole = float(np.sum(steps, dtype=np.float64))
    return {
        "min_distance_m": float(distance[at]),
        "closest_time_s": at * signals.step_s,
        "closest_obstacle": float(int(np.argmin(each))),
        "closest_x_m": float(point[0, 0]),
        "closest_y_m": float(point[0, 1]),
        "closest_progress": float(np.sum(steps[:at], dtype=np.float64)) / whole if whole > 0 else 0.0,
        **place_of(test_case, signals, at),
    }


def track_of(signals: FlightSignals) -> Track:
    """Return (t_s, x_m, y_m, z_m) about once a second, rounded to centimetres; empty without a position."""
    if signals.samples == 0 or not all(name in signals for name in ("x_m", "y_m", "altitude_m")):
        return ()
    stride = max(1, math.floor(TRACK_STEP_S / signals.step_s + 0.5))
    index = np.unique(np.append(np.arange(0, signals.samples, stride), signals.samples - 1))
    places = (np.asarray(signals[name][index], dtype=np.float64) for name in ("x_m", "y_m", "altitude_m"))
    columns = [np.round(place, 2) + 0.0 for place in places]  # no -0.0, which journals would have to keep apart
    times = np.round(index * signals.step_s, 3)
    known = np.isfinite(columns).all(axis=0)
    rows = zip(times[known], *(column[known] for column in columns), strict=True)
    return tuple((float(t), float(x), float(y), float(z)) for t, x, y, z in rows)
