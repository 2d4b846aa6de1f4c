"""The real autopilot that a person names on the command line: it flies for the target that the file is."""

from __future__ import annotations

from pathlib import Path

from saflite.contract.errors import Refused
from saflite.flight.autopilots.ardupilot import binary as ardupilot
from saflite.flight.autopilots.external.binary import Binaries
from saflite.flight.autopilots.px4 import binary as px4
from saflite.simulator_worker.registry import is_outside

EITHER = "name a simulator build: ArduCopter's (SITL), or bin/px4 of PX4's"


def use(path: Path) -> None:
    """Have the autopilot in a file fly for the target that it is; raises Refused where it is none that can fly."""
    try:
        _binaries(path).use(path)
    except Refused as fault:
        if fault.fix != ardupilot.WANTED:
            raise
        elf = fault.expected != ardupilot.VEHICLES[0]
        expected, got = (fault.expected, fault.got) if elf else ("ArduCopter or PX4", "a program with neither's words")
        raise Refused(fault.what, where=fault.where, expected=expected, got=got, fix=EITHER) from fault


def check_flies(path: Path | None, target: str) -> None:
    """Raise Refused where a campaign on a target of ours would never fly the autopilot that was named for it."""
    if path is None or is_outside(target):
        return
    own = _binaries(path).target
    if own != target:
        expected = f"a campaign on {own}, which the binary flies for"
        raise Refused(
            "--autopilot", expected=expected, got=f"one on {target}", fix=f"add --target {own}, or leave it out"
        )


def _binaries(path: Path) -> Binaries:
    return px4.BINARIES if px4.is_px4(path) else ardupilot.BINARIES._replace(wanted=EITHER)
