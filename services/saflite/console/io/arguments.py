"""Arguments that several commands share. Imports nothing heavy: every `--help` comes by here."""

from __future__ import annotations

import argparse


def add_target_settings(parser: argparse.ArgumentParser) -> None:
    """Name the arguments that change the settings of a target."""
    settings = "setting of the target's own (see `saflite list settings`)"
    parser.add_argument("--target-set", action="append", default=[], metavar="NAME=VALUE", help=settings)
    defect = "switch a planted defect on, where the target has them (see `saflite list defects`)"
    parser.add_argument("--defect", action="append", default=[], metavar="NAME", help=defect)
