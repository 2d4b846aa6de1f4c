"""Arguments that several commands share. Imports nothing heavy: every `--help` comes by here."""

from __future__ import annotations

import argparse
import re
from contextlib import suppress
from pathlib import Path

from saflite.contract.plain import cut

WALL_LIMITS_S = (0.1, 86_400.0)
DEADLINES_S = (0.001, 86_400.0)
NUMBER_MAX = 1e18
DIGITS_MAX = 18


def plain_whole(text: str) -> int:
    """Return a whole number of an argument; Python's own takes `1_000`, digits of any script and thousands of them."""
    if re.fullmatch(rf"[+-]?[0-9]{{1,{DIGITS_MAX}}}", text) is None:
        long = re.fullmatch(r"[+-]?[0-9]+", text) is not None
        what = f"a whole number of at most {DIGITS_MAX} digits" if long else "a whole number"
        raise argparse.ArgumentTypeError(f"{what} is expected, not {_shown(text)}")
    return int(text)


def _shown(text: str) -> str:
    """Return what was given, cut with a mark."""
    return repr(cut(text, 24))


def plain_number(text: str) -> float:
    """Return a number of an argument: neither `nan` nor `inf`, of which all that compares them is silent."""
    plain = re.fullmatch(r"[+-]?([0-9]{1,18}(\.[0-9]*)?|\.[0-9]+)([eE][+-]?[0-9]{1,3})?", text)
    if plain is None or not abs(float(text)) <= NUMBER_MAX:
        limit = f" from -{NUMBER_MAX:g} to {NUMBER_MAX:g}" if plain is not None or text.lstrip("+-").isdecimal() else ""
        raise argparse.ArgumentTypeError(f"a number{limit} is expected, not {_shown(text)}")
    return float(text)


def rng_seed(text: str) -> int:
    """Return the start of random draws: what a test case can hold."""
    seed = plain_whole(text)
    if seed < 0:
        raise argparse.ArgumentTypeError(f"a whole number from 0 is expected, not {_shown(text)}")
    return seed


def deadline_s(text: str) -> float:
    """Return how long something may take, seconds."""
    return _within(text, DEADLINES_S)


def add_patience(parser: argparse.ArgumentParser, what: str) -> None:
    """Name the argument that says how long nobody may answer before `what` is done; 0 is patience without end."""
    parser.add_argument("--patience", type=patience_s, default=60.0, metavar="S", help=f"{what} (60; 0: never)")


def patience_s(text: str) -> float:
    """Return a patience (s), 0 for one without end; raises ArgumentTypeError below."""
    patience = plain_number(text)
    if patience < 0:
        raise argparse.ArgumentTypeError(f"seconds from 0 on are expected, not {_shown(text)}")
    return patience


def add_run(parser: argparse.ArgumentParser, which: str = "the newest") -> None:
    """Name the argument that every command about a run has; `farm_lookup.newest` finds the one left out."""
    parser.add_argument("run", type=Path, nargs="?", metavar="RUN", help=f"run folder ({which})")


def add_minutes(parser: argparse.ArgumentParser) -> None:
    """Name the argument that says how long a farm works; `campaign_options.seconds_of` checks it."""
    text = "stop after so long (`saflite resume` goes on)"
    parser.add_argument("--minutes", type=float, metavar="M", help=text)


def add_policy(parser: argparse.ArgumentParser, words: str) -> None:
    """Name the argument for policies; `words` say what they are for."""
    known = "a name of `saflite list policies` or a .toml file; may be repeated"
    parser.add_argument("--policy", action="append", default=[], metavar="POLICY", help=f"{words}: {known}")


def add_wall_limit(parser: argparse.ArgumentParser) -> None:
    """Name the argument that says how long a flight may take."""
    text = "give a flight up after so long"
    parser.add_argument("--wall-limit", type=_wall_limit, default=300.0, metavar="S", help=text)


def add_anywhere(parser: argparse.ArgumentParser) -> None:
    """Name the argument that lifts the competition's rules of boxes."""
    text = "allow boxes outside the competition's area and count"
    parser.add_argument("--anywhere", action="store_true", help=text)


def _wall_limit(text: str) -> float:
    return _within(text, WALL_LIMITS_S)


def _within(text: str, limits_s: tuple[float, float]) -> float:
    least_s, most_s = limits_s
    with suppress(argparse.ArgumentTypeError):
        seconds = plain_number(text)
        if least_s <= seconds <= most_s:
            return seconds
    raise argparse.ArgumentTypeError(f"from {least_s:g} to {most_s:g} seconds are expected, not {_shown(text)}")


def add_modules(parser: argparse.ArgumentParser) -> None:
    """Name the arguments that give modules and an autopilot from outside; the command line hands them on."""
    text = "file with a target, strategy, scorer (.py) or policy (.toml) from outside (may be repeated)"
    parser.add_argument("--module", type=Path, action="append", default=[], metavar="FILE", help=text)
    add_autopilot(parser)


def add_autopilot(parser: argparse.ArgumentParser) -> None:
    """Name the argument that gives an autopilot from outside; the command line hands it on."""
    autopilot = "simulator build of ArduCopter or PX4 that flies for that target; known by its content, not its path"
    parser.add_argument("--autopilot", type=Path, metavar="PATH", help=autopilot)


def add_target_settings(parser: argparse.ArgumentParser) -> None:
    """Name the arguments that change the settings of a target."""
    settings = "setting of the target's own (see `saflite list settings`)"
    parser.add_argument("--target-set", action="append", default=[], metavar="NAME=VALUE", help=settings)
    defect = "switch a planted defect on, where the target has them (see `saflite list defects`)"
    parser.add_argument("--defect", action="append", default=[], metavar="NAME", help=defect)
