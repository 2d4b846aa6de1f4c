"""Turns: one process of a group at a time, and a dead one holds nobody up."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

from saflite.runtime.turns import in_turn

HOLDER = """
import sys
from pathlib import Path
from saflite.runtime.turns import in_turn
with in_turn(Path(sys.argv[1])):
    print("in", flush=True)
    sys.stdin.read()
print("out", flush=True)
"""


def holder(folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_one_after_the_other_and_a_dead_one_is_no_hindrance(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "for it"
    first = holder(folder)
    assert said(first) == "in"
    second = holder(folder)
    assert second.stdin is not None
    second.stdin.close()  # once it is in, it goes out
    assert second.poll() is None
    first.send_signal(signal.SIGKILL)
    first.communicate()
    assert [said(second), said(second)] == ["in", "out"]
    assert second.wait(60) == 0


def test_groups_do_not_wait_for_each_other(tmp_path: Path) -> None:
    with in_turn(tmp_path / "one"), in_turn(tmp_path / "other"):
        pass
