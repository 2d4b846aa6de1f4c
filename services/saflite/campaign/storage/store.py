"""The books on disk: one SQLite file (WAL, synchronous FULL), blobs beside it. One batch is one transaction.

Every journal line and event carries a running checksum, so a flipped bit is found when the books are opened.
"""

from __future__ import annotations

import logging
import os
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import IO, TypeVar

from saflite.campaign.engine.outbox import Batch
from saflite.campaign.engine.read_model import EVENTS_MAX, in_one_answer
from saflite.campaign.engine.state import Books
from saflite.campaign.storage import snapshot_file
from saflite.campaign.storage.contents import Contents
from saflite.campaign.storage.new_folder import new_folder
from saflite.campaign.storage.own_folder import place_of
from saflite.campaign.storage.projections import Tables
from saflite.campaign.storage.replaying import FAULTS, replay
from saflite.campaign.storage.seal import break_seal, is_sealed, seal
from saflite.campaign.storage.sqlite import (
    BOOKS,
    chain_at,
    check_file,
    check_version,
    connect,
    connect_reading,
    damage_named,
    entries,
    fold_in,
    lock_run,
    make_one_file,
    make_tables,
    meta,
    no_run,
    run_id_of,
    transaction,
)
from saflite.campaign.storage.typed_rows import rows
from saflite.campaign.storage.witness import Mark, Witness, check_loss, mark_of, start_of
from saflite.contract import wire
from saflite.contract.blobs import BlobRef
from saflite.contract.config import Campaign
from saflite.contract.errors import FarmError, Unavailable
from saflite.contract.names import recording_file
from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import Target, TestCase
from saflite.contract.work import Outcome
from saflite.evidence.files import put_in_place
from saflite.evidence.folder import BlobFolder

__all__ = ["Batch", "Store", "campaign_of", "store_file", "target_of"]

log = logging.getLogger(__name__)

T = TypeVar("T")
CHECKPOINT_COMMITS = 256


def store_file(run_dir: Path) -> Path:
    """Return the SQLite file of a run folder."""
    return run_dir / BOOKS


def campaign_of(run_dir: Path) -> Campaign:
    """Return the campaign of a run that nobody works on and that has lost no commits, without writing to its store.

    Raises:
        Refused: there is none, it is in use, of another version, or lost commits.
    """
    return _read(run_dir, "campaign", Campaign)


def target_of(run_dir: Path) -> Target:
    """Return what a run flies, and on which build (empty for any); as `campaign_of`."""
    return _read(run_dir, "template", TestCase).target


def _read(run_dir: Path, key: str, kind: type[T]) -> T:
    path = store_file(run_dir)
    connect_reading(path).close()  # before a lock is left in a folder without a run
    with lock_run(run_dir):
        check_loss(run_dir)
        with closing(connect_reading(path)) as connection, damage_named(path):
            return wire.decode(meta(connection, key), kind)


