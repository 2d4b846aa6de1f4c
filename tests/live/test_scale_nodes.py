"""The nodes of `scripts/bench scale` go with it, however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.live

BENCHES = Path(__file__).resolve().parents[2] / "scripts" / "benches"
HOLD = """
import sys, time
sys.path.insert(0, sys.argv[1])
from _scale_nodes import nodes
with nodes(2, farm_here=False):
    print("there", flush=True)
    time.sleep(600)
"""


def here(pid: int) -> list[str]:
    """Return the namespaces and links that a process has made."""
    listed = [
        subprocess.run(["ip", *words.split()], capture_output=True, text=True, check=True).stdout
        for words in ("netns list", "-o link")
    ]
    marks = (f"sfscale-{pid}-", f"sfb{pid % 100_000}:", f"sf{pid % 100_000}o")
    return [line for text in listed for line in text.splitlines() if any(mark in line for mark in marks)]


@pytest.mark.skipif(os.geteuid() != 0, reason="network namespaces need root")
@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_namespaces_and_bridge_are_removed(ending: signal.Signals) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLD, str(BENCHES)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "there\n"
        assert len(here(process.pid)) == 5  # two namespaces, the bridge, and a cable to each
        process.send_signal(ending)
        assert process.wait(60) != 0
    assert here(process.pid) == []
