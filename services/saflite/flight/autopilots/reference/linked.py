"""The reference autopilot as the MAVLink server sees it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from saflite.contract.errors import Refused
from saflite.contract.flight import TraceMessage
from saflite.contract.signals import MODES
from saflite.contract.test_case import Mission
from saflite.flight.autopilots.reference.autopilot import Autopilot
from saflite.flight.autopilots.reference.commands import execute
from saflite.flight.autopilots.reference.mission_items import understand
from saflite.flight.autopilots.reference.modes.table import mode_name
from saflite.flight.autopilots.reference.parameter_types import REAL32, TYPES
from saflite.flight.mavlink.vehicle import Kind, Place, Status
from saflite.flight.world.jsbsim_world import HOME_ALT_M, HOME_LAT_DEG, HOME_LON_DEG

QUADROTOR, ARDUPILOT = 2, 3  # whose parameters, modes and commands it has
VERSION = (4 << 24) | (0 << 16) | (0 << 8) | 255
CAPACITY_MAH = 5200.0


class LinkedReference:
    """An `Autopilot` behind the protocol of `mavlink.vehicle`.

    Args:
        ap: the autopilot.
        restart: called when a ground station orders a reboot on the ground.
    """

    kind = Kind(QUADROTOR, ARDUPILOT, VERSION)
    origin = Place(HOME_LAT_DEG, HOME_LON_DEG, HOME_ALT_M)

    def __init__(self, ap: Autopilot, restart: Callable[[], None]) -> None:
        self._ap, self._restart = ap, restart
        self.say = ap.say

    @property
    def parameters(self) -> Mapping[str, float]:
        """The values on board."""
        return self._ap.parameters.values

    def parameter_type(self, name: str) -> int:
        """Return the MAV_PARAM_TYPE of a parameter."""
        return TYPES.get(name, REAL32)

    @property
    def texts(self) -> Sequence[TraceMessage]:
        """Everything said since the start."""
        return self._ap.messages

    @property
    def mission(self) -> Mission | None:
        """The mission on board."""
        return self._ap.mission

    @property
    def mission_index(self) -> int:
        """The item being flown or next."""
        return self._ap.mission_index

    def status(self) -> Status:
        """Return the estimate, the readings and the states as they are."""
        ap = self._ap
        board, radio = ap.board, ap.radio
        return Status(
            time_s=ap.time_s,
            mode=MODES[ap.mode.name],
            armed=ap.armed,
            landed=ap.landed,
            position_m=(board["est_n"], board["est_e"], board["est_d"]),
            speed_mps=(board["est_vn"], board["est_ve"], board["est_vd"]),
            attitude_rad=(board["est_roll"], board["est_pitch"], board["est_yaw"]),
            rates_rps=(board["est_p"], board["est_q"], board["est_r"]),
            altitude_m=board["altitude_est_m"],
            home_m=ap.home,
            throttle=board["throttle"],
            motors=[board[f"motor_{number}"] for number in range(1, 5)],
            position_ok=board["position_ok"] != 0.0,
            innovation_ratio=board["innovation_ratio"],
            gps_ok=board["gps_ok"] != 0.0,
            gps_satellites=round(board["gps_satellites"]),
            gps_position_m=(board["gps_north_m"], board["gps_east_m"], board["gps_up_m"]),
            gps_speed_mps=(board["gps_vn_mps"], board["gps_ve_mps"]),
            baro_ok=board["baro_ok"] != 0.0,
            radio_ok=not ap.failsafes.radio,
            radio_present=radio.present,
            sticks_pwm=radio.received,
            battery_v=board["battery_v"],
            battery_a=board["battery_a"],
            battery_left=1.0 - board["pack_used_mah"] / CAPACITY_MAH,
            fence_on=bool(ap.parameters["FENCE_ENABLE"]),
            fence_breached=ap.failsafes.fence,
        )

    def set_parameter(self, name: str, value: float) -> str:
        """Set a parameter; return why not."""
        return self._ap.parameters.set(name, value)

    def execute(self, command: int, numbers: Sequence[float]) -> int:
        """Carry out a MAV_CMD; return the MAV_RESULT."""
        return int(execute(self._ap, command, numbers))

    def set_mode(self, number: int) -> str:
        """Change the mode; return why not."""
        name = mode_name(number)
        if not name:
            self._ap.say(f"no mode {number}", "warning")
        return self._ap.set_mode(name, "ground station") if name else f"no mode {number}"

    def stick(self, channel: int, pwm: float) -> None:
        """Move a stick of the radio."""
        self._ap.radio.stick(channel, pwm)

    def go_to(self, north_m: float, east_m: float, altitude_m: float) -> None:
        """Go to a place in GUIDED, in the air."""
        if self._listens():
            self._ap.mode.go_to(north_m, east_m, altitude_m)  # type: ignore[attr-defined]

    def fly_at(self, north_mps: float, east_mps: float, climb_mps: float) -> None:
        """Fly at a speed in GUIDED, in the air."""
        if self._listens():
            self._ap.mode.fly_at(north_mps, east_mps, climb_mps)  # type: ignore[attr-defined]

    def _listens(self) -> bool:
        return self._ap.mode.name == "GUIDED" and not self._ap.landed

    def load_mission(self, mission: Mission | None) -> str:
        """Replace the mission on board; return why not."""
        try:
            understand(mission) if mission is not None else ()
        except Refused as fault:
            return str(fault)
        self._ap.mission, self._ap.mission_index = mission, 0
        self._ap.parameters.changes += 1
        return ""

    def jump_to(self, index: int) -> bool:
        """Make an item current. AUTO flies on with the items it was entered with, which an upload may have outgrown."""
        ap = self._ap
        auto: Any = ap.mode if ap.mode.name == "AUTO" else None
        if ap.mission is None or index >= len(ap.mission.items) or (auto is not None and not auto.jump(index)):
            return False
        ap.mission_index = index
        return True

    def restart(self) -> bool:
        """Reboot at the end of this tick, on the ground only."""
        if self._ap.armed:
            return False
        self._restart()
        return True
