"""A recording passes the MCAP project's own checker: set MCAP=/path/to/mcap, or have `mcap` on the PATH."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from saflite.recorder import mcap

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit" / "recorder"))

TOOL = os.environ.get("MCAP") or shutil.which("mcap") or ""


@pytest.mark.live
@pytest.mark.skipif(not TOOL, reason="no `mcap` on the PATH and none named by MCAP")
def test_recordings_pass_mcap_doctor(tmp_path: Path) -> None:
    from test_mcap import START_UNIX_S, record_work

    path = tmp_path / "flight.mcap"
    path.write_bytes(mcap.write(*record_work(60.0), START_UNIX_S))
    done = subprocess.run([TOOL, "doctor", str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "error" not in (done.stdout + done.stderr).lower()
