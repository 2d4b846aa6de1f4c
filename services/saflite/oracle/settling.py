"""How fast a vehicle can be asked to lose its speed, whatever mode it is in, by the settings in force.

A rule that is about a vehicle at rest must first give it the time to come to rest. How much that is no constant can
say: at 20 m/s with WPNAV_ACCEL 100 the vehicle needs 20 s and 200 m, and then the time to come back.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

GRAVITY_MPS2 = 9.80665
SHARE = 0.5
"""Of what the settings give: the lean follows late, wind takes some of it, and the speed loop nears its aim slowly."""
LEAN_S = 1.25  # a vehicle that leans goes on gaining speed until it has been levelled
RETURN_MPS = 3.0  # LAND comes back to the place of its entry at 3 m/s, CIRCLE to its circle at 5 m/s
LEAST_MPS2 = 0.1  # the excuse stays bounded where a setting leaves no lean at all
AHEAD_S = 30.0
"""A stop may still be under way this long after it began: a setting that brakes less, given until then, counts."""


def least_ahead(values: NDArray[Any], times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the least of a setting within `AHEAD_S` from each moment on, shape (moments,)."""
    least = np.array(values, dtype=np.float64)
    for at in np.flatnonzero(np.diff(values)) + 1:
        until = (times < times[at]) & (times >= times[at] - AHEAD_S)
        least[until] = np.minimum(least[until], values[at])
    return least


def braking_mps2(acceleration_mps2: NDArray[Any], lean_deg: NDArray[Any]) -> NDArray[np.float64]:
    """Return the deceleration that can be asked of the vehicle, shape (moments,), m/s².

    Args:
        acceleration_mps2: greatest acceleration set for autonomous modes.
        lean_deg: greatest true lean: what is set, less what the board is said to be mounted askew.
    """
    lean_rad = np.radians(np.clip(np.asarray(lean_deg, dtype=np.float64), 0.0, 80.0))
    greatest = np.minimum(np.asarray(acceleration_mps2, dtype=np.float64), GRAVITY_MPS2 * np.tan(lean_rad))
    return np.asarray(np.maximum(SHARE * greatest, LEAST_MPS2))


def settling(speed_mps: NDArray[Any], tilt_deg: NDArray[Any], braking: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Return `stopping_s` and `settling_s`, shape (moments,), from the speed in the plane and what brakes it, m/s².

    The lean, in degrees, makes it faster before it can be slower.
    """
    lean_rad = np.radians(np.clip(tilt_deg, 0.0, 60.0))
    speed_mps = speed_mps + LEAN_S * GRAVITY_MPS2 * np.tan(lean_rad)
    stopping_s = speed_mps / braking
    return {"stopping_s": stopping_s, "settling_s": stopping_s * (1.0 + speed_mps / (2.0 * RETURN_MPS))}
