"""Another user of this machine, for tests of what is closed to him."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

PYTHON = "/usr/bin/python3"
"""One that he may start."""
NOBODY = "65534"


def prefix() -> tuple[str, ...]:
    """Return what runs a command as another user; skips the test where nobody can be made to be one."""
    if os.geteuid() != 0:
        pytest.skip("becoming another user needs root")
    if shutil.which("setpriv") is None or not Path(PYTHON).exists():
        pytest.skip(f"becoming another user needs setpriv (util-linux) and {PYTHON}")
    return ("setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups")
