"""A terminal that is closed ends the campaign as Ctrl-C does: clean, with a report, to be taken up again."""

from __future__ import annotations

import os
import pty
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.live


def test_a_closed_terminal_leaves_a_report(tmp_path: Path) -> None:
    run_dir = tmp_path / "run"
    words = ["-m", "saflite", "run", "avoidance-m2", "--budget", "500", "--workers", "1"]
    child, terminal = pty.fork()
    if child == 0:
        os.execv(sys.executable, [sys.executable, *words, "--out", str(run_dir)])
    seen = b""
    until_s = time.monotonic() + 90.0
    while b"flights/s" not in seen:
        assert time.monotonic() < until_s, seen
        seen += os.read(terminal, 65536)
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) in (1, 129)
    assert (run_dir / "report.html").stat().st_size > 0
    assert not (run_dir / "books.sqlite-wal").exists()
