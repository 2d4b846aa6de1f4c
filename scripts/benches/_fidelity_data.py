"""The real flights and simulations a world is compared with, and the fixed split into two halves."""

from __future__ import annotations

import csv
import hashlib
import math
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import Obstacle
from saflite.flight.geometry import boxes_array

DATA = Path(__file__).resolve().parent / "data"
UNKNOWN_HEIGHT_M = 20.0
HALVES = ("fit", "report", "all")
Array = NDArray[np.float64]


class Layout(NamedTuple):
    """One unique layout of the simulations: the mean of the distances found for it; `name` is the hash of its boxes."""

    name: str
    obstacles: tuple[Obstacle, ...]
    boxes: Array
    min_distance_m: float
    half: str


class RealFlight(NamedTuple):
    """One real flight; `track` has rows t (s), x, y, z (m)."""

    name: str
    tool: str
    mission: str
    min_distance_m: float
    duration_s: float
    obstacles: tuple[Obstacle, ...]
    boxes: Array
    track: Array
    half: str


def _name_of(key: str) -> str:
    return hashlib.sha256(key.encode()).hexdigest()[:12]


def half_of(key: str) -> str:
    """Return the half a layout belongs to, by the hash of its text: never by hand."""
    return "fit" if hashlib.sha256(key.encode()).digest()[0] % 2 == 0 else "report"


def _rows(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _obstacle(row: dict[str, str], mark: str = "") -> Obstacle:
    def number(name: str, unit: str) -> float:
        return float(row[f"{name}{mark}_{unit}"] or "nan")

    height_m = number("height", "m")
    return Obstacle(
        length_m=number("length", "m"),
        width_m=number("width", "m"),
        height_m=UNKNOWN_HEIGHT_M if math.isnan(height_m) else height_m,
        x_m=number("x", "m"),
        y_m=number("y", "m"),
        rotation_deg=number("rotation", "deg"),
    )


def layouts() -> list[Layout]:
    """Return the simulated layouts, each once."""
    found: dict[str, list[float]] = defaultdict(list)
    boxes: dict[str, tuple[Obstacle, ...]] = {}
    for row in _rows("opt_simulations.csv"):
        key = ",".join(value for name, value in row.items() if name != "min_distance_m")
        found[key].append(float(row["min_distance_m"]))
        boxes[key] = (_obstacle(row, "1"), _obstacle(row, "2"))
    return [
        Layout(_name_of(key), boxes[key], boxes_array(boxes[key]), float(np.mean(found[key])), half_of(key))
        for key in found
    ]


def real_flights() -> list[RealFlight]:
    """Return the real flights with their boxes and tracks."""
    obstacles: dict[str, list[Obstacle]] = defaultdict(list)
    texts: dict[str, str] = defaultdict(str)
    tracks: dict[str, list[list[float]]] = defaultdict(list)
    for row in _rows("real_obstacles.csv"):
        obstacles[row["flight"]].append(_obstacle(row))
        texts[row["flight"]] += ",".join(list(row.values())[1:])
    for row in _rows("real_tracks.csv"):
        tracks[row["flight"]].append([float(row[name]) for name in ("t_s", "x_m", "y_m", "z_m")])
    return [
        RealFlight(
            name=row["flight"],
            tool=row["tool"],
            mission=f"mission{row['mission']}",
            min_distance_m=float(row["printed_distance_m"]),
            duration_s=float(row["duration_s"]),
            obstacles=tuple(obstacles[row["flight"]]),
            boxes=boxes_array(obstacles[row["flight"]]),
            track=np.array(tracks[row["flight"]]),
            half=half_of(texts[row["flight"]]),
        )
        for row in _rows("real_flights.csv")
    ]
