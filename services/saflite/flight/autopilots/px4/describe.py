"""What the target says of itself: from the binary's own list of parameters, its metadata if any, and tables."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Iterator
from pathlib import Path

from saflite.contract.target_info import InputInfo, TargetInfo, ValueType
from saflite.contract.test_case import StartState
from saflite.flight.autopilots.external.inputs import PULSE_HIGH_US, PULSE_LOW_US, STICKS
from saflite.flight.autopilots.external.link import CENTRE_US
from saflite.flight.autopilots.external.listing import Listing, Row
from saflite.flight.autopilots.px4.binary import AUTOPILOT, Binary
from saflite.flight.autopilots.px4.inputs import COMMANDS, INJECTED, MOTORS, OWN
from saflite.flight.autopilots.px4.metadata import Documented, documented
from saflite.flight.autopilots.px4.modes import MODES, NUMBERS
from saflite.flight.autopilots.px4.settings import TUNE
from saflite.flight.autopilots.px4.signals import trace_names
from saflite.flight.build import build_of
from saflite.flight.logs import settings as log_settings
from saflite.flight.mavlink.client import WHOLE

TIME_LIMIT_MAX_S = 3600.0
START_MODES = ("BRAKE", "LOITER", "ALT_HOLD", "STABILIZE", "RTL", "LAND", "ACRO", "GUIDED")
_NOT_OFFERED = ("MAV_", "SYS_", "SDLOG_", "IMU_INTEG_RATE", "CAL_", "SER_", "UXRCE_", "SIM_", "SIH_", "COM_FLIGHT")
"""Parameters that would take the link, the clock or the log away rather than say anything of the vehicle."""


def describe(binary: Binary | None, listing: Listing | None, lacking: str) -> TargetInfo:
    """Return what the target is and can do here, with nothing of a binary where there is none."""
    here = binary is not None and listing is not None and not lacking
    parameters = _parameters(listing, binary.path) if here else ()  # type: ignore[union-attr, arg-type]
    return TargetInfo(
        name=AUTOPILOT,
        build=identity(binary) if here and binary is not None else "",
        repeats="statistically",
        inputs=(*_sticks(), *_modes(), *_commands(), *_faults(), *parameters),
        signals=trace_names(listing.values if listing is not None else {}),
        modes=MODES,
        start_states=(
            *(StartState(mode=mode) for mode in START_MODES),
            StartState(mode="LOITER", altitude_m=0.0, armed=False),
        ),
        missions=True,
        obstacles=True,
        wind=True,
        time_limit_max_s=TIME_LIMIT_MAX_S,
        vehicle="F450 quadcopter (JSBSim)",
        autopilot=binary.version if binary is not None else "PX4",
        needs=("jsbsim", "pymavlink", "a simulator build of PX4"),
        missing=lacking,
    )


def missing() -> str:
    """Return what this machine lacks beside a binary, empty if nothing."""
    lacking = [name for name in ("jsbsim", "pymavlink") if importlib.util.find_spec(name) is None]
    return f"the {lacking[0]} package is not installed" if lacking else ""


def identity(binary: Binary) -> str:
    """Return the build of the target: the digest of the binary and its files, and our code that shapes a trace."""
    ours = build_of(AUTOPILOT, ("jsbsim", "numpy", "pymavlink"), ("external",))
    shown = hashlib.sha256(Path(log_settings.__file__).read_bytes()).hexdigest()  # which settings the trace shows
    return hashlib.sha256(f"{ours} {shown} {binary.digest}".encode()).hexdigest()


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
    for name in NUMBERS:
        yield InputInfo(kind="mode", name=name)


def _commands() -> Iterator[InputInfo]:
    for name, meaning in COMMANDS.items():
        yield InputInfo(kind="command", name=name, meaning=meaning)


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
        if not name.startswith(_NOT_OFFERED) and name not in TUNE:
            yield _parameter(name, row, told.get(name, Documented()))


def _parameter(name: str, row: Row, told: Documented) -> InputInfo:
    low, high, default = told.low, told.high, row.value
    within = (low is None or default >= low) and (high is None or default <= high)
    kind: ValueType = "choice" if told.choices and low is None else "whole" if row.kind in WHOLE else "real"
    return InputInfo(
        kind="parameter",
        name=name,
        unit=told.unit,
        low=low,
        high=high,
        type=kind,
        choices=told.choices if kind == "choice" else (),
        default=default if within else None,
        meaning=told.meaning,
    )
