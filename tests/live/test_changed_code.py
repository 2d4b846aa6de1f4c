"""Code that changes under a run: its worker is refused when it starts anew, and the run ends with all it had."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from saflite.campaign.storage.audit import audit
from saflite.console.run_data.run_folder import open_run
from saflite.runtime.clock import WallClock

pytestmark = pytest.mark.live
EXAMPLES = Path(__file__).resolve().parents[2] / "deploy" / "examples" / "targets"
SAFLITE = [sys.executable, "-m", "saflite"]


def flights(run_dir: Path) -> int:
    """Return how many flights of a run have ended."""
    with open_run(run_dir) as run:
        return len(list(run.flights()))


def test_a_worker_whose_code_was_changed_ends_the_run_in_one_line(tmp_path: Path) -> None:
    clock, run_dir, module = WallClock(), tmp_path / "run", tmp_path / "point_mass.py"
    good = (EXAMPLES / "point_mass.py").read_text().replace('values["GAIN"] > 8.0', 'values["GAIN"] > 80.0')
    module.write_text(good)
    for name in ("point-mass.toml", "point-mass-stays.toml"):
        (tmp_path / name).write_bytes((EXAMPLES / name).read_bytes())
    words = [*SAFLITE, "run", "point-mass.toml", "--module", "point_mass.py", "--workers", "1", "--out", "run"]
    run = subprocess.Popen([*words, "--budget", "100000"], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    try:
        until_s = clock.monotonic_s() + 60.0
        while not (run_dir / "farm.json").exists() or flights(run_dir) < 8:
            assert run.poll() is None, "it ended by itself"
            assert clock.monotonic_s() < until_s, "no flights"
            clock.sleep_s(0.2)
        module.write_text(good + "# changed\n")
        os.kill(json.loads((run_dir / "farm.json").read_text())["processes"]["fly-1"], signal.SIGKILL)
        _, complaints = run.communicate(timeout=90.0)
    finally:
        run.kill()
    assert run.returncode == 3
    last = complaints.splitlines()[-1]
    assert last.startswith("saflite: unavailable: fly-1 may not work for this run: "), complaints
    assert "Traceback" not in complaints
    figures = audit(run_dir)
    assert figures["clean"], figures["problems"]
    assert not (run_dir / "books.sqlite-wal").exists()
    assert (run_dir / "report.html").stat().st_size
    with open_run(run_dir) as kept:
        assert "fly-1 may not work for this run" in kept.summary().failed
    before = flights(run_dir)
    module.write_text(good)
    again = [*SAFLITE, "resume", "run", "--workers", "1", "--budget", str(before + 60)]
    assert subprocess.run(again, cwd=tmp_path, check=False).returncode == 0
    assert flights(run_dir) > before
    assert audit(run_dir)["clean"]
