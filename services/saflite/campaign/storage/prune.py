"""Makes a run smaller: what is to stay is worked out from its tables, what goes is written into its journal.

One recording of each behaviour stays, or the trace where no recording was made; of these only the worst ones where
that is more than asked for.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import NamedTuple

from saflite.campaign.storage.audit import read_books
from saflite.campaign.storage.sqlite import check_free, connect_reading, damage_named
from saflite.campaign.storage.store import Store, store_file
from saflite.campaign.storage.typed_rows import rows
from saflite.campaign.storage.witness import check_loss
from saflite.contract.blobs import BlobRef
from saflite.contract.names import recording_file

_ORDER = (
    "SELECT fingerprint, test_case FROM violations WHERE confirmation <> 'similar' ORDER BY"
    " CASE confirmation WHEN 'confirmed' THEN 0 WHEN 'unconfirmed' THEN 1 ELSE 2 END,"
    " severity <> 'hard', robustness, test_case"
)
_RECORDINGS = "SELECT test_case, flight_index, digest, size_bytes FROM recordings WHERE digest <> ''"
_TRACES = "SELECT test_case, flight_index, trace_blob, trace_bytes FROM flights WHERE trace_blob <> ''"
_ARTEFACTS = "SELECT test_case, flight_index, blob, size_bytes FROM artefacts"

Flight = tuple[str, int]
_Named = tuple[str, int, str, int]  # a blob of a flight, and its size


class Pruned(NamedTuple):
    """What became, or would become, of a run's blobs; sizes in bytes."""

    before_bytes: int
    after_bytes: int
    recordings: int  # that stay
    behaviours: int  # that were found, each once


class _Plan(NamedTuple):
    """The blobs and recordings that go, and what becomes of the run."""

    blobs: frozenset[BlobRef]
    recordings: tuple[Flight, ...]
    pruned: Pruned


class _Left(NamedTuple):
    recordings: dict[Flight, BlobRef]
    others: dict[Flight, set[BlobRef]]  # traces and artefacts

    def of(self, flight: Flight) -> set[BlobRef]:
        """Return all that stays of a flight that is shown: a recording holds its trace."""
        recording = self.recordings.get(flight)
        return self.others.get(flight, set()) | ({recording} if recording is not None else set())


def prune(run_dir: Path, max_bytes: int | None = None, *, dry: bool = False) -> Pruned:
    """Let go of all but one find of each behaviour, and of the least bad of these until `max_bytes` hold the rest.

    Args:
        run_dir: a run nobody works on.
        max_bytes: None for as much as one find of each behaviour takes.
        dry: only say what would be; nothing is written then.

    Raises:
        Refused: there is no run, it is in use, damaged, or of another version, or lost commits.
        Unavailable: the disk does not take the change; nothing is changed then.
    """
    if dry:
        check_free(run_dir)
        check_loss(run_dir)
        return _planned(run_dir, read_books(run_dir).wanted_blobs, max_bytes).pruned
    store = Store.open(run_dir)
    try:
        books = store.rebuild()
        plan = _planned(run_dir, books.wanted_blobs, max_bytes)
        books.prune(plan.blobs, plan.recordings)
        store.commit(books.drain())
        _unname(run_dir, plan.recordings)
        return plan.pruned._replace(after_bytes=_size(books.wanted_blobs))
    finally:
        store.close()


def _planned(run_dir: Path, wanted: frozenset[BlobRef], max_bytes: int | None) -> _Plan:
    with closing(connect_reading(store_file(run_dir))) as db, damage_named(store_file(run_dir)):
        left, shown = _left(db, wanted), list(_shown(db))
    kept, recordings = _stays(left, shown, max_bytes)
    gone = tuple(sorted(flight for flight in left.recordings if flight not in recordings))
    behaviours = len({fingerprint for fingerprint, _ in shown})
    return _Plan(wanted - kept, gone, Pruned(_size(wanted), _size(wanted & kept), len(recordings), behaviours))


def _left(db: sqlite3.Connection, wanted: frozenset[BlobRef]) -> _Left:
    recordings = {
        (name, index): BlobRef(digest=blob, size_bytes=size)
        for name, index, blob, size in rows(db, _Named, _RECORDINGS)
    }
    others: dict[Flight, set[BlobRef]] = {}
    for query in (_TRACES, _ARTEFACTS):
        for name, index, blob, size in rows(db, _Named, query):
            others.setdefault((name, index), set()).add(BlobRef(digest=blob, size_bytes=size))
    return _Left(recordings, {flight: blobs & wanted for flight, blobs in others.items()})


def _shown(db: sqlite3.Connection) -> Iterator[tuple[str, str]]:
    """Yield the finds by fingerprint and test case, the one to keep of each behaviour first, the worst ones first."""
    yield from rows(db, tuple[str, str], _ORDER)


def _stays(left: _Left, shown: list[tuple[str, str]], max_bytes: int | None) -> tuple[frozenset[BlobRef], set[Flight]]:
    kept: set[BlobRef] = set()
    recordings: set[Flight] = set()
    behaviours: set[str] = set()
    flights: dict[str, list[Flight]] = {}
    for flight in sorted({*left.recordings, *left.others}):
        flights.setdefault(flight[0], []).append(flight)
    for fingerprint, name in shown:
        if fingerprint in behaviours:
            continue
        recorded = [flight for flight in flights.get(name, ()) if flight in left.recordings]
        chosen = (recorded or flights.get(name, []))[:1]
        blobs = set().union(*(left.of(flight) for flight in chosen))
        if not blobs or (max_bytes is not None and _size(kept | blobs) > max_bytes):
            continue
        behaviours.add(fingerprint)
        kept |= blobs
        recordings.update(flight for flight in chosen if flight in left.recordings)
    return frozenset(kept), recordings


def _unname(run_dir: Path, flights: tuple[Flight, ...]) -> None:
    for name, index in flights:
        with suppress(OSError):  # a name that stays takes room, no more
            (run_dir / recording_file(name, index)).unlink(missing_ok=True)


def _size(blobs: frozenset[BlobRef] | set[BlobRef]) -> int:
    return sum(blob.size_bytes for blob in blobs)
