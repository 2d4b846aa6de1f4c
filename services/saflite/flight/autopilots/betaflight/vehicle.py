"""The blackboard of a flight with the firmware: world, sensors and bridge in one native loop (`native/bridge.h`)."""

from __future__ import annotations

import ctypes
from functools import cache

from saflite.flight.blackboard import Blackboard
from saflite.flight.native_library import python_library
from saflite.flight.sensors.sensors import Sensors
from saflite.flight.world.jsbsim_world import World

BOXES = (0, 1, 2, 3, 11, 46, 27)  # permanent ids, in the order of bridge.h
OK, GONE, SILENT, EXITED = range(4)
PILOT, TELEMETRY, TEST = range(3)
HEARD_MAX = 262_144


@cache
def _library() -> ctypes.PyDLL:
    library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
    for name in ("start", "await", "pid", "code"):
        getattr(library, f"bridge_{name}").argtypes = [pointer]
    for name in ("connect", "run", "listen", "idle"):
        getattr(library, f"bridge_{name}").argtypes = [pointer, number]
    library.bridge_box.argtypes = [pointer, number, number]
    library.bridge_say.argtypes = [pointer, number, ctypes.c_char_p, number]
    library.bridge_heard.argtypes = [pointer, number, ctypes.c_char_p]
    library.bridge_pilot.argtypes = [pointer, ctypes.c_double, ctypes.c_double, number]
    return library


class Vehicle(Blackboard):
    """World and sensors of one flight, and the link to the firmware that flies in them.

    Raises:
        Unavailable: JSBSim or the native library is missing.
    """

    WHOLE, PARTS = "bridge", ("world", "sensors", "bridge")

    def __init__(self, rng_seed: int) -> None:
        self._library = _library()
        super().__init__()
        self._library.bridge_start(self.address)
        self.world = World(steps_per_state=1, memory=self.part("world"))
        self.sensors = Sensors(rng_seed, self.part("sensors"))

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

    def move_sticks(self, altitude_m: float, hover_us: float, taken: int) -> None:
        """Move the sticks as a pilot does who keeps the height and the place, but those `taken` (a bit each)."""
        self._library.bridge_pilot(self.address, altitude_m, hover_us, taken)

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
