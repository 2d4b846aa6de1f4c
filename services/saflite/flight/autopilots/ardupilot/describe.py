"""What the target says of itself: from the binary's own list of parameters, its metadata if any, and tables."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import DEFAULT_TARGET, StartState
from saflite.flight.autopilots.ardupilot.binary import AUTOPILOT
from saflite.flight.autopilots.ardupilot.inputs import COMMANDS, SIMULATION
from saflite.flight.autopilots.ardupilot.metadata import documented
from saflite.flight.autopilots.ardupilot.settings import SETTINGS, TUNE
from saflite.flight.autopilots.ardupilot.signals import trace_names
from saflite.flight.autopilots.ardupilot.telemetry import MODES
from saflite.flight.autopilots.described import setting_ranges
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

START_MODES = (
    "GUIDED",
    "LOITER",
    "ALT_HOLD",
    "STABILIZE",
    "RTL",
    "CIRCLE",
    "BRAKE",
    "POSHOLD",
    "LAND",
    "ACRO",
    "SPORT",
)
NOT_OFFERED = frozenset(
    {
        *("FORMAT_VERSION", "SYSID_THISMAV", "SYSID_MYGCS", "SIM_SPEEDUP", "SIM_RATE_HZ", "SIM_LOOP_DELAY"),
        *("LOG_DISARMED", "LOG_BACKEND_TYPE"),
    }
)
"""Parameters that would take the link or the clock away from the world rather than say anything of the vehicle."""
_OURS = ("SERIAL0_", "SR0_")
_BUILT = re.compile(
    r"SERIAL|SR\d_|SCHED_|BRD_|LOG_|TELEM_|CAN_|NET_|SCR_"  # link, clock and log
    r"|FRAME_|SERVO|MOT_PWM_|RCMAP_|RC_PROTOCOLS|RC\d+_(REVERSED|OPTION)|FLTMODE_CH|AHRS_(ORIENT|CUSTOM_)|CUST_ROT"
    r"|COMPASS_(ORIENT|EXTERN|TYPEMASK|OFS[23]|DIA|ODI|MOT|SCALE)|BARO\d_WCF"
    r"|INS_(ENABLE_MASK|FAST_SAMPLE|POS|ACC[23]|ACCSCAL|GYR[23]|TCAL)"
)
"""Those that say how the vehicle is built, wired and calibrated, and what its switches are: where metadata gives ranges
for them, searches do not draw from these, as nobody rebuilds it in flight. Ranges of our own table stay."""
GLITCH_DEG = 0.001  # some 100 m
OWN_UNITS = {f"SIM_GPS_GLITCH_{axis}": Documented(-GLITCH_DEG, GLITCH_DEG, "deg") for axis in ("X", "Y")}
"""Names shared with our own vehicle that mean something else here: latitude and longitude (4.5.7, `SIM_GPS.cpp`)."""


def describe(binary: Binary | None, listing: Listing | None, lacking: str) -> TargetInfo:
    """Return what the target is and can do here, with nothing of a binary where there is none."""
    here = binary if listing is not None and not lacking else None
    parameters = () if here is None or listing is None else _parameters(listing, here.path)
    return TargetInfo(
        name=AUTOPILOT,
        build=identity(AUTOPILOT, here),
        repeats="bitwise",
        inputs=(*sticks(), *modes_and_commands(MODES, COMMANDS), *parameters),
        signals=trace_names(),
        modes=MODES,
        settings=SETTINGS,
        start_states=(
            *(StartState(mode=mode) for mode in START_MODES),
            StartState(mode="STABILIZE", altitude_m=0.0, armed=False),
        ),
        missions=True,
        obstacles=True,
        wind=True,
        turns=True,
        snapshots=True,
        time_limit_max_s=TIME_LIMIT_MAX_S,
        vehicle=VEHICLE,
        autopilot=binary.version if binary is not None else "ArduCopter",
        needs=(*LIBRARIES, "a simulator build of ArduCopter"),
        missing=lacking,
    )


def _parameters(listing: Listing, binary: Path) -> Iterator[InputInfo]:
    """Yield the binary's parameters; without metadata, ranges stand for the names that our own vehicle shares."""
    told = {name: Documented(low, high) for name, (low, high) in setting_ranges(DEFAULT_TARGET).items()}
    told.update(OWN_UNITS)
    for name, found in documented(binary).items():
        if not _BUILT.match(name):
            told[name] = found
        elif name not in told:
            told[name] = found._replace(low=None, high=None, choices=())
    for name, row in listing.parameters.items():
        if name not in NOT_OFFERED and not name.startswith(_OURS):
            default = TUNE.get(name, row.value)
            yield parameter(name, row, told.get(name, Documented()), default, fault=name.startswith(SIMULATION))
