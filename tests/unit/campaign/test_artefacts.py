"""Files that flights left are listed, and written where they are asked for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from books_drive import Driver, doubles

from saflite.campaign.storage.store import Store
from saflite.console.cli import main


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


def test_a_folder_that_cannot_be_written_is_said(run_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (run_dir / "files").write_text("in the way")
    assert main(["artefacts", str(run_dir), "--out", str(run_dir / "files")]) == 2
    assert "a file or link" in capsys.readouterr().err
