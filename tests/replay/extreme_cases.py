"""Flights of a healthy vehicle with everything rules read at the ends of its range, no defect planted.

A flight is a row of acts from a start in any mode, at a height where something begins or ends, or of a mission: modes
(some at one instant), orders, settings set to an end of their range and back, sticks, failsafes raised and recovered,
a wind that drops, false sensors taken back; between acts it is quiet, long enough for rules to speak.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import cache
from typing import TypeVar

import msgspec
import numpy as np

from saflite.contract.rng import derive
from saflite.contract.signals import SIGNALS
from saflite.contract.target_info import InputInfo
from saflite.contract.test_case import Scenario, StartState, Stimulus, StimulusKind, Target, TestCase
from saflite.flight.autopilots.reference.autopilot import TICK_S
from saflite.flight.autopilots.reference.describe import describe
from saflite.mutator.exposure.scenarios import scenarios_of
from saflite.mutator.operators.commands import HOME_LAT_DEG, HOME_LON_DEG, NEAR_DEG

T = TypeVar("T")
Rng = np.random.Generator
Act = Callable[[Rng, float], list[Stimulus]]
LIMIT_S, FIRST_S, MISSION_FIRST_S = 120.0, 0.5, 20.0
HEIGHTS_M = (0.0, 1.0, 2.5, 5.0, 9.0, 11.0, 20.0, 40.0, 99.0, 150.0)
QUIET_S = (0.0, 1.0, 4.0, 9.0, 14.0, 25.0, 45.0)
MODES = ("STABILIZE", "ACRO", "ALT_HOLD", "AUTO", "GUIDED", "LOITER", "RTL", "CIRCLE", "LAND", "FLIP", "BRAKE")
WIND_MPS = (1.0, 5.0, 8.0, 8.1, 12.0, 15.0)
PAIRED = 0.25  # of all acts begin at the instant of the one before, or one or two ticks later


@cache
def settings_read() -> tuple[InputInfo, ...]:
    """Return the settings that a signal is about: the parameters its meaning names."""
    named = {word for signal in SIGNALS.values() for word in re.findall(r"[A-Z][A-Z0-9]+_[A-Z0-9_]+", signal.meaning)}
    return tuple(one for one in _parameters() if one.name in named)


def _parameters() -> tuple[InputInfo, ...]:
    return tuple(one for one in describe().inputs if one.kind == "parameter" and one.low is not None)


@cache
def _faults() -> tuple[InputInfo, ...]:
    return tuple(one for one in describe().inputs if one.kind == "sensor_fault" and "WIND" not in one.name)


def _given(at_s: float, kind: StimulusKind, name: str, *values: float) -> Stimulus:
    return Stimulus(at_s=round(at_s, 6), kind=kind, name=name, values=tuple(float(value) for value in values))


def _one_of(rng: Rng, members: tuple[T, ...]) -> T:
    return members[int(rng.integers(len(members)))]


def _value(rng: Rng, info: InputInfo) -> float:
    """Return an end of the range, more often than the default or something between."""
    low, high = float(info.low or 0.0), float(info.high or 0.0)
    way = rng.random()
    if way < 0.8:
        return low if way < 0.4 else high
    return float(info.default or 0.0) if way < 0.85 else float(f"{rng.uniform(low, high):.4g}")


def _setting(rng: Rng, at_s: float) -> list[Stimulus]:
    return [_given(at_s, "parameter", info.name, _value(rng, info)) for info in [_chosen(rng)]]


def _chosen(rng: Rng) -> InputInfo:
    return _one_of(rng, settings_read() if rng.random() < 0.7 else _parameters())


def _setting_and_back(rng: Rng, at_s: float) -> list[Stimulus]:
    info = _chosen(rng)
    back_s = at_s + _one_of(rng, (0.0, TICK_S, 0.3, 2.0, 6.0, 20.0))
    return [
        _given(at_s, "parameter", info.name, _value(rng, info)),
        _given(back_s, "parameter", info.name, float(info.default or 0.0)),
    ]


def _mode(rng: Rng, at_s: float) -> list[Stimulus]:
    return [_given(at_s, "mode", _one_of(rng, MODES))]


def _stick(rng: Rng, at_s: float) -> list[Stimulus]:
    name = _one_of(rng, ("RC1", "RC2", "RC3", "RC4"))
    held_s = _one_of(rng, (0.02, 0.5, 2.0, 8.0))
    value = _one_of(rng, (1000.0, 1200.0, 1480.0, 1526.0, 1700.0, 2000.0))
    return [_given(at_s, "stick", name, value), _given(at_s + held_s, "stick", name, 1500.0)]


def _position_lost(rng: Rng, at_s: float) -> list[Stimulus]:
    name, value, usual = _one_of(rng, (("SIM_GPS_NUMSATS", 2.0, 10.0), ("SIM_GPS_DISABLE", 1.0, 0.0)))
    lost_s = _one_of(rng, (0.5, 1.2, 3.0, 10.0, 30.0))
    return [_given(at_s, "sensor_fault", name, value), _given(at_s + lost_s, "sensor_fault", name, usual)]


def _radio_lost(rng: Rng, at_s: float) -> list[Stimulus]:
    lost_s = _one_of(rng, (0.3, 0.6, 2.0, 12.0))
    way = float(_one_of(rng, (1, 2)))
    return [_given(at_s, "sensor_fault", "SIM_RC_FAIL", way), _given(at_s + lost_s, "sensor_fault", "SIM_RC_FAIL", 0.0)]


def _battery_low(rng: Rng, at_s: float) -> list[Stimulus]:
    lasts_s = _one_of(rng, (1.0, 4.0, 9.0, 30.0))
    told = [_given(at_s, "sensor_fault", "SIM_BATT_VOLTAGE", 9.0)]
    told += [_given(at_s, "parameter", "BATT_LOW_VOLT", 10.5)] if rng.random() < 0.5 else []
    return [*told, _given(at_s + lasts_s, "sensor_fault", "SIM_BATT_VOLTAGE", 12.6)]


def _wind(rng: Rng, at_s: float) -> list[Stimulus]:
    lasts_s = _one_of(rng, (3.0, 10.0, 30.0))
    told = [_given(at_s, "sensor_fault", "SIM_WIND_SPD", _one_of(rng, WIND_MPS))]
    told += [_given(at_s, "sensor_fault", "SIM_WIND_DIR", float(rng.integers(0, 361)))]
    return [*told, _given(at_s + lasts_s, "sensor_fault", "SIM_WIND_SPD", 0.0)]


def _fault(rng: Rng, at_s: float) -> list[Stimulus]:
    info = _one_of(rng, _faults())
    back_s = at_s + _one_of(rng, (0.5, 3.0, 10.0))
    return [
        _given(at_s, "sensor_fault", info.name, _value(rng, info)),
        _given(back_s, "sensor_fault", info.name, float(info.default or 0.0)),
    ]


def _fence(rng: Rng, at_s: float) -> list[Stimulus]:
    told = [_given(at_s, "parameter", "FENCE_ENABLE", 1.0)]
    told += [_given(at_s, "parameter", "FENCE_ALT_MAX", _one_of(rng, (10.0, 20.0, 60.0)))] if rng.random() < 0.5 else []
    told += [_given(at_s, "parameter", "FENCE_RADIUS", _one_of(rng, (30.0, 60.0)))] if rng.random() < 0.5 else []
    told += [_given(at_s, "parameter", "FENCE_ACTION", float(rng.integers(0, 5)))] if rng.random() < 0.5 else []
    return [*told, _given(at_s + _one_of(rng, (2.0, 8.0, 40.0)), "command", "MAV_CMD_DO_FENCE_ENABLE", 0.0)]


def _place(rng: Rng) -> tuple[float, float, float]:
    reach = NEAR_DEG * _one_of(rng, (0.0, 0.1, 1.0))
    north, east = rng.uniform(-reach, reach, size=2)
    return HOME_LAT_DEG + float(north), HOME_LON_DEG + float(east), _one_of(rng, (0.5, 2.0, 12.0, 30.0, 99.0, 150.0))


def _order(rng: Rng, at_s: float) -> list[Stimulus]:
    way, turn = float(rng.integers(2)), float(rng.integers(361))
    orders: tuple[tuple[str, Callable[[], tuple[float, ...]]], ...] = (
        ("DO_REPOSITION", lambda: (0.0, float(rng.integers(2)), 0.0, 0.0, *_place(rng))),
        ("CONDITION_YAW", lambda: (turn, _one_of(rng, (0.0, 5.0, 30.0)), _one_of(rng, (-1.0, 1.0)), way)),
        ("DO_CHANGE_SPEED", lambda: (1.0, _one_of(rng, (0.1, 0.2, 1.0, 15.0, 90.0)))),
        ("NAV_TAKEOFF", lambda: (0.0,) * 6 + (_one_of(rng, (0.5, 2.0, 20.0, 100.0)),)),
        ("DO_SET_HOME", lambda: (float(rng.integers(2)), 0.0, 0.0, 0.0, *_place(rng))),
        ("DO_PAUSE_CONTINUE", lambda: (float(rng.integers(2)),)),
        ("DO_FENCE_ENABLE", lambda: (float(rng.integers(2)),)),
        ("DO_SET_ROI", lambda: (0.0,) * 4 + _place(rng)),
        ("COMPONENT_ARM_DISARM", lambda: (float(rng.integers(2)), _one_of(rng, (0.0, 0.0, 0.0, 21196.0)))),
        ("DO_PARACHUTE", lambda: (float(_one_of(rng, (0, 1, 1, 2))),)),
        *((name, lambda: ()) for name in ("MISSION_START", "NAV_LAND", "NAV_RETURN_TO_LAUNCH", "NAV_LOITER_UNLIM")),
        ("SOLO_BTN_PAUSE_CLICK", lambda: ()),
    )
    name, values = _one_of(rng, orders)
    return [_given(at_s, "command", f"MAV_CMD_{name}", *values())]


def _from_the_ground(rng: Rng, at_s: float) -> list[Stimulus]:
    """Arm and take off, as far as the vehicle stands on the ground."""
    height_m = _one_of(rng, (1.0, 3.0, 20.0, 50.0))
    return [
        _given(at_s, "mode", "GUIDED"),
        _given(at_s + 0.5, "command", "MAV_CMD_COMPONENT_ARM_DISARM", 1.0),
        _given(at_s + 1.0, "command", "MAV_CMD_NAV_TAKEOFF", 0, 0, 0, 0, 0, 0, height_m),
    ]


ACTS: tuple[tuple[float, Act], ...] = (
    (0.24, _mode),
    (0.12, _setting),
    (0.12, _setting_and_back),
    (0.16, _order),
    (0.12, _stick),
    (0.05, _position_lost),
    (0.03, _radio_lost),
    (0.03, _battery_low),
    (0.04, _wind),
    (0.03, _fault),
    (0.03, _fence),
    (0.03, _from_the_ground),
)


def _start(rng: Rng) -> tuple[Scenario, float]:
    own = Scenario(start=StartState(mode="LOITER", altitude_m=30.0), time_limit_s=LIMIT_S)
    if rng.random() < 0.25:
        return scenarios_of(own, describe()).mission(rng), MISSION_FIRST_S
    mode = _one_of(rng, tuple(dict.fromkeys(start.mode for start in describe().start_states)))
    return msgspec.structs.replace(own, start=StartState(mode=mode, altitude_m=_one_of(rng, HEIGHTS_M))), FIRST_S


def extremes(rng_seed: int = 1) -> Iterator[TestCase]:
    """Yield flights drawn from `rng_seed`, without end; all that is set lies within its documented range."""
    shares = np.array([share for share, _ in ACTS])
    number = 0
    while True:
        rng = derive(rng_seed, "edges-extremes", str(number))
        scenario, at_s = _start(rng)
        before = {info.name: _value(rng, info) for info in (_chosen(rng) for _ in range(int(rng.integers(0, 7))))}
        stimuli: list[Stimulus] = []
        while at_s < scenario.time_limit_s - 5.0:
            act = ACTS[int(rng.choice(len(ACTS), p=shares / shares.sum()))][1]
            stimuli += act(rng, at_s)
            paired = rng.random() < PAIRED
            at_s += (
                TICK_S * float(rng.integers(3))
                if paired
                else 0.3 + _one_of(rng, QUIET_S) * float(rng.uniform(0.5, 1.0))
            )
        kept = tuple(one for one in stimuli if one.at_s < scenario.time_limit_s)
        yield TestCase(target=Target(parameters=before), scenario=scenario, stimuli=kept)
        number += 1
