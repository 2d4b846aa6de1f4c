"""A fork of an autopilot is ended as itself: once others have taken leave of it, its id may be anybody's."""

from __future__ import annotations

import subprocess
import sys

import pytest

END_WHO_HAS_GONE = """
import os, select, socket, subprocess, sys
from pathlib import Path

from saflite.flight.autopilots.betaflight.process import Firmware, open_console
from saflite.flight.autopilots.external.process import ForkedProcess

def another_of_its_id(pid):
    Path("/proc/sys/kernel/ns_last_pid").write_text(str(pid - 1))
    other = subprocess.Popen(["sleep", "60"])
    if other.pid != pid:
        sys.exit(77)
    return other

def watched(pid):
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    firmware = Firmware(ours, open_console())
    firmware.watch(pid)
    return firmware.close

for hold in (lambda pid: ForkedProcess(pid, open_console(), "").end, watched):
    gone, here = subprocess.Popen(["sleep", "60"]), subprocess.Popen(["sleep", "60"])
    end, end_here = hold(gone.pid), hold(here.pid)
    gone.kill()
    gone.wait()
    other = another_of_its_id(gone.pid)
    seen = os.pidfd_open(other.pid)
    end()
    assert not select.select([seen], [], [], 0.3)[0], "another was ended"
    other.kill()
    end_here()
    assert here.wait(10.0) == -9, "it goes on"
"""


def test_nobody_is_ended_who_took_the_id_of_an_autopilot_that_is_gone() -> None:
    words = ["unshare", "--user", "--map-root-user", "--pid", "--fork", "--mount-proc", sys.executable, "-c"]
    done = subprocess.run([*words, END_WHO_HAS_GONE], capture_output=True, text=True, check=False, timeout=60.0)
    if done.returncode == 77 or "unshare" in done.stderr or "ns_last_pid" in done.stderr:
        pytest.skip("no ids of processes of one's own here")
    assert done.returncode == 0, done.stderr
