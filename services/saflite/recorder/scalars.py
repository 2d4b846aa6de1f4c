"""The named signals of a trace as flat JSON records, one topic per group, ready to plot."""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import isfinite

import msgspec
import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import Trace
from saflite.contract.signals import SIGNALS
from saflite.recorder import thinning

_GROUPS: dict[str, tuple[str, ...]] = {
    "/position": ("x_m", "y_m", "altitude_m", "vx_mps", "vy_mps", "climb_mps", "home_distance_m"),
    "/attitude": ("roll_deg", "pitch_deg", "yaw_deg"),
    "/rates": ("roll_rate_dps", "pitch_rate_dps", "yaw_rate_dps"),
    "/safety": ("obstacle_distance_m", "contact", "chute_released"),
    "/autopilot": ("mode", "armed", "landed", "throttle", "mission_item", "mission_count", "taken_off", "takeoff"),
}
TOLERANCE = {"": 0.05, "m": 0.05, "m/s": 0.1, "deg": 1.0, "deg/s": 10.0, "V": 0.05}
"""How far a plot may be from the signal, by unit; every sample is in the trace attached."""
NOISY = {"baro_altitude_m": 0.5, "gps_altitude_m": 0.5}
"""The same of signals whose noise is larger."""
SHARE, TINY = 500, 1e-4
"""Of other units: this part of what the signal ranges over in the flight."""
DECIMALS = 3
_ENCODER = msgspec.json.Encoder()


def group_of(name: str) -> str:
    """Return the topic a signal is recorded under."""
    for topic, names in _GROUPS.items():
        if name in names:
            return topic
    if "_set_" in f"{name}_" or name.startswith("fs_"):
        return "/settings"
    if "_est_" in name or "_target_" in name:
        return "/estimate"
    return "/failsafe" if name.startswith("failsafe") else "/sensors"


def groups(trace: Trace) -> dict[str, tuple[str, ...]]:
    """Return the signals of a trace by topic, sorted."""
    found: dict[str, list[str]] = {}
    for name in sorted(trace.signals):
        found.setdefault(group_of(name), []).append(name)
    return {topic: tuple(names) for topic, names in sorted(found.items())}


def schema(names: tuple[str, ...]) -> bytes:
    """Return the JSON Schema of a record holding the named signals."""
    properties = {name: {"type": "number", "description": _meaning(name)} for name in names}
    return json.dumps({"type": "object", "properties": {"time_s": {"type": "number"}, **properties}}).encode()


def records(trace: Trace, names: tuple[str, ...], at: NDArray[np.intp]) -> Iterator[bytes]:
    """Yield one JSON record per sample index in `at`; values that are no number are left out (JSON has none)."""
    values = _table(trace, names, at)
    keys = ("time_s", *names)
    times_s = [round(index * trace.step_s, 6) for index in at.tolist()]
    whole = bool(np.isfinite(values).all())
    for time_s, row in zip(times_s, values.tolist(), strict=True):
        record = dict(zip(keys, (time_s, *row), strict=True))
        yield _ENCODER.encode(record if whole else {key: value for key, value in record.items() if isfinite(value)})


def telling(trace: Trace, names: tuple[str, ...], at: NDArray[np.intp], steady: int) -> NDArray[np.intp]:
    """Return those of the sample indices `at` that tell something: every `steady`th, and what a line would miss."""
    tolerance = np.array([_tolerance(name, trace.array(name)) for name in names])
    return np.asarray(at[thinning.on_a_line(_table(trace, names, at), tolerance, steady)])


def _tolerance(name: str, values: NDArray[np.float32]) -> float:
    """Return how far a plotted signal may be from its value: by unit, for flags and codes not at all."""
    signal = SIGNALS.get(name)
    if signal is not None and signal.kind != "real":
        return TINY
    if signal is not None and signal.unit in TOLERANCE:
        return NOISY.get(name, TOLERANCE[signal.unit])
    real = values[np.isfinite(values)]
    return max(TINY, float(real.max()) / SHARE - float(real.min()) / SHARE) if len(real) else TINY


def _table(trace: Trace, names: tuple[str, ...], at: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the values of the named signals, rounded, shape (samples, names)."""
    return np.round(np.stack([trace.array(name)[at] for name in names], axis=1).astype(float), DECIMALS)


def _meaning(name: str) -> str:
    signal = SIGNALS.get(name)
    if signal is None:
        return ""
    return f"{signal.meaning} [{signal.unit}]" if signal.unit else signal.meaning
