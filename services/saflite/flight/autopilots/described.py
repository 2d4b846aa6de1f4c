"""What the autopilots of this package say of themselves, found by their place: `autopilots/<name>/describe.py`."""

from __future__ import annotations

import importlib
from typing import cast

from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import DEFAULT_TARGET


def default_target() -> TargetInfo:
    """Return the description of the target that is always there; raises Unavailable where it was not built."""
    return cast(TargetInfo, importlib.import_module(f"{__package__}.{DEFAULT_TARGET}.describe").describe())
