"""What the target says of itself, from the binary's own list of settings and the tables here."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator

from saflite.contract.target_info import InputInfo, SettingInfo, TargetInfo
from saflite.contract.test_case import StartState
from saflite.flight.autopilots.betaflight import user_memory
from saflite.flight.autopilots.betaflight.configuration import known_settings, tune
from saflite.flight.autopilots.betaflight.faults import PAIRS, WHOLE, known_faults
from saflite.flight.autopilots.betaflight.firmware import Variant, identity, listing, why_missing
from saflite.flight.autopilots.betaflight.flight import HANDS_OFF, HOLDS, LINKS, SETTING_LINK, SETTING_PILOT
from saflite.flight.autopilots.betaflight.in_flight import FIELDS
from saflite.flight.autopilots.betaflight.inputs import MSP2_COMMAND, MSP_COMMAND, RAW_BYTES, SWITCH
from saflite.flight.autopilots.betaflight.settings import BetaflightSetting
from saflite.flight.autopilots.betaflight.signals import OWN_SIGNALS, trace_names
from saflite.flight.autopilots.betaflight.switches import (
    CENTRE_US,
    MODES,
    PULSE_HIGH_US,
    PULSE_LOW_US,
    STICKS,
    SWITCHES,
    pilot_modes,
)
from saflite.flight.autopilots.sticks import stick_inputs

TIME_LIMIT_MAX_S = 600.0
SETTINGS = {
    SETTING_LINK: SettingInfo(
        meaning="how the pilot's sticks travel",
        default="msp",
        choices=tuple(LINKS),
        choice_meanings={"msp": "as messages at 50 Hz, which can get lost", "udp": "as the simulator's own packets"},
    ),
    user_memory.SETTING: SettingInfo(
        meaning="path of an eeprom.bin whose settings the test case's are added to; empty: the firmware's defaults",
        default="",
    ),
    SETTING_PILOT: SettingInfo(
        meaning="what the pilot does with sticks that the test case leaves alone",
        default=HOLDS,
        choices=(HOLDS, HANDS_OFF),
        choice_meanings={HOLDS: "keeps the vehicle in its place", HANDS_OFF: "leaves them where they are at the start"},
    ),
}


def describe(name: str, variant: Variant) -> TargetInfo:
    """Return what the target is and can do here; raises Unavailable where the native library was not built."""
    lacking = missing(variant)
    return TargetInfo(
        name=name,
        build="" if lacking else identity(variant),
        repeats="bitwise",
        inputs=tuple(_inputs(variant, lacking)),
        signals=trace_names(),
        own_signals=OWN_SIGNALS,
        modes=MODES,
        start_states=_starts(variant),
        settings=SETTINGS,
        wind=True,
        snapshots=True,
        time_limit_max_s=TIME_LIMIT_MAX_S,
        vehicle="F450 quadcopter (JSBSim)",
        stock=not variant.options and not variant.sanitized,
        options=built_with(variant),
        autopilot=f"Betaflight, {variant.name} build" + ("" if lacking else f": {listing(variant).version}"),
        needs=("jsbsim", "gcc", "make", "the betaflight package's source"),
        missing=lacking,
    )


def built_with(variant: Variant) -> str:
    """Return what a build has beyond the stock one, empty for that."""
    sanitizers = "address and undefined-behaviour sanitizers" if variant.sanitized else ""
    return ", ".join(word for word in (variant.options, sanitizers) if word)


def missing(variant: Variant) -> str:
    """Return what this machine lacks to fly, empty if nothing."""
    if importlib.util.find_spec("jsbsim") is None:
        return "the jsbsim package is not installed"
    return why_missing(variant)


def _inputs(variant: Variant, lacking: str) -> Iterator[InputInfo]:
    yield from stick_inputs(STICKS, PULSE_LOW_US, PULSE_HIGH_US, CENTRE_US, no_centre=("RC3",))
    yield from (*_modes(variant), *_switches(variant), *_faults(variant))
    if variant.sanitized:
        yield from _messages()
    yield from _parameters(variant, lacking)


def _starts(variant: Variant) -> tuple[StartState, ...]:
    modes = ("ALTHOLD",) if variant.gps else ()
    ground = StartState(mode="ANGLE", altitude_m=0.0, armed=False)
    return (*(StartState(mode=mode, altitude_m=20.0) for mode in ("ANGLE", *modes, "ACRO")), ground)


def _modes(variant: Variant) -> Iterator[InputInfo]:
    for name in pilot_modes(variant.gps):
        yield InputInfo(kind="mode", name=name, meaning="by its switches")


def _switches(variant: Variant) -> Iterator[InputInfo]:
    for name, switch in SWITCHES.items():
        if variant.gps or not switch.gps:
            yield InputInfo(
                kind="command",
                name=f"{SWITCH}{name}",
                type="flag",
                low=0.0,
                high=1.0,
                meaning=switch.meaning,
                link="pilot",
            )


def _messages() -> Iterator[InputInfo]:
    """Yield what a message strategy needs; a search over all inputs would only ever send empty ones."""
    yield InputInfo(
        kind="command", name=MSP_COMMAND, low=1, high=1, meaning="a message number (1: version), payload bytes"
    )
    yield InputInfo(kind="command", name=MSP2_COMMAND, low=1, high=1, meaning="the same, framed as version 2")
    yield InputInfo(kind="command", name=RAW_BYTES, low=0, high=255, type="whole", meaning="bytes to the serial port")


def _faults(variant: Variant) -> Iterator[InputInfo]:
    for name, fault in known_faults(variant.gps).items():
        yield InputInfo(
            kind="sensor_fault",
            name=name,
            unit=fault.unit,
            low=fault.low,
            high=fault.high,
            type="choice" if name == "motor_swap" else "whole" if name in WHOLE else "real",
            choices=PAIRS if name == "motor_swap" else (),
            default=fault.healthy,
            meaning=fault.meaning,
        )


def _parameters(variant: Variant, lacking: str) -> Iterator[InputInfo]:
    if lacking:
        return
    tuned = tune(variant)
    for setting in known_settings(variant).values():
        yield _parameter(setting, tuned.get(setting.name, setting.default))


def _parameter(setting: BetaflightSetting, default: float) -> InputInfo:
    return InputInfo(
        kind="parameter",
        name=setting.name,
        low=setting.low,
        high=setting.high,
        type="whole",
        default=default,
        meaning=", ".join(f"{place} {word}" for place, word in enumerate(setting.words)),
        at_start=setting.name not in FIELDS,
    )
