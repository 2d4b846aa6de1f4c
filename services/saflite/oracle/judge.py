"""Judges a flight against policies: one verdict each, the behaviour of the violated, the short form of the flight."""

from __future__ import annotations

import math
from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from saflite.contract.flight import AUTOPILOT_ALIVE, FLOWN_ENDINGS, Flight, Trace
from saflite.contract.test_case import TestCase
from saflite.contract.verdict import NEVER_APPLIED, Judgement, Verdict
from saflite.contract.work import PolicyTexts
from saflite.oracle.behaviour import behaviour_of, cause_of, fingerprint
from saflite.oracle.features import features_of, track_of
from saflite.oracle.finding import Finding, begins_broken, find
from saflite.oracle.policy import Policy, load_policy
from saflite.oracle.signals import FlightSignals
from saflite.oracle.states import transitions_of
from saflite.oracle.stl import Evaluator

ROBUSTNESS_MAX = 1000.0
CRISP = 1.0  # told where only yes-or-no parts decided
BEGAN_BROKEN = "the state in which the flight began breaks the rule: nothing that was given did"


def judge(
    test_case: TestCase,
    flight: Flight,
    trace: Trace | None,
    policies: tuple[str, ...],
    policy_texts: PolicyTexts | None = None,
    sources: Mapping[str, str] | None = None,
    untold: frozenset[str] = frozenset(),
) -> Judgement:
    """Return the judgement on one flight.

    Args:
        test_case: what was flown.
        flight: how it ended. An ending that says nothing of the vehicle (wedged, infra, lost) makes every verdict
            inconclusive; a dead autopilot adds a violated verdict `autopilot-alive`.
        trace: its signals; None if there is no trace.
        policies: names, or paths of policy files.
        policy_texts: the text of policies that do not ship.
        sources: where each signal comes from in a log, for verdicts that miss one; None if it is a flight of ours.
        untold: signals made of orders that a log does not keep.

    Raises:
        Refused: a policy is unknown or its file is wrong.
    """
    loaded = [load_policy(name, policy_texts) for name in policies]
    if trace is None or trace.samples == 0 or flight.ending not in FLOWN_ENDINGS:
        reason = f"nothing to judge: the flight ended as {flight.ending}" + ("" if trace else " without a trace")
        verdicts = [_inconclusive(policy, reason) for policy in loaded]
        return _judgement(test_case, flight, verdicts, {}, None)
    is_log = sources is not None
    if not is_log:
        loaded = [policy.on(test_case.target.name) for policy in loaded]
    signals = FlightSignals(test_case, flight, trace, is_log=is_log, untold=untold)
    features = features_of(test_case, signals)
    wanted = frozenset[str]().union(*(policy.signals for policy in loaded))
    judged = FlightSignals(test_case, flight, trace, between=True, is_log=is_log, untold=untold)
    shown = judged.pick(wanted)
    common = Evaluator(shown, trace.step_s, judged.moments.row)
    verdicts = []
    for policy in loaded:
        without = _assumed(policy, signals, judged.samples)
        why = _why_not(policy, test_case, signals, without, sources)
        if why:
            verdicts.append(_inconclusive(policy, why))
            continue
        own = Evaluator({**shown, **without}, trace.step_s, judged.moments.row) if without else common
        verdict = _verdict(policy, flight, own, signals, features)
        if verdict.outcome == "violated" and not is_log and begins_broken(own, policy.formula):
            verdict = _inconclusive(policy, BEGAN_BROKEN)
        verdicts.append(verdict)
    return _judgement(test_case, flight, verdicts, features, signals)


def _assumed(policy: Policy, signals: FlightSignals, moments: int) -> dict[str, NDArray[np.float32]]:
    """Return what a policy takes for granted of signals that a flight does not hold, shape (moments,) each."""
    assumed = policy.file.assumed.items()
    return {name: np.full(moments, value, dtype=np.float32) for name, value in assumed if name not in signals}


def _why_not(
    policy: Policy,
    test_case: TestCase,
    signals: FlightSignals,
    without: Mapping[str, object],
    sources: Mapping[str, str] | None,
) -> str:
    """Return why a rule cannot be judged, empty if it can: for a log with the message or parameter that would tell."""
    reason = policy.file.not_checked_on.get(test_case.target.name)
    if reason:
        return f"not checked on {test_case.target.name}: {reason}"
    missing = sorted(name for name in policy.needed if name not in signals and name not in without)
    if sources is not None and policy.needed >= {"x_m", "x_est_m"} and "x_est_m" not in signals.written:
        return "the log has no x_m (no message: a log holds where the vehicle believes to be, not where it is)"
    if not missing:
        return ""
    leaves = sorted({leaf for name in missing for leaf in signals.lacking(name)})
    if sources is None:
        return f"the trace holds no {', '.join(missing)}"
    if "obstacle_distance_m" in leaves:
        return "no obstacles are known; name them with --test-case"
    return "the log has no " + ", ".join(f"{leaf} ({sources.get(leaf, 'nothing logs it')})" for leaf in leaves)


