"""A run in which something cannot be written is refused in one line before a farm starts, which would try for ever."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

TAKE_UP_READ_ONLY = """
import contextlib, io, subprocess, sys
from pathlib import Path

from saflite.console.cli import main
from saflite.console.io import campaign_options
from saflite.console.operations import running
from saflite.simulator_worker.registry import describe_target

run = Path(sys.argv[1])
campaign = campaign_options.load("avoidance-m2", "")
running.create(run, campaign, describe_target(campaign.target.name))
farm = run.parent / "farm.toml"
farm.write_text(f'campaign = "avoidance-m2"\\nrun = "{run}"\\n[workers]\\nfly = 1\\n')
(run / "blobs").mkdir()
(run / "logs").mkdir()
for name in (".", "blobs", "logs", "books.sqlite", "books.witness"):
    path = run / name
    if subprocess.run(["mount", "--bind", path, path]).returncode:
        sys.exit(77)
    subprocess.run(["mount", "-o", "remount,bind,ro", path], check=True)
    for words in (["up", farm], ["resume", run], ["resume", run, "--budget", "999"], ["audit", run, "--rebuild"]):
        said = io.StringIO()
        with contextlib.redirect_stderr(said):
            code = main([str(word) for word in words])
        assert code == 3, (name, words, code, said.getvalue())
        assert said.getvalue().count("\\n") == 1, said.getvalue()
        assert "ead-only" in said.getvalue(), said.getvalue()
    with contextlib.redirect_stdout(io.StringIO()):  # what writes nothing works all the same
        code = main(["prune", str(run), "--dry-run"])
    assert code == 0, (name, code)
    subprocess.run(["umount", path], check=True)
assert main(["audit", str(run)]) == 0
"""


def test_what_cannot_be_written_is_told_before_anything_starts(tmp_path: Path) -> None:
    words = ["unshare", "--user", "--map-root-user", "--mount", sys.executable, "-c", TAKE_UP_READ_ONLY]
    done = subprocess.run([*words, str(tmp_path / "run")], capture_output=True, text=True, check=False)
    if done.returncode == 77 or "unshare" in done.stderr:
        pytest.skip("this user may not mount")
    assert done.returncode == 0, done.stderr
