"""Bounds of what a message may hold: checked when it is decoded, so that no service ever sees more.

A float with a bound is finite: neither NaN nor an infinity lies between two numbers. Counts stay far below what SQLite
and MessagePack hold (2**63), so that sums of them do, too.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

COUNT_MAX = 2**53
TEXT_CHARS_MAX = 65_536
TOLD_CHARS_MAX = 2_048
WORD_CHARS_MAX = 1_024
ITEMS_MAX = 100_000

Count = Annotated[int, msgspec.Meta(ge=0, le=COUNT_MAX)]
Place = Annotated[int, msgspec.Meta(ge=-1, le=COUNT_MAX)]
"""A number counted from 0; -1 stands for none."""

Number = Annotated[float, msgspec.Meta(ge=-1e300, le=1e300)]
Quantity = Annotated[float, msgspec.Meta(ge=0.0, le=1e300)]
Seconds = Annotated[float, msgspec.Meta(ge=0.0, le=1e12)]
Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Whole = Annotated[int, msgspec.Meta(ge=-COUNT_MAX, le=COUNT_MAX)]
RngSeed = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Single = Annotated[float, msgspec.Meta(ge=-3.4e38, le=3.4e38)]
"""A number that autopilots hold, in single precision: what MAVLink and traces carry."""

Latitude = Annotated[float, msgspec.Meta(ge=-90.0, le=90.0)]
Longitude = Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)]
Text = Annotated[str, msgspec.Meta(max_length=TEXT_CHARS_MAX)]
"""Words for people."""

Account = Annotated[str, msgspec.Meta(max_length=4 * TEXT_CHARS_MAX)]
"""Words of ours around words of others."""

Document = Annotated[str, msgspec.Meta(max_length=2**22)]
"""A whole file, as it was read (`contract/outside.py` reads none that is longer)."""

Word = Annotated[str, msgspec.Meta(max_length=WORD_CHARS_MAX)]
Labels = Annotated[dict[Word, Word], msgspec.Meta(max_length=64)]
Features = Annotated[dict[Word, Number], msgspec.Meta(max_length=1_000)]
Samples = Annotated[dict[Word, float], msgspec.Meta(max_length=1_000)]
"""Signals of one instant; as in a trace, a value may be no number."""

Track = Annotated[tuple[tuple[Number, Number, Number, Number], ...], msgspec.Meta(max_length=ITEMS_MAX)]


def told(text: str, chars_max: int = TEXT_CHARS_MAX) -> Text:
    """Return words of others as a message may hold them: encodable as UTF-8, and no longer than a text may be."""
    return text[:chars_max].encode("utf-8", "replace").decode()
