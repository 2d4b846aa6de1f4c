"""Damages the files of a small run block by block and looks whether anybody is told."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from books_drive import Driver, doubles

from saflite.campaign.storage.audit import audit, resume_faults, told_of
from saflite.campaign.storage.packing import Packing
from saflite.campaign.storage.projections import CHAINED, TABLES
from saflite.campaign.storage.store import Store, store_file
from saflite.contract.errors import FarmError

BLOCK_BYTES = 512
FILES = ("books.sqlite", "books.sqlite-wal", "books.witness", "books.snapshot", "books.seal")


class Fault(NamedTuple):
    """One block of one file with a flipped byte in it, or cut off with all behind it."""

    file: str
    place: int
    cut: bool


def small_run(run_dir: Path, *, killed: bool = False, flights: int = 5) -> Path:
    """Make a run that ended; if `killed`, a copy of one whose books were never closed. Returns its folder."""
    own = run_dir.with_name(run_dir.name + "-running") if killed else run_dir
    store = Store.create(own, doubles.campaign(flights, record="none"), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run()
    store.keep(driver.books.snapshot())
    if killed:
        copied(own, run_dir)
    store.close()
    return run_dir


def copied(run_dir: Path, place: Path) -> None:
    """Copy what a run keeps its books in."""
    place.mkdir(exist_ok=True)
    for file in FILES:
        (place / file).unlink(missing_ok=True)
        if (run_dir / file).exists():
            shutil.copyfile(run_dir / file, place / file)
    (place / "books.sqlite-shm").unlink(missing_ok=True)


def faults(run_dir: Path) -> Iterator[Fault]:
    """Yield every fault there is: each block of each file flipped, and cut."""
    for file in FILES:
        size = (run_dir / file).stat().st_size if (run_dir / file).exists() else 0
        for place in range(0, size, BLOCK_BYTES):
            yield Fault(file, place, cut=False)
            yield Fault(file, place, cut=True)


def inflict(fault: Fault, run_dir: Path) -> None:
    """Damage a file; the flipped byte is another one in every block."""
    path = run_dir / fault.file
    data = bytearray(path.read_bytes())
    if fault.cut:
        path.write_bytes(data[: fault.place])
        return
    place = fault.place + fault.place // BLOCK_BYTES * 37 % min(BLOCK_BYTES, len(data) - fault.place)
    data[place] ^= 0x10
    path.write_bytes(data)


def journal(run_dir: Path) -> list[tuple[object, ...]]:
    """Return what the journal and the events say, unpacked: bits behind the end of packed bytes say nothing."""
    with closing(sqlite3.connect(f"{store_file(run_dir).as_uri()}?mode=ro", uri=True)) as database:
        said: list[tuple[object, ...]] = []
        for table, (key, content) in CHAINED.items():
            packing = Packing(database, table)
            rows = database.execute(f"SELECT {key}, {content} FROM {table} ORDER BY {key}")
            said += [(table, number, packing.unpack(number, packed)) for number, packed in rows]
        return said


def tables(run_dir: Path) -> list[tuple[object, ...]]:
    """Return what all tables say, the ones made of the journal among them: what a report or an export reads."""
    with closing(sqlite3.connect(f"{store_file(run_dir).as_uri()}?mode=ro", uri=True)) as database:
        return [row for table in TABLES for row in database.execute(f"SELECT * FROM {table} ORDER BY 1, 2, 3")]


def state(run_dir: Path) -> bytes:
    """Return the books as `resume` opens them."""
    store = Store.open(run_dir)
    try:
        return store.rebuild().snapshot()
    finally:
        store.close()


class Whole(NamedTuple):
    """What an undamaged run says: to an audit, to report and replay, to resume."""

    journal: list[tuple[object, ...]]
    tables: list[tuple[object, ...]]
    state: bytes


def whole_of(run_dir: Path, place: Path) -> Whole:
    """Return what a run says, read from a copy."""
    copied(run_dir, place)
    return Whole(journal(place), tables(place), state(place))


def outcome_of(fault: Fault, run_dir: Path, place: Path, whole: Whole) -> str:
    """Damage a copy of a run at `place`; returns `told`, `harmless`, or `silent`: something is lost and nobody says.

    Each way to read a run has to say so by itself: an audit, what report, replay and export ask first, and resume;
    what resume does not look at has to be told still after it went on.
    """
    ways: tuple[tuple[Callable[[Path], bool], Callable[[Path], bool]], ...] = (
        (lambda run: not audit(run, quick=True, blobs=False)["clean"], lambda run: journal(run) == whole.journal),
        (lambda run: bool(told_of(run)), lambda run: tables(run) == whole.tables),
        (lambda run: bool(resume_faults(run)), lambda run: state(run) == whole.state),
        (lambda run: bool(told_of(run)), lambda run: (tables(run), journal(run)) == (whole.tables, whole.journal)),
    )
    copied(run_dir, place)
    inflict(fault, place)
    found = {_way(place, told, same) for told, same in ways}
    return next(one for one in ("silent", "told", "harmless") if one in found)


def _way(run_dir: Path, told: Callable[[Path], bool], same: Callable[[Path], bool]) -> str:
    try:
        if told(run_dir):
            return "told"
        return "harmless" if same(run_dir) else "silent"
    except FarmError:
        return "told"
