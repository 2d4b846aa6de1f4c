"""The suites of targets over every target found by its place that can fly on this machine."""

from __future__ import annotations

import pytest
from _pytest.mark import ParameterSet

from saflite.conformance.kit import Check, findings, name_of
from saflite.conformance.targets import checks_of
from saflite.simulator_worker.registry import load_target, target_names, why_missing

EXTERNAL = ("aerialist", "betaflight", "ardupilot", "px4")  # autopilots of others, in processes of their own


def _case(name: str, check: Check) -> ParameterSet:
    return pytest.param(name, check, marks=pytest.mark.live if name.startswith(EXTERNAL) else ())


@pytest.mark.parametrize(
    ("target", "check"),
    [_case(name, check) for name in target_names() for check in checks_of(load_target(name))],
    ids=lambda value: name_of(value) if isinstance(value, Check) else str(value),
)
def test_target(target: str, check: Check) -> None:
    reason = why_missing(target)
    if reason:
        pytest.skip(f"{target}: {reason}")
    assert findings([check]) == []
