"""Answers kept by canonical test-case text, so that nobody pays twice for the same question."""

from __future__ import annotations

import threading
from collections import OrderedDict

from saflite.contract.ids import short_id
from saflite.contract.test_case import TestCase
from saflite.scorer_pool.llm.case_text import canonical
from saflite.scorer_pool.llm.prompt import TEMPLATE
from saflite.scorer_pool.model import ModelScore, PolicyBrief

KEPT_MAX = 50_000


def key_of(test_case: TestCase, briefs: tuple[PolicyBrief, ...], model_digest: str) -> str:
    """Return the key of an answer: what was asked about, under which policies, of which model and template."""
    words = "\n".join(f"{brief.name}\n{brief.interestingness}\n{brief.state}" for brief in briefs)
    return short_id(f"{TEMPLATE}\n{model_digest}\n{words}\n{canonical(test_case)}".encode())


class Cache:
    """A bounded store of scores, the oldest forgotten first. Safe to use from several threads."""

    def __init__(self, kept_max: int = KEPT_MAX) -> None:
        self._kept: OrderedDict[str, ModelScore] = OrderedDict()
        self._kept_max = kept_max
        self._lock = threading.Lock()

    def get(self, key: str) -> ModelScore | None:
        """Return the score kept under the key, None if there is none."""
        with self._lock:
            return self._kept.get(key)

    def put(self, key: str, score: ModelScore) -> None:
        """Keep a score; faults are never kept."""
        if score.fault:
            return
        with self._lock:
            self._kept[key] = score
            while len(self._kept) > self._kept_max:
                self._kept.popitem(last=False)
