"""Violations in words for people."""

from __future__ import annotations

from typing import Literal

import pytest

from saflite.contract.verdict import Confirmation, Violation, with_mode_named, worst_first


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


def test_what_is_hard_stands_before_what_is_soft_however_far_it_is_broken() -> None:
    def of(name: str, confirmation: Confirmation, severity: Literal["soft", "hard"], robustness: float) -> Violation:
        return Violation(
            fingerprint=16 * "a",
            test_case=16 * name,
            policy="r",
            robustness=robustness,
            severity=severity,
            confirmation=confirmation,
        )

    order = [
        of("b", "confirmed", "hard", -0.5),
        of("0", "confirmed", "soft", -1.5),
        of("1", "confirmed", "soft", -1.5),
        of("2", "unconfirmed", "hard", -9.0),
        of("3", "flaky", "hard", -9.0),
        of("4", "flaky", "soft", -1.0),
    ]
    mixed = [order[at] for at in (3, 1, 5, 0, 4, 2)]
    assert sorted(mixed, key=worst_first) == order
