"""Whole files or none: a text appears under its name only once all of it is written."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from saflite.contract.errors import Unavailable
from saflite.contract.new_files import new_file_mode


def write_file(path: Path, text: str) -> None:
    """Put `text` at `path` at once, making the folder; raises Unavailable if the disk does not take it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(dir=path.parent, prefix=".part-")
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="\n") as file:
                file.write(text)
            Path(partial).chmod(new_file_mode())
            Path(partial).replace(path)
        except OSError:
            Path(partial).unlink(missing_ok=True)
            raise
    except OSError as fault:
        raise Unavailable(f"writing {path}: {fault}") from fault
