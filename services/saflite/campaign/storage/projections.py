"""Tables of the store. `journal` is the truth; the others are made of it, for people, queries and reports.

What the journal holds in full (a flight, a judgement, a proposed test case) is not told twice: its row names the
journal `line` it stands in, and `contents.py` reads it there. So it is with a violation and the event that tells of it.
"""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterator, Sequence
from typing import Annotated, NamedTuple

import msgspec

from saflite.campaign.engine.outbox import Batch, Value
from saflite.campaign.storage.packing import Packing
from saflite.campaign.storage.typed_rows import rows
from saflite.contract import wire
from saflite.contract.errors import Refused
from saflite.contract.events import kind_of

FORMAT = 15
"""Version of the store; a store of another version is refused."""

TABLES: dict[str, tuple[str, ...]] = {
    "test_cases": (
        "test_case TEXT",
        "round INTEGER",
        "place INTEGER",  # among those proposed for the round; -1 for the smallest form of a violation
        "strategy TEXT",
        "parent TEXT",
        "line INTEGER",  # of its proposal; NULL where it was made here, then `content` holds it
        "content BLOB",
        "PRIMARY KEY (test_case, round, place)",
    ),
    "scores": (
        "test_case TEXT",
        "round INTEGER",
        "model TEXT",
        "scored_by TEXT",
        "value REAL",
        "shadow INTEGER",
        "fault TEXT",
        "reason TEXT",
        "model_digest TEXT",
        "prompt_digest TEXT",
        "PRIMARY KEY (test_case, round, model, shadow)",
    ),
    "usage": (
        "round INTEGER",
        "batch INTEGER",
        "model TEXT",
        "tokens_in INTEGER",
        "tokens_out INTEGER",
        "latency_s REAL",
        "cost_usd REAL",
        "calls INTEGER",
        "asked_again INTEGER",
        "cached INTEGER",
        "faults INTEGER",
        "PRIMARY KEY (round, batch, model)",
    ),
    "selected": (
        "test_case TEXT PRIMARY KEY",
        "round INTEGER",
        "rank INTEGER",
        "selected_by TEXT",
        "score REAL",
        "novelty REAL",
    ),
    "flights": (
        "test_case TEXT",
        "purpose TEXT",
        "flight_index INTEGER",
        "ending TEXT",
        "simulated_s REAL",
        "wall_s REAL",
        "trace_digest TEXT",  # of the trace's content
        "trace_blob TEXT",
        "trace_bytes INTEGER",
        "worker TEXT",
        "message TEXT",
        "build TEXT",
        "line INTEGER",  # of its record; NULL where no worker handed one in
        "PRIMARY KEY (test_case, purpose, flight_index)",
    ),
    "artefacts": (
        "test_case TEXT",
        "purpose TEXT",
        "flight_index INTEGER",
        "name TEXT",
        "blob TEXT",
        "size_bytes INTEGER",
        "PRIMARY KEY (test_case, purpose, flight_index, name)",
    ),
    "judgements": (
        "test_case TEXT",
        "flight_index INTEGER",
        "robustness REAL",
        "violated TEXT",
        "line INTEGER",
        "PRIMARY KEY (test_case, flight_index)",
    ),
    "violations": (
        "fingerprint TEXT",
        "test_case TEXT",
        "policy TEXT",
        "confirmation TEXT",
        "robustness REAL",
        "severity TEXT",
        "event INTEGER",  # the one that tells of it in full
        "PRIMARY KEY (test_case, policy)",
    ),
    "endings": ("test_case TEXT PRIMARY KEY", "state TEXT", "ending TEXT", "flights INTEGER"),
    "outcomes": (
        "round INTEGER",
        "rank INTEGER",
        "test_case TEXT",
        "ending TEXT",
        "flight_index INTEGER",  # of the flight whose verdicts count
        "behaviours TEXT",
        "founded INTEGER",  # how many of them it was the first to show
        "PRIMARY KEY (round, rank)",
    ),
    "recordings": (
        "test_case TEXT",
        "flight_index INTEGER",
        "digest TEXT",
        "size_bytes INTEGER",
        "PRIMARY KEY (test_case, flight_index)",
    ),
    "sittings": (  # from an opening of the books to the next
        "incarnation INTEGER PRIMARY KEY",
        "opened_unix_s REAL",
        "elapsed_before_s REAL",  # how long the books had been open before
    ),
    "attempts": (
        "work TEXT",
        "epoch INTEGER",
        "stage TEXT",
        "worker TEXT",
        "from_unix_s REAL",
        "to_unix_s REAL",
        "how TEXT",
        "message TEXT",
        "PRIMARY KEY (work, epoch)",
    ),
}

BY_KEY = ("usage", "selected", "judgements", "endings", "outcomes", "recordings", "attempts")
"""Tables that stand in order of their keys, so that keys stand once; the others are read in the order of writing."""

CHAINED: dict[str, tuple[str, str]] = {"journal": ("n", "line"), "events": ("seq", "event")}
"""The tables whose entries are numbered without gap and bear a running checksum: the columns of number and content."""

