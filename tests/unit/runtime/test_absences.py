"""One vanished worker is gone at once, many together get a lease time."""

from __future__ import annotations

from saflite.runtime.absences import SETTLE_S, Absences


def _absences(count: int) -> Absences:
    absences = Absences(patience_s=2.0)
    for number in range(count):
        absences.back((f"w{number}", "fly"))
    return absences


def test_one_of_many_is_gone_at_once() -> None:
    absences = _absences(6)
    absences.vanished(("w1", "fly"), 10.0)
    assert absences.due(10.0 + SETTLE_S) == [("w1", "fly")]
    assert absences.due(99.0) == []


def test_all_at_once_get_a_lease_time_to_come_back() -> None:
    absences = _absences(4)
    for number in range(4):
        absences.vanished((f"w{number}", "fly"), 10.0 + number * 0.01)
    assert absences.due(10.0 + SETTLE_S) == []
    for number in range(3):
        absences.back((f"w{number}", "fly"))
    assert absences.due(11.9) == []
    assert absences.due(12.1) == [("w3", "fly")]


def test_the_only_worker_is_gone_at_once() -> None:
    absences = _absences(1)
    absences.vanished(("w0", "fly"), 10.0)
    assert absences.due(10.0 + SETTLE_S) == [("w0", "fly")]


def test_a_token_that_comes_back_at_once_was_never_gone() -> None:
    absences = _absences(3)
    absences.vanished(("w0", "fly"), 10.0)
    absences.back(("w0", "fly"))
    assert absences.due(20.0) == []
