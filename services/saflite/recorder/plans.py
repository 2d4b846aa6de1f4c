"""Missions as `.plan` files in a folder that several share: none is written over, none left out."""

from __future__ import annotations

from pathlib import Path

from saflite.contract.ids import short_id
from saflite.contract.outside import read_text
from saflite.contract.test_case import Mission
from saflite.flight.mission import dump_plan
from saflite.recorder.files import write_file


def write_plan(mission: Mission, folder: Path, name: str = "") -> Path:
    """Write the mission as `folder/name` (`<its name>.plan` if none is given); returns the file.

    Where another mission stands under that name, this one gets its digest into its own.
    """
    text = dump_plan(mission)
    path = folder / Path(name or f"{mission.name}.plan").name
    if path.exists() and read_text(path, "mission plan") != text:
        path = path.with_stem(f"{path.stem}-{short_id(text.encode())}")
    write_file(path, text)
    return path
