"""Which input moves which state, and how near an input's name lies to a policy's words: relevance before any flight.

Knowledge: the published profiling of ArduPilot's inputs (`data/input_moves_state.csv`), the words of parameter and
command names, and the words and signals of the policy at hand.
"""

from __future__ import annotations

import csv
import math
import re
from functools import lru_cache
from importlib.resources import files
from typing import NamedTuple

from saflite.contract.errors import Refused
from saflite.contract.test_case import Stimulus
from saflite.scorer_pool.model import PolicyBrief

SYNONYMS = {
    "alt": "altitude", "height": "altitude", "hover": "hold", "thr": "throttle", "rc3": "throttle", "rll": "roll",
    "rc1": "roll", "rc2": "pitch", "rc4": "yaw", "heading": "yaw", "compass": "yaw", "mag": "yaw", "chute": "parachute",
    "pos": "position", "location": "position", "spd": "speed", "velocity": "speed", "fs": "failsafe",
    "baro": "barometer", "rtl": "return", "flipping": "flip", "takeoff": "take", "tko": "take", "tkoff": "take",
    "batt": "battery", "bat": "battery", "flightmode": "mode", "modes": "mode", "satellites": "gps", "numsats": "gps",
    "angle": "attitude", "stick": "throttle", "radio": "rc", "descend": "land", "landing": "land", "climb": "altitude",
    "climbing": "altitude", "motors": "arm", "armed": "arm", "disarm": "arm", "disarmed": "arm", "geofence": "fence",
}  # fmt: skip
STOP_WORDS = frozenset(
    re.split(
        r"\s+",
        """a an and any are as at be by case cmd com do does drone for from has have if in is it its mav may more must
        not of on only or policy set sim test than that the then this to uav value vehicle violation when which with
        crash max min nav potential interesting considered cause param current flight one following conditions""",
    )
)
STATES = ("altitude", "position", "yaw", "throttle", "roll", "pitch", "speed", "gps", "parachute")
SIGNAL_STATES = {
    "altitude": "altitude", "climb": "altitude", "baro": "altitude", "x": "position", "y": "position",
    "home": "position", "circle": "position", "ground": "speed", "vx": "speed", "vy": "speed", "roll": "roll",
    "pitch": "pitch", "tilt": "roll", "yaw": "yaw", "throttle": "throttle", "rc3": "throttle", "gps": "gps",
    "chute": "parachute", "rc1": "roll", "rc2": "pitch", "rc4": "yaw",
}  # fmt: skip
FAULT_WORDS = {"gps": ("gps", "position"), "baro": ("altitude",), "rc": ("throttle",), "battery": ("battery",)}


class Input(NamedTuple):
    """What is known of one input: states it moves, the words of its name and label, and the label."""

    moves: frozenset[str]
    words: frozenset[str]
    label: str = ""


def words_of(text: str) -> frozenset[str]:
    """Return the telling words of a text or a name, synonyms made one: `RTL_ALT` gives return and altitude."""
    found = re.findall(r"[a-z]+[0-9]*", text.lower().replace("_", " "))
    return frozenset(SYNONYMS.get(word, word) for word in found if word not in STOP_WORDS and len(word) > 1)


@lru_cache(maxsize=1)
def table() -> dict[str, Input]:
    """Return what is known by input name; raises Refused if the data file is damaged."""
    text = files("saflite.scorer_pool").joinpath("data/input_moves_state.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    if not rows or set(rows[0]) != {"input", "kind", "moves", "label"}:
        raise Refused("input_moves_state.csv", expected="columns input, kind, moves, label", got="another table")
    return {
        row["input"]: Input(
            frozenset(filter(None, row["moves"].split("+"))),
            words_of(row["input"]) | words_of(row["label"]),
            row["label"],
        )
        for row in rows
    }


def known(stimulus: Stimulus) -> Input:
    """Return what is known of a stimulus; an unknown input is known by the words of its name only."""
    name = stimulus.name
    base = table().get(name) or table().get(f"MAV_CMD_{name}") or Input(frozenset(), frozenset())
    words = base.words | words_of(name)
    moves = base.moves | (words & frozenset(STATES))
    if stimulus.kind == "mode":
        words |= {"mode"}
        moves |= {"altitude", "position"}
    if stimulus.kind == "sensor_fault":
        extra = {state for word in words for state in FAULT_WORDS.get(word, ())}
        moves, words = moves | extra, words | extra
    return Input(frozenset(moves), frozenset(words))


@lru_cache(maxsize=1)
def _frequency() -> dict[str, int]:
    counts: dict[str, int] = {}
    for row in table().values():
        for word in row.words:
            counts[word] = counts.get(word, 0) + 1
    return counts


def _rarity(word: str) -> float:
    """Return the weight of a shared word: rare among all inputs means telling."""
    return 1.0 / (1.0 + math.log1p(_frequency().get(word, 0)))


class Aim(NamedTuple):
    """What a policy is about: its words and the states its signals show."""

    words: frozenset[str]
    states: frozenset[str]
    inputs: frozenset[str]


@lru_cache(maxsize=512)
def aim(brief: PolicyBrief) -> Aim:
    """Return what a policy is about."""
    words = words_of(brief.interestingness) | words_of(brief.state) | words_of(brief.name.replace("-", " "))
    parts = {part for signal in brief.signals for part in signal.split("_")}
    states = {SIGNAL_STATES[part] for part in parts if part in SIGNAL_STATES} | (words & frozenset(STATES))
    return Aim(words, frozenset(states), frozenset(brief.inputs))


@lru_cache(maxsize=65_536)
def relation(kind: str, name: str, brief: PolicyBrief) -> float:
    """Return how likely an input bears on a policy before any flight, 0..1."""
    about = known(Stimulus(at_s=0.0, kind=kind, name=name))  # type: ignore[arg-type]
    target = aim(brief)
    shared = sum(_rarity(word) for word in about.words & target.words)
    named = 1.0 if name.lower() in brief.interestingness.lower() and len(name) > 3 else 0.0
    moved = about.moves & target.states
    reach = len(moved) / math.sqrt(max(1, len(target.states)) * max(1, len(about.moves))) if moved else 0.0
    listed = 0.5 if target.inputs and name in target.inputs else 0.0
    weight = -2.6 + 2.2 * math.tanh(1.5 * shared) + 2.5 * named + 1.6 * reach + listed
    return 1.0 / (1.0 + math.exp(-weight))


def brief_names_negative(brief: PolicyBrief) -> bool:
    """Return whether the policy's words call negative values interesting."""
    return "negative" in words_of(brief.interestingness)


def negative(stimulus: Stimulus) -> bool:
    """Return whether a parameter is set below 0, or the last number of a command, a height, is."""
    return stimulus.kind in ("parameter", "command") and bool(stimulus.values) and stimulus.values[-1] < 0.0
