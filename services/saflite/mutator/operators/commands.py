"""What the numbers of MAVLink's commands mean (`data/mav_commands.csv`), and drawing ones that mean something. Pure."""

from __future__ import annotations

import csv
import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from saflite.contract.test_case import StimulusKind

Rng = np.random.Generator
TABLE = Path(__file__).parent.parent / "data" / "mav_commands.csv"
COUNT = 7
PLACE, HERE, HEIGHT = "place", "here", "height"
HERE_SHARE = 0.3  # of orders that may leave the place open
HEIGHT_M = (2.0, 100.0)  # all sizes alike
HOME_LAT_DEG, HOME_LON_DEG = 47.3977419, 8.5455938  # where flights without a mission begin (the competition's home)
NEAR_DEG = 0.0005  # about 50 m


MOVES, DEG_PER_M = "MAV_CMD_DO_REPOSITION", 1.0 / 111_320.0
LIFT: tuple[tuple[StimulusKind, str, tuple[float, ...]], ...] = (
    ("mode", "GUIDED", ()),
    ("command", "MAV_CMD_COMPONENT_ARM_DISARM", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    ("command", "MAV_CMD_NAV_TAKEOFF", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0)),
)
"""What lifts a vehicle from the ground by MAVLink's common message set, motors off or on."""
LANDS = "MAV_CMD_NAV_LAND"


class Span(NamedTuple):
    """Numbers from `low` to `high`, whole ones or not."""

    low: float
    high: float
    whole: bool


Meaning = str | float | Span
"""One of the words for places and heights, a number, or a span of them."""


@cache
def table() -> dict[str, tuple[tuple[Meaning, ...], ...]]:
    """Return per command what each of its seven numbers may be: choices of equal chance, none where it is unused."""
    with TABLE.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {row["name"]: tuple(_meanings(row[f"p{place}"]) for place in range(1, COUNT + 1)) for row in rows}


def _meanings(cell: str) -> tuple[Meaning, ...]:
    return tuple(_meaning(word) for word in cell.split("|")) if cell else ()


def _meaning(word: str) -> Meaning:
    if word in (PLACE, HERE, HEIGHT):
        return word
    low, dots, high = word.partition("..")
    return Span(float(low), float(high), whole="." not in low + high) if dots else float(word)


def known(name: str) -> bool:
    """Return whether the numbers of a command are known."""
    return name in table()


def used(name: str) -> tuple[int, ...]:
    """Return which numbers of a command (from 0) are used, all where it is not known."""
    meanings = table().get(name)
    return tuple(range(COUNT)) if meanings is None else tuple(at for at, each in enumerate(meanings) if each)


def telling(name: str) -> tuple[int, ...]:
    """Return which numbers of a known command say most: those used, degrees aside; the height stands for the place."""
    return tuple(
        place for place in used(name) if PLACE not in table()[name][place] and HERE not in table()[name][place]
    )


def draw(rng: Rng, name: str) -> list[float | None]:
    """Return numbers that mean something for a command that is known, None for those that are unused."""
    meanings = table()[name]
    where = _near(rng) if rng.random() >= HERE_SHARE or HERE not in meanings[4] else (0.0, 0.0)
    return [_number(rng, each, where[place - 4] if place in (4, 5) else 0.0) for place, each in enumerate(meanings)]


def away(rng: Rng, far_m: float, height_m: float) -> tuple[float, ...]:
    """Return the numbers of an order to go to a place 1.2 to 12 times as far from home, at a height."""
    return place(rng, far_m * math.exp(rng.uniform(math.log(1.2), math.log(12.0))), height_m)


def place(rng: Rng, distance_m: float, height_m: float) -> tuple[float, ...]:
    """Return the numbers of an order about a place that far from home, in any direction, at a height."""
    heading = float(rng.uniform(0.0, 2.0 * math.pi))
    north = distance_m * math.cos(heading) * DEG_PER_M
    east = distance_m * math.sin(heading) * DEG_PER_M / math.cos(math.radians(HOME_LAT_DEG))
    degrees = (round(HOME_LAT_DEG + north, 7), round(HOME_LON_DEG + east, 7))
    return (0.0, 0.0, 0.0, 0.0, *degrees, round(height_m, 2))


def _number(rng: Rng, meanings: tuple[Meaning, ...], degrees: float) -> float | None:
    if not meanings:
        return None
    meaning = meanings[int(rng.integers(len(meanings)))]
    if isinstance(meaning, float):
        return meaning
    if isinstance(meaning, Span):
        if meaning.whole:
            return float(rng.integers(int(meaning.low), int(meaning.high) + 1))
        return round(math.exp(rng.uniform(math.log(meaning.low), math.log(meaning.high))), 2)
    return _height(rng) if meaning == HEIGHT else degrees


def _height(rng: Rng) -> float:
    low, high = (math.log(height_m) for height_m in HEIGHT_M)
    return round(math.exp(rng.uniform(low, high)), 1)


def _near(rng: Rng) -> tuple[float, float]:
    north, east = rng.uniform(-NEAR_DEG, NEAR_DEG, size=2)
    return round(HOME_LAT_DEG + float(north), 7), round(HOME_LON_DEG + float(east), 7)
