"""The autopilot's process: started in a folder of its own, its console kept, ended with everything it started."""

from __future__ import annotations

import ctypes
import os
import re
import resource
import select
import signal
import subprocess
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path

from saflite.contract.endings import how_ended
from saflite.contract.errors import Unavailable
from saflite.contract.memory_faults import is_memory_report
from saflite.contract.outside import LOG_BYTES_MAX
from saflite.flight.autopilots.console import printed
from saflite.flight.autopilots.external.spinning import Spinning

CONSOLE_MAX = 200_000
READ_BYTES = 65_536
READS_MAX = 64
"""At once; a program that prints faster than it is read would be listened to for ever."""
END_S = 2.0
FILE_BYTES_MAX = LOG_BYTES_MAX
"""Of each file that a program writes: a longer log is not taken for one."""

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1
REALTIME_PRIORITY = 5
_PRIORITY = ctypes.c_int(REALTIME_PRIORITY)
_IGNORE = ctypes.c_void_p(1)  # SIG_IGN
_BUSY = "RD"
_DEATHS = re.compile(r"PANIC|floating point exception|runtime error:|aborted", re.I)
_ADDRESS = re.compile(r"0x[0-9a-fA-F]+")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class Process:
    """One process of the autopilot, the first of a group. Its console is a terminal, so that no last word is buffered.

    Args:
        command: program and arguments.
        folder: where it runs.
        environment: all it sees of one. Never ours: keys of model servers stand there, and what it prints is kept.
        realtime: give it real-time priority where this user may, so that it runs before the world whenever it can.
        keeps: open files of ours that it inherits.
        age_max_s: it is ended at this age, whatever is waited for from it then; 0 for none. By us: an alarm of the
            kernel's is one that a program may ignore, or set anew for itself.

    Raises:
        Unavailable: it cannot be started.
    """

    def __init__(
        self,
        command: Sequence[str],
        folder: Path,
        *,
        environment: Mapping[str, str],
        realtime: bool = False,
        keeps: Sequence[int] = (),
        age_max_s: float = 0.0,
    ) -> None:
        ours, theirs = os.openpty()
        os.set_blocking(ours, False)
        try:
            self._process = subprocess.Popen(
                command,
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=theirs,
                stderr=theirs,
                start_new_session=True,
                pass_fds=keeps,
                preexec_fn=partial(_begin, realtime, _file_bytes_max()),  # noqa: PLW1509  (calls looked up before)
            )
        except OSError as fault:
            os.close(ours)
            raise Unavailable(f"{command[0]}: {fault}") from fault
        finally:
            os.close(theirs)
        self._console, self._said = ours, bytearray()
        self._spinning = Spinning(self._process.pid)
        self._age_max_s, self._is_too_old = age_max_s, False
        self._aging = threading.Timer(age_max_s, self._end_of_age) if age_max_s else None
        if self._aging is not None:
            self._aging.daemon = True
            self._aging.start()

    def _end_of_age(self) -> None:
        if self._process.poll() is None:
            self._is_too_old = True
            self._kill()

    def _kill(self) -> None:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)

    @property
    def still(self) -> bool:
        """Whether nothing of it computes or waits for a disk: it waits for us, or for its own clock."""
        return not any(state in _BUSY for state in self._states())

    def _states(self) -> Iterator[str]:
        """Yield the states of all threads of its session, as the kernel's `proc` file system tells them."""
        waiting = [self._process.pid]
        while waiting:
            tasks = Path(f"/proc/{waiting.pop()}/task")
            with suppress(OSError):  # gone meanwhile
                for task in tasks.iterdir():
                    waiting += map(int, (task / "children").read_text().split())
                    yield _after_name(task / "stat")[0]

    def spinning(self) -> str:
        """Return the name of a thread of it that works and never waits, "" where there is none; see `Spinning`."""
        return self._spinning.named()

    @property
    def console(self) -> str:
        """The end of what it printed."""
        self.listen()
        return self._said.decode("utf-8", "replace").replace("\r", "")

    @property
    def gone(self) -> bool:
        """Whether it has ended."""
        return self._process.poll() is not None

    def listen(self) -> None:
        """Take what it printed, so that it never waits for us."""
        if self._console < 0:
            return
        with suppress(OSError):  # nothing more now, or for ever
            for _ in range(READS_MAX):
                self._said += os.read(self._console, READ_BYTES)
                del self._said[:-CONSOLE_MAX]

    def wait_for_words(self, words: str, silent_s: float) -> bool:
        """Return whether it printed some words before it ended or was silent for so long."""
        while words not in self.console:
            if self.gone and words not in self.console:
                return False
            if not select.select([self._console], [], [], silent_s)[0]:
                return False
        return True

    def how_it_ended(self) -> str:
        """Return the signal or exit code it ended with, and the line that says why.

        To be asked once the link to it is gone: waits a little for the end.
        """
        try:
            code = self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            return "the autopilot hangs"
        if self._is_too_old:
            return f"the autopilot had not done what it was started for after {self._age_max_s:g} s"
        return told(code, self.console)

    def end(self) -> None:
        """Kill it and everything it started; may be called twice."""
        if self._console < 0:
            return
        if self._aging is not None:
            self._aging.cancel()
        self._kill()
        self._process.wait()
        self.listen()
        os.close(self._console)
        self._console = -1


