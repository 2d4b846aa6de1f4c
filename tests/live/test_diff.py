"""A comparison of two builds that was killed goes on where it was left, and says what an undisturbed one says."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.live

WORDS = (
    "diff",
    "reference",
    "reference+parachute-in-acro",
    "--campaign",
    "policy-a-chute",
    "--budget",
    "4",
    "--times",
    "1",
)


def begun(out: Path, *more: str) -> subprocess.Popen[str]:
    words = [sys.executable, "-m", "saflite", *WORDS, "--out", str(out), "--json", *more]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def compared(out: Path) -> dict[str, Any]:
    process = begun(out)
    said, complaints = process.communicate(timeout=300)
    assert process.returncode in (0, 1), complaints
    return {**json.loads(said), "runs": ""}


def test_a_killed_comparison_goes_on(tmp_path: Path) -> None:
    disturbed, books = begun(tmp_path / "a"), tmp_path / "a" / "old" / "books.sqlite"
    end_s = time.monotonic() + 60.0
    while not books.exists() and time.monotonic() < end_s:
        time.sleep(0.1)
    assert books.exists(), "nothing was begun that could go on"
    time.sleep(2.0)
    disturbed.kill()
    disturbed.communicate()
    assert disturbed.returncode < 0, "it ended before it was killed"
    time.sleep(3.0)  # its farm notices
    assert compared(tmp_path / "a") == compared(tmp_path / "b")
    other = begun(tmp_path / "a", "--rng-seed", "9")
    assert "another" in other.communicate(timeout=60)[1]
    assert other.returncode == 2
