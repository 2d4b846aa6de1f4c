"""The gate preloaded into the autopilot (`preload/`): where it waits for our orders, and how it is forked there."""

from __future__ import annotations

import array
import os
import socket
import struct
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.console import open_console

LIBRARY = Path(__file__).parent / "preload" / "_clock.so"
ANSWER_S = 5
_KINDS = (socket.SOCK_SEQPACKET, socket.SOCK_STREAM, socket.SOCK_DGRAM, socket.SOCK_DGRAM)
"""Of channel, MAVLink, receiver and physics."""
_FORK, _WORD = b"\xff\xff\xff\xff", struct.Struct("<I")


class Fork(NamedTuple):
    """A fork of the autopilot, and our ends of what it goes on with; `physics` is None where it has its own."""

    pid: int
    channel: socket.socket
    console: int
    link: socket.socket
    receiver: socket.socket
    physics: socket.socket | None

    @property
    def files(self) -> tuple[int, ...]:
        """What must stay open for it to go on."""
        pairs = (self.channel, self.link, self.receiver, self.physics)
        return (self.console, *(one.fileno() for one in pairs if one is not None))

    def leave(self) -> None:
        """Close our ends: it ends where it next waits for us."""
        _close(one for one in (self.channel, self.link, self.receiver, self.physics) if one is not None)
        os.close(self.console)


class Gate:
    """Our end of the channel to a gate; `theirs` is the autopilot's, to be closed once it was started."""

    def __init__(self, *, own_physics: bool, log: bool, physics_port: int, receiver_port: int) -> None:
        self.channel, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self.channel.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, array.array("l", [ANSWER_S, 0]).tobytes())
        self._own_physics, self._heard = own_physics, own_physics
        self._numbers = (int(own_physics), int(not log), physics_port, receiver_port)

    @property
    def environment(self) -> dict[str, str]:
        """What the autopilot's process has to see of one."""
        words = ":".join(map(str, (self.theirs.fileno(), *self._numbers)))
        return {"LD_PRELOAD": str(LIBRARY), "SAFLITE_GATE": words}

    def close(self) -> None:
        """Let go of the autopilot: it ends where it next waits."""
        _close((self.channel, self.theirs))

    def fork(self) -> Fork:
        """Fork the autopilot where it waits; the fork goes on waiting, this one stays held.

        Raises:
            Unavailable: no gate is in it, it is gone, or it holds what a fork would not copy: threads, pipes to others.
        """
        with suppress(BlockingIOError):  # in our world it greets once, when it first waits
            while self.channel.recv(_WORD.size, socket.MSG_DONTWAIT):
                self._heard = True
        if not self._heard:
            raise Unavailable("the autopilot cannot be forked: it is linked statically, or does not wait for our world")
        kinds = _KINDS[: -1 if self._own_physics else None]
        ours, theirs = zip(*(socket.socketpair(socket.AF_UNIX, kind) for kind in kinds), strict=True)
        console = open_console()
        made = Fork(0, ours[0], console, ours[1], ours[2], None if self._own_physics else ours[3])
        try:
            channel, *others = [one.fileno() for one in theirs]
            made = made._replace(pid=self._asked([channel, console, *others]))
        except OSError as fault:
            made.leave()
            raise Unavailable(f"the held autopilot is gone: {fault}") from fault
        finally:
            _close(theirs)
        if not made.pid:
            made.leave()
            raise Unavailable("the autopilot cannot be forked: it runs threads, or holds pipes that lead elsewhere")
        return made

    def _asked(self, files: list[int]) -> int:
        given = array.array("i", files).tobytes()
        self.channel.sendmsg([_FORK], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, given)])
        answer = self.channel.recv(_WORD.size)
        return int(_WORD.unpack(answer)[0]) if len(answer) == _WORD.size else 0


def _close(sockets: Iterable[socket.socket]) -> None:
    for one in sockets:
        one.close()
