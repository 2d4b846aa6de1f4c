"""The inputs that ArduCopter takes: commands, and its simulated faults, which are parameters."""

from __future__ import annotations

from collections.abc import Collection

from saflite.contract.test_case import Stimulus
from saflite.flight.autopilots.ardupilot.telemetry import MODES
from saflite.flight.autopilots.external import inputs

SIMULATION = "SIM_"
MODE_NUMBERS = {name: (float(number),) for name, number in MODES.items()}
COMMANDS: dict[str, str] = {
    "MAV_CMD_NAV_TAKEOFF": "climb to a height",
    "MAV_CMD_NAV_LAND": "land here",
    "MAV_CMD_NAV_RETURN_TO_LAUNCH": "return and land",
    "MAV_CMD_NAV_LOITER_UNLIM": "hold the place",
    "MAV_CMD_CONDITION_YAW": "turn to a heading",
    "MAV_CMD_DO_CHANGE_SPEED": "change the speed of autonomous flight",
    "MAV_CMD_DO_SET_HOME": "set the home position",
    "MAV_CMD_DO_REPOSITION": "fly to a place",
    "MAV_CMD_DO_PAUSE_CONTINUE": "pause or continue a mission",
    "MAV_CMD_DO_SET_ROI_LOCATION": "point at a place",
    "MAV_CMD_DO_SET_ROI_NONE": "point at nothing",
    "MAV_CMD_DO_FENCE_ENABLE": "switch fences on or off",
    "MAV_CMD_DO_PARACHUTE": "switch the parachute off, on, or release it",
    "MAV_CMD_DO_MOTOR_TEST": "run one motor",
    "MAV_CMD_DO_GRIPPER": "move the gripper",
    "MAV_CMD_DO_WINCH": "move the winch",
    "MAV_CMD_DO_SET_SERVO": "move a servo output",
    "MAV_CMD_DO_REPEAT_SERVO": "move a servo output to and fro",
    "MAV_CMD_DO_SET_RELAY": "switch a relay",
    "MAV_CMD_DO_MOUNT_CONTROL": "move the camera mount",
    "MAV_CMD_DO_DIGICAM_CONTROL": "operate the camera",
    "MAV_CMD_DO_SPRAYER": "switch the sprayer",
    "MAV_CMD_DO_AUX_FUNCTION": "operate an auxiliary function",
    "MAV_CMD_DO_FLIGHTTERMINATION": "stop the motors",
    "MAV_CMD_DO_SET_MISSION_CURRENT": "go to an item of the mission",
    "MAV_CMD_DO_SEND_BANNER": "say the version",
    "MAV_CMD_MISSION_START": "start the mission",
    "MAV_CMD_COMPONENT_ARM_DISARM": "arm or disarm",
    "MAV_CMD_RUN_PREARM_CHECKS": "check whether it may be armed",
    "MAV_CMD_PREFLIGHT_CALIBRATION": "calibrate sensors",
    "MAV_CMD_PREFLIGHT_SET_SENSOR_OFFSETS": "set compass offsets",
    "MAV_CMD_SET_EKF_SOURCE_SET": "take another set of sources for the estimate",
    "MAV_CMD_DO_START_MAG_CAL": "begin to calibrate the compass",
    "MAV_CMD_DO_CANCEL_MAG_CAL": "give up calibrating the compass",
    "MAV_CMD_FIXED_MAG_CAL_YAW": "calibrate the compass by a known heading",
    "MAV_CMD_DO_ENGINE_CONTROL": "start or stop an engine",
    "MAV_CMD_GET_HOME_POSITION": "ask for the home position",
}


def check_stimulus(stimulus: Stimulus, known: Collection[str], where: str) -> None:
    """Raise Refused for a stimulus that cannot even be given; `known` are the binary's parameters."""
    inputs.check_stimulus(stimulus, known, MODES, where)
    if stimulus.kind == "sensor_fault":
        inputs.check_parameter(stimulus.name, known, where)
