"""Nothing that is written into a run folder may end up elsewhere: links in it are refused before anything is opened.

A run may come from somebody else. A link that stands where the books keep a file would be followed: what it points to
would be cut, written over, or, below `blobs`, removed as what nobody needs.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from saflite.contract.errors import Refused, Unavailable

FOLDERS = ("blobs", "logs", "modules", "recordings", "spool", "test_cases")
"""The folders below that we write into."""

DEPTH_MAX = 3  # blobs/incoming/WORKER


def check_own(run_dir: Path) -> None:
    """Raise Refused where a link stands in a run folder, or no folder where we keep files. The run folder may be one.

    Raises:
        Refused: as said.
        Unavailable: it cannot be read.
    """
    if not run_dir.is_dir():
        return
    try:
        for entry in _entries(run_dir, 1):
            if entry.is_symlink():
                _refuse(entry, "a file or folder itself", "a symbolic link")
    except OSError as fault:
        raise Unavailable(f"{run_dir} cannot be looked through: {fault}") from fault


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
                _refuse(entry, "a folder", "something else")


def _refuse(entry: os.DirEntry[str], expected: str, got: str) -> None:
    fix = "put what belongs there in its place; a run that others made may not write to your other files"
    raise Refused("run folder", where=entry.path, expected=expected, got=got, fix=fix)
