"""Which notes in run folders this user's farms wrote: marked with a key that only this user has.

A run folder may come from somebody else, and its modules are code. What bears no mark of ours is not run unless the
user names it, and no state of books but ours is gone on from.
"""

from __future__ import annotations

import hmac
import logging
import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

from saflite.contract.config import environment
from saflite.contract.errors import Refused
from saflite.contract.outside import read_bytes

log = logging.getLogger(__name__)

KEY_BYTES = 32
MARK_BYTES_MAX = 64
SIGNED_BYTES = 32


def key_file() -> Path:
    """Return where the key stands; raises RuntimeError where this user has no home."""
    data = environment("XDG_DATA_HOME")
    return (Path(data) if data else Path.home() / ".local" / "share") / "saflite" / "own-runs.key"


def mark(path: Path, content: bytes) -> None:
    """Write at `path` that `content` is ours; where there can be no key there is no mark."""
    try:
        path.write_bytes(hmac.digest(_key() or _made_key(), content, "sha256").hex().encode())
    except (OSError, RuntimeError, Refused) as fault:
        log.warning("%s is not marked as ours: %s", path, fault)
        with suppress(OSError):
            path.unlink(missing_ok=True)


def is_marked(path: Path, content: bytes) -> bool:
    """Return whether the mark at `path` says that `content` is ours."""
    with suppress(OSError, RuntimeError, Refused):
        key = _key()
        told = read_bytes(path, "mark", MARK_BYTES_MAX)
        return bool(key) and hmac.compare_digest(told, hmac.digest(key, content, "sha256").hex().encode())
    return False


def signed(content: bytes) -> bytes:
    """Return the mark that `content` is ours, to stand beside it in one file; zeros where there can be no key."""
    with suppress(OSError, RuntimeError, Refused):
        return hmac.digest(_key() or _made_key(), content, "sha256")
    return bytes(SIGNED_BYTES)


def is_signed(mark: bytes, content: bytes) -> bool:
    """Return whether a mark of `signed` says that `content` is ours."""
    with suppress(OSError, RuntimeError, Refused):
        key = _key()
        return bool(key) and hmac.compare_digest(mark, hmac.digest(key, content, "sha256"))
    return False


def _key() -> bytes:
    """Return the key, empty if there is none; raises Refused for one that others may have read or written."""
    path = key_file()
    if not os.path.lexists(path):
        return b""
    status = path.lstat()
    if not stat.S_ISREG(status.st_mode) or status.st_uid != os.geteuid() or status.st_mode & 0o077:
        raise Refused("key", where=str(path), expected="a file of this user's alone", got="another")
    key = read_bytes(path, "key", KEY_BYTES)
    if len(key) != KEY_BYTES:
        raise Refused("key", where=str(path), expected=f"{KEY_BYTES} bytes", got=f"{len(key)}")
    return key


def _made_key() -> bytes:
    path = key_file()
    path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    part = path.with_name(f"{path.name}.{secrets.token_hex(8)}")
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(secrets.token_bytes(KEY_BYTES))
    try:
        os.link(part, path)  # the first of two that begin at once counts
    except FileExistsError:
        pass
    finally:
        part.unlink()
    return _key()