CREATE = (
    "CREATE TABLE meta (key TEXT PRIMARY KEY, value BLOB) WITHOUT ROWID",
    "CREATE TABLE journal (n INTEGER PRIMARY KEY, chain INTEGER NOT NULL, line BLOB NOT NULL)",
    "CREATE TABLE words (chained TEXT, after INTEGER, content BLOB, PRIMARY KEY (chained, after)) WITHOUT ROWID",
    "CREATE TABLE events (seq INTEGER PRIMARY KEY, kind TEXT, at_unix_s REAL, chain INTEGER NOT NULL, event BLOB)",
    *(
        f"CREATE TABLE {table} ({', '.join(columns)}){' WITHOUT ROWID' if table in BY_KEY else ''}"
        for table, columns in TABLES.items()
    ),
)


def _columns(table: str) -> int:
    return sum(1 for column in TABLES[table] if not column.startswith("PRIMARY KEY"))


def _key_places(table: str) -> tuple[int, ...]:
    names = [column.split()[0] for column in TABLES[table] if not column.startswith("PRIMARY KEY")]
    compound = next((column for column in TABLES[table] if column.startswith("PRIMARY KEY")), "")
    if not compound:
        return (0,)
    return tuple(names.index(name.strip()) for name in compound[compound.index("(") + 1 : -1].split(","))


KEYS: dict[str, tuple[int, ...]] = {table: _key_places(table) for table in TABLES}
"""Which values of a row name it."""

INSERT: dict[str, str] = {
    table: f"INSERT OR REPLACE INTO {table} VALUES ({', '.join('?' * _columns(table))})"  # noqa: S608 (our own names)
    for table in TABLES
}


class Tails(NamedTuple):
    """Where the two chained tables end: how many entries they hold, and the running checksum of each."""

    lines: int = 0
    chain: int = 0
    events: int = 0
    event_chain: int = 0


class Tables:
    """Writes batches into the tables of a store; inside a transaction of whoever calls."""

    def __init__(self, connection: sqlite3.Connection) -> None:
        self._db = connection
        self._packings = {table: Packing(connection, table) for table in CHAINED}
        self.tails = Tails(*tail(connection, "journal"), *tail(connection, "events"))
        for table, last in (("journal", self.tails.lines), ("events", self.tails.events)):
            self._packings[table].begin(last + 1)

    def add(self, batch: Batch) -> Tails:
        """Write a batch; returns where the tables end then, to be set as `tails` once it is committed."""
        assert batch.first_line == self.tails.lines or not batch.lines, "a batch was left out or committed twice"
        assert not batch.events or batch.events[0].seq == self.tails.events + 1, "events were left out or told twice"
        rows: dict[str, list[tuple[Value, ...]]] = {}
        for row in batch.rows:
            rows.setdefault(row.table, []).append(row.values)
        lines = self._chained("journal", self.tails.lines, self.tails.chain, batch.lines)
        self._db.executemany("INSERT INTO journal VALUES (?, ?, ?)", lines)
        facts = self._chained("events", self.tails.events, self.tails.event_chain, [*map(wire.encode, batch.events)])
        events = [
            (seq, kind_of(event.fact), event.at_unix_s, chain, packed)
            for event, (seq, chain, packed) in zip(batch.events, facts, strict=True)
        ]
        self._db.executemany("INSERT INTO events VALUES (?, ?, ?, ?, ?)", events)
        for table, values in rows.items():
            self._db.executemany(INSERT[table], values)
        tails = self.tails
        if lines:
            tails = tails._replace(lines=lines[-1][0], chain=lines[-1][1])
        return tails._replace(events=facts[-1][0], event_chain=facts[-1][1]) if facts else tails

    def _chained(self, table: str, last: int, chain: int, entries: Sequence[bytes]) -> list[tuple[int, int, bytes]]:
        """Return number, running checksum and packed content of entries that come after the `last` one."""
        packing, chained = self._packings[table], []
        for number, entry in enumerate(entries, last + 1):
            chain = zlib.crc32(entry, chain)
            chained.append((number, chain, packing.pack(number, entry)))
            words = packing.learn(number, self._latest(table, last, entries[: number - last]))
            if words is not None:
                self._db.execute("INSERT INTO words VALUES (?, ?, ?)", (table, number, words))
        return chained

    def _latest(self, table: str, last: int, new: Sequence[bytes]) -> Iterator[bytes]:
        """Yield the entries of a table, the last first: the `new` ones, and those up to the `last` one stored."""
        yield from reversed(new)
        key, content = CHAINED[table]
        query = f"SELECT {key}, {content} FROM {table} WHERE {key} <= ? ORDER BY {key} DESC"  # noqa: S608
        for number, packed in self._db.execute(query, (last,)):
            try:
                yield self._packings[table].unpack(number, packed)
            except Refused:  # told whenever it is read; what comes now does not need it
                return


_Number = Annotated[int, msgspec.Meta(ge=0)]
_Checksum = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]


def tail(connection: sqlite3.Connection, table: str) -> tuple[int, int]:
    """Return number and running checksum of the last entry of a chained table; raises Refused where these are none."""
    key = CHAINED[table][0]
    query = f"SELECT {key}, chain FROM {table} ORDER BY {key} DESC LIMIT 1"  # noqa: S608 (our own names)
    return next(iter(rows(connection, tuple[_Number, _Checksum], query)), (0, 0))
