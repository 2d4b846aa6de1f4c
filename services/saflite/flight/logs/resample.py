"""From logged columns, each on times of its own, to evenly sampled signals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from saflite.contract.errors import Refused
from saflite.contract.flight import Trace, TraceMessage
from saflite.contract.signals import SIGNALS
from saflite.flight.heights import ABOVE_HOME, HOME_STEP_M
from saflite.flight.logs.ground import above_ground

STEP_S = 0.05
HOLE_S = 5.0
"""Between samples farther apart nobody knows what a signal was; drawn as a line it would pass for evidence."""
DURATION_MAX_S = 4 * 3600.0
BACK_S, BACK_ROWS = 1.0, 10
"""A clock that goes back so far, with so many rows on either side that share their time, has started over."""
POSITION = ("x_m", "y_m", "altitude_m")
_ORDERED = "takeoff_altitude_set_m"
"""A height above home that was worked out when it was ordered; home may move afterwards, the vehicle's aim does not."""
_MEASURED_FROM = {"altitude_target_m": "altitude_m", "baro_altitude_m": "baro_altitude_m"}

Array = NDArray[np.float64]


class Columns:
    """Logged values by signal name, to be put on one clock.

    Values that are no finite numbers are dropped; of columns that keep each value until the next they stay, as NaN:
    nobody knows it from there on. A column without any number is as good as missing.

    Args:
        began_s: when the log began. What it holds of before (a state that was told long ago and still holds) counts as
            the state at its beginning, not as a part of the flight.
    """

    def __init__(self, began_s: float = 0.0) -> None:
        self._columns: dict[str, tuple[Array, Array]] = {}
        self._held: set[str] = set()
        self._began_s = began_s
        self.messages: list[tuple[float, str, str]] = []
        self.origin: dict[str, float] = {}
        """Where positions count from, by signal; from the first one where it is not told."""
        self.home_up: tuple[Array, Array] | None = None
        """Times and heights of home in the frame of `altitude_m`, shapes (n,); None where home is not told."""

        self.height_leaps: list[tuple[float, float]] = []
        """Between which times, seconds, `altitude_m` leapt though the vehicle neither climbed nor fell."""

    def __contains__(self, name: str) -> bool:
        return name in self._columns

    def add(self, name: str, times_s: Any, values: Any) -> None:
        """Add one column, shapes (n,); a later one of the same name replaces it.

        Raises ValueError where its time starts over: two flights must not be taken for one.
        """
        times, given = _as_arrays(times_s, values)
        _check_goes_on(name, times)
        self._put(name, times, given, np.isfinite(given))

    def hold(self, name: str, times_s: Any, values: Any) -> None:
        """Add one column that keeps each value until the next, such as a setting; it says nothing of the log's span."""
        times, given = _as_arrays(times_s, values)
        known = np.isfinite(given)
        if known.any():
            self._put(name, times, np.where(known, given, np.nan), np.ones(len(times), dtype=np.bool_))
        self._held.add(name)

    def _put(self, name: str, times: Array, values: Array, good: NDArray[np.bool_]) -> None:
        assert name in SIGNALS, f"{name} is no signal"
        good = good & np.isfinite(times)
        order = np.argsort(times[good], kind="stable")
        if good.any():
            self._columns[name] = times[good][order], values[good][order]

    def drop(self, *names: str) -> tuple[str, ...]:
        """Forget columns and return the names."""
        for name in names:
            self._columns.pop(name, None)
        return names

    def get(self, name: str) -> tuple[Array, Array] | None:
        """Return times and values of a column, shapes (n,), or None."""
        return self._columns.get(name)

    def trace(self, what: str, where: str, *, placed: bool = True) -> Trace:
        """Return all columns at 20 Hz over `span`.

        Positions are taken relative to `origin`, or to the first one, as the testing competition does. Real signals run
        in straight lines between samples; flags, codes and settings keep their value, heights of settings that count
        from home that of where home was. The height above ground is made of height, motors and standing. What is not
        known at any of these times is left out, as if it had not been logged.
        """
        start, end = self.span(what, where, placed=placed)
        times = start + np.arange(int((end - start) / STEP_S) + 1, dtype=np.float64) * STEP_S
        sampled = {name: self._sampled(name, times) for name in sorted(self._columns)}
        known = {name: values for name, values in sampled.items() if not np.isnan(values).all()}
        if {"altitude_m", "armed"} <= known.keys():
            height_m = known["altitude_m"] - self._leapt(times)
            place_m = np.stack([known["x_m"], known["y_m"]], axis=1) if {"x_m", "y_m"} <= known.keys() else None
            told = known["armed"], known.get("landed"), STEP_S, place_m, known.get("throttle")
            known["above_ground_m"] = above_ground(height_m, *told, known.get("baro_altitude_m"))
        signals = {name: values.astype("<f4").tobytes() for name, values in known.items()}
        return Trace(step_s=STEP_S, signals=signals, messages=self._texts(start, end))

    def span(self, what: str, where: str, *, placed: bool = True) -> tuple[float, float]:
        """Return when the first and the last position was logged, seconds.

        Raises Refused if there is no position; with `placed` False what else was logged will do.
        """
        missing = [name for name in POSITION if name not in self._columns]
        if missing and (placed or not self._columns):
            raise Refused(what, where=where, expected="a position (x, y, altitude)", got=f"no {', '.join(missing)}")
        telling = [name for name in self._columns if name not in self._held] if missing else POSITION
        if not telling:
            raise Refused(what, where=where, expected="logged signals", got="none")
        spans = [
            (max(float(at[0]), self._began_s), float(at[-1])) for at, _ in (self._columns[name] for name in telling)
        ]
        starts, ends = zip(*spans, strict=True)
        start, end = (min(starts), max(ends)) if missing else (max(starts), min(ends))
        if not STEP_S <= end - start <= DURATION_MAX_S:
            expected = f"{'signals' if missing else 'a position'} over {STEP_S:g} s to {DURATION_MAX_S:g} s"
            way_out = "; cut it, and judge them one by one" if end - start > DURATION_MAX_S else ""
            raise Refused(what, where=where, expected=expected, got=f"{end - start:.3g} s{way_out}")
        return start, end

    def _sampled(self, name: str, times: Array) -> Array:
        at, values = self._columns[name]
        if name == "yaw_deg":
            turned = np.mod(np.interp(times, at, np.unwrap(values, period=360.0)), 360.0)
            return np.where(_unknown(times, at), np.nan, turned)
        if SIGNALS[name].kind == "real" and name not in self._held:
            sampled = np.where(_unknown(times, at), np.nan, np.interp(times, at, values))
            return sampled - self._origin(name, float(times[0]))
        since = np.maximum(np.searchsorted(at, times + 1e-9, side="right") - 1, 0)
        kept = values[since]
        if name == _ORDERED:
            return kept + self._home_up(at[since], float(times[0]))
        if name in ABOVE_HOME:
            return kept + np.where(kept > 0.0, self._home_up(times, float(times[0])), 0.0)
        return kept

    def _home_up(self, times: Array, start_s: float) -> Array:
        """How far home lies above where heights count from; less than a step is what an arming corrects."""
        if self.home_up is None:
            return np.zeros(len(times))
        at, up = self.home_up
        found = up[np.maximum(np.searchsorted(at, times + 1e-9, side="right") - 1, 0)]
        found = found - self._origin("altitude_m", start_s)
        return np.where(np.abs(found) > HOME_STEP_M, found, 0.0)

    def _leapt(self, times: Array) -> Array:
        """By how much leaps have changed the height until each time, metres, shape (n,)."""
        if not self.height_leaps:
            return np.zeros(len(times))
        ends_s = np.array(self.height_leaps)  # shape (k, 2), in order: between samples, each after the one before
        up_m = np.diff(np.interp(ends_s, *self._columns["altitude_m"]))
        after_m = np.cumsum(up_m, axis=0)
        return np.asarray(np.interp(times, ends_s.ravel(), np.hstack([after_m - up_m, after_m]).ravel()))

    def _origin(self, name: str, start_s: float) -> float:
        """What is taken off a column: positions count from the first one, a height aimed at from the first height."""
        whose = {**dict(zip(POSITION, POSITION, strict=True)), **_MEASURED_FROM}.get(name)
        if whose in self.origin:
            return self.origin[whose]
        column = self._columns.get(whose) if whose else None
        return 0.0 if column is None else float(np.interp(start_s, *column))

    def _texts(self, start: float, end: float) -> tuple[TraceMessage, ...]:
        kept = [(at, text, severity) for at, text, severity in self.messages if start - 60 <= at <= end + 60]
        return tuple(
            TraceMessage(at_s=max(0.0, round(at - start, 3)), text=text, severity=severity)  # type: ignore[arg-type]
            for at, text, severity in kept
        )


