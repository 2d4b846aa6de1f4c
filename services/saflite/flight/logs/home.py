"""Where home is over a log: orders move it, arming does, and PX4 by itself."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.flight.logs.dataflash_rows import Rows
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.topics import Topics, field, held
from saflite.flight.mission import to_local

Place = tuple[float, float]
"""Latitude and longitude, degrees."""


class Homes(NamedTuple):
    """Where home is from each time on, metres north, east and up in the frame of the logged positions, shape (n,) each.

    `up_m` is NaN where it is not told.
    """

    at_s: NDArray[np.float64]
    x_m: NDArray[np.float64]
    y_m: NDArray[np.float64]
    up_m: NDArray[np.float64]


def add_home(columns: Columns, homes: Homes | None) -> None:
    """Add the distance to home, and have heights of settings count from it; nothing where home is not told."""
    x, y = columns.get("x_m"), columns.get("y_m")
    if homes is None or x is None or y is None:
        return
    at_s, north = x
    east = np.interp(at_s, *y)
    apart = north - held((homes.at_s, homes.x_m), at_s), east - held((homes.at_s, homes.y_m), at_s)
    columns.add("home_distance_m", at_s, np.hypot(*apart))
    if np.isfinite(homes.up_m).all():
        columns.home_up = homes.at_s, homes.up_m


def homes_of_ardupilot(rows: Rows, frame: Place | None) -> Homes | None:
    """Return where home was by ORGN, of type 0 (origin of the filter) and 1 (home); None if it does not say.

    Args:
        rows: the messages of the log.
        frame: the place from which logged positions count; None if that is the origin of the filter.
    """
    home, zero, zero_up_m = None, frame, np.nan
    found = []
    for at_s, row in rows["ORGN"]:
        if not {"Type", "Lat", "Lng"} <= row.keys():
            continue
        if row["Type"] == 0 and frame is None:
            zero, zero_up_m = (row["Lat"], row["Lng"]), row.get("Alt", np.nan)
        elif row["Type"] == 1:
            home = row
        if home is not None and zero is not None:
            x_m, y_m = to_local(home["Lat"], home["Lng"], *zero)
            found.append((at_s, x_m, y_m, home.get("Alt", np.nan) - zero_up_m))
    return Homes(*np.array(found).T) if found else None


def homes_of_px4(topics: Topics, frame: Place | None) -> Homes | None:
    """Return where home was by home_position; None if it does not say.

    Args:
        topics: those of the log.
        frame: the place from which logged positions count, with heights above sea; None if positions are those of
            vehicle_local_position.
    """
    names = ("x", "y", "z") if frame is None else ("lat", "lon", "alt")
    told = [column for name in names if (column := field(topics, "home_position", name)) is not None]
    if len(told) < len(names):
        return None
    at_s, (x_m, y_m, up_m) = told[0][0], (values for _, values in told)
    good = np.isfinite([x_m, y_m, up_m]).all(axis=0)
    for name in ("valid_lpos",) if frame is None else ("valid_hpos", "valid_alt"):
        valid = field(topics, "home_position", name)
        good &= True if valid is None else valid[1] > 0
    if not good.any():
        return None
    if frame is not None:
        x_m, y_m = np.array([to_local(*place, *frame) for place in zip(x_m, y_m, strict=True)]).T
    return Homes(at_s[good], x_m[good], y_m[good], up_m[good] if frame else -up_m[good])
