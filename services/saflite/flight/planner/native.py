"""The compiled library of the flight layer and the argument types of the planner's entry points."""

from __future__ import annotations

import ctypes
from functools import cache

import numpy as np
from numpy.typing import NDArray

from saflite.flight.native_library import native_library

POINTER = ctypes.c_void_p
INT = ctypes.c_int

_SIGNATURES: dict[str, tuple[object, tuple[object, ...]]] = {
    "planner_state_size": (ctypes.c_size_t, ()),
    "planner_init": (None, (POINTER, POINTER)),
    "planner_step": (None, (POINTER, POINTER, POINTER, INT, POINTER)),
    "planner_path": (INT, (POINTER, POINTER, INT)),
    "planner_probe_cast": (INT, (POINTER, POINTER, ctypes.c_double, POINTER, INT, POINTER, INT)),
    "planner_probe_histogram": (None, (POINTER, POINTER, INT, POINTER, POINTER)),
    "planner_probe_costs": (None, (POINTER, POINTER, INT, POINTER, POINTER, POINTER, POINTER, POINTER)),
    "boxes_distances": (None, (POINTER, INT, POINTER, INT, POINTER)),
    "follower_start": (None, (POINTER, POINTER, POINTER)),
    "follower_leg": (None, (POINTER, POINTER, POINTER, POINTER, ctypes.c_double)),
    "follower_step": (None, (POINTER, POINTER, POINTER, POINTER, POINTER, POINTER, ctypes.c_double)),
    "kinematic_fly": (
        None,
        (POINTER, POINTER, POINTER, POINTER, INT, POINTER, INT, ctypes.c_uint64, POINTER, INT, POINTER),
    ),
}


@cache
def library() -> ctypes.CDLL:
    """Return the compiled library; raises Unavailable if it was not built from the sources beside it."""
    loaded = native_library()
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(loaded, name)
        function.restype, function.argtypes = result, arguments
    return loaded


def block() -> NDArray[np.uint64]:
    """Return fresh memory for one planner's state, aligned to eight bytes."""
    return np.zeros((library().planner_state_size() + 7) // 8, dtype=np.uint64)


def rows(values: NDArray[np.float64], width: int) -> NDArray[np.float64]:
    """Return `values` as (n, width) doubles, contiguous as C wants them."""
    return np.ascontiguousarray(values, dtype=np.float64).reshape(-1, width)
