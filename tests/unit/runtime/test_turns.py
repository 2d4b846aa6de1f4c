"""Turns: one process of a group at a time, and a dead one holds nobody up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from saflite.runtime.turns import in_turn, in_turn_to

HOLDER = """
import sys
from pathlib import Path
from saflite.runtime.turns import in_turn
with in_turn(Path(sys.argv[1])):
    print("in", flush=True)
    sys.stdin.read()
print("out", flush=True)
"""


COMER = HOLDER.replace("in_turn(Path(sys.argv[1]))", "in_turn_to(sys.argv[1])").replace(
    "import in_turn", "import in_turn_to"
)


def comer(endpoint: str, cache: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", COMER, endpoint],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "SAFLITE_CACHE": str(cache)},
    )


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


def test_who_comes_to_one_router_takes_turns_whatever_placed_it(tmp_path: Path) -> None:
    first = comer("tls/10.0.0.1:7447", tmp_path)
    assert said(first) == "in"
    other, second = comer("tls/10.0.0.2:7447", tmp_path), comer("tls/10.0.0.1:7447", tmp_path)
    assert said(other) == "in", "another router"
    assert second.stdin is not None
    second.stdin.close()
    assert second.poll() is None
    first.communicate()
    other.communicate()
    assert [said(second), said(second)] == ["in", "out"]
    assert second.wait(60) == 0


def test_who_can_have_no_folder_waits_for_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SAFLITE_CACHE", "/proc/nothing/can/be/made/here")
    with in_turn_to("tls/10.0.0.1:7447"), in_turn_to("tls/10.0.0.1:7447"):
        pass
