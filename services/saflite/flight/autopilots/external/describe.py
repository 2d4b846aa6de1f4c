"""What a target with a binary says of itself, where it does not hang on the autopilot."""

from __future__ import annotations

import hashlib
import importlib.util
from collections.abc import Collection, Iterator, Mapping

from saflite.contract.target_info import InputInfo, ValueType
from saflite.flight.autopilots.external.binary import Binary
from saflite.flight.autopilots.external.inputs import PULSE_HIGH_US, PULSE_LOW_US, STICKS
from saflite.flight.autopilots.external.link import CENTRE_US
from saflite.flight.autopilots.external.listing import Row
from saflite.flight.autopilots.external.metadata import Documented
from saflite.flight.autopilots.sticks import stick_inputs
from saflite.flight.build import build_of
from saflite.flight.mavlink.client import WHOLE

VEHICLE = "F450 quadcopter (JSBSim)"
LIBRARIES = ("jsbsim", "pymavlink")


def missing() -> str:
    """Return what this machine lacks beside a binary, empty if nothing."""
    lacking = [name for name in LIBRARIES if importlib.util.find_spec(name) is None]
    return f"the {lacking[0]} package is not installed" if lacking else ""


def identity(autopilot: str, binary: Binary | None, more: str = "") -> str:
    """Return the build of a target: the binary's digest and the code of ours that shapes a trace; empty for none."""
    if binary is None:
        return ""
    ours = build_of(autopilot, ("jsbsim", "numpy", "pymavlink"), ("external", "logs", "mavlink"))
    return hashlib.sha256(f"{ours} {more} {binary.digest}".encode()).hexdigest()


def sticks() -> Iterator[InputInfo]:
    """Yield the pilot's sticks."""
    return stick_inputs(STICKS, PULSE_LOW_US, PULSE_HIGH_US, CENTRE_US)


def modes_and_commands(modes: Collection[str], commands: Mapping[str, str]) -> Iterator[InputInfo]:
    """Yield the modes and commands that can be ordered."""
    for name in modes:
        yield InputInfo(kind="mode", name=name)
    for name, meaning in commands.items():
        yield InputInfo(kind="command", name=name, meaning=meaning)


def parameter(name: str, row: Row, told: Documented, default: float, *, fault: bool = False) -> InputInfo:
    """Return a parameter, or a fault that is one; its default is left out where it lies outside its own range."""
    low, high = told.low, told.high
    if low is not None and high is not None and low > high:
        low, high = high, low
    within = (low is None or default >= low) and (high is None or default <= high)
    kind: ValueType = "choice" if told.choices and low is None else "whole" if row.kind in WHOLE else "real"
    return InputInfo(
        kind="sensor_fault" if fault else "parameter",
        name=name,
        unit=told.unit,
        low=low,
        high=high,
        type=kind,
        choices=told.choices if kind == "choice" else (),
        default=default if within else None,
        meaning=told.meaning,
    )
