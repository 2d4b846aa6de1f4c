"""The world: JSBSim's F450 at 400 Hz among boxes, with wind, ground and truth, and no autopilot.

    world = World(altitude_m=20.0)
    state = world.step((0.43, 0.43, 0.43, 0.43))     # four throttles, 2.5 ms later

Native code steps it through `native/world.h`, given `World.address`. JSBSim keeps the interpreter lock, so more flights
at once need more processes. The aircraft is `world/aircraft/quad450`: mass, geometry, gear, motors and drag of JSBSim's
F450, without the parts we do not use.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from saflite.contract.errors import Refused, Unavailable
from saflite.flight.native_library import Board, Memory, python_library, slot_names, struct_size
from saflite.flight.world.state import FLYING, STANDING, STEP_S, WorldState

AIRCRAFT = Path(__file__).parent / "aircraft"
FOOT_M = 0.3048
HOME_LAT_DEG, HOME_LON_DEG, HOME_ALT_M = 47.3977419, 8.5455938, 488.7858
STANDING_M = 0.1509  # height of the centre of gravity on the ground
DRAG_AREA_M2 = 0.016129  # drag coefficient 1 on JSBSim's reference area
RATES = ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec")
FORCE = tuple(f"accelerations/a-pilot-{axis}-ft_sec2" for axis in "xyz")
POSITION = tuple(f"position/from-start-neu-{axis}-ft" for axis in "neu")
VELOCITY = tuple(f"velocities/v-{axis}-fps" for axis in ("north", "east", "down"))
ATTITUDE = tuple(f"attitude/{axis}-rad" for axis in ("phi", "theta", "psi"))
READ = RATES + FORCE + POSITION + VELOCITY + ATTITUDE  # in the order of native/world.h
MOTORS = tuple(f"fcs/throttle-cmd-norm[{i}]" for i in range(4))


@cache
def _library() -> ctypes.PyDLL:
    library, pointer, number = python_library(), ctypes.c_void_p, ctypes.c_int
    library.world_start.argtypes = [pointer, pointer, number, number]
    library.world_connect.argtypes = [pointer, ctypes.py_object, pointer, ctypes.c_double]
    library.world_read.argtypes = [pointer]
    library.world_step.argtypes = [pointer, pointer]
    assert slot_names("world") == WorldState._fields
    return library


class World(Board):
    """JSBSim with one quadrotor. `world["chute_released"] = 1.0` and the like write a slot of the truth.

    Args:
        altitude_m: where the vehicle starts, above the ground; 0 stands, motors off.
        yaw_deg: heading at the start.
        boxes: obstacles, shape (k, 8), as `flight.geometry.boxes_array` gives them.
        steps_per_state: steps from one truth of position and attitude to the next.
        memory: where the native struct lies; its own by default.

    Raises:
        Unavailable: JSBSim or the aircraft cannot be loaded.
    """

    def __init__(
        self,
        altitude_m: float = 0.0,
        yaw_deg: float = 0.0,
        boxes: NDArray[np.float64] | None = None,
        *,
        steps_per_state: int = 1,
        memory: Memory | None = None,
    ) -> None:
        library = _library()
        memory = ctypes.create_string_buffer(struct_size("world")) if memory is None else memory
        super().__init__(memory, {name: place for place, name in enumerate(WorldState._fields)})
        self._boxes = np.ascontiguousarray(np.zeros((0, 8)) if boxes is None else boxes, np.float64).reshape(-1, 8)
        library.world_start(self.address, self._boxes.ctypes.data, len(self._boxes), steps_per_state)
        self._fdm = _load()
        self._set_start(altitude_m, yaw_deg)
        manager = self._fdm.get_property_manager()
        self._held: list[Any] = [manager.get_node(name).get_double_value for name in READ]
        self._held += [manager.get_node(name).set_double_value for name in MOTORS]
        self._nodes = (ctypes.c_void_p * len(self._held))(*(id(function) for function in self._held))
        self._wind = [manager.get_node(f"atmosphere/wind-{axis}-fps", True) for axis in ("north", "east", "down")]
        self.step_jsbsim = self._fdm.run
        origin_m = float(self._fdm["position/from-start-neu-u-ft"]) * FOOT_M - altitude_m
        library.world_connect(self.address, self.step_jsbsim, ctypes.addressof(self._nodes), origin_m)
        library.world_read(self.address)
        self["world_state"] = FLYING if altitude_m > 0.0 else STANDING

    def _set_start(self, altitude_m: float, yaw_deg: float) -> None:
        fdm = self._fdm
        fdm["ic/lat-geod-deg"], fdm["ic/long-gc-deg"] = HOME_LAT_DEG, HOME_LON_DEG
        fdm["ic/terrain-elevation-ft"] = HOME_ALT_M / FOOT_M
        fdm["ic/h-agl-ft"] = (STANDING_M + altitude_m) / FOOT_M
        fdm["ic/psi-true-deg"] = yaw_deg
        fdm["aero/drag-area-sqft"] = DRAG_AREA_M2 / FOOT_M**2
        if not fdm.run_ic():
            raise Unavailable("JSBSim could not take the initial conditions")
        fdm["propulsion/set-running"] = -1

    @property
    def state(self) -> WorldState:
        """The truth now."""
        return WorldState(*self.at[: len(WorldState._fields)])

    def step(self, actuators: Sequence[float]) -> WorldState:
        """Step the physics by 2.5 ms and return the truth after it; a standing vehicle is let go by its first throttle.

        Args:
            actuators: throttles of the four motors, 0..1: front right, rear left, front left, rear right.

        Raises:
            Refused: there are not four.
        """
        if len(actuators) != len(MOTORS):
            raise Refused("actuators", expected=f"{len(MOTORS)} throttles", got=len(actuators))
        _library().world_step(self.address, (ctypes.c_double * len(MOTORS))(*actuators))
        return self.state

    def set_wind(self, north_mps: float, east_mps: float, down_mps: float) -> None:
        """Set the velocity of the air over ground."""
        for node, speed in zip(self._wind, (north_mps, east_mps, down_mps), strict=True):
            node.set_double_value(speed / FOOT_M)

    def set_drag_area(self, area_m2: float) -> None:
        """Set the drag area: the airframe's own plus an open parachute's."""
        self._fdm["aero/drag-area-sqft"] = (DRAG_AREA_M2 + area_m2) / FOOT_M**2

    def fail_motor(self, number: int, share: float = 0.0) -> None:
        """Let a motor (1 to 4, 0 none) follow only a share of its command."""
        self.set(motor_failed=float(number), motor_failed_share=share)

    def spin_up(self, throttle: float, steps: int) -> None:
        """Run the physics with all motors alike in place of an autopilot, before a start in the air."""
        for name in MOTORS:
            self._fdm[name] = throttle
        for _ in range(steps):
            self._fdm.run()
        _library().world_read(self.address)


def _load() -> Any:
    import jsbsim

    jsbsim.set_logger(jsbsim.DefaultLogger(jsbsim.LogLevel.FATAL))
    root = Path(jsbsim.get_default_root_dir())
    fdm = jsbsim.FGFDMExec(str(root), None)
    fdm.set_debug_level(0)
    if not fdm.load_model_with_paths("quad450", str(AIRCRAFT), str(root / "engine"), str(root / "systems")):
        raise Unavailable(f"JSBSim could not load {AIRCRAFT / 'quad450'}")
    fdm.set_dt(STEP_S)
    return fdm
