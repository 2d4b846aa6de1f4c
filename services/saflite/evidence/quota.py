"""How much workers may leave that the books have not answered for: none may fill the disk, broken or hostile.

What waits is counted where it stands, finished or not, so nothing has to be remembered over a restart.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

WORKER_BYTES_MAX = 2**30
"""Of one worker: some results with all they may hold (`contract.blobs.RESULT_BYTES_MAX`)."""

ALL_BYTES_MAX = 8 * 2**30
"""Of all workers together, also those that take a new name for each blob."""

FILES_MAX = 100_000


def excess(incoming: Path, worker: str, more_bytes: int) -> str:
    """Return in words why `more_bytes` more of a worker are not to be left, empty if they may be."""
    mine, all_ = _waiting([incoming / worker]), _waiting(_folders(incoming))
    for (files, size), most, whose in ((mine, WORKER_BYTES_MAX, worker), (all_, ALL_BYTES_MAX, "all workers")):
        if size + more_bytes > most or files > FILES_MAX:
            return (
                f"{size + more_bytes} bytes in {files} files of {whose} would wait for the books, more than the"
                f" {most} bytes or {FILES_MAX} files that may"
            )
    return ""


def _folders(incoming: Path) -> list[Path]:
    with suppress(OSError):
        return [Path(entry.path) for entry in os.scandir(incoming) if entry.is_dir(follow_symlinks=False)]
    return []


def _waiting(folders: Iterable[Path]) -> tuple[int, int]:
    files = size = 0
    for folder in folders:
        with suppress(OSError):
            for entry in os.scandir(folder):
                with suppress(OSError):  # taken meanwhile
                    size += entry.stat(follow_symlinks=False).st_size
                    files += 1
    return files, size
