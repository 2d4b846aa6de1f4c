"""MAV_CMD commands: each acts or is refused with the result ArduCopter gives (GCS_MAVLINK_Copter, GCS_Common).

Commands that only make sense as mission items are unsupported on their own; devices this vehicle does not have
(camera, gimbal, gripper, relays) answer so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from enum import IntEnum
from functools import cache
from typing import TYPE_CHECKING, NamedTuple

from saflite.contract.errors import Refused
from saflite.flight.autopilots.reference import settings
from saflite.flight.autopilots.reference.command_names import NAMES
from saflite.flight.autopilots.reference.modes.table import mode_name
from saflite.flight.mission import to_local
from saflite.flight.world.jsbsim_world import HOME_LAT_DEG, HOME_LON_DEG

if TYPE_CHECKING:
    from saflite.flight.autopilots.reference.autopilot import Autopilot
    from saflite.flight.autopilots.reference.modes.guided import Guided

FORCE = 21196.0
FAR_M = 50_000.0
MODE_CHANGE_FLAG = 1


class MavResult(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4


Numbers = tuple[float, float, float, float, float, float, float]
Handler = Callable[["Autopilot", Numbers], MavResult]


class Command(NamedTuple):
    """One row: MAV_CMD number and name, and what it does."""

    number: int
    name: str
    handler: Handler
    meaning: str


def command_number(name: str, where: str = "") -> int:
    """Return the number of a MAV_CMD given by name (with or without MAV_CMD_) or number; raises Refused if unknown."""
    word = name.strip().upper().removeprefix("MAV_CMD_")
    if word.isdigit():
        return int(word)
    if word not in NAMES:
        known = [f"MAV_CMD_{known}" for known in NAMES] if name.upper().startswith("MAV_CMD_") else NAMES
        raise Refused("command", where=where, expected="a MAV_CMD name or number", got=repr(name), known=known)
    return NAMES[word]


def execute(ap: Autopilot, number: int, values: Sequence[float]) -> MavResult:
    """Carry out a command with up to seven numbers; missing ones are 0, NaN is "not given"."""
    row = command_table().get(number)
    if row is None:
        return MavResult.UNSUPPORTED
    padded = [*values, *([0.0] * 7)][:7]
    if any(math.isinf(value) for value in padded):
        return MavResult.DENIED
    a, b, c, d, e, f, g = padded
    return row.handler(ap, (a, b, c, d, e, f, g))


@cache
def command_table() -> dict[int, Command]:
    """Return every command this autopilot knows, by number."""
    rows = [Command(NAMES[name], name, handler, (handler.__doc__ or "").strip()) for name, handler in _HANDLERS.items()]
    return {row.number: row for row in rows}


# ---- handlers -----------------------------------------------------------------------------------------------------


def _outcome(why: str) -> MavResult:
    return MavResult.FAILED if why else MavResult.ACCEPTED


def _parachute(ap: Autopilot, v: Numbers) -> MavResult:
    """Disable (0), enable (1) or release (2) the parachute."""
    if v[0] in (0.0, 1.0):
        if ap.parameters["CHUTE_TYPE"] != 10 and v[0] == 1.0:
            return MavResult.FAILED
        return _outcome(ap.parameters.set("CHUTE_ENABLED", v[0]))
    return _outcome(ap.parachute.release("command")) if v[0] == 2.0 else MavResult.FAILED


def _rtl(ap: Autopilot, v: Numbers) -> MavResult:
    """Return home."""
    return MavResult.FAILED if not ap.armed else _outcome(ap.set_mode("RTL", "command"))


def _land(ap: Autopilot, v: Numbers) -> MavResult:
    """Land here."""
    return MavResult.FAILED if not ap.armed else _outcome(ap.set_mode("LAND", "command"))


def _loiter(ap: Autopilot, v: Numbers) -> MavResult:
    """Hold here."""
    return _outcome(ap.set_mode("LOITER", "command"))


def _guided(ap: Autopilot) -> Guided | None:
    return ap.mode if ap.mode.name == "GUIDED" else None  # type: ignore[return-value]


def _takeoff(ap: Autopilot, v: Numbers) -> MavResult:
    """Climb to an altitude (7th number, above home) in GUIDED."""
    guided = _guided(ap)
    low = ap.defects & {"takeoff-altitude-unchecked"}
    if guided is None or not ap.armed or not ap.landed or math.isnan(v[6]) or (v[6] <= 0.0 and not low):
        return MavResult.FAILED
    if ap.failsafes.position:  # it acted where the vehicle stood, and would not act again in the air
        return MavResult.FAILED
    if v[6] > 1000.0:
        return MavResult.DENIED
    guided.take_off(v[6])
    return MavResult.ACCEPTED


def _mission_start(ap: Autopilot, v: Numbers) -> MavResult:
    """Start the mission on board."""
    if not ap.armed:
        return MavResult.FAILED
    if ap.mode.name == "AUTO":
        return MavResult.ACCEPTED if ap.mode.jump(0) else MavResult.FAILED  # type: ignore[attr-defined]
    left_at = ap.mission_index
    ap.mission_index = 0
    outcome = _outcome(ap.set_mode("AUTO", "command"))
    if outcome is not MavResult.ACCEPTED:  # what is refused does not wind the mission back
        ap.mission_index = left_at
    return outcome


def _arm(ap: Autopilot, v: Numbers) -> MavResult:
    """Arm (1) or disarm (0); 21196 as second number forces."""
    force = v[1] == FORCE
    if v[0] == 1.0:
        return _outcome(ap.arm(force=force))
    if v[0] != 0.0:
        return MavResult.UNSUPPORTED
    if ap.armed and not ap.landed and not force and "disarm-in-flight" not in ap.defects:
        return MavResult.FAILED
    ap.disarm("command")
    return MavResult.ACCEPTED


def _yaw(ap: Autopilot, v: Numbers) -> MavResult:
    """Turn to a heading (1st number, degrees; 4th: relative) in GUIDED and AUTO."""
    if ap.mode.name not in ("GUIDED", "AUTO"):
        return MavResult.FAILED
    if not 0.0 <= v[0] <= 360.0 or math.isnan(v[3]):
        return MavResult.DENIED
    turn = math.radians(v[0]) * (-1.0 if v[2] < 0.0 else 1.0)
    ap.yaw_order_rad = ap.board["est_yaw"] + turn if v[3] != 0.0 else math.radians(v[0])
    return MavResult.ACCEPTED


def _speed(ap: Autopilot, v: Numbers) -> MavResult:
    """Set the speed of autonomous modes (2nd number, m/s); one too slow to fly at is accepted and not taken."""
    if v[0] not in (0.0, 1.0):
        return MavResult.FAILED
    if math.isnan(v[1]) or v[1] <= 0.0:
        return MavResult.FAILED
    if v[1] >= settings.SPEED_LEAST_MPS:
        ap.speed_order_mps = min(15.0, v[1])
    return MavResult.ACCEPTED


def _place(v: Numbers) -> tuple[float, float] | None:
    if not (-90.0 <= v[4] <= 90.0 and -180.0 <= v[5] <= 180.0) or (v[4] == 0.0 and v[5] == 0.0):
        return None
    north, east = to_local(v[4], v[5], HOME_LAT_DEG, HOME_LON_DEG)
    return (north, east) if math.hypot(north, east) < FAR_M else None


def _set_home(ap: Autopilot, v: Numbers) -> MavResult:
    """Make this place (1) or the place given home."""
    if v[0] == 1.0:
        if ap.board["position_ok"] == 0.0:
            return MavResult.FAILED
        ap.set_home(ap.board["est_n"], ap.board["est_e"], ap.home[2])
        return MavResult.ACCEPTED
    place = _place(v)
    if place is None:
        return MavResult.DENIED
    ap.set_home(*place, ap.home[2])
    return MavResult.ACCEPTED


def _reposition(ap: Autopilot, v: Numbers) -> MavResult:
    """Go to a place (5th to 7th number: latitude, longitude, height above home) in GUIDED; flag 1 changes to it."""
    place = _place(v)
    if place is None or not 0.0 < v[6] < 1000.0:
        return MavResult.DENIED
    if not ap.armed or ap.landed:
        return MavResult.FAILED
    hold = ap.mode.name == "LOITER" and "reposition-in-hold" in ap.defects
    if hold:
        ap.say("holding elsewhere")
        ap.mode.drag(place, v[6])  # type: ignore[attr-defined]
        return MavResult.ACCEPTED
    if ap.mode.name != "GUIDED":
        if math.isnan(v[1]) or int(v[1]) & MODE_CHANGE_FLAG == 0 or v[1] > 2.0:
            return MavResult.DENIED
        if ap.set_mode("GUIDED", "reposition"):
            return MavResult.FAILED
    guided = _guided(ap)
    assert guided is not None
    guided.go_to(*place, v[6])
    return MavResult.ACCEPTED


def _set_mode(ap: Autopilot, v: Numbers) -> MavResult:
    """Change the mode (2nd number; the 1st must have bit 1 for custom modes)."""
    if math.isnan(v[0]) or int(v[0]) & 1 == 0 or not v[1].is_integer():
        return MavResult.DENIED
    name = mode_name(int(v[1]))
    return _outcome(ap.set_mode(name, "command")) if name else MavResult.FAILED


def _pause(ap: Autopilot, v: Numbers) -> MavResult:
    """Pause (0) or continue (1) the mission."""
    if ap.mode.name != "AUTO" or v[0] not in (0.0, 1.0):
        return MavResult.DENIED
    if v[0] == 0.0:
        ap.mode.pause()  # type: ignore[attr-defined]
    else:
        ap.mode.resume()  # type: ignore[attr-defined]
    return MavResult.ACCEPTED


def _terminate(ap: Autopilot, v: Numbers) -> MavResult:
    """Stop the motors at once (1st number above 0.5)."""
    if math.isnan(v[0]) or v[0] <= 0.5:
        return MavResult.FAILED
    ap.disarm("flight termination")
    return MavResult.ACCEPTED


def _fence(ap: Autopilot, v: Numbers) -> MavResult:
    """Switch the fence off (0) or on (1)."""
    return _outcome(ap.parameters.set("FENCE_ENABLE", v[0])) if v[0] in (0.0, 1.0) else MavResult.FAILED


def _banner(ap: Autopilot, v: Numbers) -> MavResult:
    """Send the version text."""
    ap.say("SaFliTe reference copter")
    return MavResult.ACCEPTED


def _roi(ap: Autopilot, v: Numbers) -> MavResult:
    """Turn the nose towards a place; no place ends it."""
    place = _place(v)
    if place is None and (v[4] != 0.0 or v[5] != 0.0):
        return MavResult.DENIED
    if place is None:
        ap.yaw_order_rad = None
        return MavResult.ACCEPTED
    ap.yaw_order_rad = math.atan2(place[1] - ap.board["est_e"], place[0] - ap.board["est_n"])
    return MavResult.ACCEPTED


def _button_fly(ap: Autopilot, v: Numbers) -> MavResult:
    """Solo's fly button: LOITER."""
    return _outcome(ap.set_mode("LOITER", "button")) if ap.armed else MavResult.FAILED


