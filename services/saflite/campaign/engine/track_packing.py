"""Tracks of flights as the journal keeps them: whole milliseconds and centimetres, as steps from one to the next.

A track is told about once a second, in seconds to three and metres to two decimals: as floating-point numbers it is
most of a judgement. Column by column, as steps, it takes a tenth of that, and comes back bit by bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Track = tuple[tuple[float, float, float, float], ...]
SCALE = np.array([1000.0, 100.0, 100.0, 100.0])  # of t_s, x_m, y_m, z_m
WHOLE_MAX = 2.0**30
_SHORT, _LONG = b"h", b"i"  # which whole numbers follow, as in `struct`
_SHORT_MAX = 2**15 - 1


def pack_track(track: Track) -> bytes:
    """Return a track as bytes, empty where it would not come back bit by bit."""
    if not track:
        return b""
    values = np.array(track, dtype=np.float64)
    scaled = np.rint(values * SCALE)
    if not (np.abs(scaled) < WHOLE_MAX).all():
        return b""
    whole: NDArray[np.int64] = scaled.astype(np.int64)
    if (whole / SCALE).tobytes() != values.tobytes():
        return b""
    steps = np.diff(whole, axis=0, prepend=0).T
    short = bool(np.abs(steps).max() <= _SHORT_MAX)
    return (_SHORT if short else _LONG) + steps.astype("<i2" if short else "<i4").tobytes()


def unpack_track(data: bytes) -> Track:
    """Return the track in `data`; raises ValueError if there is none."""
    kinds = {_SHORT: "<i2", _LONG: "<i4"}
    if data[:1] not in kinds:
        raise ValueError("a packed track of an unknown kind")
    steps = np.frombuffer(data[1:], dtype=kinds[data[:1]]).reshape(4, -1).astype(np.int64)
    return tuple((t_s, x_m, y_m, z_m) for t_s, x_m, y_m, z_m in (np.cumsum(steps, axis=1).T / SCALE).tolist())
