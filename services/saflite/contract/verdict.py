"""What the oracle says of a flight, per policy, and what the books make of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Literal

import msgspec

from saflite.contract.bounds import Account, Count, Features, Number, Place, Share, Text, Track, Word
from saflite.contract.names import Name, ShortId, ShortIdOrNone, StateWords

Ruling = Literal["held", "violated", "vacuous", "inconclusive"]
"""held, violated; vacuous: the rule never applied in this flight; inconclusive: it could not be judged."""

_IN_MODE = re.compile(r"in mode (-?\d+)")
NEVER_APPLIED = "the rule never applied"
"""What people are told of a vacuous verdict."""

Confirmation = Literal["candidate", "confirmed", "flaky", "unconfirmed", "similar"]


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """One policy on one flight.

    `robustness` is the signed distance to violation in the policy's own unit: negative means violated; None unless
    the rule held or was violated. `nearness`, 0 to 1, is the greatest share of the rule's conditions that were true at
    once: 1 where the rule applied, 0 where it could not be judged. `applied_from_s` is when its condition first held,
    None where it never did or the rule has none. The witness window is the stretch of simulated time
    that decided the outcome. `behaviour` says in words in which way the rule was violated, as far as one flight tells;
    `cause` names the inputs that may be behind it. Both are empty where it was not violated, or nobody can tell.
    """

    policy: Name
    outcome: Ruling
    robustness: Number | None = None
    nearness: Share = 1.0
    applied_from_s: Number | None = None
    witness_from_s: Number = 0.0
    witness_to_s: Number = 0.0
    severity: Literal["none", "soft", "hard"] = "none"
    points: Number = 0.0
    message: Text = ""
    behaviour: Text = ""
    cause: Annotated[tuple[Word, ...], msgspec.Meta(max_length=1_000)] = ()

    @property
    def margin(self) -> float:
        """The robustness of a verdict that is known to be held or violated."""
        assert self.robustness is not None, f"{self.policy} is {self.outcome}: it has no robustness"
        return self.robustness


TRANSITIONS_MAX = 256


class Transition(msgspec.Struct, frozen=True, array_like=True):
    """One step of a flight through the target's states, in words: mode, standing, disarmed, failsafes raised.

    `stimulus` is the place in `TestCase.stimuli` of the input given in the state `before`, -1 where the target changed
    by itself; `preceding` that of the input given last before, -1 for none. `after` equals `before` where nothing
    changed until the next input.
    """

    before: StateWords
    after: StateWords
    stimulus: Place = -1
    preceding: Place = -1


class Judgement(msgspec.Struct, frozen=True, kw_only=True):
    """All verdicts on one flight and the short form of it that strategies and scorers learn from.

    `track` holds (t_s, x_m, y_m, z_m) about once a second; `fingerprint` names the violation found, empty if none;
    `features` are named numbers of the flight (`min_distance_m`, `duration_s`, ...); `transitions` are its steps
    through the target's states, in order.
    """

    test_case: ShortId
    flight_index: Count
    verdicts: Annotated[tuple[Verdict, ...], msgspec.Meta(max_length=1_000)]
    fingerprint: ShortIdOrNone = ""
    features: Features = {}
    track: Track = ()
    transitions: Annotated[tuple[Transition, ...], msgspec.Meta(max_length=TRANSITIONS_MAX)] = ()


class Violation(msgspec.Struct, frozen=True, kw_only=True):
    """A violation. Those of one behaviour share its `fingerprint`; `behaviour` tells it in words.

    `similar` is a find of a behaviour that its `representative`, another test case, has confirmed: it was not re-flown.
    `confirmed` when enough of the `reflown` re-flights, each under noise of its own, violated again (`failed_again`),
    `flaky` when they did not, `unconfirmed` when too few could be flown to say. `rate_low` to `rate_high` is the 95 %
    interval of the rate at which it violates under other noise (Wilson); None without a re-flight. `robustness` and
    `severity` are those of the flight that shows the violation (`flight_index`), the one it was chosen for: what the
    others showed says how much of that is luck. `again_low` to `again_high` is the robustness of the re-flights that
    violated again, None if none did; in `hard_again` of them it was hard.
    """

    fingerprint: ShortId
    test_case: ShortId
    policy: Name
    robustness: Number
    severity: Literal["none", "soft", "hard"]
    confirmation: Confirmation
    reflown: Count = 0
    failed_again: Count = 0
    rate_low: Share | None = None
    rate_high: Share | None = None
    again_low: Number | None = None
    again_high: Number | None = None
    hard_again: Count = 0
    flight_index: Count = 0
    behaviour: Text = ""
    representative: ShortIdOrNone = ""
    workers: Annotated[tuple[Name, ...], msgspec.Meta(max_length=10_000)] = ()
    message: Account = ""


_STANDINGS, _SEVERITIES = {"confirmed": 0, "unconfirmed": 1, "flaky": 2}, {"hard": 0, "soft": 1}


def worst_first(violation: Violation) -> tuple[int, int, float, str]:
    """Return what violations are shown by: confirmed ones first, of these hard ones, of these those broken most."""
    standing, severity = _STANDINGS.get(violation.confirmation, 3), _SEVERITIES.get(violation.severity, 2)
    return standing, severity, violation.robustness, violation.test_case


def with_mode_named(violation: Violation, modes: Mapping[str, int]) -> Violation:
    """Return a violation for people: its behaviour has the mode's name in place of the number where there is one."""
    return msgspec.structs.replace(violation, behaviour=modes_named(violation.behaviour, modes))


