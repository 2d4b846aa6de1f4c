"""Files of keys: for their user only, whole or not at all, and changed by one process after the other."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LOCK = "register.lock"


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Wait until no other process changes the keys in a folder; the kernel ends the turn of one that dies.

    A file of its own is locked, not the folder: of network file systems some lock only what is open for writing.

    Raises:
        OSError: it cannot be written or locked.
    """
    lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def make_private(folder: Path) -> None:
    """Have a folder that only this user may enter; raises OSError."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder.chmod(0o700)


def write(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, for this user only; raises OSError."""
    handle, beside = tempfile.mkstemp(dir=path.parent, prefix=".part-")  # mode 0600
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except BaseException:
        Path(beside).unlink(missing_ok=True)
        raise
