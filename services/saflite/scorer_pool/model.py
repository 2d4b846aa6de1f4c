"""What every scorer model is: a function from a job to one score per test case.

A model keeps no memory of its own that could change a score: what it may learn from stands in `Job.history`, so a
score depends on (model, test case, rng_seed, history up to the cursor) only, never on which worker made it or when.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from saflite.contract.clock import Clock
from saflite.contract.score import Usage
from saflite.contract.service import Cancelled
from saflite.contract.test_case import TestCase
from saflite.contract.work import Outcome, PolicyTexts
from saflite.scorer_pool.llm.transcript import Transcript, silent

MIDDLE = 5.0
"""The score of a model that has nothing to say: the middle of the scale, so that order alone is left to others."""


class PolicyBrief(NamedTuple):
    """What a scorer is told of a policy: the Definition of Interestingness in words, and what is behind it.

    `signals` are the names the formula reads, `show` the state to be shown, `inputs` the inputs that may be mutated;
    `state` says in words what the caller knows of the current state beyond the test case.
    """

    name: str
    interestingness: str = ""
    signals: tuple[str, ...] = ()
    show: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    state: str = ""


BriefOf = Callable[[str, PolicyTexts | None], PolicyBrief]
"""Gives the brief of a policy by name, also of those in the texts; raises Refused for an unknown one. Handed in by the
runtime."""


class Job(NamedTuple):
    """Test cases to be scored and all a model may know. `history` holds outcomes in (round, index) order."""

    test_cases: tuple[TestCase, ...]
    briefs: tuple[PolicyBrief, ...] = ()
    rng_seed: int = 0
    round: int = 0
    history: tuple[Outcome, ...] = ()
    cursor: int = -1
    deadline_s: float = 60.0
    within_s: float | None = None  # see `ScoreWork`
    cancelled: Cancelled = lambda: False


class ModelScore(NamedTuple):
    """One score, 0..10. `scored_by` names the model that answered where it is not the one asked; `fault` says why.

    `kind` names what the test case is expected to show: the choice spreads over kinds (see `Score.kind`).
    """

    value: float
    reason: str = ""
    fault: str = ""
    scored_by: str = ""
    prompt_digest: str = ""
    kind: str = ""


class ScoreSheet(NamedTuple):
    """One score per test case of the job, in order, what it took, and the digest of the model that answered."""

    scores: tuple[ModelScore, ...]
    usage: Usage = Usage()
    digest: str = ""


class Tools(NamedTuple):
    """What a model is built with: the clock, other models by label, the limit for loading, the transcript."""

    clock: Clock
    model: Callable[[str], Model]
    load_deadline_s: float = 300.0
    transcript: Transcript = silent


class Model(Protocol):
    """One scorer model. Its file stands in `scorer_pool/models/` and defines `class Model` made with (argument, tools).

    `parallel` is how many jobs it takes at once, each in a thread of its own: 1 for what computes here, more for what
    waits for a server. One that does may say so by `waits = True`: then it takes part in the cascade.
    """

    label: str
    parallel: int

    def score(self, job: Job) -> ScoreSheet:
        """Return one score per test case; never raises for what a model server says or does not say."""
        ...

    def warm(self, cancelled: Cancelled) -> str:
        """Load and answer one probe; returns a line about it, raises Unavailable or Refused where it cannot."""
        ...

    def close(self) -> None:
        """Free what the model holds."""
        ...
