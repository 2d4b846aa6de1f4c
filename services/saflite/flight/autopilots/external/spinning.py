"""Whether a thread of an autopilot works on and on and never waits: it hangs, whatever the others still answer.

The kernel counts how often a thread waited by itself (`voluntary_ctxt_switches`); one that works beside it for seconds
of processor time is in a loop without end. Time is the process's own: others on the machine do not count.
"""

from __future__ import annotations

import ctypes
import os
import time
from contextlib import suppress
from pathlib import Path

from saflite.contract.plain import word

LOOK_S = 0.5  # of processor time between two looks at the threads: next to nothing where all is well
SPINS_S = 2.0  # without having waited; what an autopilot does between two waits takes milliseconds
_LIBC = ctypes.CDLL(None)
_USER, _SYSTEM = 11, 12  # places in a thread's `stat` after its name
_WAITED = "voluntary_ctxt_switches:"


class Spinning:
    """Watches the threads of a process.

    Args:
        pid: its number.
        spins_s: processor time after which a thread that has not waited counts as one that never will.
    """

    def __init__(self, pid: int, spins_s: float = SPINS_S) -> None:
        self._tasks, self._spins_s = Path(f"/proc/{pid}/task"), spins_s
        self._tick_s = 1.0 / os.sysconf("SC_CLK_TCK")
        self._looked_s = 0.0
        self._began: dict[str, tuple[str, float]] = {}  # by thread: how often it had waited, its processor time then
        clock = ctypes.c_int()
        gone = _LIBC.clock_getcpuclockid(pid, ctypes.byref(clock))
        self._clock = None if gone else clock.value

    def named(self) -> str:
        """Return the name of a thread that spins, "" where none does; to be asked often, it seldom looks."""
        if self._clock is None:
            return ""
        try:
            now_s = time.clock_gettime(self._clock)
        except OSError:  # it has ended
            return ""
        if now_s - self._looked_s < min(LOOK_S, self._spins_s):
            return ""
        self._looked_s = now_s
        return self._look()

    def _look(self) -> str:
        found = ""
        with suppress(OSError):  # gone meanwhile
            for task in self._tasks.iterdir():
                with suppress(OSError):
                    found = found or self._look_at(task)
        return found

    def _look_at(self, task: Path) -> str:
        fields = _told(task / "stat").rpartition(")")[2].split()
        worked_s = (int(fields[_USER]) + int(fields[_SYSTEM])) * self._tick_s
        lines = _told(task / "status").splitlines()
        waited = next((line for line in lines if line.startswith(_WAITED)), "")
        before, since_s = self._began.get(task.name, ("", worked_s))
        if waited != before or not waited:
            self._began[task.name] = (waited, worked_s)
            return ""
        return word(_told(task / "comm").strip()) if worked_s - since_s >= self._spins_s else ""


def _told(path: Path) -> str:
    """Return what the kernel says; a thread's name there is any bytes."""
    return path.read_text(encoding="utf-8", errors="backslashreplace")
