"""Processes of a farm start in any environment that Python allows."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from saflite.runtime import serve
from saflite.runtime.launchers.base import Meeting, RoleSpec
from saflite.runtime.launchers.local import LocalLauncher


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
