"""What the vehicle starts with, and which settings the trace shows."""

from __future__ import annotations

from collections.abc import Mapping

from saflite.contract.test_case import TestCase
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.px4.vehicle import Vehicle
from saflite.flight.heights import above_start
from saflite.flight.logs.settings import PX4
from saflite.flight.mavlink.client import WHOLE

PHYSICS, SIH = "physics", "sih"
COMPANION, PLANNER, PILOT = "companion", "planner", "pilot"
OWN_KIND, QUADROTOR = "SIH_VEHICLE_TYPE", 0.0  # a parameter that only a build with physics of its own has
TUNE: dict[str, float] = {
    "IMU_INTEG_RATE": 200,  # the rate of the world's sensors
    "COM_RC_IN_MODE": 0,  # a radio that can be lost, no joystick
    "COM_RCL_EXCEPT": 0,
    "RC_CHAN_CNT": 8,  # above 0 the radio counts as calibrated
    "RC_MAP_ROLL": 1,
    "RC_MAP_PITCH": 2,
    "RC_MAP_THROTTLE": 3,
    "RC_MAP_YAW": 4,
    "RC2_REV": -1,  # below the centre is forward, as on other targets
    "RC_FAILS_THR": 950,
    "COM_DISARM_PRFLT": -1,  # no time limit from arming to take-off
    "SIM_BAT_DRAIN": 3600,
    "MIS_TAKEOFF_ALT": 20,
}
"""Gains are those of its Iris: they fly the F450 as they are."""
AVOIDANCE: dict[str, float] = {"CP_DIST": 3}
"""Set where a scenario has obstacles, unless the test case sets it itself: collision prevention in position mode."""
NO_LOG: dict[str, float] = {"SDLOG_BACKEND": 0}


def own_physics(test_case: TestCase) -> bool:
    """Return whether a test case is flown on the binary's own physics."""
    return test_case.target.settings.get(PHYSICS) == SIH


def companion_of(test_case: TestCase) -> str:
    """Return who flies the mission of a test case in PX4's place, empty for nobody."""
    named = str(test_case.target.settings.get(COMPANION, "none"))
    return "" if named == "none" else named


def start_parameters(given: Mapping[str, float], listing: Listing, *, obstacles: bool) -> dict[str, float]:
    """Return what the vehicle starts with beyond the binary's own defaults; names it does not know are left out."""
    ours = {**TUNE, **(AVOIDANCE if obstacles else {})}
    return {name: float(value) for name, value in {**ours, **given}.items() if name in listing.parameters}


def as_texts(parameters: Mapping[str, float], types: Mapping[str, int]) -> dict[str, str]:
    """Return values as PX4's start-up files take them, by type."""
    return {
        name: str(round(value)) if types.get(name) in WHOLE else f"{value:.9g}" for name, value in parameters.items()
    }


def shown_settings(parameters: Mapping[str, float]) -> dict[str, float]:
    """Return the settings in force by slot of the trace, of those that the parameters say."""
    found: dict[str, float] = {}
    for slot, rule in PX4.items():
        try:
            found[slot] = rule(parameters)
        except (KeyError, StopIteration):  # another release has it under another name, or not at all
            continue
    if "RC_FAILS_THR" in parameters:
        found["fs_throttle_set_pwm"] = parameters["RC_FAILS_THR"]
    if "NAV_RCL_ACT" in parameters:
        found["fs_throttle_enabled"] = float(parameters["NAV_RCL_ACT"] > 0)
    return found


def show(vehicle: Vehicle, parameters: Mapping[str, float], home_up_m: float = 0.0) -> None:
    """Write the settings in force into the slots of the trace; `parameters` are all by name, `heights.py` says why."""
    vehicle.set(**{slot: above_start(slot, value, home_up_m) for slot, value in shown_settings(parameters).items()})
