"""The gate preloaded into a PX4 on its own physics (`preload/`): it runs the steps that are ordered and no more."""

from __future__ import annotations

import socket
import struct
from contextlib import suppress
from pathlib import Path

from saflite.contract.errors import Unavailable
from saflite.flight.autopilots.external.place import FailedBringUp
from saflite.flight.autopilots.external.process import Process

LIBRARY = Path(__file__).parent / "preload" / "_clock.so"
LOOK_S = 0.2
UNGATED = "its own physics does not wait for ours: no simulator_sih in it, or linked statically"
_WORD = struct.Struct("<I")


class Gate:
    """Our end of the channel to a gate; `theirs` is PX4's, to be closed once it was started.

    Raises:
        Unavailable: the library was not built.
    """

    def __init__(self) -> None:
        if not LIBRARY.is_file():
            raise Unavailable(f"{LIBRARY.name}, preloaded into PX4 on its own physics, is not built: scripts/setup")
        self.channel, self.theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)

    @property
    def environment(self) -> dict[str, str]:
        """What PX4's process has to see of one."""
        return {"LD_PRELOAD": str(LIBRARY), "SAFLITE_GATE": str(self.theirs.fileno())}

    def greet(self, process: Process, within_s: float) -> None:
        """Wait until its physics has made a first step and waits.

        Raises:
            FailedBringUp: it ended, or never did within some wall time.
        """
        self.channel.settimeout(LOOK_S)
        ended = False
        for _ in range(round(within_s / LOOK_S)):
            with suppress(TimeoutError):
                if len(self.channel.recv(_WORD.size)) == _WORD.size:
                    self.channel.settimeout(None)
                    return
                ended = True  # its end of the channel closes with it, before it can be seen to be gone
            process.listen()
            if ended or process.gone:
                break
        raise FailedBringUp(process.how_it_ended() if ended or process.gone else UNGATED)

    def close(self) -> None:
        """Let go of PX4: it ends where it next waits."""
        self.channel.close()
        self.theirs.close()
