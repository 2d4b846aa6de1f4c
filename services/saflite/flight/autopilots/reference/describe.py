"""What the reference target says of itself, from its own tables."""

from __future__ import annotations

import importlib.util
from functools import cache

from saflite.contract.signals import SIGNALS
from saflite.contract.target_info import InputInfo, TargetInfo
from saflite.contract.test_case import DEFAULT_TARGET, StartState
from saflite.flight.autopilots.reference import tables
from saflite.flight.autopilots.reference.check import TIME_LIMIT_MAX_S
from saflite.flight.autopilots.reference.command_names import NAMES
from saflite.flight.autopilots.reference.defects import SETTINGS
from saflite.flight.autopilots.reference.flight import trace_names
from saflite.flight.autopilots.reference.modes.table import mode_table
from saflite.flight.autopilots.reference.parameter import Parameter
from saflite.flight.autopilots.reference.parameters import parameter_table
from saflite.flight.autopilots.reference.radio import CENTRED
from saflite.flight.build import build_of
from saflite.flight.mending import builds_library
from saflite.flight.native_library import LIBRARY

NAME = DEFAULT_TARGET
COMMAND_PREFIX = "MAV_CMD_"
STICK_LOW_PWM, STICK_HIGH_PWM = 1000.0, 2000.0
_STICK_MEANINGS = {1: "roll stick", 2: "pitch stick, below the centre is forward", 3: "throttle stick", 4: "yaw stick"}
_SWITCHES = (
    *("_ENABLE", "_ENABLED", "_DISABLE", "_TYPE", "_OPTIONS", "_ACTION", "_BOOST", "_TRAINER", "_SOURCE", "_BHV"),
    *("_PRIMARY", "_NUMSATS", "_SATS_MIN", "_NAVFILTER", "_FAIL"),
)
_WHOLE_UNITS = frozenset({"cm", "cm/s", "ms", "us", "cdeg"})


@cache
def describe() -> TargetInfo:
    """Return what this target is and can do; raises Unavailable where the native library was not built."""
    return TargetInfo(
        name=NAME,
        build=build_of(NAME),
        repeats="bitwise",
        inputs=(*_sticks(), *_commands(), *_parameters(), *_modes()),
        signals=tuple(name for name in SIGNALS if name in frozenset(trace_names())),
        modes=tables.modes(),
        start_states=_start_states(),
        settings=SETTINGS,
        missions=True,
        obstacles=True,
        wind=True,
        turns=True,
        snapshots=True,
        time_limit_max_s=TIME_LIMIT_MAX_S,
        vehicle="F450 quadcopter (JSBSim)",
        autopilot="SaFliTe reference flight stack, with ArduCopter's names",
        needs=("jsbsim",),
        missing=missing(),
    )


def missing() -> str:
    """Return what this machine lacks to fly, empty if nothing."""
    if importlib.util.find_spec("jsbsim") is None:
        return "the jsbsim package is not installed"
    return "" if LIBRARY.exists() else f"the native library is not built ({builds_library()})"


def _sticks() -> tuple[InputInfo, ...]:
    return tuple(
        InputInfo(
            kind="stick",
            name=f"RC{channel}",
            unit="us",
            low=STICK_LOW_PWM,
            high=STICK_HIGH_PWM,
            type="whole",
            default=centre_pwm,
            meaning=_STICK_MEANINGS[channel],
        )
        for channel, centre_pwm in CENTRED.items()
    )


def _commands() -> tuple[InputInfo, ...]:
    meanings = {row.name: row.meaning for row in tables.commands().values()}
    return tuple(
        InputInfo(kind="command", name=f"{COMMAND_PREFIX}{name}", meaning=meanings.get(name, ""))
        for name in sorted(NAMES)
    )


def _parameters() -> tuple[InputInfo, ...]:
    return tuple(_parameter(row) for row in parameter_table().values())


def _parameter(row: Parameter) -> InputInfo:
    whole = row.unit in _WHOLE_UNITS or row.name.endswith(_SWITCHES)
    return InputInfo(
        kind="sensor_fault" if row.name.startswith(tables.SIMULATION) else "parameter",
        name=row.name,
        unit=row.unit,
        low=float(row.low),
        high=float(row.high),
        type="whole" if whole else "real",
        default=float(row.default),
        meaning=row.meaning + (" (acts at the next start)" if row.reboot else ""),
        restart=row.reboot,
    )


def _modes() -> tuple[InputInfo, ...]:
    kinds = mode_table()
    return tuple(
        InputInfo(kind="mode", name=name, meaning=(kinds[name].__doc__ or "").partition("\n")[0])
        for name in tables.modes()
    )


def _start_states() -> tuple[StartState, ...]:
    flying = tuple(StartState(mode=name) for name in tables.modes() if name not in ("AUTO", "GUIDED"))
    return (StartState(), *flying, StartState(mode="STABILIZE", altitude_m=0.0, armed=False))
