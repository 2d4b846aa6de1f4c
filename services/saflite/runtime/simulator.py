"""The simulator's own process, `python -m saflite.runtime.simulator FD PARENT_PID`: `simulator_worker/simulator.py`."""

from __future__ import annotations

import os
import sys
from multiprocessing.connection import Connection

from saflite.runtime.clock import WallClock
from saflite.simulator_worker.processes import die_with_parent
from saflite.simulator_worker.simulator import serve


def main(argv: list[str]) -> None:
    """Serve the socket `FD` until the worker closes it."""
    die_with_parent(int(argv[1]))
    serve(Connection(int(argv[0])), WallClock())
    os._exit(0)


if __name__ == "__main__":
    main(sys.argv[1:])
