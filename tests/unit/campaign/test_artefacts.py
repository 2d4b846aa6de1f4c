"""Files that flights left are listed, and written where they are asked for."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from books_drive import Driver, doubles

from saflite.campaign.storage.store import Store
from saflite.console.cli import main
from saflite.console.run_data.run_folder import open_run
from saflite.contract.errors import Refused


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """A run of which every third flight left a log."""
    store = Store.create(tmp_path / "run", doubles.campaign(15), doubles.TEMPLATE, doubles.TARGET)
    Driver(store.rebuild(), store).run()
    store.close()
    return tmp_path / "run"


def test_the_files_of_a_flight_are_listed_and_written(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["artefacts", str(run_dir), "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed, "no flight that was kept left a log"
    assert {one["name"] for one in listed} == {"log.txt"}
    test_case = listed[0]["flight"].split("-")[0]
    assert main(["artefacts", str(run_dir), "--test-case", test_case[:6], "--out", str(run_dir / "files")]) == 0
    assert "log.txt" in capsys.readouterr().out
    assert (run_dir / "files" / listed[0]["flight"] / "log.txt").read_text() == test_case


def test_a_test_case_that_was_never_flown_is_refused(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["artefacts", str(run_dir), "--test-case", "zzz"]) == 2
    assert "expected one flown in this run, got 'zzz'" in capsys.readouterr().err
    with open_run(run_dir) as folder:
        left = {row.test_case for row in folder.artefacts()}
        bare = next(row.test_case for row in folder.flights() if row.test_case not in left)
    assert main(["artefacts", str(run_dir), "--test-case", bare]) == 0
    assert "0 files" in capsys.readouterr().out


def test_a_folder_that_cannot_be_written_is_said(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run_dir / "files").write_text("in the way")
    assert main(["artefacts", str(run_dir), "--out", str(run_dir / "files")]) == 2
    assert "a file or link" in capsys.readouterr().err


FORGED = {
    "name": "../../x",
    "test_case": "../../../x",
    "purpose": "/../../../x",
    "flight_index": "/../../../x",
}


@pytest.mark.parametrize("column", FORGED)
def test_names_of_a_run_that_others_made_lead_nowhere_else(
    column: str, run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["artefacts", str(run_dir), "--json"]) == 0
    case, purpose, _ = json.loads(capsys.readouterr().out)[-1]["flight"].split("-")
    kept = f"WHERE test_case = '{case}' AND purpose = '{purpose}'"
    _alter(run_dir, f"UPDATE artefacts SET {column} = '{FORGED[column]}' {kept}")
    before = sorted(tmp_path.rglob("*"))
    assert main(["artefacts", str(run_dir), "--out", str(tmp_path / "deep" / "out")]) == 2
    refused = capsys.readouterr().err.splitlines()[-1]
    assert "artefact" in refused
    assert str(run_dir) in refused
    assert sorted(tmp_path.rglob("*")) == before
    any_text = column in ("name", "test_case")
    assert main(["artefacts", str(run_dir)]) == (0 if any_text else 2), "what is only listed is escaped"


@pytest.mark.parametrize("digest", ["../../../secret", "0" * 63, 7])
def test_a_recording_of_a_run_that_others_made_is_no_file_of_ours(
    digest: object, run_dir: Path, tmp_path: Path
) -> None:
    (tmp_path / "secret").write_text("ours")
    (recording, *_) = sorted((run_dir / "recordings").iterdir())
    recording.unlink()
    test_case = recording.name.partition("-")[0]
    _alter(run_dir, f"UPDATE recordings SET digest = '{digest}' WHERE test_case = '{test_case}'")
    with closing(Store.open(run_dir)) as store, pytest.raises(Refused, match="a digest of 64"):
        store.rebuild()
    assert not recording.exists()


@pytest.mark.parametrize("table", ["test_cases", "judgements", "flights"])
def test_a_row_that_names_an_entry_of_another_kind_is_damage(table: str, run_dir: Path) -> None:
    other = "judgements" if table == "test_cases" else "test_cases"
    _alter(run_dir, f"UPDATE {table} SET line = (SELECT max(line) FROM {other})")
    with open_run(run_dir) as run:
        row = next(row for row in run.flights() if row.purpose == "search" and row.ending != "lost")
        read: dict[str, Callable[[], object]] = {
            "test_cases": lambda: run.test_case(row.test_case),
            "judgements": lambda: run.judgement(row.test_case),
            "flights": lambda: run.flight(row),
        }
        with pytest.raises(Refused, match="tables are damaged"):
            read[table]()


def _alter(run_dir: Path, statement: str) -> None:
    with closing(sqlite3.connect(run_dir / "books.sqlite")) as store, store:
        store.execute(statement)
