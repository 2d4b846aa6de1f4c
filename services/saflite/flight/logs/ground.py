"""How high a logged vehicle was above the ground under it: a log tells heights above where it began, and no terrain.

What stands keeps its height. So the ground is as high as the vehicle where it counts as standing and does not move, or
where it came to lie after a fall. On the way it is taken to be as high as where the vehicle took off, and from the
highest point of the flight on as where it came down.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_MOVES_M, _WITHIN_S = 1.5, 2.0
"""What moves so far in height stands nowhere; the pressure under propellers that stop moves an estimate by less."""
_WATCHED_S = 3.0  # after the motors stopped: later on somebody may carry it away
_LIES_S = 1.0  # so long without moving after the motors stopped it has not been falling
_AT_REST_S = 5.0  # the ground a vehicle takes off from or comes down to is where it stood so long before or after
_FLIES, _STANDS, _DISARMED = 0, 1, 2


def above_ground(height_m: Array, armed: Array, landed: Array | None, step_s: float) -> Array:
    """Return the height above ground, metres, shape (n,), NaN where the height is not known.

    Args:
        height_m: height above where the log counts from, shape (n,), NaN where not known.
        armed: above 0 while the motors are armed, shape (n,).
        landed: above 0 while the autopilot takes itself to stand, shape (n,); None where it does not say.
        step_s: time between samples.
    """
    stands = np.zeros(len(armed), dtype=np.bool_) if landed is None else landed > 0
    state = np.where(armed > 0, np.where(stands, _STANDS, _FLIES), _DISARMED)
    edges = [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), len(state)]
    watched, rest = round(_WATCHED_S / step_s), round(_AT_REST_S / step_s)
    ground_m = np.zeros(len(height_m))
    below_m, flown_from, until = 0.0, 0, 0
    for number, (start, end) in enumerate(pairwise(edges)):
        if state[start] == _FLIES:
            ground_m[start:end], flown_from = below_m, start
            continue
        until = max(start, until)
        if state[start] == _STANDS or not start or state[start - 1] == _FLIES:
            off = end if state[start] == _STANDS else start
            after = edges[min(number + 2, len(edges) - 1)] if state[start] == _STANDS else end
            until = min(after, off + watched)
            ground_m[start:until] = _under(height_m[start:until], below_m, bool(state[start] == _STANDS), step_s)
            if start and state[start - 1] == _FLIES:
                highest = flown_from + _highest(height_m[flown_from:start])
                ground_m[highest:start] = _middle(ground_m[start : min(until, start + rest)], below_m)
        ground_m[until:end] = height_m[until:end]
        below_m = _middle(height_m[max(start, end - rest) : end], below_m)
    return height_m - ground_m


def _under(height_m: Array, taken_off_m: float, stands: bool, step_s: float) -> Array | float:
    """Return how high the ground is under what does not fly any more, from its heights until the motors are off."""
    span = max(1, min(round(_WITHIN_S / step_s), len(height_m) - 1))
    if len(height_m) > 1 and bool((np.abs(height_m[span:] - height_m[:-span]) > _MOVES_M).any()):
        return float(np.nanmin(height_m))
    return height_m if stands or len(height_m) * step_s >= _LIES_S else taken_off_m


def _highest(height_m: Array) -> int:
    return 0 if np.isnan(height_m).all() else int(np.nanargmax(height_m))


def _middle(height_m: Array, otherwise_m: float) -> float:
    return otherwise_m if np.isnan(height_m).all() else float(np.nanmedian(height_m))
