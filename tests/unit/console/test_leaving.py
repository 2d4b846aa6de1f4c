"""A command that has ended leaves, whatever threads of the bus still do; what it said and its exit code stay."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import atexit, sys, threading
from saflite.console import cli
if {bus}:
    import zenoh
    threading.Thread(target=threading.Event().wait).start()  # never ends, and Python waits for it
atexit.register(print, "left in order")
def main():
    print("said")
    {ending}
cli.main = main
cli.command()
"""


@pytest.mark.parametrize("bus", [True, False])
@pytest.mark.parametrize(("ending", "code"), [("return 0", 0), ("return 4", 4), ("raise SystemExit(2)", 2)])
def test_a_command_that_has_ended_leaves(ending: str, code: int, bus: bool) -> None:
    words = [sys.executable, "-c", SCRIPT.format(bus=bus, ending=ending)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (code, "said\nleft in order\n", "")
