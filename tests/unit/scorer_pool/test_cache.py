"""Answers kept by their question: so many at most, and no faults."""

from __future__ import annotations

from saflite.scorer_pool.llm.cache import Cache
from saflite.scorer_pool.model import ModelScore


def test_cache_is_bounded_and_keeps_no_faults() -> None:
    cache = Cache(kept_max=2)
    for key in "abc":
        cache.put(key, ModelScore(1.0))
    cache.put("d", ModelScore(1.0, fault="schema"))
    assert [cache.get(key) is not None for key in "abcd"] == [False, True, True, False]