def _judgement(
    test_case: TestCase,
    flight: Flight,
    verdicts: list[Verdict],
    features: dict[str, float],
    signals: FlightSignals | None,
) -> Judgement:
    if flight.ending == "autopilot_died":
        verdicts.append(_died(flight))
    told = [
        msgspec.structs.replace(
            verdict,
            behaviour=behaviour_of(test_case, verdict, features, signals),
            cause=cause_of(test_case, flight, verdict),
        )
        if verdict.outcome == "violated"
        else verdict
        for verdict in verdicts
    ]
    broken = [verdict for verdict in told if verdict.outcome == "violated"]
    worst = min(broken, key=lambda verdict: (verdict.margin, verdict.policy), default=None)
    return Judgement(
        test_case=flight.test_case,
        flight_index=flight.flight_index,
        verdicts=tuple(told),
        fingerprint=fingerprint(worst) if worst else "",
        features={name: value for name, value in features.items() if math.isfinite(value)},
        track=track_of(signals) if signals else (),
        transitions=transitions_of(test_case, flight, signals) if signals else (),
    )


def _verdict(
    policy: Policy, flight: Flight, evaluator: Evaluator, signals: FlightSignals, features: dict[str, float]
) -> Verdict:
    finding = find(evaluator, policy.formula)
    if finding is None:
        return _inconclusive(policy, f"a flight of {signals.samples * signals.step_s:g} s is too short for the rule")
    if math.isnan(finding.robustness):
        return _inconclusive(policy, _gaps(policy, signals) or "a division by zero")
    return _ruled(policy, finding, _hard(policy, finding, flight, evaluator, signals), features)


def _ruled(policy: Policy, finding: Finding, hard: bool, features: dict[str, float]) -> Verdict:
    violated = finding.robustness < 0
    if finding.applied_share == 0 and not violated:
        return Verdict(policy=policy.id, outcome="vacuous", nearness=finding.nearness, message=NEVER_APPLIED)
    return Verdict(
        policy=policy.id,
        outcome="violated" if violated else "held",
        robustness=_finite(finding.robustness),
        applied_from_s=finding.applied_from_s,
        witness_from_s=finding.witness_from_s,
        witness_to_s=finding.witness_to_s,
        severity=("hard" if hard else "soft") if violated else "none",
        points=_points(policy, features) if violated else 0.0,
        message=_message(policy, finding),
    )


def _finite(robustness: float) -> float:
    if math.isinf(robustness):
        return math.copysign(CRISP, robustness)
    return max(-ROBUSTNESS_MAX, min(ROBUSTNESS_MAX, robustness))


def _message(policy: Policy, finding: Finding) -> str:
    if finding.robustness >= 0:
        return ""
    margin = "" if math.isinf(finding.robustness) else f" by {-finding.robustness:.3g} {policy.unit}".rstrip()
    return f"{policy.file.title}: broken{margin} from {finding.witness_from_s:.1f} to {finding.witness_to_s:.1f} s"


def _hard(policy: Policy, finding: Finding, flight: Flight, evaluator: Evaluator, signals: FlightSignals) -> bool:
    severity = policy.file.severity
    if finding.robustness < 0 and flight.ending == "crashed":
        return True
    if severity.hard_at is not None and finding.robustness <= severity.hard_at:
        return True
    if policy.hard_when is None or not all(name in signals for name in policy.signals):
        return False
    return bool((evaluator.trace(policy.hard_when) > 0).any())


def _points(policy: Policy, features: dict[str, float]) -> float:
    """Points of the first rule that fits, most points first."""
    rules = sorted(policy.file.points, key=lambda rule: -rule.points)
    return next((rule.points for rule in rules if features.get(rule.feature, math.inf) < rule.below), 0.0)


def _gaps(policy: Policy, signals: FlightSignals) -> str:
    """Return in words which signals of a rule are not known all the time, and from when on; empty if all are."""
    unknown = {name: np.flatnonzero(np.isnan(signals[name])) for name in sorted(policy.needed) if name in signals}
    told = [f"{name} (from {places[0] * signals.step_s:.1f} s)" for name, places in unknown.items() if len(places)]
    return f"not known all the time: {', '.join(told)}" if told else ""


def _inconclusive(policy: Policy, message: str) -> Verdict:
    return Verdict(policy=policy.id, outcome="inconclusive", nearness=0.0, message=message)


def _died(flight: Flight) -> Verdict:
    return Verdict(
        policy=AUTOPILOT_ALIVE,
        outcome="violated",
        robustness=-CRISP,
        witness_from_s=flight.simulated_s,
        witness_to_s=flight.simulated_s,
        severity="hard",
        message=f"the autopilot died: {flight.message}" if flight.message else "the autopilot died",
    )
