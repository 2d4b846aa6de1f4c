"""A store that others made or edited holds words where numbers belong: told in one line, wherever it is read."""

from __future__ import annotations

import shutil
import sqlite3
import sys
from collections.abc import Iterator
from contextlib import closing
from itertools import product
from pathlib import Path

import pytest
from _pytest.mark.structures import ParameterSet

from saflite.campaign.storage.projections import TABLES
from saflite.campaign.storage.prune import prune
from saflite.campaign.storage.seal import digest_of, seal
from saflite.campaign.storage.store import Store
from saflite.campaign.storage.witness import mark_of
from saflite.console.cli import main
from saflite.console.run_data.run_folder import RunFolder, open_run
from saflite.console.view.dashboard.source import _PARTS, RunSource
from saflite.contract.errors import FarmError

sys.path.insert(0, str(Path(__file__).parents[1] / "campaign"))

from books_drive import Driver, doubles

COLUMNS = [
    *((table, column.split()[0]) for table, columns in TABLES.items() for column in columns if column[:7] != "PRIMARY"),
    *(("journal", column) for column in ("chain", "line")),
    *(("events", column) for column in ("kind", "at_unix_s", "chain", "event")),
    *(("words", column) for column in ("chained", "after", "content")),
    ("meta", "value"),
]
WRONG = ("words", b"\xff\0", None)
REFUSED = 2


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run_dir = tmp_path_factory.mktemp("whole") / "run"
    store = Store.create(run_dir, doubles.campaign(8), doubles.TEMPLATE, doubles.TARGET)
    Driver(store.rebuild(), store).run()
    store.close()
    return run_dir


@pytest.fixture
def run_dir(whole: Path, tmp_path: Path) -> Path:
    shutil.copytree(whole, tmp_path / "run")
    (tmp_path / "run").chmod(0o700)
    return tmp_path / "run"


def edited(run_dir: Path, table: str, column: str, value: object) -> None:
    """Put a value into a column of all rows, and seal the run as if it had been closed so."""
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as database:
        database.execute(f"UPDATE OR IGNORE {table} SET {column} = ?", (value,))
        database.commit()
    seal(run_dir, digest_of(run_dir))


def read(run: RunFolder) -> Iterator[object]:
    """Yield all that can be read of a run."""
    yield from (run.standing(), run.standings(), run.smallest_forms(), run.endings(), run.coverage(), run.budget())
    yield from (run.scores(), run.fallbacks(), run.usage(), run.last_change(), run.elapsed_s(), run.memory_faults())
    yield from (run.flown(), run.artefacts(), run.first_event(), run.last_events(9))
    for reading in (run.outcomes, run.events, run.findings, run.summary):
        try:
            yield list(reading())
        except FarmError:
            continue
    for row in run.flights():
        yield from (run.flight(row), run.trace(row.trace_digest), run.good_before(row.test_case))


def damaged() -> Iterator[ParameterSet]:
    """Yield each column with each wrong value: one value each time, by turns, the others with the live tests."""
    for (place, (table, column)), (kind, value) in product(enumerate(COLUMNS), enumerate(WRONG)):
        marks = () if place % len(WRONG) == kind else pytest.mark.live
        yield pytest.param(table, column, value, marks=marks, id=f"{table}.{column}-{value!r}")


@pytest.mark.parametrize(("table", "column", "value"), list(damaged()))
def test_whatever_stands_in_a_column_is_read_or_refused(table: str, column: str, value: object, run_dir: Path) -> None:
    try:
        edited(run_dir, table, column, value)
    except sqlite3.IntegrityError:  # a key that has to be there
        return
    for what in range(3 + len(_PARTS)):
        try:
            if what == 0:
                with open_run(run_dir) as run:
                    list(read(run))
            elif what == 1:
                prune(run_dir, dry=True)
            elif what == 2:
                with closing(sqlite3.connect(run_dir / "books.sqlite")) as database:
                    mark_of(database)
            else:
                RunSource(run_dir).part([*_PARTS][what - 3])
        except FarmError:
            continue


@pytest.mark.parametrize(
    ("table", "column"),
    [
        ("flights", "simulated_s"),
        ("flights", "flight_index"),
        ("judgements", "robustness"),
        ("judgements", "line"),
        ("scores", "value"),
        ("sittings", "opened_unix_s"),
        ("usage", "cost_usd"),
        ("violations", "event"),
    ],
)
def test_a_word_where_a_number_belongs_is_told_in_one_line(
    table: str, column: str, run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edited(run_dir, table, column, "words")
    assert main(["report", str(run_dir)]) == REFUSED
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for part in (
        str(run_dir / "books.sqlite"),
        table,
        "saflite writes",
        "got Expected",
        "`str`",
        "audit RUN --rebuild",
    ):
        assert part in said, said
