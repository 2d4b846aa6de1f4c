"""What an autopilot's process prints, as a file in memory of a bounded size."""

from __future__ import annotations

import fcntl
import os

BYTES_MAX = 2**26
"""A program that prints without end, as a sanitizer's build in a bad flight, would else fill the memory of its host."""


def open_console() -> int:
    """Return a file for what a process prints; once it is full, what more is printed is lost and the process goes on.

    Handed on, it must stay the same open file: how much was printed is how far that stands.
    """
    console = os.memfd_create("console", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.ftruncate(console, BYTES_MAX)  # takes no memory until it is written
    fcntl.fcntl(console, fcntl.F_ADD_SEALS, fcntl.F_SEAL_GROW | fcntl.F_SEAL_SHRINK)
    return console


def printed(console: int, bytes_max: int) -> bytes:
    """Return the end of what was printed."""
    size = min(os.lseek(console, 0, os.SEEK_CUR), BYTES_MAX)
    return os.pread(console, bytes_max, max(0, size - bytes_max))
