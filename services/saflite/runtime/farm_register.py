"""Which farms this user started on this machine: a note each, so that commands find them wherever their runs lie."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path

from saflite.contract.config import environment


def register_folder() -> Path:
    """Return the folder of the notes."""
    cache = environment("XDG_CACHE_HOME")
    return (Path(cache) if cache else Path.home() / ".cache") / "saflite" / "farms"


def note(run_dir: Path) -> None:
    """Note that a farm works in a run folder; where nothing can be noted, it is found below `runs/` alone."""
    with suppress(OSError, RuntimeError):
        file = _file(run_dir)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(str(run_dir.resolve()), encoding="utf-8")


def forget(run_dir: Path) -> None:
    """Take the note of a farm away."""
    with suppress(OSError, RuntimeError):
        _file(run_dir).unlink(missing_ok=True)


def is_noted(run_dir: Path) -> bool:
    """Return whether this user started a farm in a run folder that has not ended in order since."""
    with suppress(OSError, RuntimeError, UnicodeDecodeError):
        return _file(run_dir).read_text(encoding="utf-8") == str(run_dir.resolve())
    return False


def noted() -> list[Path]:
    """Return the run folders noted; some may be of farms that were killed."""
    found = []
    with suppress(OSError, RuntimeError):
        for file in register_folder().iterdir():
            with suppress(OSError, UnicodeDecodeError):
                found.append(Path(file.read_text(encoding="utf-8")))
    return found


def _file(run_dir: Path) -> Path:
    return register_folder() / hashlib.sha256(str(run_dir.resolve()).encode()).hexdigest()[:16]
