"""The world: JSBSim's F450 at 400 Hz with wind, ground and truth. One simulator per process, started anew per flight.

JSBSim keeps the interpreter lock, so more flights at once need more processes. The aircraft is
`world/aircraft/quad450`: mass, geometry, gear, motors and drag of JSBSim's F450, without the parts we do not use.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

from saflite.contract.errors import Unavailable
from saflite.flight.vehicle import STEP_S, Vehicle

AIRCRAFT = Path(__file__).parent / "aircraft"
FOOT_M = 0.3048
HOME_LAT_DEG, HOME_LON_DEG, HOME_ALT_M = 47.3977419, 8.5455938, 488.7858
STANDING_M = 0.1509  # height of the centre of gravity on the ground
DRAG_AREA_M2 = 0.016129  # drag coefficient 1 on JSBSim's reference area
IMU = ("velocities/p-rad_sec", "velocities/q-rad_sec", "velocities/r-rad_sec")
FORCE = tuple(f"accelerations/a-pilot-{axis}-ft_sec2" for axis in "xyz")
POSITION = tuple(f"position/from-start-neu-{axis}-ft" for axis in "neu")
VELOCITY = tuple(f"velocities/v-{axis}-fps" for axis in ("north", "east", "down"))
ATTITUDE = tuple(f"attitude/{axis}-rad" for axis in ("phi", "theta", "psi"))
READ = IMU + FORCE + POSITION + VELOCITY + ATTITUDE
MOTORS = tuple(f"fcs/throttle-cmd-norm[{i}]" for i in range(4))


class World:
    """JSBSim with one quadrotor.

    Args:
        altitude_m: where the vehicle starts, above the ground; 0 stands.
        yaw_deg: heading at the start.

    Raises:
        Unavailable: JSBSim or the aircraft cannot be loaded.
    """

    def __init__(self, altitude_m: float = 0.0, yaw_deg: float = 0.0) -> None:
        self._fdm = _load()
        self._set_start(altitude_m, yaw_deg)
        manager = self._fdm.get_property_manager()
        self._held: list[Any] = [manager.get_node(name).get_double_value for name in READ]
        self._held += [manager.get_node(name).set_double_value for name in MOTORS]
        self.nodes = (ctypes.c_void_p * len(self._held))(*(id(function) for function in self._held))
        self._wind = [manager.get_node(f"atmosphere/wind-{axis}-fps", True) for axis in ("north", "east", "down")]
        self.step = self._fdm.run
        self.origin_m = float(self._fdm["position/from-start-neu-u-ft"]) * FOOT_M - altitude_m

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

    def set_wind(self, north_mps: float, east_mps: float, down_mps: float) -> None:
        """Set the velocity of the air over ground."""
        for node, speed in zip(self._wind, (north_mps, east_mps, down_mps), strict=True):
            node.set_double_value(speed / FOOT_M)

    def set_drag_area(self, area_m2: float) -> None:
        """Set the drag area: the airframe's own plus an open parachute's."""
        self._fdm["aero/drag-area-sqft"] = (DRAG_AREA_M2 + area_m2) / FOOT_M**2

    def set_motors(self, throttle: float, steps: int) -> None:
        """Spin all motors up alike in place of the autopilot, e.g. before a start in the air."""
        for name in MOTORS:
            self._fdm[name] = throttle
        for _ in range(steps):
            self._fdm.run()

    def read(self, vehicle: Vehicle) -> None:
        """Put the state of the world on the vehicle's board."""
        vehicle.read_world(self.nodes, self.origin_m)

    def run(self, vehicle: Vehicle, steps: int) -> None:
        """Run `steps` physics steps with the vehicle's sensors, estimator and control."""
        vehicle.run(steps, self.step, self.nodes, self.origin_m)


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
