"""Joining a farm that is full for now."""

from __future__ import annotations

from saflite.contract.join import Joined
from saflite.runtime.joining import Joining


def test_a_full_farm_is_waited_for_and_not_given_up() -> None:
    joining, full = Joining(0.0), Joined(accepted=False, message="full", retry_after_s=5.0)
    for turn in range(100):
        at_s = 5.0 * turn
        assert joining.due(at_s)
        joining.answered(full, at_s)
        assert not joining.refused
        assert not joining.due(at_s + 4.9)
        assert joining.next_s() == at_s + 5.0
    joining.answered(Joined(accepted=True, session="life"), 600.0)
    assert joining.session == "life"