def _button_hold(ap: Autopilot, v: Numbers) -> MavResult:
    """Solo's fly button held: land where flying."""
    return _outcome(ap.set_mode("LAND", "button")) if ap.armed and not ap.landed else MavResult.FAILED


def _button_pause(ap: Autopilot, v: Numbers) -> MavResult:
    """Solo's pause button: BRAKE; on the ground disarm."""
    if not ap.armed:
        return MavResult.FAILED
    if ap.landed:
        ap.disarm("button")
        return MavResult.ACCEPTED
    return _outcome(ap.set_mode("BRAKE", "button"))


def _not_armed(ap: Autopilot, v: Numbers) -> MavResult:
    """Calibration: never while armed."""
    return MavResult.TEMPORARILY_REJECTED if ap.armed else MavResult.UNSUPPORTED


def _no_device(ap: Autopilot, v: Numbers) -> MavResult:
    """A device this vehicle does not have."""
    return MavResult.FAILED


def _mission_only(ap: Autopilot, v: Numbers) -> MavResult:
    """Only as a mission item."""
    return MavResult.UNSUPPORTED


_MISSION_ONLY = (
    "NAV_WAYPOINT NAV_LOITER_TURNS NAV_LOITER_TIME NAV_SPLINE_WAYPOINT NAV_GUIDED_ENABLE DO_JUMP CONDITION_DELAY "
    "CONDITION_DISTANCE DO_GUIDED_LIMITS NAV_ALTITUDE_WAIT DO_AUTOTUNE_ENABLE POWER_OFF_INITIATED GIMBAL_RESET"
)
_DEVICES = (
    "DO_SET_SERVO DO_SET_RELAY DO_REPEAT_SERVO DO_REPEAT_RELAY DO_DIGICAM_CONFIGURE DO_DIGICAM_CONTROL "
    "DO_SET_CAM_TRIGG_DIST DO_MOUNT_CONTROL DO_GRIPPER"
)
_CALIBRATION = (
    "FIXED_MAG_CAL FIXED_MAG_CAL_FIELD FIXED_MAG_CAL_YAW DO_START_MAG_CAL DO_ACCEPT_MAG_CAL DO_CANCEL_MAG_CAL "
    "SET_FACTORY_TEST_MODE PREFLIGHT_CALIBRATION PREFLIGHT_REBOOT_SHUTDOWN"
)
_HANDLERS: dict[str, Handler] = {
    "DO_PARACHUTE": _parachute,
    "NAV_RETURN_TO_LAUNCH": _rtl,
    "NAV_LAND": _land,
    "NAV_LOITER_UNLIM": _loiter,
    "NAV_TAKEOFF": _takeoff,
    "MISSION_START": _mission_start,
    "COMPONENT_ARM_DISARM": _arm,
    "CONDITION_YAW": _yaw,
    "DO_CHANGE_SPEED": _speed,
    "DO_SET_HOME": _set_home,
    "DO_REPOSITION": _reposition,
    "DO_SET_MODE": _set_mode,
    "DO_PAUSE_CONTINUE": _pause,
    "DO_FLIGHTTERMINATION": _terminate,
    "DO_FENCE_ENABLE": _fence,
    "DO_SEND_BANNER": _banner,
    "DO_SET_ROI": _roi,
    "SOLO_BTN_FLY_CLICK": _button_fly,
    "SOLO_BTN_FLY_HOLD": _button_hold,
    "SOLO_BTN_PAUSE_CLICK": _button_pause,
    **dict.fromkeys(_CALIBRATION.split(), _not_armed),
    **dict.fromkeys(_DEVICES.split(), _no_device),
    **dict.fromkeys(_MISSION_ONLY.split(), _mission_only),
}
