"""What mends a missing part: in a checkout its scripts, in an installed wheel what came with it."""

from __future__ import annotations

import sys
from pathlib import Path

SCRIPTS = Path(__file__).parents[3] / "scripts"


def builds_library() -> str:
    """Return the command that builds the compiled library, or installs it again."""
    if (SCRIPTS / "build_native.py").exists():
        return "`python scripts/build_native.py`"
    return f"`{sys.executable} -m pip install --force-reinstall --no-deps saflite-farm`"


def builds_firmware(*variants: str) -> str:
    """Return the command that builds variants of Betaflight; without any, those that campaigns fly."""
    if (SCRIPTS / "setup").exists():
        return f"`{' '.join(('scripts/setup betaflight', *variants))}`"
    return f"`{' '.join((sys.executable, '-m saflite.flight.autopilots.betaflight.install', *variants))}`"
