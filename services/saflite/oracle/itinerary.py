"""What a mission's items ask of a flight, as signals: place and wait of the item at hand, and the one to follow.

Numbers and their meaning are MAVLink's (MAV_CMD). Items are told by `mission_item`, the index counted from 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import Given
from saflite.contract.signals import MODES
from saflite.contract.test_case import Mission, MissionItem
from saflite.flight.mission import to_local
from saflite.oracle.orders import SPEED_LEAST_MPS

Array = NDArray[np.float64]
NAMES = (
    "item_command",
    "item_heading_deg",
    "item_wait_s",
    "item_speed_mps",
    "item_off_m",
    "item_height_off_m",
    "item_landing_off_m",
    "item_unexpected",
)
FLOWN_TO, STAYS, WAITS, LAND, JUMP, TURN, SPEED = (16, 82, 19), 17, (93, 112), 21, 177, 115, 178
ELSEWHERE = (20, 21, 22)  # returns, landings, take-offs: where they end others tell
FOR_EVER_S = 1e6
NO_PLACE_M, NO_HEADING_DEG, NO_SPEED_MPS = -1.0, -1.0, -1.0
NEAR_M, LOW_M = 12.0, 4.0  # the greatest WPNAV_RADIUS and a little; as much as that counts what its height is off
PASSED_MAX = 64  # items, loops of jumps that do not show as well
ROUNDS_MAX = 16  # of a jump that does not show, and ways to have counted them that are kept
AFRESH_S = 0.1  # what an order or an entry does to the item shows within this


class Item(NamedTuple):
    """Place in metres from the origin of the track and height above home, NaN without; wait; item to jump to, times."""

    x_m: float = np.nan
    y_m: float = np.nan
    altitude_m: float = np.nan
    wait_s: float = 0.0
    target: int = -1
    times: float = 0.0


def items_of(mission: Mission | None) -> tuple[Item, ...]:
    """Return what each item asks for; only way-points have a place: where take-offs and landings go others tell.

    A way-point without latitude and longitude is where the one before it was.
    """
    found: list[Item] = []
    last = Item()
    for raw in mission.items if mission is not None else ():
        assert mission is not None
        numbers = [value or 0.0 for value in raw.params]
        if raw.command in (*FLOWN_TO, STAYS):
            last = _flown_to(mission, raw, last)
            found.append(last)
        elif raw.command in WAITS:
            found.append(Item(wait_s=max(0.0, numbers[0])))
        elif raw.command == JUMP:
            found.append(Item(target=int(numbers[0]) - 1, times=numbers[1]))
            last = Item()  # who jumps comes from elsewhere
        else:
            found.append(Item())
            last = Item() if raw.command in ELSEWHERE else last
    return tuple(found)


def _flown_to(mission: Mission, raw: MissionItem, last: Item) -> Item:
    """Return what a way-point asks for that follows `last`; one whose place is not known only stays there or does not.

    The place of one before, if known, counts for what has no latitude and longitude.
    """
    hold_s, lat_deg, lon_deg, up_m = raw.params[0], *raw.params[4:7]
    wait_s = FOR_EVER_S if raw.command == STAYS else hold_s or 0.0
    placed = bool(lat_deg and lon_deg)
    if up_m is None or not (placed or (not (lat_deg or lon_deg) and np.isfinite(last.x_m))):
        return Item(wait_s=wait_s if raw.command == STAYS else 0.0)
    x_m, y_m = _place(mission, raw) if placed else (last.x_m, last.y_m)
    return Item(x_m, y_m, up_m - (mission.home_alt_m if raw.frame in (0, 5) else 0.0), wait_s=wait_s)


def landings_of(mission: Mission | None) -> tuple[Item, ...]:
    """Return where in the plane each item lands; one that does not, or lands where it is, has no place."""
    items = mission.items if mission is not None else ()
    landing = [raw.command == LAND and bool(raw.params[4]) and bool(raw.params[5]) for raw in items]
    assert mission is not None or not items
    return tuple(Item(*_place(mission, raw)) if lands else Item() for raw, lands in zip(items, landing, strict=True))


def _place(mission: Mission | None, item: MissionItem) -> tuple[float, float]:
    assert mission is not None
    return to_local(item.params[4] or 0.0, item.params[5] or 0.0, mission.home_lat_deg, mission.home_lon_deg)


def commands_of(mission: Mission | None) -> tuple[float, ...]:
    """Return the MAV_CMD number of each item."""
    return tuple(float(raw.command) for raw in mission.items) if mission is not None else ()


def headings(mission: Mission | None, item: NDArray[Any], yaw_deg: NDArray[Any]) -> Array:
    """Return the heading that the item at hand asks to wait with, shape (moments,); `NO_HEADING_DEG` where none.

    Only a wait right after an item that turns asks for one: what is flown to turns the nose again. A relative turn
    counts from the heading as the wait began, so one that is not over at once is not told.
    """
    asked = np.full(len(item), NO_HEADING_DEG)
    items = mission.items if mission is not None else ()
    begins = np.concatenate([[0], np.flatnonzero(np.diff(item) != 0) + 1, [len(item)]]).astype(int)
    for at, end in pairwise(begins):
        index = int(item[at])
        if not 0 < index < len(items) or items[index].command not in WAITS or items[index - 1].command != TURN:
            continue
        angle, _, way, relative = (value or 0.0 for value in items[index - 1].params[:4])
        if relative:
            angle = float(yaw_deg[at]) + (-angle if way < 0.0 else angle)
        asked[at:end] = angle % 360.0
    return asked


def speeds(mission: Mission | None, item: NDArray[Any]) -> Array:
    """Return the speed over ground that the mission has ordered before the item at hand, shape (moments,).

    `NO_SPEED_MPS` where it has ordered none, and wherever a jump leaves open which order was the last.
    """
    asked, known = NO_SPEED_MPS, list[float]()
    items = mission.items if mission is not None else ()
    for raw in items:
        known.append(asked)
        kind, speed_mps = (value or 0.0 for value in raw.params[:2])
        if raw.command == SPEED and kind <= 1 and speed_mps >= SPEED_LEAST_MPS:
            asked = float(speed_mps)
    if any(raw.command == JUMP for raw in items):
        known = [NO_SPEED_MPS] * len(known)
    return np.asarray(np.nan_to_num(of_items(known, item), nan=NO_SPEED_MPS))


def of_items(values: Sequence[float], item: NDArray[Any]) -> Array:
    """Return a number of the item at hand, shape (moments,); NaN where there is no such item."""
    index = item.astype(int)
    known = np.array([*values, np.nan])
    return np.asarray(known[np.where((index >= 0) & (index < len(values)), index, len(values))])


def off(items: Sequence[Item], item: NDArray[Any], x_m: NDArray[Any], y_m: NDArray[Any]) -> Array:
    """Return the distance in the plane to the way-point at hand, `NO_PLACE_M` where the item is none."""
    far_m = np.hypot(x_m - of_items([one.x_m for one in items], item), y_m - of_items([one.y_m for one in items], item))
    return np.asarray(np.nan_to_num(far_m, nan=NO_PLACE_M))


def height_off(items: Sequence[Item], item: NDArray[Any], altitude_m: NDArray[Any]) -> Array:
    """Return the distance in height to the way-point at hand, `NO_PLACE_M` where the item is none."""
    gap_m = np.abs(altitude_m - of_items([one.altitude_m for one in items], item))
    return np.asarray(np.nan_to_num(gap_m, nan=NO_PLACE_M))


def afresh(given: Sequence[Given]) -> list[float]:
    """Return when a mission was ordered to begin anew, in seconds."""
    return [one.at_s for one, _, _ in given if one.kind == "command" and one.name.upper().endswith("MISSION_START")]


def unexpected(
    items: Sequence[Item],
    item: NDArray[Any],
    mode: NDArray[Any],
    place_off_m: Sequence[Array],
    started_s: Sequence[float],
    times: Array,
) -> Array:
    """Return 1 where the item at hand is not the one that had to follow, shape (moments,).

    An item that is over at once may not show between two samples: one without a place or a wait, a way-point at which
    the vehicle is.

    Args:
        items: of the mission, as `items_of` has them.
        item: index at each moment.
        mode: flight mode at each moment; only what changes within AUTO is looked at.
        place_off_m: of each item, how far the vehicle is from it at each moment; NaN without a place.
        started_s: when the mission was ordered to begin anew, so with its first item; jumps are counted from then, or
            from the entry into AUTO.
        times: of the moments, seconds.
    """
    flags = np.zeros(len(times))
    auto = np.asarray(mode) == MODES["AUTO"]
    counts: list[dict[int, int]] = [{}]  # how often each jump may have been taken: what does not show leaves it open
    for at in np.flatnonzero((np.diff(item) != 0) | (np.diff(auto.astype(int)) != 0)) + 1:
        anew = any(0.0 <= times[at] - one <= AFRESH_S for one in started_s)
        if not auto[at] or not (auto[at - 1] or anew):
            counts = [{}]
            continue
        near = {number for number, off_m in enumerate(place_off_m) if not off_m[at] > NEAR_M}
        passed = {number for number in near if not items[number].wait_s}
        before, now = int(item[at - 1]), int(item[at])
        if anew:
            before, counts, passed = -1, [{}], passed | {-1}
        followed: list[dict[int, int]] = []
        for jumped in counts:
            followed += [one for one in _followed_unseen(items, before, now, jumped, passed) if one not in followed]
        flags[at], counts = (0.0, followed[:ROUNDS_MAX]) if followed else (1.0, counts)
    return flags


def _followed_unseen(
    items: Sequence[Item], index: int, now: int, jumped: dict[int, int], passed: set[int]
) -> Iterator[dict[int, int]]:
    """As `_followed`, after any number of rounds of a jump back to `index`: one takes a tick, and may not show."""
    for _ in range(ROUNDS_MAX):
        followed = _followed(items, index, now, jumped, passed)
        if followed is not None:
            yield followed
        again = _followed(items, index, index, jumped, passed)
        if again is None or again == jumped:
            return
        jumped = again


def _followed(
    items: Sequence[Item], index: int, now: int, jumped: dict[int, int], passed: set[int]
) -> dict[int, int] | None:
    """Return the jumps counted once item `now` has followed `index`; None if it cannot."""
    counted = dict(jumped)
    for _ in range(PASSED_MAX):
        index = _after(items, index, counted)
        if index == now:
            return counted
        if index not in passed:
            return None
    return None


def _after(items: Sequence[Item], index: int, jumped: dict[int, int]) -> int:
    """Return the item that follows one, and count a jump."""
    if not 0 <= index < len(items):
        return index + 1
    one, done = items[index], jumped.get(index, 0)
    if one.target >= 0 and one.target != index and one.target < len(items) and (one.times < 0 or done < one.times):
        if one.times >= 0:
            jumped[index] = done + 1
        return one.target
    return index + 1