class ForkedProcess:
    """A fork of the autopilot's process. It is the other's child: how it ended is read from the kernel's `proc` files.

    Args:
        pid: its number.
        console: what it prints goes into this file, which is ours from now on.
        before: what the other had printed.
    """

    def __init__(self, pid: int, console: int, before: str) -> None:
        self._pid, self._console, self._before = pid, console, before
        try:
            self._watched = os.pidfd_open(pid)
        except ProcessLookupError:
            self._watched = -1

    @property
    def console(self) -> str:
        """The end of what it printed."""
        said = b"" if self._console < 0 else printed(self._console, CONSOLE_MAX)
        return self._before + said.decode("utf-8", "replace")

    def how_it_ended(self) -> str:
        """See `Process`."""
        if not self._ended_within(END_S):
            return "the autopilot hangs"
        try:
            status = int(_after_name(Path(f"/proc/{self._pid}/stat"))[-1])
        except OSError:  # the other has taken leave of it
            return f"the autopilot ended: {last_line(self.console)}"
        return told(os.waitstatus_to_exitcode(status), self.console)

    def listen(self) -> None:
        """Nothing has to be taken from it: it never waits for us."""

    def end(self) -> None:
        """Kill it and wait until nothing of it is left but its status; may be called twice."""
        if self._console < 0:
            return
        if self._watched >= 0:  # by the process itself: once the other has taken leave of it, its id may be another's
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._watched, signal.SIGKILL)
            self._ended_within(END_S)
            os.close(self._watched)
            self._watched = -1
        os.close(self._console)
        self._console = -1

    def _ended_within(self, limit_s: float) -> bool:
        return self._watched < 0 or bool(select.select([self._watched], [], [], limit_s)[0])


def told(code: int, console: str) -> str:
    """Return in words how a process ended: its code, negative for a signal, and the line that says why."""
    return f"the autopilot ended with {how_ended(code)}: {last_line(console)}"


def _die_with_parent() -> None:
    """Have the kernel kill this process with the one that started it: an autopilot takes no other word for the end."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, ctypes.c_ulong(signal.SIGKILL), 0, 0, 0)


def _begin(realtime: bool, file_bytes_max: int) -> None:
    """The same; have it run before others whenever it can, where this user may ask for that.

    What would make a file longer than `file_bytes_max` fails, and the program goes on: left to itself the kernel would
    end it with a signal, which would pass for a death that the flight has caused.
    """
    _die_with_parent()
    _LIBC.signal(signal.SIGXFSZ, _IGNORE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (file_bytes_max, file_bytes_max))
    if realtime:
        _LIBC.sched_setscheduler(0, os.SCHED_FIFO, ctypes.byref(_PRIORITY))


def _file_bytes_max() -> int:
    """Return how long files of a program may become: `FILE_BYTES_MAX`, or what is allowed here."""
    allowed = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    return FILE_BYTES_MAX if allowed == resource.RLIM_INFINITY else min(FILE_BYTES_MAX, allowed)


def _after_name(stat: Path) -> list[str]:
    """Return what the kernel says of a process or thread behind its name, which may be any bytes."""
    return stat.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()


def last_line(console: str) -> str:
    """Return the line that tells a death, the last one otherwise; no addresses, no colours: equals read the same.

    A report of a fault of memory goes first: what sanitizers found before and passed over may be harmless.
    """
    lines = [line.strip() for line in _COLOUR.sub("", console).splitlines() if line.strip()]
    reported = next(filter(is_memory_report, lines), None)
    told = reported or next(filter(_DEATHS.search, lines), lines[-1] if lines else "it said nothing")
    return _ADDRESS.sub("0x..", told)[:300]
