"""Nothing that is written into a run folder may end up elsewhere: links in it are refused before anything is opened.

A run may come from somebody else. A link that stands where the books keep a file would be followed: what it points to
would be cut, written over, or, below `blobs`, removed as what nobody needs. A second name of one file (a hard link, as
`cp -al` or an archive makes them) would have both written.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from saflite.contract.closed import check_closed
from saflite.contract.errors import Refused, Unavailable

FOLDERS = ("blobs", "logs", "modules", "recordings", "spool", "test_cases")
"""The folders below that we write into."""

SHARED = ("blobs", "recordings")
"""Those in which we give one file two names ourselves: a recording is its blob, and neither is ever written again."""

DEPTH_MAX = 3  # blobs/incoming/WORKER
STORE = "books.sqlite"
_SUPER_MAGIC = bytes.fromhex("d9d505f920a163d7")
"""The last 8 bytes of a rollback journal that names a super-journal (SQLite's file format, section 3)."""


def place_of(run_dir: Path) -> tuple[int, int, int] | None:
    """Return which folder and which store stand at a path now, None if there are none: two equal ones are the same."""
    try:
        folder, store = os.stat(run_dir), os.stat(f"{run_dir}/{STORE}")  # paths are taken apart at each commit else
    except OSError:
        return None
    return folder.st_dev, folder.st_ino, store.st_ino


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
        check_run_closed(run_dir)
        for entry in _entries(run_dir, 1):
            if entry.is_symlink():
                _refuse(entry.path, "a file or folder itself", "a symbolic link")
            if entry.name.startswith("books.") and not entry.is_file(follow_symlinks=False):
                _refuse(entry.path, "a regular file", "a folder, device or pipe")
            _check_entry(entry, run_dir)
        check_store(run_dir / STORE)
    except OSError as fault:
        raise Unavailable(f"{run_dir} cannot be looked through: {fault}") from fault


def check_writable(run_dir: Path) -> None:
    """Raise Unavailable where the run, or a folder or book of it, cannot be written: a farm would try for ever.

    For whoever has the run locked: in one at work, files come and go.
    """
    books = (path for path in run_dir.glob(f"{STORE.partition('.')[0]}.*") if path.is_file())
    folders = (folder for name in FOLDERS if (folder := run_dir / name).is_dir())
    for path in (run_dir, *folders, *books):
        try:
            wanted = os.W_OK | (os.X_OK if path.is_dir() else 0)
            if os.access(path, wanted, effective_ids=True):
                continue
        except OSError as fault:
            raise Unavailable(f"{path} cannot be looked at: {fault.strerror}") from fault
        why = "its file system is read-only" if os.statvfs(path).f_flag & os.ST_RDONLY else "this user may not"
        raise Unavailable(f"{path} cannot be written: {why}")


def check_run_closed(folder: Path | str) -> None:
    """Raise Refused where a run folder, or one in it, is another user's, or others can write in it."""
    check_closed(folder, "run folder")


def _check_entry(entry: os.DirEntry[str], run_dir: Path) -> None:
    """Refuse a folder of ours that others can write in, and a file that has another name as well."""
    top = Path(entry.path).relative_to(run_dir).parts[0]
    if entry.is_dir(follow_symlinks=False) and top in FOLDERS:
        check_run_closed(entry.path)
    if entry.is_file(follow_symlinks=False) and top not in SHARED and os.lstat(entry.path).st_nlink > 1:
        _refuse(entry.path, "a file with one name", "one that has another name, too (a hard link)")


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
