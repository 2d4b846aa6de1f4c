"""How far two tracks are apart in shape: time plays no part, detours do.

The UAV testing competition (SBFT 2024) calls two tests similar by dynamic time warping (Sakoe and Chiba 1978) between
their tracks; its limit is not published. Here tracks are points evenly spaced along the way, and the sum of gaps along
the best alignment is divided by its steps: metres, whatever the length of the flight and however long it hovered.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache

import numpy as np

from saflite.contract.bounds import Track
from saflite.flight.native_library import native_library

POINTS = 64
SAME_SHAPE_M = 5.0
"""Tracks no farther apart than this on average have one shape."""

Shape = bytes
"""`POINTS` places (x, y) in the plane as little-endian doubles; empty without a track."""


def shape_of(track: Track) -> Shape:
    """Return a track as points in the plane (x, y), evenly spaced along the way; empty without a track."""
    if not track:
        return b""
    places = np.array([point[1:3] for point in track], dtype=np.float64)
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(places, axis=0).T)))
    wanted = np.linspace(0.0, float(along[-1]), POINTS)
    columns = [np.round(np.interp(wanted, along, places[:, axis]), 3) for axis in (0, 1)]
    return np.stack(columns, axis=1).astype("<f8").tobytes()


def centre_of(shape: Shape) -> tuple[float, float]:
    """Return the mean place (x, y) of a shape that is not empty, in metres."""
    x, y = np.mean(np.frombuffer(shape, dtype="<f8").reshape(-1, 2), axis=0).tolist()
    return x, y


def gap_m(one: Shape, other: Shape) -> float:
    """Return the mean gap between two shapes along their best alignment; 0 where both are empty."""
    if not one or not other:
        return 0.0 if one == other else float("inf")
    return float(_library().shapes_gap(one, other, float("inf")))


def first_like(shape: Shape, others: Sequence[Shape], limit_m: float = SAME_SHAPE_M) -> int | None:
    """Return the place of the first of the others that is no farther away than `limit_m`; None if all are."""
    if not shape or not all(others):
        return next((place for place, other in enumerate(others) if gap_m(shape, other) <= limit_m), None)
    place = _library().shapes_first_like(shape, b"".join(others), len(others), limit_m)
    return None if place < 0 else int(place)


@cache
def _library() -> ctypes.CDLL:
    library, shape, metres = native_library(), ctypes.c_char_p, ctypes.c_double
    library.shapes_gap.restype, library.shapes_gap.argtypes = metres, (shape, shape, metres)
    library.shapes_first_like.restype = ctypes.c_int
    library.shapes_first_like.argtypes = (shape, shape, ctypes.c_int, metres)
    return library
