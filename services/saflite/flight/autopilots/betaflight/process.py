"""The firmware's process: started with the clock library preloaded, forked at a gate, ended by its socket."""

from __future__ import annotations

import array
import os
import signal
import socket
import subprocess
from contextlib import suppress
from pathlib import Path

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.console import open_console, printed
from saflite.flight.mending import builds_firmware

SILENT_S = 10  # of wall time without an answer: the firmware hangs
CONSOLE_TAIL = 20_000
_LINK_FORK = 2
_FORK_MESSAGE = _LINK_FORK.to_bytes(4, "little") + bytes(4096)  # at least a LinkDown without serial bytes
SANITIZER_OPTIONS = (
    "verify_asan_link_order=0:detect_leaks=0:abort_on_error=0:exitcode=99:detect_stack_use_after_return=0"
)


class FirmwareDied(Exception):
    """The firmware ended while it was set up or on the way to the start state; says how."""


class Firmware:
    """One process of the firmware: the socket to it, and a file with what it printed.

    It ends when the socket is closed, or when it is killed; a fork can be once it has said its id (`watch`).
    """

    def __init__(self, link: socket.socket, console: int, process: subprocess.Popen[bytes] | None = None) -> None:
        self._link, self._console, self._process = link, console, process
        self._watched = -1
        link.settimeout(None)
        seconds = array.array("l", [SILENT_S, 0]).tobytes()
        link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, seconds)

    @property
    def fd(self) -> int:
        """The socket."""
        return self._link.fileno()

    @property
    def files(self) -> frozenset[int]:
        """What must stay open for it to go on."""
        return frozenset({self._link.fileno(), self._console, self._watched} - {-1})

    def fork(self) -> Firmware:
        """Fork it; the fork answers on a socket of its own with what this one said last. This one stays held.

        Raises:
            Unavailable: it is gone.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        console = open_console()
        with theirs:
            given = array.array("i", [theirs.fileno(), console]).tobytes()
            try:
                self._link.sendmsg([_FORK_MESSAGE], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, given)])
            except OSError as fault:
                ours.close()
                os.close(console)
                raise Unavailable(f"the held firmware is gone: {fault}") from fault
        return Firmware(ours, console)

    def through(self, link: socket.socket) -> Firmware:
        """Return it at the other end of another socket, over which a process of ours passes everything on."""
        self._link.close()
        return Firmware(link, self._console, self._process)

    def last_words(self) -> str:
        """Return the end of what it printed."""
        return printed(self._console, CONSOLE_TAIL).decode("ascii", "replace")

    def leave(self) -> None:
        """In a fork of the process that holds it: close what was inherited; the held firmware goes on waiting."""
        self._link.close()
        self._close_files()

    def watch(self, pid: int) -> None:
        """Hold on to the process of a fork, which has just said its id: once it has ended, another may have that."""
        with suppress(OSError):
            self._watched = os.pidfd_open(pid)

    def close(self) -> None:
        """Let it end, or kill it, in case it hangs. May be called twice."""
        if self._link.fileno() < 0:
            return
        self._link.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        elif self._watched >= 0:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._watched, signal.SIGKILL)
        self._close_files()

    def _close_files(self) -> None:
        os.close(self._console)
        if self._watched >= 0:
            os.close(self._watched)


def start(binary: Path, clock_library: Path, folder: Path) -> Firmware:
    """Start the firmware in `folder`, where its `eeprom.bin` lies or will lie.

    Raises:
        Unavailable: it cannot be started.
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    console = open_console()
    variables = {"LD_PRELOAD": str(clock_library), "SAFLITE_LINK": str(theirs.fileno())}
    variables |= {"ASAN_OPTIONS": SANITIZER_OPTIONS} if "sanitized" in binary.name else {}
    with theirs:
        try:
            process = subprocess.Popen(
                [str(binary)],
                cwd=folder,
                env=variables,
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=console,
                stderr=console,
            )
        except OSError as fault:
            ours.close()
            os.close(console)
            again = f"{builds_firmware(binary.name.partition('-')[2])} builds it again"
            raise Unavailable(f"{binary} does not run here ({fault.strerror}): {again}") from fault
    return Firmware(ours, console, process)
