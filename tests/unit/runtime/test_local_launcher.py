"""What the launcher of this machine says of a role that ended."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from saflite.runtime.launchers.base import Meeting, RoleSpec, RoleState
from saflite.runtime.launchers.local import LocalLauncher


@pytest.mark.parametrize(
    ("ending", "state"),
    [
        ("kill -ABRT $$", RoleState("broken", "process died: signal SIGABRT")),
        ("kill -SEGV $$", RoleState("broken", "process died: signal SIGSEGV")),
        ("kill -KILL $$", RoleState("killed", "process died: signal SIGKILL")),
        ("exit 7", RoleState("broken", "exit code 7: joined night as mutate-1")),
        ("exit 2", RoleState("refused", "joined night as mutate-1")),
    ],
)
def test_a_role_that_died_is_told_by_its_signal_and_not_by_its_last_line(
    tmp_path: Path, ending: str, state: RoleState
) -> None:
    meeting = Meeting(campaign="night", connect="unixsock-stream//nowhere")
    command = ("sh", "-c", f"echo joined night as mutate-1; {ending}")
    launcher = LocalLauncher(meeting, tmp_path, prefix_of=lambda _: command)
    launcher.start(RoleSpec(name="mutate-1", kind="mutate"))
    try:
        os.waitid(os.P_PID, launcher.pids()["mutate-1"], os.WEXITED | os.WNOWAIT)
        assert launcher.poll() == {"mutate-1": state}
    finally:
        launcher.stop()
