"""Arguments that several commands share. Imports nothing heavy: every `--help` comes by here."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

WALL_LIMITS_S = (0.1, 86_400.0)


def add_run(parser: argparse.ArgumentParser, which: str = "the newest") -> None:
    """Name the argument that every command about a run has; `farm_lookup.newest` finds the one left out."""
    parser.add_argument("run", type=Path, nargs="?", metavar="RUN", help=f"run folder ({which})")


def add_wall_limit(parser: argparse.ArgumentParser) -> None:
    """Name the argument that says how long a flight may take."""
    text = "give a flight up after so long"
    parser.add_argument("--wall-limit", type=_wall_limit, default=300.0, metavar="S", help=text)


def _wall_limit(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not WALL_LIMITS_S[0] <= seconds <= WALL_LIMITS_S[1]:
        least, most = WALL_LIMITS_S
        raise argparse.ArgumentTypeError(f"from {least:g} to {most:g} seconds are expected, not {text[:20]!r}")
    return seconds


def add_modules(parser: argparse.ArgumentParser) -> None:
    """Name the arguments that give modules and an autopilot from outside; the command line hands them on."""
    text = "file with a target, strategy, scorer (.py) or policy (.toml) from outside (may be repeated)"
    parser.add_argument("--module", type=Path, action="append", default=[], metavar="FILE", help=text)
    autopilot = "simulator build of ArduCopter or PX4 that flies for that target; known by its content, not its path"
    parser.add_argument("--autopilot", type=Path, metavar="PATH", help=autopilot)


def add_target_settings(parser: argparse.ArgumentParser) -> None:
    """Name the arguments that change the settings of a target."""
    settings = "setting of the target's own (see `saflite list settings`)"
    parser.add_argument("--target-set", action="append", default=[], metavar="NAME=VALUE", help=settings)
    defect = "switch a planted defect on, where the target has them (see `saflite list defects`)"
    parser.add_argument("--defect", action="append", default=[], metavar="NAME", help=defect)
