"""The embedded default: geometry and a cheap flight together for layouts, `relevance` for stimuli. Needs no server."""

from __future__ import annotations

from saflite.contract.service import Cancelled
from saflite.scorer_pool.labels import no_argument
from saflite.scorer_pool.learning.features import has_layout
from saflite.scorer_pool.model import Job, ModelScore, ScoreSheet, Tools

FLIGHT_WEIGHT = 0.9
"""Share of the cheap flight. On 260 random layouts of missions 2 and 3, flown on the reference target, any share from
0.8 on ranked about as well as the cheap flight alone (ROC area 0.92 to 0.95, geometry alone 0.56 to 0.65)."""


class Model:
    """Asks the embedded models that have something to say about each test case."""

    parallel = 1

    def __init__(self, argument: str, tools: Tools) -> None:
        no_argument("blend", argument)
        self.label = "blend"
        self._gap = tools.model("gap")
        self._low_fidelity = tools.model("low_fidelity")
        self._relevance = tools.model("relevance")

    def score(self, job: Job) -> ScoreSheet:
        """Return one score per test case."""
        layouts = [place for place, case in enumerate(job.test_cases) if has_layout(case)]
        others = [place for place, case in enumerate(job.test_cases) if not has_layout(case)]
        scores: dict[int, ModelScore] = {}
        if layouts:
            part = job._replace(test_cases=tuple(job.test_cases[place] for place in layouts))
            seen, flown = self._gap.score(part), self._low_fidelity.score(part)
            scores |= zip(layouts, map(_mixed, seen.scores, flown.scores), strict=True)
        if others:
            part = job._replace(test_cases=tuple(job.test_cases[place] for place in others))
            scores |= zip(others, self._relevance.score(part).scores, strict=True)
        return ScoreSheet(tuple(scores[place] for place in range(len(job.test_cases))), digest="blend-4")

    def warm(self, cancelled: Cancelled) -> str:
        """Warm the parts."""
        return "; ".join(part.warm(cancelled) for part in (self._gap, self._low_fidelity, self._relevance))

    def close(self) -> None:
        """Nothing to free: the pool closes the parts."""


def _mixed(seen: ModelScore, flown: ModelScore) -> ModelScore:
    value = (1.0 - FLIGHT_WEIGHT) * seen.value + FLIGHT_WEIGHT * flown.value
    reason = f"gap {seen.value:.1f} ({seen.reason}); low_fidelity {flown.value:.1f} ({flown.reason})"
    return ModelScore(value, reason, kind=flown.kind)
