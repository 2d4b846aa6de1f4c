"""Where the terrain data that an ArduCopter flies by put the ground higher than it is taken to be here.

It slows down in landings by the height above that ground (TERR.CHeight), right or wrong, so the height at which it is
set to (LAND_ALT_LOW) cannot be compared with that above home.
"""

from __future__ import annotations

import numpy as np

from saflite.flight.logs.dataflash_rows import Rows
from saflite.flight.logs.resample import Columns
from saflite.flight.logs.topics import held

_LOADED = 2  # TERR.Status: what lies around the vehicle is known
_SAME_M = 2.0  # a slope, or what home is off
_SETTING = "land_altitude_low_set_m"


def forget_by_terrain(rows: Rows, columns: Columns) -> None:
    """Have the height at which a landing slows down not be known while the ground is said to be nearer."""
    told = [
        (at_s, float(row["CHeight"]))
        for at_s, row in rows["TERR"]
        if row.get("Status") == _LOADED and isinstance(row.get("CHeight"), (int, float))
    ]
    setting, height = columns.get(_SETTING), columns.get("altitude_m")
    if not told or setting is None or height is None:
        return
    at_s, above_m = np.array(told, dtype=np.float64).T
    nearer = above_m < np.interp(at_s, *height) - _SAME_M
    times = np.union1d(setting[0], at_s)
    since = np.searchsorted(at_s, times, side="right") - 1
    unknown = (since >= 0) & nearer[np.maximum(since, 0)]
    columns.hold(_SETTING, times, np.where(unknown, np.nan, held(setting, times)))
