"""How far one flight came towards breaking one rule, on one scale: not applying, applying, near a violation."""

from __future__ import annotations

from saflite.contract.work import Outcome, RuleOutcome

APPLIED = 0.5
CRISP_HELD = 1.0
"""The robustness of a rule that held with yes-or-no parts alone: it tells no distance."""


def progress(rule: RuleOutcome) -> float | None:
    """Return 0 to 1: below APPLIED the rule was silent (an antecedent nearer to true is more), 1 it was violated.

    None where it could not be judged.
    """
    if rule.outcome == "violated":
        return 1.0
    if rule.outcome == "vacuous":
        return APPLIED * rule.nearness
    if rule.outcome == "inconclusive" or rule.robustness is None:
        return None
    return APPLIED + 0.5 * APPLIED / (0.5 + max(0.0, rule.robustness))


def by_policy(outcome: Outcome) -> dict[str, float]:
    """Return the progress of every policy that the flight said something of."""
    told = ((rule.policy, progress(rule)) for rule in outcome.rules)
    return {policy: value for policy, value in told if value is not None}


def applied_s(outcome: Outcome) -> dict[str, float]:
    """Return when each rule that applied first did."""
    return {rule.policy: rule.applied_from_s for rule in outcome.rules if rule.applied_from_s is not None}


def answers(outcome: Outcome) -> tuple[frozenset[int], frozenset[int]]:
    """Return the places of the inputs that were given in a flight, and of those that the target took.

    What was refused makes no step; what was due after the last that made one may never have been given.
    """
    stimuli = outcome.test_case.stimuli
    taken = frozenset(step.stimulus for step in outcome.transitions if 0 <= step.stimulus < len(stimuli))
    if not outcome.transitions:
        return frozenset(range(len(stimuli))), frozenset(range(len(stimuli)))
    last_s = max((stimuli[place].at_s for place in taken), default=-1.0)
    return taken | {place for place, one in enumerate(stimuli) if one.at_s <= last_s}, taken
