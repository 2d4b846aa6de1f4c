"""A process of others is watched whatever it calls itself, and however deep below it others were started."""

from __future__ import annotations

import inspect
import os
import signal
import subprocess
import sys

from saflite.simulator_worker.processes import identity, processor_s, resident_mib, starved_s

ODD = r"""
import ctypes
ctypes.CDLL(None).prctl(15, b"\xff)\n(", 0, 0, 0)  # PR_SET_NAME
sum(range(10**7))
print()
input()
"""


def test_a_process_may_have_any_bytes_for_a_name() -> None:
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-u", "-c", ODD], **pipes) as process:  # type: ignore[call-overload]
        try:
            process.stdout.readline()
            assert processor_s(process.pid) > 0.0
            assert identity(process.pid)
        finally:
            process.kill()


DEEP = 60
CHAIN = f"""
import os, signal
for _ in range({DEEP}):
    if os.fork():
        signal.pause()
print(flush=True)
signal.pause()
"""


def test_processes_may_be_started_in_a_chain_of_any_length() -> None:
    """Each was looked at within the look at the one before: a worker that flew a build with a long one died of it."""
    limit = sys.getrecursionlimit()
    with subprocess.Popen([sys.executable, "-c", CHAIN], stdout=subprocess.PIPE, start_new_session=True) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            sys.setrecursionlimit(len(inspect.stack()) + DEEP)
            held_mib = resident_mib(process.pid)
            processor_s(process.pid)  # maybe less than a tick of the clock
            starved_s(process.pid)
        finally:
            sys.setrecursionlimit(limit)
            os.killpg(process.pid, signal.SIGKILL)
    assert held_mib > 0.0
