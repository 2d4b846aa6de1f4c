"""Files of keys: for their user only, whole or not at all, and changed by one process after the other."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from saflite.contract.closed import check_closed
from saflite.contract.errors import Refused

LOCK = "register.lock"
DOUBT = "if what is in it is still what `saflite keys` wrote; make new keys if it is not"


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
    """Have a folder that only this user may enter; raises OSError, or Refused where it is another user's."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder.chmod(0o700)
    check_closed(folder, "keys", DOUBT)  # root may change the mode of anybody's


def check_ours(path: Path) -> None:
    """Raise Refused where others can change a file or folder of keys, or put another in its place.

    Whoever can replace the authority's certificate decides whom this end trusts. Where a link leads counts as well.
    """
    try:
        for one in (*_folders(path), path) if path.is_file() else (path,):
            check_closed(one, "keys", DOUBT)
    except (OSError, RuntimeError) as fault:  # it went meanwhile, may not be looked at, or links lead in a circle
        raise Refused("keys", where=str(path), expected="what can be read", got=str(fault)) from fault


def _folders(path: Path) -> Iterator[Path]:
    """Yield the folders of a file, of each link that leads on from it, and of what they lead to."""
    yield path.resolve().parent
    yield path.parent
    while path.is_symlink():
        path = path.parent / os.readlink(path)
        yield path.parent


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
