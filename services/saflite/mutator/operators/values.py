"""Drawing the value of an input: PGFuzz's rules with their dead branches mended. Pure.

PGFuzz (NDSS 2021): a parameter evenly in its valid range, a least value only: up to 10,000; none known: always 0;
commands: seven whole numbers 1..100; sensors and world: 0..100. Mended here: inputs without bounds get numbers of every
size and sign instead of 0, a share of draws leaves the valid range (below, above, negative, 0), and commands get
numbers that mean something to them.
"""

from __future__ import annotations

import math

import numpy as np

from saflite.contract.test_case import StimulusKind
from saflite.mutator.operators.inputs import Input

Rng = np.random.Generator
Values = tuple[float, ...]

UNBOUNDED_HIGH = 10_000.0
STICK_BEYOND = 0.2  # how far beyond its ends a failing radio can put a stick, as a share of its range
COMMAND_NUMBERS = 7
# the choices that matter, by command and number (from 1): MAVLink's common message set
_CHOICES: dict[str, dict[int, tuple[float, ...]]] = {
    "MAV_CMD_DO_PARACHUTE": {1: (2.0, 2.0, 1.0, 0.0)},
    "MAV_CMD_COMPONENT_ARM_DISARM": {1: (0.0, 1.0), 2: (0.0, 0.0, 21196.0)},
    "MAV_CMD_DO_CHANGE_SPEED": {1: (0.0, 1.0, 2.0, 3.0)},
    "MAV_CMD_CONDITION_YAW": {3: (-1.0, 0.0, 1.0), 4: (0.0, 1.0)},
    "MAV_CMD_DO_SET_HOME": {1: (0.0, 1.0)},
    "MAV_CMD_DO_PAUSE_CONTINUE": {1: (0.0, 1.0)},
    "MAV_CMD_NAV_GUIDED_ENABLE": {1: (0.0, 1.0)},
    "MAV_CMD_DO_AUTOTUNE_ENABLE": {1: (0.0, 1.0)},
    "MAV_CMD_DO_SET_MODE": {1: (1.0,), 2: (0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 9.0, 17.0)},
}
# numbers 5 to 7 of these are a place: degrees and metres; 0 means "here"
_PLACES = frozenset(
    {
        *("MAV_CMD_DO_REPOSITION", "MAV_CMD_NAV_WAYPOINT", "MAV_CMD_NAV_SPLINE_WAYPOINT", "MAV_CMD_NAV_LAND"),
        *("MAV_CMD_DO_SET_HOME", "MAV_CMD_NAV_LOITER_TIME", "MAV_CMD_NAV_LOITER_TURNS", "MAV_CMD_NAV_TAKEOFF"),
    }
)
HOME_LAT_DEG, HOME_LON_DEG = 47.3977419, 8.5455938  # where flights without a mission begin (the competition's home)
NEAR_DEG = 0.0005  # about 50 m


MOVES, DEG_PER_M = "MAV_CMD_DO_REPOSITION", 1.0 / 111_320.0


def away(rng: Rng, far_m: float, height_m: float) -> Values:
    """Return the numbers of an order to go to a place 1.2 to 12 times as far from home, at a height."""
    distance = far_m * math.exp(rng.uniform(math.log(1.2), math.log(12.0)))
    heading = float(rng.uniform(0.0, 2.0 * math.pi))
    north = distance * math.cos(heading) * DEG_PER_M
    east = distance * math.sin(heading) * DEG_PER_M / math.cos(math.radians(HOME_LAT_DEG))
    return (0.0, 0.0, 0.0, 0.0, round(HOME_LAT_DEG + north, 7), round(HOME_LON_DEG + east, 7), neat(height_m))


def has_choices(command: str) -> bool:
    """Return whether numbers that mean something are known for a command."""
    return command in _CHOICES or command in _PLACES


