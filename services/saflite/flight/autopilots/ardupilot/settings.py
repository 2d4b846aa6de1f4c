"""What the vehicle starts with so that the F450 flies well, and which settings the trace shows."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

from saflite.contract.target_info import SettingInfo
from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.ardupilot.vehicle import Vehicle
from saflite.flight.heights import above_start
from saflite.flight.logs.settings import ARDUPILOT

_CHANNELS = range(1, 9)
SWITCHES = ("_ENABLE", "_ENABLED")
F450: dict[str, float] = {
    # stock gains oscillate: the F450's motors follow in 45 ms
    "ATC_RAT_RLL_P": 0.09,
    "ATC_RAT_RLL_I": 0.09,
    "ATC_RAT_RLL_D": 0.0045,
    "ATC_RAT_PIT_P": 0.09,
    "ATC_RAT_PIT_I": 0.09,
    "ATC_RAT_PIT_D": 0.0045,
    "INS_GYRO_FILTER": 50,
    "MOT_THST_HOVER": 0.435,
}
PHYSICS, NATIVE = "physics", "native"
LOG, NO_LOG = "log", "none"
SETTINGS = {
    LOG: SettingInfo(
        meaning="whether the autopilot keeps its log; flights without are forked from their start",
        default="dataflash",
        choices=("dataflash", NO_LOG),
        choice_meanings={NO_LOG: "only so can flights be forked: a thread writes the log, and a fork copies none"},
    ),
    PHYSICS: SettingInfo(
        meaning="whose physics is flown",
        default="jsbsim",
        choices=("jsbsim", NATIVE),
        choice_meanings={NATIVE: "the binary's own quadrotor with its own gains; no boxes, wind by SIM_WIND_SPD"},
    ),
}
TUNE: dict[str, float] = {
    "FRAME_CLASS": 1,  # quadrotor
    "FRAME_TYPE": 1,  # X; motors front right, rear left, front left, rear right
    **F450,
    # calibrated: small offsets count as done, and the simulator's compass stands off by these
    **{f"INS_ACC{number}OFFS_{axis}": 0.001 for number in ("", "2") for axis in "XYZ"},
    **{f"INS_ACC{number}SCAL_{axis}": 1.001 for number in ("", "2") for axis in "XYZ"},
    **{f"COMPASS_OFS{number}_X": 5 for number in ("", "2", "3")},
    **{f"COMPASS_OFS{number}_Y": 13 for number in ("", "2", "3")},
    **{f"COMPASS_OFS{number}_Z": -18 for number in ("", "2", "3")},
    **{f"RC{channel}_MIN": 1000 for channel in _CHANNELS},
    **{f"RC{channel}_MAX": 2000 for channel in _CHANNELS},
    **{f"RC{channel}_TRIM": 1500 for channel in _CHANNELS},
    "FLTMODE_CH": 0,  # modes are changed by messages, not by a switch
    "BATT_MONITOR": 4,
    "LOG_DISARMED": 1,  # else arming waits for a file that a thread opens, by wall time
    "SIM_TEMP_BRD_OFF": 0,  # air pressure is turned into heights by the sensor's temperature: warmer is 5 % too high
    "FS_THR_ENABLE": 1,
    # one telemetry link; what it says is asked for message by message
    "SERIAL1_PROTOCOL": -1,
    "SERIAL2_PROTOCOL": -1,
    **{f"SR0_{name}": 0 for name in ("EXTRA1", "EXTRA2", "EXTRA3", "POSITION", "RAW_SENS", "RC_CHAN", "EXT_STAT")},
}
SENSOR_FLIGHT = "SIM_TEMP_FLIGHT"
AIR_AT_HOME_DEGC = 11.8  # of the standard atmosphere, 489 m above sea
STEADY_SENSOR = {SENSOR_FLIGHT: AIR_AT_HOME_DEGC, "SIM_TEMP_START": AIR_AT_HOME_DEGC}
"""A sensor with a temperature of its own (4.1), no offset to the air's: its 35 degrees make heights 5 % too high."""
AVOIDANCE: dict[str, float] = {
    "PRX1_TYPE": 2,
    "PRX_TYPE": 2,
    "AVOID_ENABLE": 7,
    "AVOID_MARGIN": 3,
    "OA_TYPE": 1,
    "OA_BR_LOOKAHEAD": 10,
    "OA_LOOKAHEAD": 10,
    "OA_MARGIN_MAX": 3,
    "GUID_OPTIONS": 64,
}
"""Set where a scenario has obstacles, unless the test case sets them itself: proximity by MAVLink, BendyRuler."""


class Shown(NamedTuple):
    """Where a slot's value comes from: the first of these parameters that the binary has, and how to read it."""

    names: tuple[str, ...]
    scale: float = 1.0


