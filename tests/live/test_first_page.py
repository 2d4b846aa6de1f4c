"""The sample of the first page is what the demo's campaign prints."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.live
ROOT = Path(__file__).parents[2]


def sample() -> str:
    """Return the violation that the first page shows, on one line, without the identity of its test case.

    That identity goes by the build that flies: it changes with the code.
    """
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    at = next(number for number, line in enumerate(lines) if line.startswith("    VIOLATION"))
    return f"{lines[at].strip()}  {lines[at + 1].strip()}".partition("  test case")[0]


def test_the_first_page_shows_what_the_demo_prints(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "saflite", "run", "avoidance-m2", "--budget", "30", "--out", str(tmp_path / "run")]
    said = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert said.returncode == 1, said.stderr
    assert sample() in said.stdout
    assert f"replay {tmp_path / 'run'}" in said.stdout
