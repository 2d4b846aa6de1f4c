"""`scripts/setup` over a stand-in for Python: what goes wrong beside the installation is said, and ends nothing."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PYTHON = """#!/bin/sh
[ "$1" = - ] || exit 0
echo "Traceback (most recent call last):" >&2
echo "ValueError: no room for 'it'" >&2
exit {code}
"""


@pytest.mark.parametrize("code", [0, 1])
def test_what_is_not_compiled_is_told_in_one_line(code: int, tmp_path: Path) -> None:
    for name in ("scripts/setup", "pyproject.toml", "deploy/constraints.txt", "scripts/build_native.py"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    for folder in (".venv/bin", "services/saflite/flight/native"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / ".venv/bin/python").write_text(PYTHON.format(code=code))
    (tmp_path / ".venv/bin/python").chmod(0o755)
    done = subprocess.run([tmp_path / "scripts/setup"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    warnings = [line for line in done.stderr.splitlines() if "warning" in line]
    assert ["ValueError: no room for 'it'" in line for line in warnings] == [True] * code
    assert "Traceback" not in done.stderr
    assert (tmp_path / ".venv/.saflite-compiled").exists(), "it is not tried again at each start"
