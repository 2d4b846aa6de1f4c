"""Damages the files of a small run block by block and looks whether anybody is told."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from books_drive import Driver, doubles

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.store import Store, store_file
from saflite.contract.errors import FarmError

BLOCK_BYTES = 512
FILES = ("books.sqlite", "books.sqlite-wal", "books.witness", "books.snapshot")


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
    """Return what the journal and the events say."""
    with closing(sqlite3.connect(f"{store_file(run_dir).as_uri()}?mode=ro", uri=True)) as database:
        lines = database.execute("SELECT n, line FROM journal ORDER BY n").fetchall()
        return lines + database.execute("SELECT seq, event FROM events ORDER BY seq").fetchall()


def outcome_of(fault: Fault, run_dir: Path, place: Path, whole: list[tuple[object, ...]]) -> str:
    """Damage a copy of a run at `place`; returns `told`, `harmless`, or `silent`: something is lost and nobody says."""
    copied(run_dir, place)
    inflict(fault, place)
    try:
        if not audit(place, quick=True, blobs=False)["clean"]:
            return "told"
    except FarmError:
        return "told"
    return "harmless" if journal(place) == whole else "silent"
