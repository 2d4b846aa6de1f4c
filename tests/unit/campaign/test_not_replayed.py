"""A journal line that fits its checksums and cannot be replayed is told by every reader, in one line."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from books_drive import Driver, doubles

from saflite.campaign.engine.journal import (
    Entry,
    GaveUp,
    Granted,
    Line,
    Returned,
    Selected,
    Settled,
    TraceMissing,
    encode_line,
)
from saflite.campaign.engine.outbox import Batch
from saflite.campaign.scheduling.work_keys import FlyKey, MutateKey, RecordKey
from saflite.campaign.storage.audit import audit, is_over, resume_faults, told_of
from saflite.campaign.storage.prune import prune
from saflite.campaign.storage.rebuild import rebuild
from saflite.campaign.storage.seal import seal_file
from saflite.campaign.storage.store import Store
from saflite.contract.errors import Refused
from saflite.contract.work import MutateResult

NAME = "0123456789abcdef"
ENTRIES: tuple[Entry, ...] = (
    Settled(key=MutateKey(77), epoch=1, worker="a", result=MutateResult(round=77, test_cases=())),
    Granted(key=FlyKey(NAME, "search", 0), epoch=1, worker="a"),
    Returned(key=FlyKey(NAME, "search", 0), epoch=1, how="lost"),
    Selected(round=77, picks=()),
    TraceMissing(key=FlyKey(NAME, "search", 0), message=""),
    GaveUp(key=RecordKey(NAME, "search", 0), message=""),
)
LINES = (*(encode_line(Line(1e6, entry)) for entry in ENTRIES), b"", b"\xc1", msgspec.msgpack.encode([1, 2, 3]))


@pytest.fixture(params=[False, True], ids=["killed", "closed"])
def closed(request: pytest.FixtureRequest) -> bool:
    return bool(request.param)


def _with(run_dir: Path, line: bytes, *, closed: bool, snapshot: bool = False) -> Path:
    """Return a run that has ended, with one more line as the store itself writes it."""
    store = Store.create(run_dir, doubles.campaign(3), doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.run()
    if snapshot:
        store.keep(driver.books.snapshot())
    store.commit(Batch(store._tables.tails.lines, (line,), (), (), (), (), ()))
    store.close()
    if not closed:
        seal_file(run_dir).unlink()
    return run_dir


def _is_named(words: str) -> bool:
    return "journal entry" in words and "can be replayed" in words and len(words.splitlines()) == 1


@pytest.mark.parametrize("line", LINES)
def test_every_reader_names_the_line(line: bytes, closed: bool, tmp_path: Path) -> None:
    run_dir = _with(tmp_path / "run", line, closed=closed)
    (found,) = audit(run_dir)["problems"]
    assert _is_named(found)
    assert [_is_named(words) for words in resume_faults(run_dir)] == [True]
    for read in (rebuild, prune, is_over):
        with pytest.raises(Refused) as refused:
            read(run_dir)
        assert _is_named(str(refused.value))
    assert closed or _is_named(told_of(run_dir))


def test_one_behind_the_snapshot_is_named_by_its_number(closed: bool, tmp_path: Path) -> None:
    run_dir = _with(tmp_path / "run", LINES[0], closed=closed, snapshot=True)
    (from_the_start,) = audit(run_dir)["problems"]
    assert resume_faults(run_dir) == [from_the_start]
