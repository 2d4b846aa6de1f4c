"""What a machine allows each process of a farm: open files, raised as far as may be, and memory to begin with."""

from __future__ import annotations

import resource
from contextlib import suppress

from saflite.contract.errors import Refused

FILES = 64  # of any process; seen: 19 in a simulator, 33 in the books of eight workers
FILES_PER_WORKER = 2  # the books' links to those they answer
FILES_RAISED_TO = 16_384  # enough for as many workers as may join; programs that close all they could have stay quick
MEMORY = 1_000_000 * 1024  # bytes of address space; seen: 0.8 GB mapped in the books, of which little is used


def prepare_limits(workers: int = 0) -> None:
    """Raise the soft limit of open files, which child processes inherit; see that a farm can begin.

    Numerical libraries that may map no more memory wait for it without end, so too little is told before.

    Args:
        workers: how many processes meet in the farm that begins here.

    Raises:
        Refused: what is allowed is too little.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = FILES_RAISED_TO if hard == resource.RLIM_INFINITY else min(FILES_RAISED_TO, hard)
    if _less(soft, most):
        with suppress(OSError, ValueError):  # not allowed here: what there is may do
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
            soft = most
    needed = FILES + FILES_PER_WORKER * workers
    if _less(soft, needed):
        for_whom = f", with {workers} processes" if workers else ""
        raise Refused(
            "limit of open files", expected=f"at least {needed}{for_whom}", got=soft, fix="raise it (ulimit -n)"
        )
    memory, _ = resource.getrlimit(resource.RLIMIT_AS)
    if _less(memory, MEMORY):
        expected = f"at least {MEMORY // 1024} KiB for each process"
        raise Refused("limit of memory", expected=expected, got=f"{memory // 1024} KiB", fix="raise it (ulimit -v)")


def _less(limit: int, than: int) -> bool:
    return limit != resource.RLIM_INFINITY and limit < than