LIFT: tuple[tuple[StimulusKind, str, Values], ...] = (
    ("mode", "GUIDED", ()),
    ("command", "MAV_CMD_COMPONENT_ARM_DISARM", (1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    ("command", "MAV_CMD_NAV_TAKEOFF", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 20.0)),
)
"""What lifts a vehicle from the ground by MAVLink's common message set, motors off or on."""


def telling(command: str) -> tuple[int, ...]:
    """Return the numbers of a command (from 0) that say most: a height rather than a place, else the first four."""
    return (6, 6, 4, 5, 0) if command in _PLACES else (0, 1, 2, 3)


def neat(value: float) -> float:
    """Return the number with six digits, so that it reads well and survives every text form."""
    return float(f"{value:.6g}")


def draw(rng: Rng, entry: Input, beyond: float) -> Values:
    """Return values for the input; a share `beyond` of bounded ones lies outside the valid range."""
    if entry.kind == "mode":
        return ()
    if entry.choices and rng.random() >= beyond:
        return (entry.choices[int(rng.integers(len(entry.choices)))],)
    if entry.kind == "command" and math.isnan(entry.low):
        return _command(rng, entry.name, beyond)
    if entry.kind == "stick" and math.isfinite(entry.high - entry.low):
        return (_stick(rng, entry, beyond),)
    if rng.random() < beyond:
        return (_beyond(rng, entry),)
    return (_within(rng, entry),)


def jitter(rng: Rng, entry: Input, values: Values) -> Values:
    """Return the values moved a little: by up to a tenth of the range, or of their size where there is none.

    A command's numbers are mostly choices, not sizes: one of them is drawn anew.
    """
    if entry.kind == "mode" or not values:
        return values
    if entry.choices:
        return draw(rng, entry, 0.2)
    if entry.kind == "command" and math.isnan(entry.low):
        place, new = int(rng.integers(min(len(values), COMMAND_NUMBERS))), _command(rng, entry.name, 0.2)
        return (*values[:place], new[place], *values[place + 1 :])
    span = entry.high - entry.low
    moved = []
    for value in values:
        reach = 0.1 * span if math.isfinite(span) else 0.1 * max(1.0, abs(value))
        step = float(rng.uniform(-reach, reach))
        moved.append(neat(round(value + step) if entry.whole else value + step))
    return tuple(moved)


def within(entry: Input, values: Values) -> Values:
    """Return the values moved into the valid range, or to the nearest choice; what has neither stays."""
    if entry.choices:
        return tuple(min(entry.choices, key=lambda choice: abs(choice - value)) for value in values)
    if not math.isfinite(entry.high - entry.low):
        return values
    kept = (min(max(value, entry.low), entry.high) for value in values)
    return tuple(float(round(value)) if entry.whole else value for value in kept)


def _whole_or_real(rng: Rng, low: float, high: float, whole: bool) -> float:
    if whole and math.ceil(low) <= math.floor(high):
        return float(rng.integers(math.ceil(low), math.floor(high) + 1))
    value = float(rng.uniform(low, high))
    return float(round(value)) if whole else neat(value)


def _stick(rng: Rng, entry: Input, beyond: float) -> float:
    """A third at one of the ends, where sticks do most; some beyond, as a failing radio sends; the rest evenly."""
    pick = rng.random()
    if pick < 0.5 * beyond:
        low_end = rng.random() < 0.5
        reach = STICK_BEYOND * (entry.high - entry.low)
        low, high = (entry.low - reach, entry.low) if low_end else (entry.high, entry.high + reach)
        return _whole_or_real(rng, low, high, entry.whole)
    if pick < 0.5 * beyond + 1 / 3:
        return entry.low if rng.random() < 0.5 else entry.high
    return _whole_or_real(rng, entry.low, entry.high, entry.whole)


def _within(rng: Rng, entry: Input) -> float:
    low, high = entry.low, entry.high
    if math.isnan(low) and math.isnan(high):
        return _any_size(rng)
    if math.isnan(high):
        high = max(UNBOUNDED_HIGH, low + 1.0)
    if math.isnan(low):
        low = min(-UNBOUNDED_HIGH, high - 1.0)
    edge = rng.random()
    if edge < 0.1:
        return low
    if edge < 0.2:
        return high
    return _whole_or_real(rng, low, high, entry.whole)


def _any_size(rng: Rng) -> float:
    """A number of any size from a thousandth to ten thousand, either sign, sometimes 0."""
    if rng.random() < 0.1:
        return 0.0
    size = 10.0 ** rng.uniform(-3.0, 4.0)
    return neat(float(size if rng.random() < 0.5 else -size))


def _beyond(rng: Rng, entry: Input) -> float:
    low, high = entry.low, entry.high
    low = high if math.isnan(low) else low
    high = low if math.isnan(high) else high
    if math.isnan(low):
        return _any_size(rng)
    span = max(high - low, abs(high), 1.0)
    pick = int(rng.integers(5))
    if pick == 0:
        return neat(low - span * float(rng.uniform(0.0, 1.0)))
    if pick == 1:
        return neat(high + span * float(rng.uniform(0.0, 1.0)))
    if pick == 2:
        return neat(high * 10.0 ** float(rng.uniform(1.0, 4.0)) if high > 0 else low - 1.0)
    return (-1.0, 0.0)[pick - 3]


def _command(rng: Rng, name: str, beyond: float) -> Values:
    numbers = [_number(rng, beyond) for _ in range(COMMAND_NUMBERS)]
    for place, choices in _CHOICES.get(name, {}).items():
        if rng.random() >= beyond:
            numbers[place - 1] = choices[int(rng.integers(len(choices)))]
    if name in _PLACES:
        numbers[4:] = _place(rng, beyond)
    return tuple(numbers)


def _number(rng: Rng, beyond: float) -> float:
    pick = rng.random()
    if pick < 0.2:
        return 0.0
    if pick < 0.2 + 0.5 * beyond:
        return -float(rng.integers(1, 101))
    if pick < 0.2 + beyond:
        return neat(float(rng.uniform(0.0, 1.0)))
    return float(rng.integers(1, 101))


def _place(rng: Rng, beyond: float) -> list[float]:
    height_m = float(rng.integers(1, 101)) * (-1.0 if rng.random() < 0.5 * beyond else 1.0)
    if rng.random() < 0.2:
        return [0.0, 0.0, height_m]
    lat, lon = rng.uniform(-NEAR_DEG, NEAR_DEG, size=2)
    return [round(HOME_LAT_DEG + float(lat), 7), round(HOME_LON_DEG + float(lon), 7), height_m]
