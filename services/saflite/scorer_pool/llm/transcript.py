"""Questions to language models and their answers, word for word: one JSON line per exchange, for people."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from saflite.contract.plain import plain_json

FILE_BYTES_MAX = 64 * 2**20


class Exchange(NamedTuple):
    """One question and its answer. `prompt_digest` is the one that stands with the scores."""

    model: str
    prompt_digest: str
    messages: list[dict[str, str]]
    content: str
    thinking: str = ""


Transcript = Callable[[Exchange], None]


def silent(exchange: Exchange) -> None:
    """Keep nothing."""


class TranscriptFile:
    """Appends exchanges to a file until it holds 64 MiB; then, or when the disk is full, no more: it is only a log."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._bytes = path.stat().st_size if path.exists() else 0

    def __call__(self, exchange: Exchange) -> None:
        """Append one exchange."""
        line = (plain_json(json.dumps(exchange._asdict(), ensure_ascii=False)) + "\n").encode()
        with self._lock:
            if self._bytes + len(line) > FILE_BYTES_MAX:
                return
            try:
                with self._path.open("ab") as file:
                    file.write(line)
            except OSError:
                self._bytes = FILE_BYTES_MAX
                return
            self._bytes += len(line)
