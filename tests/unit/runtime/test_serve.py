"""Processes of a farm start in any environment that Python allows."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import cast

import pytest

from saflite.bus.memory import MemoryBus, MemoryNetwork
from saflite.contract.join import Join
from saflite.contract.service import Service
from saflite.contract.topics import PROTOCOL
from saflite.runtime import serve
from saflite.runtime.clock import WallClock
from saflite.runtime.launchers.base import Meeting, RoleSpec
from saflite.runtime.launchers.local import LocalLauncher
from saflite.runtime.spool import Spool
from saflite.runtime.worker_events import WorkerConfig
from saflite.runtime.worker_shell import WorkerShell


@pytest.mark.parametrize("module", ["saflite", "saflite.runtime.serve"])
def test_it_starts_where_python_drops_docstrings(module: str) -> None:
    """PYTHONOPTIMIZE=2, which some packagers set, leaves every `__doc__` None."""
    environment = {**os.environ, "PYTHONOPTIMIZE": "2", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-m", module, "--help"], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-300:]
    assert "usage" in done.stdout


def test_a_role_is_told_of_paths_that_begin_with_a_dash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    meeting = Meeting(campaign="night", connect="unixsock-stream/-socket", listen="unixsock-stream/-socket")
    launcher = LocalLauncher(meeting, Path("-run"), run_dir=Path("-run"), modules=[Path("-own.py")], keys=Path("-keys"))
    roles = (
        RoleSpec(name="fly-1", kind="fly", modules=("-own.py",), labels={"site": "-lab"}),
        RoleSpec(name="books", kind="books", listens=True),
    )
    for role in roles:
        command = launcher._command(role)
        told = serve.parser().parse_args(command[command.index(role.kind) :])
        assert (told.run_dir, told.spool) == (Path("-run"), Path("-run/spool") / role.name)
    assert told.listen == "unixsock-stream/-socket"


def test_a_worker_that_hangs_in_compiled_code_ends_and_says_where() -> None:
    """Nobody did: its process ran, so that the launcher was content, and it asked for no more work."""
    hangs = "import ctypes\nfrom saflite.runtime import serve\nserve.HANGS_S = 0.2\n"
    hangs += "def scores(): ctypes.PyDLL(None).pause()\nserve.end_unless_said_again()\nscores()\n"
    done = subprocess.run([sys.executable, "-c", hangs], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert "in scores" in done.stderr


def test_a_worker_says_again_and_again_that_it_does_not_hang(tmp_path: Path) -> None:
    class Idle:
        cursor, parallel = -1, 1

    card = Join(protocol=PROTOCOL, worker="record-1", stage="record")
    bus, config = MemoryBus("record-1", MemoryNetwork()), WorkerConfig("record-1", "record")
    shell = WorkerShell(bus, "night", cast(Service, Idle()), config, card, Spool(tmp_path), WallClock())
    turns = list[int]()

    def turn() -> None:
        turns.append(len(turns))
        if len(turns) == 2:
            shell.stop("enough")

    shell.on_turn = turn
    assert shell.run().why == "enough"
    assert turns == [0, 1]
