"""What strategies and learning scorers are told of a test case that has ended. Pure."""

from __future__ import annotations

from saflite.campaign.lifecycle.confirmation import violated_verdicts, worst_robustness
from saflite.contract.flight import Ending
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import Judgement, nearest, vacuous, worst
from saflite.contract.work import Outcome, RuleOutcome


def outcome_of(
    test_case: TestCase,
    round_: int,
    ending: Ending,
    judgement: Judgement | None,
    behaviours: tuple[str, ...] = (),
    founded: int = 0,
) -> Outcome:
    """Return the outcome of a test case; `judgement` is that of the flight that counts, None if it was not judged."""
    if judgement is None:
        return Outcome(test_case=test_case, round=round_, ending=ending, robustness=None)
    return Outcome(
        test_case=test_case,
        round=round_,
        ending=ending,
        robustness=worst_robustness(judgement),
        nearness=nearest(judgement),
        violated=tuple(verdict.policy for verdict in violated_verdicts(judgement)),
        features=judgement.features,
        track=judgement.track,
        behaviours=behaviours,
        founded=founded,
        points=max((verdict.points for verdict in judgement.verdicts), default=0.0),
        rules=tuple(
            RuleOutcome(verdict.policy, verdict.outcome, verdict.nearness, verdict.robustness, verdict.applied_from_s)
            for verdict in judgement.verdicts
        ),
        transitions=judgement.transitions,
    )


def state_of(judgement: Judgement) -> str:
    """Return how a test case without violation ended: held, vacuous if no rule applied, inconclusive if none could."""
    if worst(judgement) is not None:
        return "held"
    return "vacuous" if vacuous(judgement) else "inconclusive"
