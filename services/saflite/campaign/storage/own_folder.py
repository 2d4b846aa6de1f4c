"""Nothing that is written into a run folder may end up elsewhere: links in it are refused before anything is opened.

A run may come from somebody else. A link that stands where the books keep a file would be followed: what it points to
would be cut, written over, or, below `blobs`, removed as what nobody needs.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from saflite.contract.errors import Refused, Unavailable

FOLDERS = ("blobs", "logs", "modules", "recordings", "spool", "test_cases")
"""The folders below that we write into."""

DEPTH_MAX = 3  # blobs/incoming/WORKER
STORE = "books.sqlite"
_SUPER_MAGIC = bytes.fromhex("d9d505f920a163d7")
"""The last 8 bytes of a rollback journal that names a super-journal (SQLite's file format, section 3)."""


def check_own(run_dir: Path) -> None:
    """Raise Refused where others can write, a link stands, or no folder where we keep files. The run folder may be one.

    Whoever can write in the folder can put a link there after it was looked through.

    Raises:
        Refused: as said.
        Unavailable: it cannot be read.
    """
    if not run_dir.is_dir():
        return
    try:
        _check_closed(run_dir)
        for entry in _entries(run_dir, 1):
            if entry.is_symlink():
                _refuse(entry.path, "a file or folder itself", "a symbolic link")
            if entry.name.startswith("books.") and not entry.is_file(follow_symlinks=False):
                _refuse(entry.path, "a regular file", "a folder, device or pipe")
        check_store(run_dir / STORE)
    except OSError as fault:
        raise Unavailable(f"{run_dir} cannot be looked through: {fault}") from fault


def _check_closed(run_dir: Path) -> None:
    found = run_dir.stat()
    if found.st_uid not in (0, os.geteuid()):
        got, fix = f"one of user {found.st_uid}", "work on a copy (cp -r), or have the folder given to you (chown -R)"
    elif found.st_mode & stat.S_IWOTH:
        got, fix = "one that anybody can write in", "chmod o-w the folder, if what is in it is still yours"
    else:
        return
    raise Refused("run folder", where=str(run_dir), expected="one of your own or root's", got=got, fix=fix)


def _entries(folder: Path | str, depth: int) -> Iterator[os.DirEntry[str]]:
    """Yield what stands in a folder and in the folders of ours below it."""
    with os.scandir(folder) as entries:
        for entry in entries:
            yield entry
            if depth == 1 and entry.name not in FOLDERS:
                continue
            if entry.is_dir(follow_symlinks=False):
                if depth < DEPTH_MAX:
                    yield from _entries(entry.path, depth + 1)
            elif depth == 1 and not entry.is_symlink():
                _refuse(entry.path, "a folder", "something else")


def check_store(path: Path) -> None:
    """Raise Refused where SQLite would wait for, or act on, what stands beside a store.

    It opens whatever bears these names, and waits for whoever writes a pipe. A rollback journal of ours names no other
    file; one that does has SQLite remove that file after the journal was rolled back, wherever it is.
    """
    for suffix in ("", "-wal", "-shm", "-journal"):
        beside = f"{path}{suffix}"
        try:
            handle = os.open(beside, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            continue
        except OSError as fault:
            raise Unavailable(f"{beside} cannot be read: {fault.strerror}") from fault
        with os.fdopen(handle, "rb") as file:
            found = os.fstat(handle)
            if not stat.S_ISREG(found.st_mode):
                _refuse(beside, "a regular file", "a folder, device or pipe")
            if suffix == "-journal" and found.st_size >= len(_SUPER_MAGIC):
                file.seek(-len(_SUPER_MAGIC), os.SEEK_END)
                if file.read() == _SUPER_MAGIC:
                    _refuse(beside, "a journal of this store alone", "one that names another file, to be removed")


def _refuse(path: str, expected: str, got: str) -> None:
    fix = "put what belongs there in its place; a run that others made may not write to your other files"
    raise Refused("run folder", where=path, expected=expected, got=got, fix=fix)