class Store:
    """The store of one run, open for writing by one process at a time. Also the read model the books read from."""

    def __init__(self, run_dir: Path, connection: sqlite3.Connection, lock: IO[bytes], *, whole: bool) -> None:
        self._run_dir, self._path, self._db, self._lock = run_dir, store_file(run_dir), connection, lock
        self._place = place_of(run_dir)
        self._whole = whole  # tables included; they bear no checksums, so only then is the store sealed at the end
        self.blobs = BlobFolder(run_dir)
        self.campaign = self._decoded("campaign", Campaign)
        self.template = self._decoded("template", TestCase)
        self.target = self._decoded("target", TargetInfo)
        self.run_id = run_id_of(connection)
        self._tables = Tables(connection)
        self._contents = Contents(connection)
        self._commits = mark_of(connection).commits
        self._start = start_of(connection)
        self._witness = Witness(run_dir, self._start, self._mark())
        self._unwitnessed = False
        self._kept_line = 0  # the last journal entry in the snapshot
        snapshot_file.code()  # that of this process, not what stands on disk when it ends

    # ---- making and opening --------------------------------------------------------------------------------------

    @classmethod
    def create(cls, run_dir: Path, campaign: Campaign, template: TestCase, target: TargetInfo) -> Store:
        """Make the store of a new run in `run_dir`; `target` is what the target says of itself now.

        Raises:
            Refused: a run stands there already, or test case or target hold what no message may.
            Unavailable: the disk cannot be written.
        """
        template, target = wire.checked(template, TestCase), wire.checked(target, TargetInfo)
        try:
            with new_folder(run_dir) as lock:
                connection = connect(store_file(run_dir))
                try:
                    make_tables(connection, campaign, template, target)
                    return cls(run_dir, connection, lock, whole=True)
                except BaseException:
                    connection.close()
                    raise
        except (OSError, sqlite3.OperationalError) as fault:
            raise Unavailable(f"no store can be made in {run_dir}: {fault}") from fault

    @classmethod
    def open(cls, run_dir: Path) -> Store:
        """Open the store of an earlier run to go on with it.

        One that is not as it was closed (it was killed) has its structure checked; what the books are rebuilt from is
        checked by `rebuild`, other entries of the journal when they are read, tables by an audit only.

        Raises:
            Refused: there is none, it is in use, damaged, of another version, or lost commits; the text says what
                to do.
        """
        path = store_file(run_dir)
        if not path.is_file():
            raise no_run(run_dir)
        lock = lock_run(run_dir)
        try:
            check_loss(run_dir)  # before anything is opened for writing: that gives up what SQLite does not take
            with damage_named(path):
                whole = is_sealed(run_dir)
                connection = connect(path)
                (check_version if whole else check_file)(connection, path)
                store = cls(run_dir, connection, lock, whole=whole)
                break_seal(run_dir)
        except FarmError:
            lock.close()
            raise
        return store

    def close(self) -> None:
        """Close the store and let others open it; leaves one SQLite file, its witness and, if it is whole, a seal.

        One whose folder was moved is left as if its process had been killed.
        """
        moved = self._was_moved()
        if not moved:
            self._checkpoint()
        self._db.close()  # SQLite itself leaves alone what stands in the place of a file that was moved
        if not moved:
            make_one_file(self._path)
            if self._whole:
                seal(self._run_dir)
        self._witness.close()
        self._lock.close()

    # ---- writing -------------------------------------------------------------------------------------------------

    def commit(self, batch: Batch) -> None:
        """Make a batch durable: blobs that are kept first, then everything else in one transaction, then its witness.

        Raises:
            Unavailable: the disk is full or fails, or another folder stands where the run was; nothing of the batch
                counts, and the same batch has to be committed again later, before any other. Nothing may be answered
                before.
        """
        if not batch:
            return
        if self._was_moved():
            raise Unavailable(
                f"{self._run_dir} was moved or replaced: put the folder back, or stop and resume it there"
            )
        self.blobs.flush(batch.flushed)
        if not self._unwitnessed:
            self._write(batch)
        assert not batch.lines or batch.first_line + len(batch.lines) == self._tables.tails.lines, "another batch"
        self._witness.append(self._mark())
        self._unwitnessed = False
        self._publish(batch.published)
        self.blobs.drop(batch.dropped)
        if self._commits % CHECKPOINT_COMMITS == 0:
            self._checkpoint()

    def room_bytes(self) -> int | None:
        """Return how much the disk takes yet, 0 where it takes no more files; None where that is not known."""
        try:
            disk = os.statvfs(self._run_dir)
        except OSError:
            return None
        no_files = disk.f_files > 0 and disk.f_favail == 0  # some file systems do not count them
        return 0 if no_files else disk.f_bavail * disk.f_frsize

    def _was_moved(self) -> bool:
        """Whether another folder, or none, stands at our path: by it we would write into somebody else's."""
        return place_of(self._run_dir) != self._place

    def _write(self, batch: Batch) -> None:
        commits = self._commits + 1
        try:
            with transaction(self._db):
                tails = self._tables.add(batch)
                self._db.execute("UPDATE meta SET value = ? WHERE key = 'commits'", (str(commits).encode(),))
        except sqlite3.OperationalError as fault:
            raise Unavailable(f"{self._path} takes no writes: {fault}") from fault
        self._tables.tails, self._commits, self._unwitnessed = tails, commits, True

    def _mark(self) -> Mark:
        return Mark(self._commits, *self._tables.tails)

    def _checkpoint(self) -> None:
        """Fold the write-ahead log in and shorten the witness; what fails now is done the next time."""
        try:
            fold_in(self._db)
            if not self._unwitnessed:
                self._witness.restart(self._mark())
        except (sqlite3.Error, Unavailable) as fault:
            log.warning("%s is not folded in: %s", self._path, fault)

    @property
    def lines_behind(self) -> int:
        """How many journal entries came behind the snapshot."""
        return self._tables.tails.lines - self._kept_line

    @property
    def snapshot_due(self) -> bool:
        """Whether there is enough new in the journal to keep the state of the books again."""
        return self.lines_behind >= snapshot_file.LINES_MAX

    def keep(self, state: bytes) -> None:
        """Keep the state of the books, as it is after the last commit, for who opens the run next."""
        tails = self._tables.tails
        if tails.lines > self._kept_line and not self._unwitnessed and not self._was_moved():
            snapshot_file.keep(self._run_dir, self._start, tails.lines, tails.chain, state)
            self._kept_line = tails.lines

    def _publish(self, files: Iterable[tuple[str, str]]) -> None:
        """Let blobs stand under names for people; what fails now is done when the run is opened again."""
        for file, digest in files:
            try:
                put_in_place(self.blobs.path(digest), self._run_dir / file)
            except Unavailable as fault:
                log.warning("%s", fault)

    # ---- reading -------------------------------------------------------------------------------------------------

    def rebuild(self) -> Books:
        """Return the books as last committed, rebuilt from the journal; `Books.begin` then opens them.

        What is in the snapshot, if there is one that fits, is neither replayed nor read: the first entry behind it
        has to go on from the running checksum the snapshot was made at, and the last be the one that was witnessed.

        Raises:
            Refused: a line of the journal that is read is damaged, or cannot be replayed.
        """
        books, self._kept_line, chain = self._books_so_far()
        for number, line in enumerate(self.journal(self._kept_line, chain), self._kept_line + 1):
            replay(books, line, number, self._path)
        self.blobs.keep_only(frozenset(blob.digest for blob in books.wanted_blobs))
        self._publish(self._unpublished())
        return books

    def _books_so_far(self) -> tuple[Books, int, int]:
        """Return the books of the snapshot, how many journal entries are in it, and the checksum of the last.

        Without a snapshot: empty ones, 0, 0.
        """
        kept = snapshot_file.kept(self._run_dir, self._start, self._db, ours=True)
        if kept is not None:
            books = self._empty_books()
            try:
                books.restore(kept.state)
            except FAULTS as fault:
                log.warning("the snapshot is not used: %s", fault)
            else:
                return books, kept.line, kept.chain
        return self._empty_books(), 0, 0

    def _empty_books(self) -> Books:
        return Books(self.campaign, self.template, self.target, run_id=self.run_id, read_model=self)

    def _unpublished(self) -> list[tuple[str, str]]:
        """Return the recordings that have no name for people yet, by name and digest."""
        try:
            there = {f"recordings/{path.name}" for path in (self._run_dir / "recordings").iterdir()}
        except OSError:
            there = set()
        query = "SELECT test_case, flight_index, digest FROM recordings WHERE digest <> ''"
        found = rows(self._db, tuple[str, int, str], query)
        named = ((recording_file(test_case, index), digest) for test_case, index, digest in found)
        return [(file, digest) for file, digest in named if file not in there]

    def journal(self, after: int = 0, chain: int = 0) -> Iterator[bytes]:
        """Yield the journal lines after one with the running checksum `chain`; raises Refused at a damaged one."""
        with damage_named(self._path):
            yield from entries(self._db, "journal", self._path, after=after, chain=chain)

    def blob_fault(self, blob: BlobRef, *, deep: bool = False) -> str:
        """See `ReadModel.blob_fault`."""
        return self.blobs.fault(blob, deep=deep)

    def outcomes(self, after_round: int, upto_round: int, limit: int) -> tuple[Outcome, ...]:
        """Return the outcomes of whole rounds in (after, upto], in order, up to about `limit` of them."""
        found: list[Outcome] = []
        for outcome in self._contents.outcomes(after_round, upto_round):
            if len(found) >= limit and outcome.round != found[-1].round:
                break
            found.append(outcome)
        return tuple(found)

    def events(self, from_seq: int) -> tuple[bytes, ...]:
        """See `ReadModel.events`; raises Refused if one of them is damaged."""
        before = from_seq - 1
        chain = chain_at(self._db, "events", before)
        return in_one_answer(entries(self._db, "events", self._path, after=before, chain=chain, limit=EVENTS_MAX))

    def _meta(self, key: str) -> bytes:
        return meta(self._db, key)

    def _decoded(self, key: str, kind: type[T]) -> T:
        return wire.decode(self._meta(key), kind)
