"""What the autopilots of this package say of themselves, found by their place: `autopilots/<name>/describe.py`."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from functools import cache
from typing import Any, cast

from saflite.contract.target_info import TargetInfo
from saflite.contract.test_case import DEFAULT_TARGET


def default_target() -> TargetInfo:
    """Return the description of the target that is always there; raises Unavailable where it was not built."""
    return cast(TargetInfo, importlib.import_module(f"{__package__}.{DEFAULT_TARGET}.describe").describe())


@cache
def default_settings(target: str) -> Mapping[str, float]:
    """Return the defaults of a target's parameters by name; none for a target that is not of this package."""
    return {name: float(row.default) for name, row in _parameters(target).items()}


@cache
def setting_ranges(target: str) -> Mapping[str, tuple[float, float]]:
    """Return the documented ranges of a target's parameters by name; none for one that is not of this package."""
    return {name: (float(row.low), float(row.high)) for name, row in _parameters(target).items()}


def _parameters(target: str) -> Mapping[str, Any]:
    if target != DEFAULT_TARGET:
        return {}
    table = importlib.import_module(f"{__package__}.{DEFAULT_TARGET}.parameters").parameter_table()
    return cast(Mapping[str, Any], table)
