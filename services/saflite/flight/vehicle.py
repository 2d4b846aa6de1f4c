"""The vehicle's blackboard: sensors, estimator and control in C (`native/vehicle.h`), shared with the modes in Python.

`board["est_n"]` reads and writes a slot; the names come from the C side.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saflite.contract.rng import derive_seed
from saflite.flight.native_library import python_library

STEP_S = 0.0025
STREAMS = ("imu", "baro", "gps", "compass")
Getter = Callable[[], float]
Setter = Callable[[float], object]


@cache
def _library() -> ctypes.PyDLL:
    library = python_library()
    pointer, number = ctypes.c_void_p, ctypes.c_int
    library.vehicle_slot_name.restype = ctypes.c_char_p
    library.vehicle_size.restype = ctypes.c_size_t
    library.vehicle_start.argtypes = [pointer, pointer, pointer, number]
    library.vehicle_record.argtypes = [pointer, pointer, pointer, number, number, number]
    library.vehicle_read_state.argtypes = [pointer, pointer, ctypes.c_double]
    library.vehicle_run.argtypes = [pointer, number, ctypes.py_object, pointer, ctypes.c_double]
    for name in ("vehicle_rows", "vehicle_row", "vehicle_sense", "vehicle_align"):
        getattr(library, name).argtypes = [pointer]
    library.vehicle_read_imu.argtypes = [pointer, pointer]
    return library


@cache
def slots() -> dict[str, int]:
    """Return name to index of every slot, as the C side lists them."""
    library = _library()
    return {library.vehicle_slot_name(i).decode(): i for i in range(library.vehicle_slot_count())}


class Vehicle:
    """One flight's blackboard and recorder.

    Args:
        rng_seed: the test case's; sensors draw from streams of their own.
        boxes: obstacles, shape (k, 8), as `flight.geometry.boxes_array` gives them.
    """

    def __init__(self, rng_seed: int, boxes: NDArray[np.float64]) -> None:
        self._library = _library()
        self._memory = ctypes.create_string_buffer(self._library.vehicle_size() + 64)
        self._slots = slots()
        count = len(self._slots)
        self.at: memoryview[float] = memoryview(self._memory)[: 8 * count].cast("B").cast("d")
        self._boxes = np.ascontiguousarray(boxes, dtype=np.float64).reshape(-1, 8)
        seeds = (ctypes.c_uint64 * 4)(*(derive_seed(rng_seed, "sensors", stream) for stream in STREAMS))
        self._address = ctypes.addressof(self._memory)
        self._library.vehicle_start(self._address, seeds, self._boxes.ctypes.data, len(self._boxes))
        self._rows = np.zeros((0, 0), np.float32)
        self._columns = np.zeros(0, np.int32)
        self.record_names: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> float:
        return self.at[self._slots[name]]

    def __setitem__(self, name: str, value: float) -> None:
        self.at[self._slots[name]] = value

    def set(self, **values: float) -> None:
        """Write several slots."""
        at, index = self.at, self._slots
        for name, value in values.items():
            at[index[name]] = value

    # -- running --------------------------------------------------------------------------------------------------

    def align(self) -> None:
        """Draw sensor biases and take the truth on the board as believed."""
        self._library.vehicle_align(self._address)

    def read_world(self, nodes: Any, origin_m: float) -> None:
        """Read JSBSim's state onto the board."""
        self._library.vehicle_read_imu(self._address, nodes)
        self._library.vehicle_read_state(self._address, ctypes.addressof(nodes) + 6 * 8, origin_m)

    def run(self, steps: int, step_world: Callable[[], object], nodes: Any, origin_m: float) -> None:
        """Run `steps` physics steps of 2.5 ms with sensors, estimator and control."""
        self._library.vehicle_run(self._address, steps, step_world, nodes, origin_m)

    # -- the trace ------------------------------------------------------------------------------------------------

    def record(self, names: Sequence[str], row_limit: int, step_s: float) -> None:
        """Record the slots `names` every `step_s` from now on, at most `row_limit` rows, the first at once."""
        self.record_names = tuple(names)
        self._columns = np.array([self._slots[name] for name in names], np.int32)
        self._rows = np.empty((row_limit, len(names)), np.float32)
        every = round(step_s / STEP_S)
        self._library.vehicle_record(
            self._address, self._rows.ctypes.data, self._columns.ctypes.data, len(names), row_limit, every
        )
        self._library.vehicle_row(self._address)

    def columns(self) -> dict[str, bytes]:
        """Return what was recorded: each name's samples as little-endian float32."""
        count = self._library.vehicle_rows(self._address)
        table = np.ascontiguousarray(self._rows[:count].T, dtype="<f4")
        return {name: table[i].tobytes() for i, name in enumerate(self.record_names)}
