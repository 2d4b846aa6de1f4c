"""Violations in words for people."""

from __future__ import annotations

import pytest

from saflite.contract.verdict import Violation, with_mode_named


@pytest.mark.parametrize(
    ("behaviour", "told"),
    [
        ("r, soft, in mode 6", "r, soft, in RESCUE"),
        ("r, soft, in mode 6, SEGV in f < g", "r, soft, in RESCUE, SEGV in f < g"),
        ("r, soft, in mode 60", "r, soft, in mode 60"),
        ("r, soft, in mode -1", "r, soft, in an unknown mode"),
        ("r, soft, right of obstacle 3 on leg 2", "r, soft, right of obstacle 3 on leg 2"),
    ],
)
def test_a_mode_bears_the_name_the_target_gives_it(behaviour: str, told: str) -> None:
    violation = Violation(
        fingerprint=16 * "a",
        test_case=16 * "b",
        policy="r",
        robustness=-1.0,
        severity="soft",
        confirmation="confirmed",
        behaviour=behaviour,
    )
    assert with_mode_named(violation, {"ANGLE": 0, "RESCUE": 6}).behaviour == told
    nameless = behaviour.replace("in mode -1", "in an unknown mode")
    assert with_mode_named(violation, {}).behaviour == nameless
