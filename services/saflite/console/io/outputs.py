"""Files that commands write for the user: whole or not at all, and never over what stands there unless told so."""

from __future__ import annotations

import argparse
import errno
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from saflite.contract.errors import Refused, Unavailable
from saflite.contract.new_files import new_file_mode

FIX = "choose another place, or --force to write over it"


def add_force(parser: argparse.ArgumentParser) -> None:
    """Name the argument that lets files be written over."""
    parser.add_argument("--force", action="store_true", help="write over what stands there")


def check_takes(folder: Path, option: str = "--out") -> None:
    """Raise Unavailable where a folder, or the nearest above it that there is, takes no new files."""
    above = folder.absolute()
    while not os.path.lexists(above) and above != above.parent:
        above = above.parent
    if above.is_dir() and not os.access(above, os.W_OK | os.X_OK):
        raise Unavailable(f"{folder} cannot be written: {above} takes no new files; choose another place ({option})")


def check_file(path: Path, *, force: bool, option: str = "--out") -> None:
    """Raise Refused unless a file may be written at `path`: nothing is there, or a file or link and `force`.

    Raises Unavailable where its folder takes none.
    """
    there = os.path.lexists(path)
    if there and not (path.is_file() or path.is_symlink()):
        raise Refused(option, where=str(path), expected="a place for a file", got="a folder or device")
    if there and not force:
        raise Refused(option, where=str(path), expected="a file that does not exist", got="one that does", fix=FIX)
    check_takes(path.parent, option)


def check_folder(path: Path, *, force: bool, option: str = "--out") -> None:
    """Raise Refused unless files may be written into `path`: it is not there, or empty, or a folder and `force`.

    Raises Unavailable where it takes none.
    """
    try:
        usable = path.is_dir() and (force or not any(path.iterdir()))
    except OSError as fault:
        raise Unavailable(f"{path}: {fault}") from fault
    if not usable and os.path.lexists(path):
        got = "one with files in it" if path.is_dir() else "a file or link"
        fix = FIX if path.is_dir() else "choose another place"
        raise Refused(option, where=str(path), expected="a folder that is new or empty", got=got, fix=fix)
    check_takes(path, option)


def write(path: Path, data: bytes, *, force: bool, option: str = "--out") -> None:
    """Write a file, and its folder if need be; a link is replaced, never followed.

    Raises:
        Refused: something stands there and `force` is not given, or it is no file, or its name is too long.
        Unavailable: the disk does not take it.
    """
    check_file(path, force=force, option=option)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, beside = tempfile.mkstemp(dir=path.parent, prefix=".part-")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            os.chmod(beside, new_file_mode())
            os.replace(beside, path)
        except OSError:
            with suppress(OSError):
                os.unlink(beside)
            raise
    except OSError as fault:
        if fault.errno == errno.ENAMETOOLONG:
            got = f"one of {len(os.fsencode(path.name))} bytes"
            raise Refused(option, expected="a name no longer than files may have", got=got) from fault
        raise Unavailable(f"{path} cannot be written: {fault}") from fault
