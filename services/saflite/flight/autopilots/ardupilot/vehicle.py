"""The blackboard of a flight with ArduPilot: world and lockstep in one native loop (`native/lockstep.h`)."""

from __future__ import annotations

import ctypes
import socket
from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from saflite.flight.native_library import Board, Memory, python_library, slot_names, struct_size
from saflite.flight.world.jsbsim_world import World
from saflite.flight.world.state import STEP_S

PARTS = ("world", "lockstep")
OK, GONE, SILENT, ALIEN = range(4)
SILENT_MS = 10_000  # of wall time without an answer: the autopilot hangs
HEARD_MAX = 1 << 20


@cache
def _library() -> ctypes.PyDLL:
    library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
    library.lockstep_offset.restype = ctypes.c_size_t
    library.lockstep_connect.argtypes = [pointer, number, number, number]
    library.lockstep_run.argtypes = [pointer, number]
    library.lockstep_heard.argtypes = [pointer, ctypes.c_char_p]
    library.lockstep_record.argtypes = [pointer, pointer, pointer, number, number, number]
    for name in ("await", "rows"):
        getattr(library, f"lockstep_{name}").argtypes = [pointer]
    return library


@cache
def slots() -> dict[str, int]:
    """Return name to index of every slot, in doubles from the start of the native struct."""
    library = _library()
    found = {
        name: library.lockstep_offset(part) // 8 + place
        for part, prefix in enumerate(PARTS)
        for place, name in enumerate(slot_names(prefix))
    }
    assert len(found) == sum(len(slot_names(prefix)) for prefix in PARTS), "a slot is listed twice"
    return found


class Vehicle(Board):
    """World of one flight, and the links to the autopilot that flies in it.

    Raises:
        Unavailable: JSBSim or the native library is missing.
    """

    def __init__(self, boxes: NDArray[np.float64], yaw_deg: float) -> None:
        self._library = _library()
        super().__init__(ctypes.create_string_buffer(struct_size("lockstep")), slots())
        self.world = World(0.0, yaw_deg, boxes, steps_per_state=1, memory=self._world_memory())
        self._into = ctypes.create_string_buffer(HEARD_MAX)
        self._rows = np.zeros((0, 0), np.float32)
        self._columns = np.zeros(0, np.int32)
        self._names: tuple[str, ...] = ()

    def _world_memory(self) -> Memory:
        offset = self._library.lockstep_offset(0)
        return (ctypes.c_char * struct_size("world")).from_buffer(self._memory, offset)

    def connect(self, udp: socket.socket, tcp: socket.socket) -> int:
        """Fly with the autopilot at the other end from now on; return what came of its first outputs."""
        self._library.lockstep_connect(self.address, udp.fileno(), tcp.fileno(), SILENT_MS)
        return int(self._library.lockstep_await(self.address))

    def run(self, steps: int) -> int:
        """Run steps of 2.5 ms; return OK, GONE, SILENT or ALIEN. Stops early when the world has crashed."""
        return int(self._library.lockstep_run(self.address, steps))

    def heard(self) -> bytes:
        """Take what the autopilot said over MAVLink."""
        count = int(self._library.lockstep_heard(self.address, self._into))
        return ctypes.string_at(self._into, count)

    def record(self, names: Sequence[str], row_limit: int, step_s: float) -> None:
        """Record the slots `names` every `step_s` from now on, at most `row_limit` rows, the first at once."""
        self._names = tuple(names)
        self._columns = np.array([self._slots[name] for name in names], np.int32)
        self._rows = np.empty((row_limit, len(names)), np.float32)
        places = (self._rows.ctypes.data, self._columns.ctypes.data)
        self._library.lockstep_record(self.address, *places, len(names), row_limit, round(step_s / STEP_S))

    def columns(self) -> dict[str, bytes]:
        """Return what was recorded: each name's samples as little-endian float32."""
        count = int(self._library.lockstep_rows(self.address))
        table = np.ascontiguousarray(self._rows[:count].T, dtype="<f4")
        return {name: table[i].tobytes() for i, name in enumerate(self._names)}
