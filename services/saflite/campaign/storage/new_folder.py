"""Making a run folder, whole or not at all: what a full disk leaves of one would be refused the next time."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from saflite.campaign.storage.sqlite import BOOKS, InUse, lock_run
from saflite.contract.errors import Refused
from saflite.contract.plain import argument


@contextmanager
def new_folder(run_dir: Path) -> Iterator[IO[bytes]]:
    """Make a run folder, if it is not there, and lock it; if what is done inside fails, all of that goes again.

    Yields the lock, which stays.

    Raises:
        Refused: a run stands there already, or is being made; or no message could tell its path.
        OSError: the disk does not take it.
    """
    _check_new(run_dir)
    _check_text(run_dir)
    made = _make(run_dir)
    try:
        lock = lock_run(run_dir)
        _check_new(run_dir)  # now that nobody else can begin one
        try:
            yield lock
        except BaseException:
            for path in run_dir.glob("books.*"):
                path.unlink(missing_ok=True)
            lock.close()
            raise
    except BaseException as fault:
        if made and not isinstance(fault, InUse):
            shutil.rmtree(run_dir, ignore_errors=True)
        raise


def _make(run_dir: Path) -> bool:
    run_dir.parent.mkdir(parents=True, exist_ok=True)
    try:
        run_dir.mkdir(mode=0o700)
    except FileExistsError:
        return False
    return True


def _check_new(run_dir: Path) -> None:
    if (run_dir / BOOKS).exists():
        raise Refused(
            "run folder",
            where=str(run_dir),
            expected="a folder without a run in it",
            got="the books of an earlier run",
            fix=f"`saflite resume {argument(run_dir)}` goes on with it; or choose another folder",
        )


def _check_text(run_dir: Path) -> None:
    try:
        str(run_dir.absolute()).encode()
    except UnicodeEncodeError as fault:
        raise Refused(
            "run folder",
            expected="a path that is text in UTF-8",
            got=ascii(str(run_dir.absolute())),
            fix="choose another folder, or call this from another one",
        ) from fault
