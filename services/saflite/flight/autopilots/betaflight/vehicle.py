"""The blackboard of a flight with the firmware: world, sensors and bridge in one native loop (`native/bridge.h`)."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache

import numpy as np

from saflite.flight.native_library import Board, Memory, python_library, slot_names, struct_size
from saflite.flight.sensors.sensors import Sensors
from saflite.flight.world.jsbsim_world import World
from saflite.flight.world.state import STEP_S

PARTS = ("world", "sensors", "bridge")
BOXES = (0, 1, 2, 3, 11, 46, 27)  # permanent ids, in the order of bridge.h
OK, GONE, SILENT, EXITED = range(4)
PILOT, TELEMETRY, TEST = range(3)
HEARD_MAX = 262_144


@cache
def _library() -> ctypes.PyDLL:
    library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
    library.bridge_offset.restype = ctypes.c_size_t
    for name in ("start", "await", "rows", "pid", "code"):
        getattr(library, f"bridge_{name}").argtypes = [pointer]
    for name in ("connect", "run", "listen", "idle"):
        getattr(library, f"bridge_{name}").argtypes = [pointer, number]
    library.bridge_box.argtypes = [pointer, number, number]
    library.bridge_say.argtypes = [pointer, number, ctypes.c_char_p, number]
    library.bridge_heard.argtypes = [pointer, number, ctypes.c_char_p]
    library.bridge_record.argtypes = [pointer, pointer, pointer, number, number, number]
    return library


@cache
def slots() -> dict[str, int]:
    """Return name to index of every slot, in doubles from the start of the native struct."""
    library = _library()
    found = {
        name: library.bridge_offset(part) // 8 + place
        for part, prefix in enumerate(PARTS)
        for place, name in enumerate(slot_names(prefix))
    }
    assert len(found) == sum(len(slot_names(prefix)) for prefix in PARTS), "a slot is listed twice"
    return found


class Vehicle(Board):
    """World and sensors of one flight, and the link to the firmware that flies in them.

    Raises:
        Unavailable: JSBSim or the native library is missing.
    """

    def __init__(self, rng_seed: int) -> None:
        self._library = _library()
        super().__init__(ctypes.create_string_buffer(struct_size("bridge")), slots())
        self._library.bridge_start(self.address)
        self.world = World(steps_per_state=1, memory=self._part(0))
        self.sensors = Sensors(rng_seed, self._part(1))
        self._rows = np.zeros((0, 0), np.float32)
        self._columns = np.zeros(0, np.int32)
        self._names: tuple[str, ...] = ()

    def _part(self, part: int) -> Memory:
        offset = self._library.bridge_offset(part)
        return (ctypes.c_char * struct_size(PARTS[part])).from_buffer(self._memory, offset)

    # -- the firmware -------------------------------------------------------------------------------------------------

    def connect(self, fd: int) -> int:
        """Fly with the firmware at the other end of a socket from now on; return what came of its first word."""
        self._library.bridge_connect(self.address, fd)
        return int(self._library.bridge_await(self.address))

    @property
    def pid(self) -> int:
        """Id of the firmware's process, as it says."""
        return int(self._library.bridge_pid(self.address))

    @property
    def exit_code(self) -> int:
        """What the firmware ended itself with."""
        return int(self._library.bridge_code(self.address))

    def run(self, steps: int) -> int:
        """Run steps of 2.5 ms; return OK, GONE, SILENT or EXITED. Stops early when the world has crashed."""
        return int(self._library.bridge_run(self.address, steps))

    def know_boxes(self, ids: bytes) -> None:
        """Take the order in which the firmware lists its boxes (permanent ids): places of bits in its status."""
        for which, box in enumerate(BOXES):
            self._library.bridge_box(self.address, which, ids.find(box))

    def say(self, port: int, data: bytes) -> bool:
        """Queue bytes for a serial port; False if it has too many waiting."""
        return int(self._library.bridge_say(self.address, port, data, len(data))) == 0

    def listen(self, *ports: int) -> None:
        """Keep what these ports say, instead of the others."""
        self._library.bridge_listen(self.address, sum(1 << port for port in ports))

    def heard(self, port: int) -> bytes:
        """Take what a port has said."""
        into = ctypes.create_string_buffer(HEARD_MAX)
        count = int(self._library.bridge_heard(self.address, port, into))
        return into.raw[:count]

    # -- the trace ----------------------------------------------------------------------------------------------------

    def record(self, names: Sequence[str], row_limit: int, step_s: float) -> None:
        """Record the slots `names` every `step_s` from now on, at most `row_limit` rows, the first at once."""
        self._names = tuple(names)
        self._columns = np.array([self._slots[name] for name in names], np.int32)
        self._rows = np.empty((row_limit, len(names)), np.float32)
        places = (self._rows.ctypes.data, self._columns.ctypes.data)
        self._library.bridge_record(self.address, *places, len(names), row_limit, round(step_s / STEP_S))

    def columns(self) -> dict[str, bytes]:
        """Return what was recorded: each name's samples as little-endian float32."""
        count = int(self._library.bridge_rows(self.address))
        table = np.ascontiguousarray(self._rows[:count].T, dtype="<f4")
        return {name: table[i].tobytes() for i, name in enumerate(self._names)}
