"""A process of others is watched whatever it calls itself."""

from __future__ import annotations

import subprocess
import sys

from saflite.simulator_worker.processes import identity, processor_s

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
