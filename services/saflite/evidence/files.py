"""Blob files: whole or not there, checked without holding them in memory."""

from __future__ import annotations

import hashlib
import os
import shutil
import stat
import tempfile
from contextlib import suppress
from io import FileIO
from pathlib import Path

from saflite.contract.blobs import BlobMissing, BlobRef
from saflite.contract.errors import Refused, Unavailable
from saflite.contract.ids import digest
from saflite.contract.new_files import new_file_mode
from saflite.contract.outside import read_bytes

PART = ".part"
AT_ONCE_BYTES = 2**16
FOLDER_TRIES = 100  # each is lost only where the folder is removed right after it was made


def make_folder(folder: Path, within: Path | None) -> None:
    """Make a folder and those above it, up to but not `within` where one is named: where that is missing, it was moved.

    Raises OSError if the disk fails, FileNotFoundError where `within` is not there.
    """
    try:
        folder.mkdir(exist_ok=True)
    except FileNotFoundError:
        if folder.parent == within:
            raise
        make_folder(folder.parent, within)
        folder.mkdir(exist_ok=True)


def write_whole(path: Path, data: bytes, within: Path | None = None) -> None:
    """Write a file beside its place and rename it into it, not flushed; raises Unavailable if the disk fails.

    Its folder is made where it is missing (`make_folder`).
    """
    try:
        handle, beside = _opened_in(path.parent, within)
        try:
            os.fchmod(handle, new_file_mode())
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            os.replace(beside, path)
        except OSError:
            with suppress(OSError):
                os.unlink(beside)
            raise
    except OSError as fault:
        raise Unavailable(f"{path.parent} takes no blob: {fault}") from fault


def _opened_in(folder: Path, within: Path | None) -> tuple[int, str]:
    """Return a new file in a folder, open, and its name; the books remove a folder whenever nothing is left in it."""
    for tries_left in reversed(range(FOLDER_TRIES)):
        try:
            make_folder(folder, within)
            return tempfile.mkstemp(dir=folder, suffix=PART)
        except (FileNotFoundError, FileExistsError):  # the latter where it went while it was looked at
            if not tries_left:
                raise
    raise AssertionError("unreachable")


def remove_if_empty(folder: Path | str) -> None:
    """Remove a folder in which nothing is left, else leave it."""
    with suppress(OSError):
        os.rmdir(folder)


def read_whole(path: Path, ref: BlobRef) -> bytes:
    """Return a blob's bytes; raises BlobMissing unless they are there and fit the digest."""
    try:
        data = read_bytes(path, "blob", ref.size_bytes)
    except Refused as fault:
        raise BlobMissing(ref, "is damaged" if path.exists() else "is missing") from fault
    if len(data) != ref.size_bytes or digest(data) != ref.digest:
        raise BlobMissing(ref, "is damaged")
    return data


def fault_of(path: Path | str, ref: BlobRef, *, deep: bool) -> str:
    """Return `missing`, `damaged` or, where all is well, nothing. Only `deep` reads the bytes and checks the digest."""
    try:
        status = os.stat(path)
        if status.st_size != ref.size_bytes or not stat.S_ISREG(status.st_mode):
            return "damaged"
        if deep:
            with open(path, "rb", buffering=0) as file:
                return "" if _digest_of(file, ref.size_bytes) == ref.digest else "damaged"
    except FileNotFoundError:
        return "missing"
    except OSError:
        return "damaged"
    return ""


def _digest_of(file: FileIO, size_bytes: int) -> str:
    """Return the digest of a file that had so many bytes just now; a small one is read at once."""
    if size_bytes < AT_ONCE_BYTES:
        return digest(file.read(AT_ONCE_BYTES))
    return hashlib.file_digest(file, "sha256").hexdigest()


def put_in_place(source: Path | str, place: Path | str) -> bool:
    """Let a file stand under a second name, too: the same bytes on disk where the file system can, else a copy.

    Returns whether it does; False where something stood there, and does still.

    Raises:
        Unavailable: the disk fails.
    """
    try:
        try:
            os.link(source, place)
        except FileExistsError:
            return False
        except OSError:  # looked for only now: most folders are there
            _put_anew(source, Path(place))
    except OSError as fault:
        raise Unavailable(f"{place} cannot be written: {fault}") from fault
    return True


def _put_anew(source: Path | str, place: Path) -> None:
    """Link or copy a file to where there may be no folder yet."""
    place.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, place)
    except OSError:
        beside = place.with_name(place.name + PART)
        shutil.copyfile(source, beside)
        os.replace(beside, place)


def flush(path: Path) -> None:
    """Have a file or folder on disk for good; raises OSError if the disk fails."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
