"""A key that asks too much is slowed down; others, and the farm's own processes, are not."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from saflite.runtime.rate_limit import PEERS_MAX, QUESTION_BYTES, RateLimit


def test_a_burst_passes_and_a_flood_does_not() -> None:
    limit = RateLimit(rate_per_s=10.0, burst=5.0)
    assert [limit.allows("lab", 0.0) for _ in range(7)] == [True] * 5 + [False] * 2
    assert limit.allows("ana", 0.0)
    assert all(limit.allows("", 0.0) for _ in range(100))
    assert [limit.allows("lab", 0.2) for _ in range(3)] == [True, True, False]


def test_a_long_question_counts_as_several_and_may_be_longer_than_a_burst() -> None:
    limit = RateLimit(rate_per_s=10.0, burst=100.0)
    assert limit.allows("eve", 0.0, 1_000 * QUESTION_BYTES)
    assert not limit.allows("eve", 80.0), "it is paid off first: 1,001 of them, at 10 a second"
    assert limit.allows("eve", 91.0)
    assert limit.allows("", 0.0, 1_000 * QUESTION_BYTES)


@given(st.lists(st.floats(0.0, 0.2), min_size=1, max_size=300))
def test_no_more_pass_than_burst_and_rate_allow(pauses_s: list[float]) -> None:
    limit, now_s, passed = RateLimit(rate_per_s=10.0, burst=5.0), 0.0, 0
    for pause_s in pauses_s:
        now_s += pause_s
        passed += limit.allows("lab", now_s)
    assert passed <= 5.0 + 10.0 * now_s + 1e-6


def test_names_without_end_take_no_memory_without_end() -> None:
    limit = RateLimit()
    for number in range(2 * PEERS_MAX + 1):
        assert limit.allows(f"peer{number}", 0.0)
    assert len(limit._buckets) <= PEERS_MAX
