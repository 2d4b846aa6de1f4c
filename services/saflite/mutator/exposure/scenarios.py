"""Where flights begin: the campaign's or a policy's start state, any mode at any height, on the ground, a mission."""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np

from saflite.contract.ids import short_id
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Mission, MissionItem, Scenario, StartState
from saflite.flight.mission import dump_plan, parse_plan
from saflite.mutator.exposure.tried import Tried
from saflite.mutator.exposure.vocabulary import pick
from saflite.mutator.operators.commands import HOME_LAT_DEG, HOME_LON_DEG, NEAR_DEG

Rng = np.random.Generator
HEIGHT_M = (3.0, 120.0)
GROUND_SHARE = 0.15
ELSEWHERE = (0.25, 3.0)  # times a policy's own height: to sink for long takes height
MISSION_HEIGHT_M = (4.0, 40.0)
MISSION_LONGER_S = 60.0  # a mission begins with half a minute on the ground and the way up
ITEMS_MAX = 8  # between take-off and end: what a mission counts, skips and jumps shows with several only
TAKEOFF, LAND, RETURN, YAW, SPEED, JUMP = 22, 21, 20, 115, 178, 177
WAYPOINT, SPLINE, WAIT, STAY = 16, 82, 19, 17  # flown to; the last for good
DELAY, PAUSE = 112, 93  # waited for beside the way on, and on the spot
LEGS = {WAYPOINT: 45, SPLINE: 6, WAIT: 7, STAY: 2, JUMP: 7, SPEED: 12, YAW: 12, DELAY: 6, PAUSE: 3}
"""How often each item is drawn between take-off and end."""
COVERED = 0.5  # share of items whose kind is the one that was flown least, not drawn by these weights
TURNS = ((-1.0, 0.0), (0.0, 0.0), (1.0, 0.0), (-1.0, 1.0), (1.0, 1.0))
"""Ways to turn in a mission: the side, and whether the angle counts from the heading at hand; a side for both."""
BACK, AHEAD = range(2)  # where a jump leads
MISSION_SPEED_MPS = (0.3, 12.0)  # one above what is flown at anyway bounds nothing
HOLDS = 0.3  # share of places where the vehicle is to wait, besides those that are for that
ITEM = "item"
NOWHERE = 0.15  # share of places that say 0, 0: a place of the item before


class Scenarios(NamedTuple):
    """The campaign's own scenario and the modes of the target a flight may begin in."""

    own: Scenario
    modes: tuple[str, ...]
    missions: bool
    lacks: frozenset[int]  # commands that the target takes in no mission
    tried: Tried  # which items were flown how often

    def begin(self, start: StartState) -> Scenario:
        """Return the campaign's scenario with another start."""
        return msgspec.structs.replace(self.own, start=start, mission=None)

    def anywhere(self, rng: Rng) -> Scenario:
        """Return a start in any mode, on the ground or at a height with all sizes alike."""
        if not self.modes:
            return self.own
        mode = self.modes[int(rng.integers(len(self.modes)))]
        on_ground = rng.random() < GROUND_SHARE
        height_m = 0.0 if on_ground else round(_log_uniform(rng, *HEIGHT_M), 1)
        return self.begin(StartState(mode=mode, altitude_m=height_m))

    def elsewhere(self, rng: Rng, start: StartState) -> Scenario:
        """Return a start in the same mode at another height; what begins on the ground stays there."""
        if start.altitude_m <= 0.0:
            return self.begin(start)
        height_m = round(start.altitude_m * _log_uniform(rng, *ELSEWHERE), 1)
        return self.begin(msgspec.structs.replace(start, altitude_m=height_m))

    def mission(self, rng: Rng) -> Scenario:
        """Return a mission near home: take-off, one to eight items, an end or none."""
        height_m = round(_log_uniform(rng, *MISSION_HEIGHT_M), 1)
        items = [_item(TAKEOFF, place=_or_nowhere(rng, (HOME_LAT_DEG, HOME_LON_DEG, height_m)))]
        for _ in range(int(rng.integers(1, ITEMS_MAX + 1))):
            items.append(self._leg(rng, height_m, len(items)))
        end = (LAND, RETURN, 0)[int(rng.integers(3))]
        if end == LAND:
            items.append(_item(LAND, place=_or_nowhere(rng, _near(rng, 0.0))))
        elif end == RETURN:
            items.append(_item(RETURN))
        limit_s = self.own.time_limit_s + MISSION_LONGER_S
        return msgspec.structs.replace(self.own, start=None, mission=_named(tuple(items)), time_limit_s=limit_s)

    def changed(self, rng: Rng, drawn: Mission) -> Mission:
        """Return a drawn mission with one item between take-off and end drawn anew, more, less, or before the next."""
        items = list(drawn.items)
        ends = items[-1].command in (LAND, RETURN)
        first, last = 1, len(items) - ends  # those that may be changed
        way = ("anew", "more", "less", "swapped")[int(rng.integers(4))]
        if last - first < 2 and way in ("less", "swapped"):
            way = "more"
        if last - first > ITEMS_MAX and way == "more":
            way = "anew"
        if way == "swapped":
            at = int(rng.integers(first, last - 1))
            items[at], items[at + 1] = items[at + 1], items[at]
        else:
            at = int(rng.integers(first, last + (way == "more")))
            new = [] if way == "less" else [self._leg(rng, items[0].params[6] or 0.0, at)]
            items[at : at + (way != "more")] = new
        return _named(tuple(_leading_on(item, place) for place, item in enumerate(items)))

    def _leg(self, rng: Rng, height_m: float, before: int) -> MissionItem:
        """Return an item that follows `before` others; a jump goes back to one of them, or to the next."""
        commands = [command for command in LEGS if command not in self.lacks]
        by_weight = pick(rng, commands, [LEGS[command] for command in commands])
        command = self.tried.least(rng, ITEM, commands) if rng.random() < COVERED else by_weight
        if command in (WAYPOINT, SPLINE, WAIT, STAY):
            waits = command == WAIT or (command != STAY and rng.random() < HOLDS)
            up_m = round(height_m * _log_uniform(rng, 0.5, 2.0), 1)
            place = _or_nowhere(rng, _near(rng, up_m))
            return _item(command, float(rng.integers(1, 8)) if waits else 0.0, place=place)
        if command == JUMP:
            back = self.tried.least(rng, f"{ITEM} {JUMP}", (BACK, AHEAD)) == BACK
            return _item(JUMP, float(rng.integers(2, before + 2) if back else before + 2), float(rng.integers(1, 3)))
        if command == SPEED:
            return _item(SPEED, 1.0, round(_log_uniform(rng, *MISSION_SPEED_MPS), 1))
        if command == YAW:
            side, relative = TURNS[self.tried.least(rng, f"{ITEM} {YAW}", range(len(TURNS)))]
            angle_deg = rng.integers(10, 181) if relative else rng.integers(0, 360)
            return _item(YAW, float(angle_deg), 0.0, side, relative)
        return _item(command, float(rng.integers(1, 8)))


