"""Feature vectors by identity, kept so that a history of thousands is turned into numbers only once."""

from __future__ import annotations

import threading
from collections import OrderedDict

import numpy as np
from numpy.typing import NDArray

from saflite.contract.test_case import TestCase, identity
from saflite.scorer_pool.features import FEATURES, features

KEPT_MAX = 20_000


class Vectors:
    """A bounded store of feature vectors. Safe to use from several threads."""

    def __init__(self) -> None:
        self._kept: OrderedDict[str, NDArray[np.float64]] = OrderedDict()
        self._lock = threading.Lock()

    def of(self, test_cases: list[TestCase]) -> NDArray[np.float64]:
        """Return the vectors of the test cases, shape (count, FEATURES)."""
        if not test_cases:
            return np.zeros((0, FEATURES))
        return np.stack([self._one(case) for case in test_cases])

    def _one(self, test_case: TestCase) -> NDArray[np.float64]:
        name = identity(test_case)
        with self._lock:
            if name in self._kept:
                return self._kept[name]
        vector = features(test_case)
        with self._lock:
            self._kept[name] = vector
            while len(self._kept) > KEPT_MAX:
                self._kept.popitem(last=False)
        return vector
