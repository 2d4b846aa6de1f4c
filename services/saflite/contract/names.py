"""Alphabets of what comes in messages and becomes a path, a key or a word on a terminal.

The types are checked whenever a message is decoded; `is_name` is for what does not come in one.
"""

from __future__ import annotations

import re
from typing import Annotated

from msgspec import Meta

from saflite.contract.errors import Refused

_END = r"(?![\s\S])"  # `$` would let a line break follow
NAME_CHARS_MAX = 64
NAME = rf"[A-Za-z0-9][A-Za-z0-9._-]{{0,{NAME_CHARS_MAX - 1}}}"
NAME_EXPECTED = f"1 to {NAME_CHARS_MAX} of A-Z a-z 0-9 . _ - beginning with a letter or digit"

Name = Annotated[str, Meta(pattern=f"^{NAME}{_END}")]
NameOrAny = Annotated[str, Meta(pattern=f"^(?:{NAME}|[*]){_END}")]
NameOrNone = Annotated[str, Meta(pattern=f"^(?:{NAME})?{_END}")]
ShortId = Annotated[str, Meta(pattern=f"^[0-9a-f]{{16}}{_END}")]
ShortIdOrNone = Annotated[str, Meta(pattern=f"^(?:[0-9a-f]{{16}})?{_END}")]
Digest = Annotated[str, Meta(pattern=f"^[0-9a-f]{{64}}{_END}")]
DigestOrNone = Annotated[str, Meta(pattern=f"^(?:[0-9a-f]{{64}})?{_END}")]
LABEL_CHARS_MAX = 500
LABEL = rf"[!-~]{{0,{LABEL_CHARS_MAX}}}"
Label = Annotated[str, Meta(pattern=f"^{LABEL}{_END}")]
"""Names a model and maybe its server: printable ASCII without spaces."""

StateWords = Annotated[str, Meta(pattern=f"^[A-Za-z0-9_]+(?: [A-Za-z0-9_]+){{0,15}}{_END}", max_length=200)]
"""Names a state of a target: its mode and what else holds, in words."""


def is_name(text: str) -> bool:
    """Return whether a text can stand in keys, paths and tables as it is."""
    return re.fullmatch(NAME, text) is not None


def is_label(text: str) -> bool:
    """Return whether a text can name a model, maybe with its server."""
    return re.fullmatch(LABEL, text) is not None


def recording_file(test_case: str, flight_index: int) -> str:
    """Return where the recording of a flight stands in a run folder: derived, never told by anybody.

    Raises:
        Refused: the identity cannot be one.
    """
    if re.fullmatch(r"[0-9a-f]{16}", test_case) is None or flight_index < 0:
        raise Refused("recording", expected="a test case by its 16 hexadecimal digits", got=repr(test_case[:80]))
    return f"recordings/{test_case}-{flight_index}.mcap"
