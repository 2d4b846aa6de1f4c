"""What the target says of itself: from the binary's own list of parameters, its metadata if any, and tables."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from saflite.contract.target_info import InputInfo, SettingInfo, TargetInfo, ValueType
from saflite.contract.test_case import StartState
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.check import TIME_LIMIT_MAX_S
from saflite.flight.autopilots.external.describe import (
    LIBRARIES,
    VEHICLE,
    identity,
    modes_and_commands,
    parameter,
    sticks,
)
from saflite.flight.autopilots.external.listing import Listing
from saflite.flight.autopilots.external.metadata import Documented
from saflite.flight.autopilots.px4.binary import AUTOPILOT
from saflite.flight.autopilots.px4.inputs import COMMANDS, INJECTED, MOTORS, NOT_OWN_PHYSICS, OWN
from saflite.flight.autopilots.px4.metadata import documented
from saflite.flight.autopilots.px4.modes import MODES, NUMBERS
from saflite.flight.autopilots.px4.settings import COMPANION, PHYSICS, PILOT, PLANNER, SIH, TUNE
from saflite.flight.autopilots.px4.signals import trace_names
from saflite.flight.logs import settings as log_settings

START_MODES = ("BRAKE", "LOITER", "ALT_HOLD", "STABILIZE", "RTL", "LAND", "ACRO", "GUIDED")
SPLINE_WAYPOINT, CONDITION_DELAY, CONDITION_YAW = 82, 112, 115
NO_MISSION_ITEMS = (SPLINE_WAYPOINT, CONDITION_DELAY, CONDITION_YAW)
"""Common items that PX4 answers as not supported, and with them the whole mission (1.17, `mavlink_mission.cpp`); a
mission with a CONDITION_DELAY it takes, finds not feasible (`FeasibilityChecker.cpp`), and does not arm."""
SETTINGS = {
    COMPANION: SettingInfo(
        meaning="who flies a mission's way-points in PX4's place, which takes off and lands",
        default="none",
        choices=("none", PLANNER, PILOT),
        choice_meanings={
            PLANNER: "our local planner, in OFFBOARD, round the boxes",
            PILOT: "a pilot by the sticks, in position mode, blind to boxes: PX4's collision prevention must hold",
        },
    ),
    PHYSICS: SettingInfo(
        meaning="whose physics is flown",
        default="jsbsim",
        choices=("jsbsim", SIH),
        choice_meanings={SIH: "PX4's own quadrotor and sensors, in lockstep; boxes end the flight, no wind"},
        lacks={SIH: NOT_OWN_PHYSICS},
    ),
}
_NOT_OFFERED = ("MAV_", "SYS_", "SDLOG_", "IMU_INTEG_RATE", "CAL_", "SER_", "UXRCE_", "SIM_", "SIH_", "COM_FLIGHT")
"""Parameters that would take the link, the clock or the log away rather than say anything of the vehicle."""
_BUILT = ("CA_AIRFRAME", "CA_ROTOR", "CA_R_REV", "PWM_MAIN_FUNC", "PWM_MAIN_REV", "SENS_BOARD_")
"""Those that say how the vehicle is built and wired: where its rotors sit, which output turns which, how the board is
turned. All can be set in flight within documented ranges, and the vehicle tumbles at once: nobody rebuilds it there."""


def describe(binary: Binary | None, listing: Listing | None, lacking: str) -> TargetInfo:
    """Return what the target is and can do here, with nothing of a binary where there is none."""
    here = binary if listing is not None and not lacking else None
    parameters = () if here is None or listing is None else _parameters(listing, here.path)
    shown = hashlib.sha256(Path(log_settings.__file__).read_bytes()).hexdigest()  # which settings the trace shows
    return TargetInfo(
        name=AUTOPILOT,
        build=identity(AUTOPILOT, here, shown),
        repeats="statistically",
        inputs=(*sticks(), *modes_and_commands(NUMBERS, COMMANDS), *_faults(), *parameters),
        signals=trace_names(listing.values if listing is not None else {}),
        modes=MODES,
        settings=SETTINGS,
        start_states=(
            *(StartState(mode=mode) for mode in START_MODES),
            StartState(mode="LOITER", altitude_m=0.0, armed=False),
        ),
        missions=True,
        mission_lacks=NO_MISSION_ITEMS,
        obstacles=True,
        wind=True,
        time_limit_max_s=TIME_LIMIT_MAX_S,
        vehicle=VEHICLE,
        autopilot=binary.version if binary is not None else "PX4",
        needs=(*LIBRARIES, "a simulator build of PX4"),
        missing=lacking,
    )


def _faults() -> Iterator[InputInfo]:
    for name, fault in OWN.items():
        kind: ValueType = "whole" if name == "motor_failed" else "flag" if name.endswith("_loss") else "real"
        yield InputInfo(
            kind="sensor_fault",
            name=name,
            unit=fault.unit,
            low=fault.low,
            high=fault.high,
            type=kind,
            default=fault.healthy,
            meaning=fault.meaning,
        )
    for name, injected in INJECTED.items():
        motor = name == "motor_off"
        yield InputInfo(
            kind="sensor_fault",
            name=name,
            low=0.0,
            high=float(MOTORS if motor else 1),
            type="whole" if motor else "flag",
            default=0.0,
            meaning=injected.meaning,
            link="trusted",
        )


def _parameters(listing: Listing, binary: Path) -> Iterator[InputInfo]:
    told = documented(binary)
    for name, row in listing.parameters.items():
        if not name.startswith((*_NOT_OFFERED, *_BUILT)) and name not in TUNE:
            yield parameter(name, row, told.get(name, Documented()), row.value)
