"""What the target says of itself: from the binary's own list of parameters, its metadata if any, and tables."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path

from saflite.contract.target_info import InputInfo, TargetInfo, ValueType
from saflite.contract.test_case import DEFAULT_TARGET, StartState
from saflite.flight.autopilots.ardupilot.binary import AUTOPILOT, Binary
from saflite.flight.autopilots.ardupilot.inputs import COMMANDS, SIMULATION
from saflite.flight.autopilots.ardupilot.metadata import Documented, documented
from saflite.flight.autopilots.ardupilot.settings import TUNE
from saflite.flight.autopilots.ardupilot.signals import trace_names
from saflite.flight.autopilots.ardupilot.telemetry import MODES
from saflite.flight.autopilots.described import setting_ranges
from saflite.flight.autopilots.external.inputs import PULSE_HIGH_US, PULSE_LOW_US, STICKS
from saflite.flight.autopilots.external.link import CENTRE_US
from saflite.flight.autopilots.external.listing import Listing, Row
from saflite.flight.build import build_of
from saflite.flight.mavlink.client import WHOLE

TIME_LIMIT_MAX_S = 3600.0
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


def describe(binary: Binary | None, listing: Listing | None, lacking: str) -> TargetInfo:
    """Return what the target is and can do here, with nothing of a binary where there is none."""
    here = binary is not None and listing is not None and not lacking
    return TargetInfo(
        name=AUTOPILOT,
        build=identity(binary) if here and binary is not None else "",
        repeats="bitwise",
        inputs=(*_sticks(), *_modes(), *_commands(), *(_parameters(listing, binary.path) if here else ())),  # type: ignore[union-attr, arg-type]
        signals=trace_names(),
        modes=MODES,
        start_states=(
            *(StartState(mode=mode) for mode in START_MODES),
            StartState(mode="STABILIZE", altitude_m=0.0, armed=False),
        ),
        missions=True,
        obstacles=True,
        wind=True,
        time_limit_max_s=TIME_LIMIT_MAX_S,
        vehicle="F450 quadcopter (JSBSim)",
        autopilot=binary.version if binary is not None else "ArduCopter",
        needs=("jsbsim", "pymavlink", "a simulator build of ArduCopter"),
        missing=lacking,
    )


def missing() -> str:
    """Return what this machine lacks beside a binary, empty if nothing."""
    lacking = [name for name in ("jsbsim", "pymavlink") if importlib.util.find_spec(name) is None]
    return f"the {lacking[0]} package is not installed" if lacking else ""


def identity(binary: Binary) -> str:
    """Return the build of the target: the binary's digest and the code of ours that shapes a trace."""
    ours = build_of(AUTOPILOT, ("jsbsim", "numpy", "pymavlink"), ("external",))
    return hashlib.sha256(f"{ours} {binary.digest}".encode()).hexdigest()


def _sticks() -> Iterator[InputInfo]:
    for name, meaning in STICKS.items():
        yield InputInfo(
            kind="stick",
            name=name,
            unit="us",
            low=PULSE_LOW_US,
            high=PULSE_HIGH_US,
            type="whole",
            default=CENTRE_US,
            meaning=meaning,
        )


def _modes() -> Iterator[InputInfo]:
    for name in MODES:
        yield InputInfo(kind="mode", name=name)


def _commands() -> Iterator[InputInfo]:
    for name, meaning in COMMANDS.items():
        yield InputInfo(kind="command", name=name, meaning=meaning)


def _parameters(listing: Listing, binary: Path) -> Iterator[InputInfo]:
    """Yield the binary's parameters; without metadata, ranges stand for the names that our own vehicle shares."""
    told = {name: Documented(low, high) for name, (low, high) in setting_ranges(DEFAULT_TARGET).items()}
    told.update(documented(binary))
    for name, row in listing.parameters.items():
        if name not in NOT_OFFERED and not name.startswith(_OURS):
            yield _parameter(name, row, told.get(name, Documented()))


def _parameter(name: str, row: Row, told: Documented) -> InputInfo:
    default = TUNE.get(name, row.value)
    low, high = told.low, told.high
    if low is not None and high is not None and low > high:
        low, high = high, low
    within = (low is None or default >= low) and (high is None or default <= high)
    kind: ValueType = "choice" if told.choices and low is None else "whole" if row.kind in WHOLE else "real"
    return InputInfo(
        kind="sensor_fault" if name.startswith(SIMULATION) else "parameter",
        name=name,
        unit=told.unit,
        low=low,
        high=high,
        type=kind,
        choices=told.choices if kind == "choice" else (),
        default=default if within else None,
        meaning=told.meaning,
    )
