"""How much workers may leave that the books have not answered for: none may fill the disk, broken or hostile.

What waits is counted where it stands, finished or not, so nothing has to be remembered over a restart. A worker's own
is counted each time; that of all only once a thousandth of the room left by the last count may have been used up,
since a look at every folder costs 25 ms with 1,000 workers.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from saflite.contract.blobs import BLOBS_PER_RESULT_MAX

WORKER_BYTES_MAX = 2**30
"""Of one worker: some results with all they may hold (`contract.blobs.RESULT_BYTES_MAX`)."""

ALL_BYTES_MAX = 8 * 2**30
"""Of all workers together, also those that take a new name for each blob."""

FILES_MAX = 100_000
"""Of all workers together; an empty folder is one, too."""

WORKER_FILES_MAX = 64 * BLOBS_PER_RESULT_MAX
"""Of one worker: they are counted at each blob."""

SHARES = 1000
"""Room is used by shares of it between two counts: a thousand writers that count apart pass the limit by one room."""


class Quota:
    """What may still be left under one folder of incoming blobs, as one writer there sees it."""

    def __init__(self, incoming: Path) -> None:
        self._incoming = incoming
        self._bytes_used = self._files_used = 0  # since all was counted
        self._all = 0, 0
        self.key_of: Callable[[str], str] = lambda _: ""
        self._of_keys: dict[str, tuple[int, int]] = {}  # files and bytes, at most: what went meanwhile is still in it

    def excess(self, worker: str, more_bytes: int) -> str:
        """Return in words why `more_bytes` more of a worker are not to be left, empty if they may be.

        `key_of` tells whose key a worker's name begins with, empty for the farm's own. The workers of a key may leave
        no more than is free besides: one key alone gets half of the room, n keys an n+1-th each, and as much is left.
        """
        files, size = _waiting([self._incoming / worker])
        if words := _over(files, size + more_bytes, WORKER_FILES_MAX, WORKER_BYTES_MAX, worker):
            return words
        files, size = self._all
        self._bytes_used += more_bytes
        self._files_used += 1
        if self._bytes_used * SHARES > ALL_BYTES_MAX - size or self._files_used * SHARES > FILES_MAX - files:
            self._all = files, size = _waiting(_folders(self._incoming))
            self._bytes_used = self._files_used = 0
            if words := _over(files, size + more_bytes, FILES_MAX, ALL_BYTES_MAX, "all workers"):
                return words
        key = self.key_of(worker)
        return self._excess_of(key, more_bytes) if key else ""

    def _excess_of(self, key: str, more_bytes: int) -> str:
        files_free = FILES_MAX - self._all[0] - self._files_used
        bytes_free = ALL_BYTES_MAX - self._all[1] - self._bytes_used
        files, size = self._of_keys.get(key, (0, 0))
        self._of_keys[key] = files, size = files + 1, size + more_bytes
        if files <= files_free and size <= bytes_free:
            return ""
        theirs = [folder for folder in _folders(self._incoming) if self.key_of(Path(folder).name) == key]
        self._of_keys[key] = files, size = _waiting(theirs)
        return _over(files, size + more_bytes, files_free, bytes_free, f"workers of key {key}")


def _over(files: int, size: int, files_max: int, bytes_max: int, whose: str) -> str:
    if size <= bytes_max and files <= files_max:
        return ""
    return (
        f"{size} bytes in {files} files of {whose} would wait for the books, more than the {bytes_max} bytes or"
        f" {files_max} files that may"
    )


def _folders(incoming: Path) -> list[str]:
    with suppress(OSError):
        return [entry.path for entry in os.scandir(incoming) if entry.is_dir(follow_symlinks=False)]
    return []


def _waiting(folders: Iterable[str | Path]) -> tuple[int, int]:
    files = size = 0
    for folder in folders:
        found = 0
        with suppress(OSError):
            for entry in os.scandir(folder):
                with suppress(OSError):  # taken meanwhile
                    size += entry.stat(follow_symlinks=False).st_size
                    found += 1
        files += max(1, found)
    return files, size
