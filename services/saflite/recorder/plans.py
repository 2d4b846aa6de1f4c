"""Missions as `.plan` files in a folder that several share: none is written over, none left out."""

from __future__ import annotations

from pathlib import Path

import msgspec

from saflite.contract.errors import Refused
from saflite.contract.ids import short_id
from saflite.contract.outside import read_text
from saflite.contract.test_case import Mission
from saflite.flight.mission import dump_plan
from saflite.recorder.files import write_file

NAME_BYTES_MAX = 200
"""Of the 255 that file systems take, so that a digest and what marks a file half written have room."""


def write_plan(mission: Mission, folder: Path, name: str = "") -> Path:
    """Write the mission as `folder/name` (`<its name>.plan` if none is given); returns the file.

    Where another mission stands under that name, this one gets its digest into its own. A name comes with the test
    case, from whoever wrote it: one that no file should have gives way to the digest.
    """
    text = dump_plan(mission)
    wanted = Path(name or f"{mission.name}.plan").name
    path = folder / (wanted if _names_a_file(wanted) else f"mission-{short_id(text.encode())}.plan")
    if path.exists() and read_text(path, "mission plan") != text:
        path = path.with_stem(f"{path.stem}-{short_id(text.encode())}")
    write_file(path, text)
    return path


def with_readable_rest(mission: Mission) -> Mission:
    """Return the mission without what it keeps of its plan where that is none of a plan: the rest is written.

    For what is written of many: one that says something else must not keep the others from being written.
    """
    try:
        dump_plan(mission)
    except Refused:
        return msgspec.structs.replace(mission, plan_extra="{}")
    return mission


def _names_a_file(name: str) -> bool:
    return name.isprintable() and not name.startswith(".") and 0 < len(name.encode()) <= NAME_BYTES_MAX
