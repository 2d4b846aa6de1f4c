"""What of a DataFlash log can be read: its messages, each whole and of a kind that is described, and what was lost.

A message is two bytes that mark it, the number of its kind, and as many bytes as the description of that kind says
(ArduPilot, AP_Logger: `FMT` has number, length, name, a letter for each field and their names). Cards and radio links
leave holes; a hole in a description would otherwise cost the whole log. A description that contradicts itself is held
against the log: the size after which the next message begins is the right one.
"""

from __future__ import annotations

import re
import struct
from collections import Counter, defaultdict
from typing import NamedTuple

from saflite.contract.errors import Refused

HEAD = b"\xa3\x95"
SIZES = {
    **dict.fromkeys("bBM", 1),
    **dict.fromkeys("hHcCg", 2),
    **dict.fromkeys("iIfneEL", 4),
    **dict.fromkeys("dqQ", 8),
    **dict.fromkeys("N", 16),
    **dict.fromkeys("aZ", 64),
}
"""Bytes of a field by its letter."""
_FMT, _FMT_BYTES = 128, 89
_LAYOUT = struct.Struct("<3xBB4s16s64s")
_UNITS = ("UNIT", "MULT", "FMTU")  # nothing here reads units; damaged ones would end the reader
_NAME = re.compile(r"[A-Za-z0-9_]{1,4}")
DESCRIPTIONS_MAX = 16  # of one kind that differ; a sound log has one, each more costs a look through the log
MESSAGES_MAX, PIECES_MAX = 2**24, 2**20
"""A day of a copter, and more holes than anybody would read on after. The library takes 100 bytes for each."""

_TRIED = 64  # places at which a size is tried
_SHOWN = 6


class Sound(NamedTuple):
    """The messages that can be read, as a log of its own, and in words what of the log was lost; empty if nothing."""

    log: bytes
    lost: tuple[str, ...]


class _Kind(NamedTuple):
    """What a description says of a kind; `by_letters` and `length` differ where it contradicts itself."""

    number: int
    length: int
    name: str
    letters: str
    columns: str

    @property
    def by_letters(self) -> int:
        """Bytes of a message by its fields; 0 where the letters or the names of the fields are damaged."""
        names = self.columns.split(",") if self.columns else []
        if len(names) != len(self.letters) or not all(letter in SIZES for letter in self.letters):
            return 0
        return len(HEAD) + 1 + sum(SIZES[letter] for letter in self.letters)

    @property
    def called(self) -> str:
        """Name it for people."""
        return self.name if _NAME.fullmatch(self.name) else f"number {self.number}"


