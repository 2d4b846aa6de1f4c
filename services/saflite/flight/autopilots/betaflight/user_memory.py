"""A user's own `eeprom.bin`, as Betaflight's simulator build leaves it: settings that a test case's are added to."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from saflite.contract.errors import Refused
from saflite.contract.outside import NAME_SHOWN, read_bytes
from saflite.contract.test_case import Setting

SETTING = "eeprom"
SIZE_BYTES = 32_768
_FIX = "make it anew: `save` on the command line of this build writes one; or leave the setting out"


def read(settings: Mapping[str, Setting]) -> bytes:
    """Return the content of the file that a target's settings name, empty if they name none.

    Raises:
        Refused: it cannot be read, or is of another size than every such file.
    """
    name = str(settings.get(SETTING, ""))
    if not name:
        return b""
    try:
        content = read_bytes(Path(name), SETTING, SIZE_BYTES)
    except Refused:
        content = b""
    if len(content) != SIZE_BYTES:  # a farm may name any file of a worker's machine: it does not hear what ails it
        expected = f"a file of {SIZE_BYTES} bytes that can be read, on the machine that flies"
        raise Refused(SETTING, where=name[:NAME_SHOWN], expected=expected, got="none", fix=_FIX)
    return content


def check_taken(given: bytes, now: bytes) -> None:
    """Raise Refused where the firmware has put its defaults in place of what it was given: it could not read it."""
    if given != now:
        expected = "settings of this build, undamaged"
        raise Refused(SETTING, expected=expected, got="content that the firmware discards", fix=_FIX)