def scenarios_of(own: Scenario, target: TargetInfo, tried: Tried | None = None) -> Scenarios:
    """Return what may be drawn for a target: the modes of its example start states."""
    modes = tuple(dict.fromkeys(start.mode for start in target.start_states))
    lacks = frozenset(target.mission_lacks)
    return Scenarios(own, modes if own.mission is None else (), target.missions, lacks, tried or Tried())


def items_of(mission: Mission) -> list[tuple[str, int]]:
    """Return which items a mission has between take-off and end, as `Tried` counts them."""
    flown: list[tuple[str, int]] = []
    for place, item in enumerate(mission.items, start=1):
        first, _, side, relative, *_ = item.params
        if item.command in LEGS:
            flown.append((ITEM, item.command))
        if item.command == YAW and (side, relative) in TURNS:
            flown.append((f"{ITEM} {YAW}", TURNS.index((float(side or 0.0), float(relative or 0.0)))))
        if item.command == JUMP:
            flown.append((f"{ITEM} {JUMP}", BACK if (first or 0.0) <= place else AHEAD))
    return flown


def _named(items: tuple[MissionItem, ...]) -> Mission:
    """Return a mission as its file would hold it, named after its items: plans of a run lie in one folder."""
    name = f"drawn-{short_id(msgspec.json.encode(items))}"
    home = Mission(name=name, home_lat_deg=HOME_LAT_DEG, home_lon_deg=HOME_LON_DEG, home_alt_m=0.0, items=items)
    return parse_plan(dump_plan(home), name, name)


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _near(rng: Rng, up_m: float) -> tuple[float, float, float]:
    north, east = rng.uniform(-NEAR_DEG / 2, NEAR_DEG / 2, size=2)
    return round(HOME_LAT_DEG + float(north), 7), round(HOME_LON_DEG + float(east), 7), up_m


def _or_nowhere(rng: Rng, place: tuple[float, float, float]) -> tuple[float, float, float]:
    return (0.0, 0.0, place[2]) if rng.random() < NOWHERE else place


def _leading_on(item: MissionItem, place: int) -> MissionItem:
    """Return an item at this index, counted from 0; a jump leads no further than to the one after it."""
    first, *rest = item.params
    if item.command != JUMP or first is None or first <= place + 2:
        return item
    return msgspec.structs.replace(item, params=(place + 2.0, *rest))


def _item(command: int, *numbers: float, place: tuple[float, float, float] | None = None) -> MissionItem:
    params = [*numbers, *([0.0] * 4)][:4]
    where: tuple[float | None, ...] = place if place is not None else (0.0, 0.0, 0.0)
    return MissionItem(command=command, params=(*params, *where))
