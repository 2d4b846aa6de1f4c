"""One vanished worker is gone at once, many together get a lease time."""

from __future__ import annotations

from saflite.runtime.liveness import SETTLE_S, TOKENS_MAX, Liveness


def _liveness(count: int) -> Liveness:
    liveness = Liveness(patience_s=2.0)
    for number in range(count):
        liveness.back((f"w{number}", "fly", "s"))
    return liveness


def test_who_joined_without_a_token_is_absent_after_a_while_and_who_shows_one_is_not() -> None:
    liveness = Liveness(patience_s=2.0)
    for name in ("ghost", "late", "early"):
        who = (name, "fly", "life")
        if name == "early":
            liveness.back(who)
        liveness.joined(who, 10.0)
    liveness.back(("late", "fly", "life"))
    liveness.joined(("ghost", "fly", "life"), 11.9)  # saying it again and again does not help
    assert liveness.due(11.9) == []
    assert liveness.due(12.0) == [("ghost", "fly", "life")]
    assert liveness.due(60.0) == []


def test_tokens_of_a_key_are_bounded_and_vanished_ones_make_room() -> None:
    liveness = Liveness(patience_s=2.0, key_of=lambda worker: "eve" if worker.startswith("eve-") else "")
    tokens = [(f"eve-{number}", "fly", "life") for number in range(TOKENS_MAX + 10)]
    assert [liveness.back(who) for who in tokens] == [True] * TOKENS_MAX + [False] * 10
    assert all(liveness.back(who) for who in tokens[:TOKENS_MAX]), "said again"
    assert all(liveness.back((f"fly-{number}", "fly", "life")) for number in range(2 * TOKENS_MAX))
    for who in tokens:
        liveness.vanished(who, 10.0)
    assert sorted(liveness.due(10.0 + SETTLE_S)) == sorted(tokens[:TOKENS_MAX])
    assert [liveness.back(who) for who in tokens] == [True] * TOKENS_MAX + [False] * 10


def test_one_of_many_is_gone_at_once() -> None:
    liveness = _liveness(6)
    liveness.vanished(("w1", "fly", "s"), 10.0)
    assert liveness.due(10.0 + SETTLE_S) == [("w1", "fly", "s")]
    assert liveness.due(99.0) == []


def test_all_at_once_get_a_lease_time_to_come_back() -> None:
    liveness = _liveness(4)
    for number in range(4):
        liveness.vanished((f"w{number}", "fly", "s"), 10.0 + number * 0.01)
    assert liveness.due(10.0 + SETTLE_S) == []
    for number in range(3):
        liveness.back((f"w{number}", "fly", "s"))
    assert liveness.due(11.9) == []
    assert liveness.due(12.1) == [("w3", "fly", "s")]


def test_the_only_worker_is_gone_at_once() -> None:
    liveness = _liveness(1)
    liveness.vanished(("w0", "fly", "s"), 10.0)
    assert liveness.due(10.0 + SETTLE_S) == [("w0", "fly", "s")]


def test_a_token_that_comes_back_at_once_was_never_gone() -> None:
    liveness = _liveness(3)
    liveness.vanished(("w0", "fly", "s"), 10.0)
    liveness.back(("w0", "fly", "s"))
    assert liveness.due(20.0) == []
