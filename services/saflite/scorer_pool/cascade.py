"""Which test cases of a batch a slow model is asked about: as many as it answers while simulators still have work.

The embedded scorer screens the whole batch; the model re-ranks those the screen puts first, and what it does not answer
in time is decided by the screen. So a model server of any speed costs at most the time the flights take anyway. (A
cascade of classifiers: Viola and Jones, CVPR 2001; here the budget is time.)
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence

from saflite.scorer_pool.model import MIDDLE, Model, ModelScore

NOT_IN_TIME = "deadline"
"""The fault of a score that did not come in time: here no fault, for it was our impatience."""

LEARNT = 0.3  # weight of the latest batch in what a test case is taken to last
FORGOTTEN = 0.8  # of that, with each batch that is too short to ask in: a server that was slow may be fast again


def waits_for_a_server(model: Model) -> bool:
    """Whether a model waits for a server: its class says so by `waits = True`."""
    return bool(getattr(model, "waits", False))


class Paces:
    """How long the models take for a test case, learnt while they answer. Safe to use from several threads."""

    def __init__(self) -> None:
        self._case_s: dict[str, float] = {}
        self._lock = threading.Lock()

    def fitting(self, label: str, within_s: float, most: int) -> int:
        """Return how many test cases, at most `most`, a model answers within `within_s`; all while it is unknown."""
        with self._lock:
            case_s = self._case_s.get(label)
            if within_s <= 0.0 or case_s is None:
                return most if within_s > 0.0 else 0
            fits = min(most, int(within_s / case_s)) if case_s > 0.0 else most
            if not fits:
                self._case_s[label] = FORGOTTEN * case_s
            return fits

    def took(self, label: str, asked: int, answered: int, seconds: float) -> None:
        """Learn from `seconds` in which `answered` of `asked` test cases were; none at all tells of more for one."""
        case_s = seconds / answered if answered else 2.0 * seconds
        with self._lock:
            known = self._case_s.get(label)
            self._case_s[label] = case_s if known is None else (1.0 - LEARNT) * known + LEARNT * case_s


def first_by(screen: Sequence[ModelScore], many: int) -> list[int]:
    """Return the places of the `many` test cases the screen puts first, in order of the batch."""
    order = sorted(range(len(screen)), key=lambda place: (-_value(screen[place]), place))
    return sorted(order[:many])


def decided(screened: Sequence[ModelScore], asked: dict[int, ModelScore], screen: str) -> tuple[ModelScore, ...]:
    """Return the deciding scores: what the model asked gave, elsewhere the screen's, under the name of the `screen`.

    A fault of the model other than having had too little time stays with the score that stands in for it.
    """
    scores = []
    for place, seen in enumerate(screened):
        answer = asked.get(place)
        if answer is not None and not answer.fault:
            scores.append(answer._replace(kind=answer.kind or seen.kind))
            continue
        fault = "" if answer is None or answer.fault == NOT_IN_TIME else answer.fault
        scores.append(seen._replace(value=_value(seen), fault=fault, scored_by=seen.scored_by or screen))
    return tuple(scores)


def _value(score: ModelScore) -> float:
    return MIDDLE if score.fault or not math.isfinite(score.value) else score.value
