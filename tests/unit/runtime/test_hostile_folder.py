"""A farm may be started anywhere, in the folder of a stranger's run, too: what lies there is not run."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import saflite
from saflite.contract.config import own_python
from saflite.runtime.clock import WallClock
from saflite.runtime.launchers.base import Meeting, RoleSpec
from saflite.runtime.launchers.local import LocalLauncher
from saflite.simulator_worker.sandbox import Sandbox, SandboxConfig

SERVICES = Path(saflite.__file__).parent
PLANTED = ("tomllib", "secrets", "logging", "argparse", "msgspec", "zenoh", "numpy", "jsbsim", "saflite", "pip")


@pytest.fixture
def planted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with files that bear the names of what our processes import; returns what they would leave."""
    left = tmp_path / "it-ran"
    for name in PLANTED:
        (tmp_path / f"{name}.py").write_text(f"open({str(left)!r}, 'a').write({name!r})\nraise SystemExit(9)\n")
    monkeypatch.chdir(tmp_path)
    return left


def test_a_role_runs_nothing_of_the_folder_it_is_started_in(planted: Path, tmp_path: Path) -> None:
    meeting = Meeting(campaign="night", connect="unixsock-stream//nowhere", patience_s=0.1)
    launcher = LocalLauncher(meeting, tmp_path / "farm")
    launcher.start(RoleSpec(name="fly-1", kind="fly"))
    try:
        process = launcher._running["fly-1"]
        assert process.wait(60) in (2, 4), (tmp_path / "farm" / "logs" / "fly-1.log").read_text()
    finally:
        launcher.stop()
    assert not planted.exists()


def test_a_simulator_runs_nothing_of_the_folder_it_is_started_in(planted: Path) -> None:
    sandbox = Sandbox(WallClock(), SandboxConfig())
    try:
        assert sandbox.builds()["reference"]
    finally:
        sandbox.close()
    assert not planted.exists()


def test_python_of_ours_knows_itself_and_nothing_that_lies_about(planted: Path) -> None:
    done = subprocess.run([*own_python("saflite"), "list", "targets"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert not planted.exists()
    assert os.path.samefile(own_python("saflite")[0], sys.executable)


def test_no_other_place_starts_python() -> None:
    """`python -m` and `python -c` put the working folder before all others; `own_python` says not to."""
    found = [
        f"{path.relative_to(SERVICES)}:{node.lineno}"
        for path in SERVICES.rglob("*.py")
        if "standalone" not in path.parts  # scripts that are handed out, and run by who took them
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and node.attr == "executable"
    ]
    told_to_users = ("contract/errors.py", "flight/mending.py", "console/commands/completion.py")
    started = [place for place in found if not place.startswith(("contract/config.py", *told_to_users))]
    assert not started
