"""What the oracle says of a flight, per policy, and what the books make of it."""

from __future__ import annotations

from typing import Literal

import msgspec

Ruling = Literal["held", "violated", "vacuous", "inconclusive"]
"""held, violated; vacuous: the rule never applied in this flight; inconclusive: it could not be judged."""

Confirmation = Literal["candidate", "confirmed", "flaky", "unconfirmed"]


class Verdict(msgspec.Struct, frozen=True, kw_only=True):
    """One policy on one flight.

    `robustness` is the signed distance to violation in the policy's own unit: negative means violated. The witness
    window is the stretch of simulated time that decided it.
    """

    policy: str
    outcome: Ruling
    robustness: float
    witness_from_s: float = 0.0
    witness_to_s: float = 0.0
    severity: Literal["none", "soft", "hard"] = "none"
    points: float = 0.0
    message: str = ""


class Judgement(msgspec.Struct, frozen=True, kw_only=True):
    """All verdicts on one flight and the short form of it that strategies and scorers learn from.

    `track` holds (t_s, x_m, y_m, z_m) about once a second; `fingerprint` names the violation found, empty if none;
    `features` are named numbers of the flight (`min_distance_m`, `duration_s`, ...).
    """

    test_case: str
    flight_index: int
    verdicts: tuple[Verdict, ...]
    fingerprint: str = ""
    features: dict[str, float] = {}
    track: tuple[tuple[float, float, float, float], ...] = ()


class Violation(msgspec.Struct, frozen=True, kw_only=True):
    """A violation with its stable fingerprint. Reported when re-flown; `flaky` when the re-flight differs."""

    fingerprint: str
    test_case: str
    policy: str
    robustness: float
    severity: Literal["none", "soft", "hard"]
    confirmation: Confirmation
    reflown: int = 0
    failed_again: int = 0
    bit_equal: bool = False
    workers: tuple[str, ...] = ()
    message: str = ""


def worst(judgement: Judgement) -> Verdict | None:
    """Return the verdict with the least robustness among the conclusive ones, None if there is none."""
    conclusive = [verdict for verdict in judgement.verdicts if verdict.outcome != "inconclusive"]
    return min(conclusive, key=lambda verdict: (verdict.robustness, verdict.policy), default=None)
