"""Whether somebody pressed Ctrl-C: code from outside may raise KeyboardInterrupt, too, though nobody did."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


class _Note:
    """A handler of SIGINT that notes the signal and does what was done with it before."""

    def __init__(self) -> None:
        self.before = signal.getsignal(signal.SIGINT)
        self.came = False

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Note the signal and hand it on; raises KeyboardInterrupt."""
        self.came = True
        assert callable(self.before), "it was put before a handler"
        self.before(number, frame)


@contextmanager
def interrupts() -> Iterator[Callable[[], bool]]:
    """Give what says whether a signal SIGINT came while the body ran; the signal raises KeyboardInterrupt as ever.

    Only Python's own handler raises, and only in the main thread: where another one is at work, or in another thread,
    no KeyboardInterrupt is of a signal.
    """
    hears = threading.current_thread() is threading.main_thread()
    note = _Note()
    usual = note.before
    if not hears or not (usual is signal.default_int_handler or isinstance(usual, _Note)):
        yield lambda: False
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield lambda: note.came
    finally:
        if signal.getsignal(signal.SIGINT) is note:  # the body may have set one of its own
            signal.signal(signal.SIGINT, usual)
