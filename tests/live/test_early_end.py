"""A strategy of one's own that breaks in mid-campaign: told, no success, and mended without flying anything again."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.live
SAFLITE = [sys.executable, "-m", "saflite"]
INFRASTRUCTURE = 3
BUDGET = 40
ASKED = "return [self._next(rng) for _ in range(count)]"
BREAKS = {
    "raises": "raise ValueError('boom')",
    "dies": "__import__('os')._exit(9)",
}


def _saflite(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*SAFLITE, *words], cwd=folder, capture_output=True, text=True, timeout=240.0, check=False)


def _result(folder: Path, *words: str) -> tuple[int, dict[str, Any]]:
    done = _saflite(folder, *words, "--json")
    return done.returncode, json.loads(done.stdout)


@pytest.mark.parametrize("how", BREAKS)
def test_a_strategy_that_breaks_is_told_and_can_be_mended(how: str, tmp_path: Path) -> None:
    assert _saflite(tmp_path, "new", "strategy", "mine").returncode == 0
    whole = (tmp_path / "mine.py").read_text()
    assert whole.count(ASKED) == 1
    broken = f"if len(self._near) > 2:\n            {BREAKS[how]}\n        {ASKED}"
    (tmp_path / "mine.py").write_text(whole.replace(ASKED, broken))
    mine = ("--strategy", "mine", "--module", "mine.py", "--budget", str(BUDGET), "--out", "run")
    code, told = _result(tmp_path, "run", "policy-upright", *mine, "--workers", "2")
    assert code == INFRASTRUCTURE
    assert told["ended"]
    assert told["failed"]
    assert "the strategy 'mine'" in told["why"]
    assert 0 < told["flights"] < BUDGET
    assert _result(tmp_path, "resume", "run")[1]["why"] == told["why"]
    (tmp_path / "mended").mkdir()
    (tmp_path / "mended" / "mine.py").write_text(whole)
    code, mended = _result(tmp_path, "resume", "run", "--budget", str(BUDGET), "--module", "mended/mine.py")
    assert (code, mended["why"], mended["failed"]) == (0, "the budget is spent", False)
    assert mended["flights"] == BUDGET
    assert _saflite(tmp_path, "audit", "run").returncode == 0
