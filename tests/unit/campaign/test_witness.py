"""Lost commits are told: by the audit, by opening, before anything is reported."""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
from pathlib import Path

import pytest
from books_corruption import copied, faults, journal, outcome_of, small_run, whole_of
from books_drive import Driver, doubles

from saflite.campaign.storage.audit import audit, told_of
from saflite.campaign.storage.store import Store
from saflite.campaign.storage.witness import RECORD_BYTES, accept_loss
from saflite.console.cli import main
from saflite.contract.errors import Refused, Unavailable

SAMPLE = 30


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_run(tmp_path_factory.mktemp("ended") / "run")


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_run(tmp_path_factory.mktemp("killed") / "run", killed=True)


FINISHED = ["books.lock", "books.seal", "books.snapshot", "books.sqlite", "books.witness"]
"""No log beside the store. The snapshot is a cache: without it the journal is read."""


def test_a_finished_run_is_one_file_and_a_witness_of_one_record(ended: Path) -> None:
    assert sorted(path.name for path in ended.glob("books.*")) == FINISHED
    assert (ended / "books.witness").stat().st_size == RECORD_BYTES
    assert audit(ended)["problems"] == []
    assert sorted(path.name for path in ended.glob("books.*")) == FINISHED


@pytest.mark.parametrize("state", ["ended", "killed"])
def test_no_flipped_or_cut_block_is_silent(state: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    run_dir: Path = request.getfixturevalue(state)
    whole, every = whole_of(run_dir, tmp_path / "whole"), list(faults(run_dir))
    step = len(every) // SAMPLE | 1  # odd: flips and cuts by turns
    outcomes = {fault: outcome_of(fault, run_dir, tmp_path / "run", whole) for fault in every[::step]}
    assert [fault for fault, outcome in outcomes.items() if outcome == "silent"] == []
    assert "told" in outcomes.values()


def test_a_run_copied_without_its_log_is_told_everywhere(
    killed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_dir = tmp_path / "run"
    copied(killed, run_dir)
    assert audit(run_dir, quick=True, blobs=False)["problems"] == []
    Store.open(run_dir).close()  # what the log held stands in the file now
    store = Store.open(run_dir)
    driver = Driver(store.rebuild(), store)
    driver.books.fault("test", "one more commit", driver.now)
    driver.commit()
    copied(run_dir, tmp_path / "copy")
    (tmp_path / "copy" / "books.sqlite-wal").unlink()
    store.close()
    assert "commits are lost" in audit(tmp_path / "copy", quick=True, blobs=False)["problems"][0]
    with pytest.raises(Refused, match="commits are lost"):
        Store.open(tmp_path / "copy")
    for words in (["report"], ["export", "--format", "csv"], ["replay", "--violation", "none"]):
        main([words[0], str(tmp_path / "copy"), *words[1:]])
        assert capsys.readouterr().err.startswith("saflite: warning: what follows is not the whole run")
    assert main(["resume", str(tmp_path / "copy")]) == 2
    assert "--accept-loss" in capsys.readouterr().err
    accept_loss(tmp_path / "copy")
    assert told_of(tmp_path / "copy") == ""
    Store.open(tmp_path / "copy").close()


@pytest.mark.parametrize("keep", [0, 1, 3])
def test_a_missing_or_shortened_witness_is_told(killed: Path, tmp_path: Path, keep: int) -> None:
    copied(killed, tmp_path / "run")
    path = tmp_path / "run" / "books.witness"
    path.write_bytes(path.read_bytes()[: keep * RECORD_BYTES])
    assert "books.witness" in told_of(tmp_path / "run")


def test_a_crash_between_commit_and_witness_loses_nothing_and_is_no_loss(killed: Path, tmp_path: Path) -> None:
    copied(killed, tmp_path / "run")
    path = tmp_path / "run" / "books.witness"
    path.write_bytes(path.read_bytes()[: -RECORD_BYTES // 2])
    assert told_of(tmp_path / "run") == ""
    store = Store.open(tmp_path / "run")
    store.close()
    assert journal(tmp_path / "run") == journal(killed)


def test_a_witness_that_takes_no_writes_is_a_failed_commit_taken_later(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store.create(tmp_path / "run", doubles.campaign(5, record="none"), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=2)
    driver.books.fault("test", "no room", driver.now)
    batch = driver.books.drain()

    def full(file: int, data: bytes, place: int) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", full)
        for _ in range(2):
            with pytest.raises(Unavailable, match=r"books\.witness takes no writes"):
                store.commit(batch)
    store.commit(batch)
    driver.run()
    store.close()
    assert audit(tmp_path / "run")["problems"] == []


def test_an_older_store_put_back_with_its_witness_is_told_by_the_snapshot(tmp_path: Path) -> None:
    run_dir, older = tmp_path / "run", tmp_path / "older"
    store = Store.create(run_dir, doubles.campaign(8, record="none"), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run(until_flights=3)
    store.close()
    shutil.copytree(run_dir, older)
    store = Store.open(run_dir)
    driver = Driver(store.rebuild(), store)
    driver.run()
    store.keep(driver.books.snapshot())
    store.close()
    assert told_of(run_dir) == ""
    for name in ("books.sqlite", "books.witness"):
        shutil.copyfile(older / name, run_dir / name)
    assert "older than books.snapshot" in told_of(run_dir)
    assert not audit(run_dir, blobs=False)["clean"]
    with pytest.raises(Refused, match="older than"):
        Store.open(run_dir)
    accept_loss(run_dir)
    assert told_of(run_dir) == ""
    Store.open(run_dir).close()


@pytest.mark.parametrize("words", [["audit"], ["report"], ["artefacts"], ["prune"], ["resume"]], ids=" ".join)
def test_what_a_dying_process_left_half_done_is_taken_back(words: list[str], ended: Path, tmp_path: Path) -> None:
    """Whoever is killed as it makes one file of a store leaves a rollback journal, which only writers heed."""
    before, died = tmp_path / "before", tmp_path / "died"
    shutil.copytree(ended, before)
    writing = sqlite3.connect(before / "books.sqlite", isolation_level=None)
    writing.execute("PRAGMA cache_size = 5")
    writing.execute("BEGIN")
    writing.execute("CREATE TABLE half_done (x)")
    for _ in range(100):
        writing.execute("INSERT INTO half_done VALUES (zeroblob(4096))")
    shutil.copytree(before, died)
    writing.close()
    assert (died / "books.sqlite-journal").stat().st_size > 0
    assert (died / "books.sqlite").read_bytes() != (ended / "books.sqlite").read_bytes()
    assert main([words[0], str(died), *words[1:]]) in (0, 1)
    assert audit(died)["clean"]
    if words == ["audit"]:
        assert (died / "books.sqlite").read_bytes() == (ended / "books.sqlite").read_bytes()
