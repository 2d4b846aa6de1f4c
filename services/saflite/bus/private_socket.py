"""A Unix socket for one farm, in a folder that only this user may enter: nobody else on the machine can connect.

The folder is not the run folder, whose path may be too long for a socket. A farm that was killed leaves its folder
behind; the next one to open a socket removes it, since nobody holds its lock any more.
"""

from __future__ import annotations

import fcntl
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from shutil import rmtree

from saflite.bus.endpoints import UNIX_PATH_BYTES_MAX
from saflite.contract.config import environment
from saflite.contract.errors import Unavailable

PREFIX, PREPARING = "saflite-farm-", ".saflite-farm-"
SOCKET, OWNER = "bus", "owner"
LOCK_SUFFIX = ".lock"  # Zenoh puts a lock beside the socket


class PrivateSocket:
    """The endpoint of a farm for as long as this object is open.

    Raises:
        Unavailable: there is no folder to put it in.
    """

    def __init__(self) -> None:
        self.folder, self._lock = _open_folder()

    @property
    def endpoint(self) -> str:
        """Where the router listens and clients connect."""
        return f"unixsock-stream/{self.folder / SOCKET}"

    def close(self) -> None:
        """Remove socket and folder; harmless when done twice."""
        rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):
            os.close(self._lock)
        self._lock = -1

    def __enter__(self) -> PrivateSocket:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _open_folder() -> tuple[Path, int]:
    faults = []
    for base in _bases():
        try:
            _sweep(base)
            return _make_folder(base)
        except OSError as fault:
            faults.append(f"{base}: {fault.strerror or fault}")
    raise Unavailable(f"no folder for the farm's socket ({'; '.join(faults)}); set TMPDIR to a short path")


def _bases() -> Iterator[Path]:
    """Yield the folders that may hold ours, best first: the user's runtime directory if it is private, temporary."""
    runtime = environment("XDG_RUNTIME_DIR")
    if runtime and is_private(Path(runtime)):
        yield Path(runtime)
    yield Path(tempfile.gettempdir())
    yield Path("/tmp")  # noqa: S108 - where TMPDIR is too long; the folder made there is private and its name random


def is_private(folder: Path) -> bool:
    """Return whether it is a folder of this user, no link, that nobody else may enter."""
    try:
        status = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & 0o077


def _make_folder(base: Path) -> tuple[Path, int]:
    """Make the folder under a name that is not swept, lock it, then give it its name."""
    hidden = Path(tempfile.mkdtemp(prefix=PREPARING, dir=base))  # mode 0700
    lock = -1
    try:
        folder = base / hidden.name.replace(PREPARING, PREFIX, 1)
        if len(os.fsencode(folder / SOCKET)) + len(LOCK_SUFFIX) > UNIX_PATH_BYTES_MAX:
            raise OSError(0, "path too long for a socket")
        lock = os.open(hidden / OWNER, os.O_CREAT | os.O_RDWR, 0o600)
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        hidden.rename(folder)
    except OSError:
        rmtree(hidden, ignore_errors=True)
        if lock >= 0:
            os.close(lock)
        raise
    return folder, lock


def _sweep(base: Path) -> None:
    """Remove folders of this user whose farm is gone."""
    for folder in base.glob(f"{PREFIX}*"):
        if is_private(folder) and _is_abandoned(folder):
            rmtree(folder, ignore_errors=True)


def _is_abandoned(folder: Path) -> bool:
    try:
        lock = os.open(folder / OWNER, os.O_RDWR)
    except OSError:
        return False
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(lock)
    return True
