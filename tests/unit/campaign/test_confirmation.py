"""What re-flights make of a violation."""

from __future__ import annotations

import pytest

from saflite.campaign.lifecycle.confirmation import confirmation_of


@pytest.mark.parametrize(
    ("reflown", "again", "asked", "needed", "expected"),
    [
        (1, 1, 1, 1, "confirmed"),
        (1, 0, 1, 1, "flaky"),
        (0, 0, 0, 1, "unconfirmed"),
        (0, 0, 1, 1, "unconfirmed"),
        (3, 2, 3, 2, "confirmed"),
        (3, 1, 3, 2, "flaky"),
        (2, 1, 3, 2, "unconfirmed"),  # the third could not be flown and might have failed
        (2, 0, 3, 2, "flaky"),
        (2, 2, 3, 2, "confirmed"),
        (1, 1, 1, 2, "unconfirmed"),  # the budget left room for one only
    ],
)
def test_confirmation(reflown: int, again: int, asked: int, needed: int, expected: str) -> None:
    assert confirmation_of(reflown, again, asked, needed) == expected