SHOWN: dict[str, Shown] = {
    "rtl_altitude_set_m": Shown(("RTL_ALT",), 0.01),
    "rtl_altitude_final_set_m": Shown(("RTL_ALT_FINAL",), 0.01),
    "land_speed_set_mps": Shown(("LAND_SPEED",), 0.01),
    "land_altitude_low_set_m": Shown(("LAND_ALT_LOW",), 0.01),
    "pilot_speed_up_set_mps": Shown(("PILOT_SPEED_UP",), 0.01),
    "takeoff_speed_set_mps": Shown(("WPNAV_SPEED_UP",), 0.01),
    "chute_altitude_min_set_m": Shown(("CHUTE_ALT_MIN",)),
    "fs_throttle_set_pwm": Shown(("FS_THR_VALUE",)),
    "fs_throttle_enabled": Shown(("FS_THR_ENABLE",)),
    "failsafe_options_set": Shown(("FS_OPTIONS",)),
    "circle_options_set": Shown(("CIRCLE_OPTIONS",)),
    "auto_options_set": Shown(("AUTO_OPTIONS",)),
    "fs_gps_action": Shown(("FS_EKF_ACTION",)),
    "fence_type_set": Shown(("FENCE_TYPE",)),
    "fence_action_set": Shown(("FENCE_ACTION",)),
    "fence_altitude_max_set_m": Shown(("FENCE_ALT_MAX",)),
    "fence_radius_set_m": Shown(("FENCE_RADIUS",)),
    "battery_low_set_v": Shown(("BATT_LOW_VOLT",)),
    "battery_timer_set_s": Shown(("BATT_LOW_TIMER",)),
    "battery_low_action_set": Shown(("BATT_FS_LOW_ACT",)),
    "battery_critical_set_v": Shown(("BATT_CRT_VOLT",)),
    "battery_low_charge_set_mah": Shown(("BATT_LOW_MAH",)),
    "battery_capacity_set_mah": Shown(("BATT_CAPACITY",)),
    "arming_checks_set": Shown(("ARMING_CHECK",)),
    "angle_max_set_deg": Shown(("ANGLE_MAX",), 0.01),
    "acceleration_set_mps2": Shown(("WPNAV_ACCEL",), 0.01),
    "waypoint_radius_set_m": Shown(("WPNAV_RADIUS",), 0.01),
    "cruise_speed_set_mps": Shown(("WPNAV_SPEED",), 0.01),
    "return_climb_min_set_m": Shown(("RTL_CLIMB_MIN",), 0.01),
    "loiter_speed_set_mps": Shown(("LOIT_SPEED",), 0.01),
    "disarm_delay_set_s": Shown(("DISARM_DELAY",)),
    "trim_roll_set_deg": Shown(("AHRS_TRIM_X",), 57.29578),
    "trim_pitch_set_deg": Shown(("AHRS_TRIM_Y",), 57.29578),
    "circle_rate_set_dps": Shown(("CIRCLE_RATE",), 1.0),
    "descent_speed_set_mps": Shown(("WPNAV_SPEED_DN",), 0.01),
    "circle_radius_set_m": Shown(("CIRCLE_RADIUS",), 0.01),
}
YAW_P_DPS = 45.0  # a full stick turns so fast times ACRO_YAW_P, where there is no PILOT_Y_RATE (4.1)
CEILING = 1  # bit of FENCE_TYPE
BAROMETER = {"EK2_ALT_SOURCE": 0.0}  # heights come from there where no parameter asks for another source


def own_physics(test_case: TestCase) -> bool:
    """Return whether a test case is flown on the binary's own physics."""
    return test_case.target.settings.get(PHYSICS) == NATIVE


def without_log(test_case: TestCase) -> bool:
    """Return whether a test case is flown without the autopilot's own log."""
    return test_case.target.settings.get(LOG) == NO_LOG


def start_parameters(
    given: Mapping[str, float],
    known: Collection[str],
    *,
    obstacles: bool,
    own_physics: bool = False,
    log: bool = True,
) -> dict[str, float]:
    """Return what the vehicle starts with beyond the binary's own defaults; names it does not know are left out.

    On its own physics it is no F450, and flies with its own gains.
    """
    tune = {name: value for name, value in TUNE.items() if not (own_physics and name in F450)}
    tune |= STEADY_SENSOR if SENSOR_FLIGHT in known else {}
    ours = {**tune, **(AVOIDANCE if obstacles else {}), **({} if log else {"LOG_BACKEND_TYPE": 0.0})}
    return {name: float(value) for name, value in {**ours, **given}.items() if name in known}


def opening(known: Collection[str]) -> dict[str, float]:
    """Return values with which ArduPilot shows the parameters that it hides while what they belong to is off."""
    ours = {**TUNE, **AVOIDANCE}
    switches = [name for name in known if name.endswith(SWITCHES)]
    return {name: float(ours.get(name, 1.0)) for name in (*switches, *(name for name in ours if name in known))}


def as_file(parameters: Mapping[str, float]) -> str:
    """Return parameters as the text of a `.parm` file."""
    return "".join(f"{name} {value:.9g}\n" for name, value in parameters.items())


def show(vehicle: Vehicle, parameters: Mapping[str, float], home_up_m: float = 0.0) -> None:
    """Write the settings in force into the slots of the trace; `parameters` are all by name, `heights.py` says why."""
    for slot, shown in SHOWN.items():
        name = next((name for name in shown.names if name in parameters), None)
        if name is not None:
            vehicle[slot] = above_start(slot, shown.scale * parameters[name], home_up_m)
    get: Callable[[str, float], float] = parameters.get
    fast = get("LAND_SPEED_HIGH", 0.0) or get("WPNAV_SPEED_DN", 0.0)
    vehicle["land_speed_high_set_mps"] = 0.01 * fast
    vehicle["return_speed_set_mps"] = 0.01 * (get("RTL_SPEED", 0.0) or get("WPNAV_SPEED", 0.0))
    vehicle["pilot_speed_down_set_mps"] = 0.01 * (get("PILOT_SPEED_DN", 0.0) or get("PILOT_SPEED_UP", 0.0))
    vehicle["pilot_turn_speed_set_dps"] = get("PILOT_Y_RATE", YAW_P_DPS * get("ACRO_YAW_P", 0.0))
    vehicle["altitude_source"] = ARDUPILOT["altitude_source"]({**BAROMETER, **parameters})