def told_far_off(rows: int) -> str:
    """Return in words that rows were left out for their time."""
    return f"{rows} messages have a time far from all others"


def check_no_other_flight(name: str, times_s: Array, far: NDArray[np.bool_]) -> None:
    """Raise ValueError where rows that are `far` from most of a log, in its order, go on among themselves.

    Single rows of a wrong time are damage; another flight must not be left out as such.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[False], far, [False]]).astype(np.int8)))
    for start, end in edges.reshape(-1, 2):
        steps = np.diff(times_s[start:end])
        if end - start >= BACK_ROWS and (steps >= 0).all() and steps.sum() <= DURATION_MAX_S:
            raise ValueError(
                f"{end - start} rows of {name} go on from {times_s[start]:.1f} s, more than {DURATION_MAX_S:g} s from "
                "most of the log: two flights in one file; cut it there, and judge them one by one"
            )


def _as_arrays(times_s: Any, values: Any) -> tuple[Array, Array]:
    times = np.asarray(times_s, dtype=np.float64)
    return times, np.broadcast_to(np.asarray(values, dtype=np.float64), times.shape)


def _unknown(times: Array, at: Array) -> NDArray[np.bool_]:
    """Return at which times nothing is known of a signal that was logged `at` these times: inside of a hole, or beyond.

    A hole is longer than `HOLE_S` and than ten times what lies between two samples as a rule.
    """
    if len(at) < 2:
        return np.zeros(len(times), dtype=np.bool_)
    hole_s = max(HOLE_S, 10.0 * float(np.median(np.diff(at))))
    after = np.searchsorted(at, times + 1e-9, side="right")
    earlier, later = at[np.maximum(after - 1, 0)], at[np.minimum(after, len(at) - 1)]
    return (later - earlier > hole_s) & (times > earlier + 1e-9) | (earlier - times > hole_s) | (times - later > hole_s)


def _check_goes_on(name: str, times_s: Array) -> None:
    """Raise ValueError where a column, in the order of the log, begins anew; a row of a wrong time does not."""
    times = times_s[np.isfinite(times_s)]
    for at in np.flatnonzero(np.diff(times) < -BACK_S)[:100]:
        end_s, again_s = times[at], times[at + 1]
        before, after = times[: at + 1] > again_s + BACK_S, times[at + 1 :] < end_s - BACK_S
        if min(np.count_nonzero(before), np.count_nonzero(after)) >= BACK_ROWS:
            raise ValueError(
                f"the time of {name} starts over at {again_s:.1f} s after {end_s:.1f} s: two flights in one file; "
                "cut it there, and judge them one by one"
            )
