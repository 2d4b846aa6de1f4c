"""The journal is the one truth: every other table can be made anew from it, row by row what it was."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from books_drive import Driver, doubles

from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.projections import BY_KEY, TABLES
from saflite.campaign.storage.rebuild import rebuild
from saflite.campaign.storage.store import Store, store_file
from saflite.contract.errors import Refused

ALL = (*TABLES, "meta", "journal", "events")


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run interrupted once, with lost leases, minimising and recordings, stopped before its end."""
    run_dir = tmp_path_factory.mktemp("rebuild") / "run"
    store = Store.create(
        run_dir, doubles.campaign(20, shrink=True, shrink_flights_max=10), doubles.TEMPLATE, doubles.TARGET
    )
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=7)
    driver.ask("fly", "gone", 2)
    store.close()
    store = Store.open(run_dir)
    driver = Driver(store.rebuild(), store)
    driver.now += 60.0
    driver.books.tick(driver.now)
    driver.commit()
    driver.run(until_flights=17)
    driver.ask("mutate")
    store.close()
    return run_dir


@pytest.fixture
def run_dir(kept: Path, tmp_path: Path) -> Path:
    """A copy of it; the store and its witness only."""
    (tmp_path / "run").mkdir()
    for file in ("books.sqlite", "books.witness"):
        (tmp_path / "run" / file).write_bytes((kept / file).read_bytes())
    return tmp_path / "run"


def rows(run_dir: Path) -> dict[str, list[tuple[object, ...]]]:
    """Return every row of every table in order, with its place."""
    with closing(sqlite3.connect(store_file(run_dir))) as database:
        return {table: database.execute(_all(table)).fetchall() for table in ALL}


def _all(table: str) -> str:
    by_key = table == "meta" or table in BY_KEY
    return f"SELECT * FROM {table} ORDER BY 1, 2" if by_key else f"SELECT rowid, * FROM {table} ORDER BY rowid"


def change(run_dir: Path, statement: str) -> None:
    with closing(sqlite3.connect(store_file(run_dir))) as database:
        database.execute(statement)
        database.commit()


def test_a_rebuilt_store_is_the_same_row_by_row(run_dir: Path) -> None:
    before = rows(run_dir)
    assert all(before[table] for table in ALL), "the run leaves some table empty"
    assert rebuild(run_dir) == len(before["journal"])
    assert rows(run_dir) == before
    assert {path.name for path in run_dir.iterdir()} == {"books.sqlite", "books.witness", "books.seal", "books.lock"}


@pytest.mark.parametrize("table", [*TABLES, "events"])
@pytest.mark.parametrize("damage", ["DELETE FROM {0}", "UPDATE {0} SET {1} = 'x'", "DROP TABLE {0}"])
def test_whatever_happened_to_a_table_is_told_and_mended(run_dir: Path, table: str, damage: str) -> None:
    before = rows(run_dir)
    column = "at_unix_s" if table == "events" else _last_column(table)
    change(run_dir, damage.format(table, column))
    if "DROP" not in damage and not (table == "events" and "UPDATE" in damage):
        assert any(table.removesuffix("s") in problem for problem in audit(run_dir, quick=True)["problems"])
    rebuild(run_dir)
    assert rows(run_dir) == before


def _last_column(table: str) -> str:
    names = [column.split()[0] for column in TABLES[table] if not column.startswith("PRIMARY KEY")]
    return names[-1]


def test_torn_pages_outside_the_journal_are_mended(run_dir: Path) -> None:
    before = rows(run_dir)
    with closing(sqlite3.connect(store_file(run_dir))) as database:
        (page,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'scores'").fetchone()
        (size,) = database.execute("PRAGMA page_size").fetchone()
    data = bytearray(store_file(run_dir).read_bytes())
    data[(page - 1) * size : page * size] = b"\xff" * size
    store_file(run_dir).write_bytes(bytes(data))
    with pytest.raises(Refused, match="an intact store"):
        Store.open(run_dir)
    rebuild(run_dir)
    assert rows(run_dir) == before
    Store.open(run_dir).close()


def test_a_damaged_journal_is_refused_and_nothing_is_changed(run_dir: Path) -> None:
    change(run_dir, "UPDATE journal SET line = x'00' WHERE n = 20")
    before = store_file(run_dir).read_bytes()
    with pytest.raises(Refused, match="journal entry 20"):
        rebuild(run_dir)
    assert store_file(run_dir).read_bytes() == before
    assert not list(run_dir.glob("*.rebuilt*"))


def test_a_run_in_use_is_not_rebuilt(run_dir: Path) -> None:
    store = Store.open(run_dir)
    with pytest.raises(Refused, match="another process works on"):
        rebuild(run_dir)
    store.close()
    with pytest.raises(Refused, match=r"books\.sqlite"):
        rebuild(run_dir / "nowhere")


def test_a_rebuilt_run_goes_on(kept: Path, tmp_path: Path) -> None:
    import shutil

    shutil.copytree(kept, tmp_path / "run")
    rebuild(tmp_path / "run")
    store = Store.open(tmp_path / "run")
    driver = Driver(store.rebuild(), store)
    driver.run()
    assert driver.books.status(driver.now).flights == 20
    store.close()
    assert audit(tmp_path / "run")["problems"] == []


ON_A_SMALL_DISK = """
import os, shutil, subprocess, sys
from pathlib import Path
from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.rebuild import rebuild
from saflite.contract.errors import Unavailable

kept, disk = Path(sys.argv[1]), Path(sys.argv[2])
size = (kept / "books.sqlite").stat().st_size
for eighths in range(0, 25, 2):
    options = f"mode=0700,size={size + 65536 + size * eighths // 8}"
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "none", disk])
    mounted.returncode and sys.exit(77)
    for file in ("books.sqlite", "books.witness"):
        shutil.copy(kept / file, disk / file)
    try:
        rebuild(disk)
    except Unavailable:
        print("full", end=" ")
    else:
        print("made", end=" ")
    figures = audit(disk, quick=True, blobs=False)
    assert figures["clean"], (eighths, figures)
    subprocess.run(["umount", disk], check=True)
"""


def test_whatever_room_the_disk_has_nothing_is_lost(kept: Path, tmp_path: Path) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    words = ["unshare", "--user", "--map-root-user", "--mount", sys.executable, "-c", ON_A_SMALL_DISK]
    done = subprocess.run([*words, str(kept), str(disk)], capture_output=True, text=True, check=False)
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("no file system of one's own here")
    assert done.returncode == 0, done.stderr
    assert {"full", "made"} == set(done.stdout.split()), "from too little room to enough"