_ITSELF = _Kind(_FMT, _FMT_BYTES, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")


class _Marks:
    """The first places at which a message of each kind seems to begin; a log is looked through once for a kind."""

    def __init__(self, data: bytes) -> None:
        self._data, self._places = data, dict[int, list[int]]()

    def fit(self, number: int, size: int) -> float:
        """Return the share of a kind's messages after which, by this size, another begins; 0 of a size that is none."""
        if size <= len(HEAD):
            return 0.0
        if number not in self._places:
            self._places[number] = self._found(HEAD + bytes([number]))
        ends = [place + size for place in self._places[number]]
        met = sum(self._data.startswith(HEAD, end) or end == len(self._data) for end in ends)
        return met / len(ends) if ends else 1.0

    def _found(self, mark: bytes) -> list[int]:
        places = [self._data.find(mark)]
        while places[-1] >= 0 and len(places) <= _TRIED:
            places.append(self._data.find(mark, places[-1] + 1))
        return places[:-1]


def sound(data: bytes, where: str = "") -> Sound:
    """Return what can be read of a log; raises Refused for one in more pieces than a log has: each takes memory."""
    marks = _Marks(data)
    kinds, damaged = _kinds(data, marks)
    sizes = [0] * 256
    for number, kind in kinds.items():
        sizes[number] = kind.by_letters
    for number, kind in damaged.items():
        sizes[number] = kind.length if marks.fit(number, kind.length) else 0
    sizes[_FMT] = _FMT_BYTES
    silent = {_FMT, *damaged, *(number for number, kind in kinds.items() if kind.name in _UNITS)}
    try:
        kept, left_out, unknown, skipped = _walk(data, sizes, silent)
    except _TooMany as fault:
        raise Refused("ArduPilot log", where=where, expected=f"at most {fault}", got="more") from fault
    described = [_description(kind) for kind in (_ITSELF, *kinds.values()) if kind.name not in _UNITS]
    counts = left_out + unknown
    lost = [_of(f"the description of {kind.called} is damaged", counts[kind.number]) for kind in damaged.values()]
    nameless = sorted(number for number in unknown if number not in damaged)
    lost += [_of(f"nothing describes number {number}", unknown[number]) for number in nameless]
    if skipped and not lost:
        lost = [f"{skipped} of {len(data)} bytes are of no message"]
    more = [f"and {len(lost) - _SHOWN} more"] if len(lost) > _SHOWN else []
    return Sound(b"".join([*described, *kept]), (*lost[:_SHOWN], *more))


def _of(what: str, count: int) -> str:
    return f"{what}: its {count} messages are left out" if count else f"{what}, which left no message"


def _kinds(data: bytes, marks: _Marks) -> tuple[dict[int, _Kind], dict[int, _Kind]]:
    """Return by number the kinds that are described well, and those whose description is damaged."""
    told: dict[int, list[_Kind]] = defaultdict(list)
    place = data.find(HEAD + bytes([_FMT]))
    while 0 <= place <= len(data) - _FMT_BYTES:
        kind = _read(data, place)
        others = told[kind.number]
        if kind.number != _FMT and len(others) < DESCRIPTIONS_MAX and kind not in others and _is_description(kind):
            others.append(kind)
        place = data.find(HEAD + bytes([_FMT]), place + 1)
    kinds, damaged = {}, {}
    for number, several in told.items():
        fits = {kind: marks.fit(number, kind.by_letters) for kind in several if kind.by_letters}
        best = [kind for kind, fit in fits.items() if fit == max(fits.values())]
        if len(best) == 1 and _NAME.fullmatch(best[0].name) and _is_right(marks, best[0]):
            kinds[number] = best[0]
        elif several:
            damaged[number] = several[0]
    return kinds, damaged


def _read(data: bytes, place: int) -> _Kind:
    number, length, *texts = _LAYOUT.unpack_from(data, place)
    return _Kind(number, length, *(text.split(b"\0", 1)[0].decode("latin-1") for text in texts))


def _is_description(kind: _Kind) -> bool:
    """Whether it is one, damaged or not, and no other message that happens to hold its mark."""
    good = sum(letter in SIZES for letter in kind.letters)
    columns = re.fullmatch(r"[\x20-\x7e]*", kind.columns) is not None
    return bool(_NAME.fullmatch(kind.name)) + (2 * good >= len(kind.letters) > 0) + columns >= 2 and bool(kind.columns)


def _is_right(marks: _Marks, kind: _Kind) -> bool:
    """Whether its fields make up its messages, where its length says otherwise."""
    if kind.by_letters == kind.length:
        return True
    return marks.fit(kind.number, kind.by_letters) >= marks.fit(kind.number, kind.length)


class _TooMany(Exception):
    """More than any log has, and what of."""


def _walk(data: bytes, sizes: list[int], silent: set[int]) -> tuple[list[bytes], Counter[int], Counter[int], int]:
    """Go through the log message by message.

    Returns the stretches kept; by number the messages left out for their kind, and those nobody described; and how many
    bytes before the last message are of none. Raises _TooMany.
    """
    kept: list[bytes] = []
    messages = 0
    left_out, unknown = Counter[int](), Counter[int]()
    skipped = hole = begun = place = 0
    end = len(data)
    first, second = HEAD
    while place + 3 <= end:
        number = data[place + 2]
        size = sizes[number] if data[place] == first and data[place + 1] == second else 0
        messages += 1
        if messages > MESSAGES_MAX or len(kept) > PIECES_MAX:
            raise _TooMany(f"{PIECES_MAX} pieces" if len(kept) > PIECES_MAX else f"{MESSAGES_MAX} messages")
        if size and place + size <= end:
            skipped, hole = skipped + hole, 0
            if number in silent:
                kept.append(data[begun:place])
                begun = place + size
                left_out[number] += 1
            place += size
            continue
        kept.append(data[begun:place])
        if data.startswith(HEAD, place) and not size:
            unknown[number] += 1
        begun = _next(data, place + 1, sizes)
        hole += begun - place
        place = begun
    kept.append(data[begun:place] if place <= end else b"")
    return kept, left_out, unknown, skipped


def _next(data: bytes, place: int, sizes: list[int]) -> int:
    """Return where the next message begins: one of a known kind that another one follows, or the end of the log."""
    end = len(data)
    while 0 <= (place := data.find(HEAD, place)) <= end - 3:
        size = sizes[data[place + 2]]
        if not size or data.startswith(HEAD, place + size) or place + size == end:
            return place
        place += 1
    return end


def _description(kind: _Kind) -> bytes:
    texts = (text.encode("latin-1") for text in (kind.name, kind.letters, kind.columns))
    return HEAD + bytes([_FMT]) + _LAYOUT.pack(kind.number, kind.by_letters, *texts)[3:]
