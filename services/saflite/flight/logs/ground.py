"""How high a logged vehicle was above the ground under it: a log tells heights above where it began, and no terrain.

What stands keeps its height. So the ground is as high as the vehicle where it stands, or where it came to lie after a
fall. On the way it is taken to be as high as where the vehicle took off, and from the highest point of the flight on as
where it came down.

That it counts as landed, or that its motors are off, is no proof that it stands: autopilots err in this, and rules ask
whether they do. It stands where it descended to just before, is motionless, its motors do not carry it, and nothing
lower was seen about there; or where its motors stop and it does not fall. What a barometer of its own right sees
standing still neither falls nor climbs, whatever the estimate does. Where the log says neither that it stands nor
how high the ground is, the height above ground is not known.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_MOVES = ((2.0, 1.5), (10.0, 2.0))
"""What changes its height by so many metres within so many seconds stands nowhere; estimates that drift do it slower,
and the pressure under propellers that stop moves them by less."""
_SPIKE_S = 1.0  # a gust or a knock at a barometer is over sooner
_DROPS_M = 0.5  # as the motors stop: as high as a rule takes for the air
_WATCHED_S = 3.0  # after the motors stopped: later on somebody may carry it away
_LIES_S = 1.0  # so long without moving after the motors stopped it has not been falling; what stands shorter does not
_STILL_M = 0.3  # what sinks less within the last second has come down
_AT_REST_S = 5.0  # the ground a vehicle takes off from or comes down to is where it stood so long before or after
_DESCENDS_M = 0.5  # within that time before it stands
_SAME_M = 1.5  # a height that drifts in a flight: so far from where it took off it is on that ground
_LOWER_M = 3.0  # a place so far below is none that the estimate drifted from
_NEARBY_M = 3.0  # horizontally; what moves so far within two seconds does not stand either
_CARRIES = 0.75  # of the throttle in flight
_FLIES, _STANDS, _DISARMED = 0, 1, 2


class _Course(NamedTuple):
    """What a log tells: heights, motors, places (n, 2), throttle and height by the barometer (n,); None if not told."""

    height_m: Array
    armed: NDArray[np.bool_]
    step_s: float
    place_m: Array | None
    throttle: Array | None
    baro_m: Array | None

    def samples(self, seconds: float) -> int:
        return max(1, round(seconds / self.step_s))


class _Rest(NamedTuple):
    """Samples in which it counts as standing, or its motors are off: from, until the motors stop, until it is watched.

    `again` tells that the motors were off for some time and then armed again, so the estimate went on meanwhile.
    """

    start: int
    off: int
    until: int
    flown_from: int
    stands: bool
    again: bool


def above_ground(
    height_m: Array,
    armed: Array,
    landed: Array | None,
    step_s: float,
    place_m: Array | None = None,
    throttle: Array | None = None,
    baro_m: Array | None = None,
) -> Array:
    """Return the height above ground, metres, shape (n,), NaN where it is not known.

    Args:
        height_m: height above where the log counts from, shape (n,), NaN where not known.
        armed: above 0 while the motors are armed, shape (n,).
        landed: above 0 while the autopilot takes itself to stand, shape (n,); None where it does not say.
        step_s: time between samples.
        place_m: metres north and east, shape (n, 2), NaN where not known; None where not told.
        throttle: 0 to 1, shape (n,), NaN where not known; None where not told.
        baro_m: height by the barometer, shape (n,), NaN where not known; None where not told.
    """
    course = _Course(height_m, armed > 0, step_s, place_m, throttle, baro_m)
    state, edges = _states(course, landed)
    watched, rest_s = course.samples(_WATCHED_S), course.samples(_AT_REST_S)
    ground_m = np.zeros(len(height_m))
    below_m, flown_from, until = 0.0, 0, 0
    for number, (start, end) in enumerate(pairwise(edges)):
        if state[start] == _FLIES:
            ground_m[start:end], flown_from = below_m, start
            continue
        until, known = max(start, until), True
        if state[start] == _STANDS or not start or state[start - 1] == _FLIES:
            stands = bool(state[start] == _STANDS)
            off = end if stands else start
            stopped = off < len(state) and state[off] == _DISARMED
            after = edges[number + 1 + stands] if stopped else end
            until = min(after, off + watched) if stopped else end
            again = after < len(state) and after - off >= course.samples(_LIES_S)
            under = _under(course, _Rest(start, off, until, flown_from, stands, again), below_m)
            known = not bool(np.isnan(under).all())
            ground_m[start:until] = under
            if start and state[start - 1] == _FLIES:
                highest = flown_from + _highest(height_m[flown_from:start])
                ground_m[highest:start] = _middle(ground_m[start : min(until, start + rest_s)], below_m)
        ground_m[until:end] = height_m[until:end]
        if known:
            below_m = _middle(ground_m[max(start, end - rest_s) : end], below_m)
    return height_m - ground_m


def _states(course: _Course, landed: Array | None) -> tuple[NDArray[np.int_], list[int]]:
    """Return what it does at each sample and where that changes; to stand for a moment in a flight is to fly."""
    stands = np.zeros(len(course.armed), dtype=np.bool_) if landed is None else landed > 0
    state = np.where(course.armed, np.where(stands, _STANDS, _FLIES), _DISARMED)
    for start, end in list(pairwise(_edges(state)))[1:-1]:
        around = {int(state[start - 1]), int(state[end])}
        if state[start] == _STANDS and around == {_FLIES} and end - start < course.samples(_LIES_S):
            state[start:end] = _FLIES
    return state, _edges(state)


def _edges(state: NDArray[np.int_]) -> list[int]:
    return [0, *(np.flatnonzero(np.diff(state)) + 1).tolist(), len(state)]


def _under(course: _Course, rest: _Rest, below_m: float) -> Array | float:
    """Return how high the ground is under what does not fly any more, NaN where nobody knows."""
    height_m = course.height_m[rest.start : rest.until]
    if np.isnan(height_m).all():
        return float("nan")
    if _falls(course, rest):
        lowest_m, last = float(np.nanmin(height_m)), course.samples(_LIES_S) + 1
        down = len(height_m) >= last and height_m[-last] - height_m[-1] < _STILL_M
        return lowest_m if down else float(np.fmin(lowest_m, _lowest_nearby(course, rest.start)))
    middle_m = float(np.nanmedian(height_m))
    lies = rest.stands or len(height_m) >= course.samples(_LIES_S)
    as_before = abs(middle_m - below_m) <= _SAME_M
    if not rest.start or rest.again or (lies and as_before):
        return height_m
    if _comes_down(course, rest):
        stays = rest.off < rest.until or not _lowest_nearby(course, rest.start) < middle_m - _SAME_M
        return height_m if lies and stays else below_m if as_before else float("nan")
    if not lies:
        return below_m
    lower_m = _lowest_nearby(course, rest.start)
    return lower_m if lower_m < middle_m - _LOWER_M else float("nan")


def _falls(course: _Course, rest: _Rest) -> bool:
    """Return whether it moves up or down, or drops as its motors stop."""
    height_m, after_m = course.height_m[rest.start : rest.until], course.height_m[rest.off : rest.until]
    if rest.start and len(after_m) and bool((after_m[0] - after_m > _DROPS_M).any()):
        return True
    return _changes(course, height_m) and not _stays_by_barometer(course, rest)


def _changes(course: _Course, height_m: Array) -> bool:
    return any(_moves(height_m, course.samples(within_s), far_m) for within_s, far_m in _MOVES)


def _stays_by_barometer(course: _Course, rest: _Rest) -> bool:
    """Return whether the barometer sees no change of height wherever the estimate is known."""
    if course.baro_m is None:
        return False
    part = slice(rest.start, rest.until)
    told = ~np.isnan(course.baro_m[part]) | np.isnan(course.height_m[part])
    return bool(told.all()) and not _changes(course, _mean(course.baro_m[part], course.samples(_SPIKE_S)))


def _mean(values: Array, span: int) -> Array:
    """Return the mean over each `span` samples, shape (n - span + 1,); one of all where there are fewer."""
    span = max(1, min(span, len(values)))
    return np.convolve(values, np.full(span, 1.0 / span), mode="valid") if len(values) else values


def _moves(values: Array, span: int, far: float) -> bool:
    span = max(1, min(span, len(values) - 1))
    return len(values) > 1 and bool((np.abs(values[span:] - values[:-span]) > far).any())


def _comes_down(course: _Course, rest: _Rest) -> bool:
    """Return whether it descended just before, stays where it is, and its motors do not carry it."""
    before_m = course.height_m[max(rest.flown_from, rest.start - course.samples(_AT_REST_S)) : rest.start + 1]
    if np.isnan(before_m).all() or not np.nanmax(before_m) - before_m[-1] >= _DESCENDS_M:
        return False
    place_m = None if course.place_m is None else course.place_m[rest.start : rest.off]
    if place_m is not None and any(_moves(part, course.samples(_MOVES[0][0]), _NEARBY_M) for part in place_m.T):
        return False
    if course.throttle is None or not rest.stands:
        return True
    flown, now = course.throttle[rest.flown_from : rest.start], course.throttle[rest.start : rest.off]
    return not _middle(now, 0.0) > _CARRIES * _middle(flown, 1.0)


def _lowest_nearby(course: _Course, number: int) -> float:
    """Return how low it ever was with its motors armed about the place of a sample; NaN where places are not known."""
    if course.place_m is None:
        return float("nan")
    away_m = np.hypot(*(course.place_m - course.place_m[number]).T)
    heights_m = course.height_m[course.armed & (away_m <= _NEARBY_M)]
    return float("nan") if np.isnan(heights_m).all() else float(np.nanmin(heights_m))


def _highest(height_m: Array) -> int:
    return 0 if np.isnan(height_m).all() else int(np.nanargmax(height_m))


def _middle(values: Array, otherwise: float) -> float:
    return otherwise if np.isnan(values).all() else float(np.nanmedian(values))
