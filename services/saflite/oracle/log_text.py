"""A flight as text for a language model: modes, events, extremes, tracking errors. Figures only, no judgement.

Also the same facts as numbers (`LogFacts`), from which a rule of thumb makes the embedded answer that a language model
has to beat.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import Flight, Trace
from saflite.contract.signals import FAILSAFES, MODES, SIGNALS
from saflite.contract.test_case import Scenario, Target, TestCase
from saflite.oracle.signals import FlightSignals

EVENTS_MAX, TEXTS_MAX = 40, 30
_EXTREMES = (
    *("altitude_m", "ground_speed_mps", "climb_mps", "tilt_deg", "roll_rate_dps", "pitch_rate_dps", "yaw_rate_dps"),
    *("gps_satellites", "battery_v", "throttle", "obstacle_distance_m"),
)
_FLAGS = ("armed", "landed", "takeoff", "rc_present", "gps_ok", "baro_ok", "chute_released")
_PAIRS = (("altitude_m", "altitude_target_m"), ("altitude_m", "altitude_est_m"), ("x_m", "x_est_m"), ("y_m", "y_est_m"))
_NAMES: dict[float, str] = {number: name for name, number in MODES.items()}


NO_OBSTACLE_M = 1000.0  # what the signal says where there is none


class LogFacts(NamedTuple):
    """What of a log tells trouble: counts of texts and failsafes, how violently and how near to obstacles it moved."""

    duration_s: float
    warnings: int
    errors: int
    failsafes: int
    mode_changes: int
    tilt_max_deg: float
    rate_max_dps: float
    sink_max_mps: float
    obstacle_min_m: float = NO_OBSTACLE_M


def facts_of(trace: Trace) -> LogFacts:
    """Return the facts of a flight; those whose signals are missing are 0."""
    signals = _signals(trace)

    def most(name: str, sign: float = 1.0) -> float:
        return float(np.nanmax(sign * signals[name])) if name in signals and signals.samples else 0.0

    rates = [max(most(name), most(name, -1.0)) for name in ("roll_rate_dps", "pitch_rate_dps", "yaw_rate_dps")]
    raised = [name for name in FAILSAFES if name in trace.signals and most(name) > 0]
    said = [text for text in trace.messages if "failsafe" in text.text.lower()]
    return LogFacts(
        duration_s=trace.duration_s,
        warnings=sum(text.severity == "warning" for text in trace.messages),
        errors=sum(text.severity == "error" for text in trace.messages),
        failsafes=len(raised) + len(said),
        mode_changes=len(changes(signals, "mode")) - 1 if "mode" in signals else 0,
        tilt_max_deg=most("tilt_deg"),
        rate_max_dps=max(rates),
        sink_max_mps=max(0.0, most("climb_mps", -1.0)),
        obstacle_min_m=-most("obstacle_distance_m", -1.0) if _has_obstacles(signals) else NO_OBSTACLE_M,
    )


def _has_obstacles(signals: FlightSignals) -> bool:
    name = "obstacle_distance_m"
    return name in signals.written and signals.samples > 0 and float(np.nanmin(signals[name])) < NO_OBSTACLE_M


class Thumb(NamedTuple):
    """The rule of thumb's score, 0..10, and what it goes by."""

    score: float
    reason: str


def rule_of_thumb(facts: LogFacts) -> Thumb:
    """Return how interesting the flight looks by errors, failsafes, warnings, violent motion and near misses alone."""
    points = {
        f"{facts.errors} errors": 2.5 * min(facts.errors, 2),
        f"{facts.failsafes} failsafes": 2.5 * min(facts.failsafes, 2),
        f"{facts.warnings} warnings": 0.5 * min(facts.warnings, 4),
        f"tilt {facts.tilt_max_deg:.0f} deg": 2.5 * (facts.tilt_max_deg > 60.0),
        f"turns {facts.rate_max_dps:.0f} deg/s": 1.0 * (facts.rate_max_dps > 250.0),
        f"sinks {facts.sink_max_mps:.1f} m/s": 1.5 * (facts.sink_max_mps > 5.0),
        f"{facts.obstacle_min_m:.2f} m from an obstacle": 6.0 * (facts.obstacle_min_m < 1.5),
    }
    named = ", ".join(words for words, value in points.items() if value)
    return Thumb(min(10.0, float(sum(points.values()))), named or "nothing out of the ordinary")


def describe(trace: Trace) -> str:
    """Return the flight as text, at most some 6,000 characters."""
    signals = _signals(trace)
    parts = [
        [f"Duration {trace.duration_s:.1f} s, {len(trace.signals)} signals."],
        ["Flight modes:", *_modes(signals)],
        ["Events:", *_events(signals)],
        ["Texts of the autopilot:", *_texts(trace)],
        ["Extremes (least, mean, greatest):", *_extremes(signals)],
        ["Tracking errors (root mean square, greatest):", *_errors(signals)],
    ]
    return "\n".join(line for part in parts if len(part) > 1 or part[0].startswith("Duration") for line in part) + "\n"


def _signals(trace: Trace) -> FlightSignals:
    case = TestCase(target=Target(), scenario=Scenario())
    return FlightSignals(case, Flight(test_case="", flight_index=0, ending="completed"), trace)


def changes(signals: FlightSignals, name: str) -> list[tuple[float, float]]:
    """Return (time in seconds, value) of the first sample and of every change of a signal."""
    values: NDArray[np.float32] = signals[name]
    if len(values) == 0:
        return []
    at = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist()]
    return [(index * signals.step_s, float(values[index])) for index in at]


def _modes(signals: FlightSignals) -> list[str]:
    if "mode" not in signals:
        return []
    steps = changes(signals, "mode")[:EVENTS_MAX]
    return [f"  {at:.1f} s {_NAMES.get(mode, 'another mode')}" for at, mode in steps]


def _events(signals: FlightSignals) -> list[str]:
    found = [
        (at, f"{SIGNALS[name].meaning}: {'yes' if value > 0 else 'no'}")
        for name in (*_FLAGS, *FAILSAFES)
        if name in signals
        for at, value in changes(signals, name)[1:]
    ]
    return [f"  {at:.1f} s {text}" for at, text in sorted(found)[:EVENTS_MAX]]


def _texts(trace: Trace) -> list[str]:
    telling = [text for text in trace.messages if text.severity != "info"] or list(trace.messages)
    return [f"  {text.at_s:.1f} s {text.severity}: {text.text[:120]}" for text in telling[:TEXTS_MAX]]


def _extremes(signals: FlightSignals) -> list[str]:
    lines = []
    for name in _EXTREMES:
        if name == "obstacle_distance_m" and not _has_obstacles(signals):
            continue
        if name in signals and signals.samples:
            values = signals[name]
            numbers = f"{np.nanmin(values):.2f}, {np.nanmean(values):.2f}, {np.nanmax(values):.2f}"
            lines.append(f"  {SIGNALS[name].meaning}: {numbers} {SIGNALS[name].unit}".rstrip())
    return lines


def _errors(signals: FlightSignals) -> list[str]:
    lines = []
    for real, wanted in _PAIRS:
        if wanted in signals.written and real in signals and signals.samples:
            gap = np.asarray(signals[real] - signals[wanted], dtype=np.float64)
            rms, most = float(np.sqrt(np.nanmean(gap**2))), float(np.nanmax(np.abs(gap)))
            lines.append(f"  {real} against {wanted}: {rms:.2f}, {most:.2f} {SIGNALS[real].unit}")
    return lines
