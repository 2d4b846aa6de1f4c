"""Entries of journal and events as they are stored: deflated, and told in words that earlier entries were made of.

An entry alone is short, and most of it is what the entries before it hold, too: names of fields, of policies, of
signals. So now and then some of the last entries are kept as words (table `words`), and whatever comes after is told
in them. Which words an entry is told in depends on its number only, so a store made anew from its journal is the same.
"""

from __future__ import annotations

import sqlite3
import zlib
from bisect import bisect_left
from collections.abc import Iterable
from itertools import islice

from saflite.contract.errors import Refused

LEVEL = 6
BYTES_MAX = 64 * 2**20  # of an entry unpacked
WORDS_BYTES_MAX = 2**15  # as far back as deflate looks
LEARNT_FROM = 96  # the last entries that words are taken from
LEARNT_BYTES_MAX = 4096  # of one entry: the beginning of a long one holds its words
FIRST, FACTOR = 64, 8  # words are taken after so many entries, and again after so many times as many
_AFTER: tuple[int, ...] = (0, *(FIRST * FACTOR**times for times in range(20)))

FIX = "`saflite audit RUN --rebuild` makes all but the journal anew; else restore the run folder from a copy"

_RAW = -zlib.MAX_WBITS  # no header, no checksum: entries bear one of their own


class Packing:
    """Packs and unpacks the entries of one chained table, `journal` or `events`."""

    def __init__(self, connection: sqlite3.Connection, table: str) -> None:
        self._db, self._table = connection, table
        self._words: dict[int, bytes] = {0: b""}
        self._begun: tuple[int, zlib._Compress] | None = None

    def begin(self, number: int) -> None:
        """Be ready to pack the entry of this number; raises Refused if the words it is told in are gone or damaged."""
        after = learnt_after(number)
        self._begun = after, zlib.compressobj(LEVEL, wbits=_RAW, zdict=self._told_in(after))

    def pack(self, number: int, data: bytes) -> bytes:
        """Return the entry of this number packed."""
        if self._begun is None or self._begun[0] != learnt_after(number):
            self.begin(number)
        assert self._begun is not None, "nothing to pack with"
        packer = self._begun[1].copy()
        return packer.compress(data) + packer.flush()

    def unpack(self, number: int, data: object) -> bytes:
        """Return the entry of this number; raises Refused if `data` is none, or unpacks without end."""
        unpacker = zlib.decompressobj(_RAW, zdict=self._told_in(learnt_after(number)))
        try:
            entry = unpacker.decompress(data if isinstance(data, bytes) else b"", BYTES_MAX)
        except zlib.error as fault:
            raise self._damaged(f"entry {number}", "packed bytes", str(fault)) from fault
        if not unpacker.eof or unpacker.unused_data:
            raise self._damaged(f"entry {number}", f"one whole entry of at most {BYTES_MAX} bytes", "another length")
        return entry

    def learn(self, number: int, latest: Iterable[bytes]) -> bytes | None:
        """Return the words that entries after this one are told in, packed; None where none are due.

        Args:
            number: of the entry written last.
            latest: the entries up to it, the last first; read only where words are due.
        """
        if learnt_after(number + 1) != number:
            return None
        taken: list[bytes] = []
        left = WORDS_BYTES_MAX
        for entry in islice(latest, LEARNT_FROM):
            taken.append(entry[: min(LEARNT_BYTES_MAX, left)])
            left -= len(taken[-1])
        self._words[number] = b"".join(reversed(taken))  # the nearest last: they cost the least to point at
        return zlib.compress(self._words[number], 9)

    def _told_in(self, after: int) -> bytes:
        words = self._words.get(after)
        if words is None:
            query = "SELECT content FROM words WHERE chained = ? AND after = ?"
            row = self._db.execute(query, (self._table, after)).fetchone()
            words = self._words[after] = self._unpacked_words(after, None if row is None else row[0])
        return words

    def _unpacked_words(self, after: int, data: object) -> bytes:
        unpacker = zlib.decompressobj()
        try:
            words = unpacker.decompress(data if isinstance(data, bytes) else b"", WORDS_BYTES_MAX)
        except zlib.error as fault:
            raise self._damaged(f"words after entry {after}", "them whole", str(fault)) from fault
        if not unpacker.eof:
            raise self._damaged(f"words after entry {after}", "them whole", "none, or a part")
        return words

    def _damaged(self, where: str, expected: str, got: str) -> Refused:
        return Refused("books", where=f"{self._table} {where}", expected=expected, got=got, fix=FIX)


def learnt_after(number: int) -> int:
    """Return after which entry the words were taken that one is told in, 0 if there were none yet."""
    return _AFTER[bisect_left(_AFTER, number) - 1]