def modes_named(behaviour: str, modes: Mapping[str, int]) -> str:
    """Return a behaviour for people: names of modes in place of numbers; -1 is that of a target that tells none."""
    names = {"-1": "an unknown mode", **{str(number): name for name, number in modes.items()}}
    return _IN_MODE.sub(lambda found: f"in {names[found[1]]}" if found[1] in names else found[0], behaviour)


def failed_again(violation: Violation) -> str:
    """Return in words how often it violated again, with the interval of its rate, and how badly, as far as is known."""
    count = f"{violation.failed_again} of {violation.reflown}"
    if violation.rate_low is None or violation.rate_high is None:
        return count
    alone = "" if violation.failed_again else ", only under its own noise"
    rate = f"rate {violation.rate_low:.2f} to {violation.rate_high:.2f}"
    return ", ".join(filter(None, (f"{count}{alone}", rate, _how_badly(violation))))


def _how_badly(violation: Violation) -> str:
    """Return in words what the re-flights that violated again showed, empty if none did."""
    if violation.again_low is None or violation.again_high is None:
        return ""
    least, most = f"{violation.again_low:.3f}", f"{violation.again_high:.3f}"
    hard = violation.severity == "hard" or violation.hard_again
    many = f"hard in {violation.hard_again or 'none'}" if hard else ""
    told = f"robustness then {least if least == most else f'{least} to {most}'}"
    return ", ".join(filter(None, (told, many)))


def worst(judgement: Judgement) -> Verdict | None:
    """Return the verdict with the least robustness among those held or violated, None if there is none."""
    conclusive = [verdict for verdict in judgement.verdicts if verdict.robustness is not None]
    return min(conclusive, key=lambda verdict: (verdict.margin, verdict.policy), default=None)


def vacuous(judgement: Judgement) -> tuple[str, ...]:
    """Return the policies whose rule never applied."""
    return tuple(verdict.policy for verdict in judgement.verdicts if verdict.outcome == "vacuous")


def nearest(judgement: Judgement) -> float | None:
    """Return how near the nearest of the rules that never applied came to applying, 0 to 1; None if all applied."""
    return max((verdict.nearness for verdict in judgement.verdicts if verdict.outcome == "vacuous"), default=None)
