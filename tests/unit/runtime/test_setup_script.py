"""`scripts/setup` over a stand-in for Python, and `scripts/bench`: what is wrong is said."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
PYTHON = """#!/bin/sh
[ "$1" = - ] || exit 0
echo "Traceback (most recent call last):" >&2
echo "ValueError: no room for 'it'" >&2
exit {code}
"""


def _clone(folder: Path, python: str) -> Path:
    """Make as much of a clone as is needed, and return its `scripts/setup`."""
    for name in ("scripts/setup", "pyproject.toml", "deploy/constraints.txt", "scripts/build_native.py"):
        (folder / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, folder / name)
    for made in (".venv/bin", "services/saflite/flight/native"):
        (folder / made).mkdir(parents=True)
    (folder / ".venv/bin/python").write_text(python)
    (folder / ".venv/bin/python").chmod(0o755)
    return folder / "scripts/setup"


def test_an_unknown_extra_is_refused_before_anything_is_installed(tmp_path: Path) -> None:
    setup = _clone(tmp_path, f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    done = subprocess.run([setup, "test,lvie"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "setup: refused: extras: expected betaflight, docs, live," in done.stderr
    assert done.stderr.endswith("got lvie\n")
    assert not list(tmp_path.glob(".venv/.saflite*"))


@pytest.mark.parametrize("code", [0, 1])
def test_what_is_not_compiled_is_told_in_one_line(code: int, tmp_path: Path) -> None:
    setup = _clone(tmp_path, PYTHON.format(code=code))
    done = subprocess.run([setup], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    warnings = [line for line in done.stderr.splitlines() if "warning" in line]
    assert ["ValueError: no room for 'it'" in line for line in warnings] == [True] * code
    assert "Traceback" not in done.stderr
    assert (tmp_path / ".venv/.saflite-compiled").exists(), "it is not tried again at each start"


def test_a_measurement_nobody_knows_is_answered_with_those_there_are() -> None:
    done = subprocess.run([sys.executable, ROOT / "scripts/bench", "rqq1"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "  rq1         the paper's first question." in done.stderr
    assert done.stderr.endswith("no measurement 'rqq1'; did you mean rq1?\n")
