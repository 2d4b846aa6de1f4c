from __future__ import annotations

import msgspec
import numpy as np
import pytest

from saflite.contract.blobs import BlobMissing
from saflite.contract.errors import Refused
from saflite.contract.flight import Delivered, DeliveryAnswer, Ending, Flight, Trace, pack_trace
from saflite.contract.test_case import Obstacle, Scenario, Stimulus, Target, TestCase, identity
from saflite.contract.verdict import NEVER_APPLIED, Judgement, Verdict, nearest, vacuous, worst
from saflite.contract.work import JudgeResult, JudgeWork, PolicyText
from saflite.evidence.memory import MemoryBlobs
from saflite.oracle.judge import judge
from saflite.oracle.work import open_service

POLICIES = ("min-obstacle-distance",)
STEP_S = 0.05


def box(x_m: float, y_m: float, size_m: float = 4.0) -> Obstacle:
    return Obstacle(length_m=size_m, width_m=size_m, height_m=20.0, x_m=x_m, y_m=y_m)


def case(*obstacles: Obstacle, **more: object) -> TestCase:
    return msgspec.structs.replace(TestCase(target=Target(), scenario=Scenario(obstacles=obstacles)), **more)


def packed(values: object) -> bytes:
    return np.asarray(values, dtype="<f4").tobytes()


def straight(aside_m: float, contact: float = 0.0, length_m: float = 50.0) -> Trace:
    """A flight north-east of nothing: along y at 1 m/s, `aside_m` off the axis, 10 m up."""
    t = np.arange(0, length_m + STEP_S / 2, STEP_S)
    names = {"x_m": aside_m, "altitude_m": 10.0, "vx_mps": 0.0, "vy_mps": 1.0, "contact": contact}
    signals = {name: packed(np.full_like(t, value)) for name, value in names.items()}
    return Trace(step_s=STEP_S, signals={**signals, "y_m": packed(t)})


def judged(test_case: TestCase, trace: Trace | None, ending: Ending = "completed") -> Judgement:
    flight = Flight(test_case=identity(test_case), flight_index=0, ending=ending)
    return judge(test_case, flight, trace, POLICIES)


@pytest.mark.parametrize(
    ("aside_m", "outcome", "points"),
    [(6.0, "held", 0.0), (3.51, "held", 0.0), (3.2, "violated", 1.0), (2.6, "violated", 2.0), (2.1, "violated", 5.0)],
)
def test_distance_decides_outcome_and_points(aside_m: float, outcome: str, points: float) -> None:
    verdict = judged(case(box(0.0, 20.0)), straight(aside_m)).verdicts[0]
    assert (verdict.outcome, verdict.points) == (outcome, points)
    assert verdict.robustness == pytest.approx(aside_m - 2.0 - 1.5, abs=1e-5)
    assert verdict.severity == ("none" if outcome == "held" else "soft")


def test_contact_makes_it_hard() -> None:
    assert judged(case(box(0.0, 20.0)), straight(1.0, contact=1.0)).verdicts[0].severity == "hard"


def test_witness_window_is_the_stretch_below_the_threshold() -> None:
    verdict = judged(case(box(0.0, 20.0)), straight(2.5)).verdicts[0]
    reach = 2.0 + np.sqrt(1.5**2 - 0.5**2)
    assert verdict.witness_from_s == pytest.approx(20 - reach, abs=STEP_S)
    assert verdict.witness_to_s == pytest.approx(20 + reach, abs=STEP_S)


def test_features_and_track() -> None:
    judgement = judged(case(box(30.0, 30.0), box(0.0, 20.0)), straight(3.0))
    features = judgement.features
    assert features["closest_obstacle"] == 1.0
    assert features["min_distance_m"] == pytest.approx(1.0)
    assert features["path_length_m"] == pytest.approx(50.0, rel=1e-4)
    assert features["duration_s"] == pytest.approx(50.0)
    assert features["stall_s"] == 0.0
    assert features["closest_progress"] == pytest.approx(18 / 50, abs=0.01)
    assert len(judgement.track) == 51
    assert judgement.track[10] == (10.0, 3.0, 10.0, 10.0)


def test_near_identical_finds_share_a_fingerprint_and_others_do_not() -> None:
    first = judged(case(box(1.0, 22.0), box(13.0, 33.0)), straight(4.0))
    near = judged(case(box(1.1, 22.1), box(13.0, 33.0)), straight(4.0))
    other_box = judged(case(box(1.0, 33.0), box(13.0, 22.0)), straight(4.0))
    other_side = judged(case(box(1.0, 22.0), box(13.0, 33.0)), straight(-2.0))
    assert first.fingerprint == near.fingerprint != ""
    assert len({first.fingerprint, other_box.fingerprint, other_side.fingerprint}) == 3
    assert judged(case(box(30.0, 22.0)), straight(0.0)).fingerprint == ""


@pytest.mark.parametrize("ending", ["wedged", "infra", "lost"])
def test_trouble_of_the_farm_is_never_a_violation(ending: Ending) -> None:
    judgement = judged(case(box(0.0, 20.0)), straight(0.0), ending)
    assert [verdict.outcome for verdict in judgement.verdicts] == ["inconclusive"]
    assert judgement.fingerprint == ""


def test_a_dead_autopilot_is_a_finding() -> None:
    judgement = judged(case(box(30.0, 20.0)), straight(0.0), "autopilot_died")
    assert [(v.policy, v.outcome) for v in judgement.verdicts] == [
        ("min-obstacle-distance", "held"),
        ("autopilot-alive", "violated"),
    ]
    assert judgement.fingerprint


def test_a_trace_without_position_is_inconclusive_and_says_why() -> None:
    trace = Trace(step_s=STEP_S, signals={"roll_deg": packed(np.zeros(100))})
    verdict = judged(case(box(0.0, 20.0)), trace).verdicts[0]
    assert verdict.outcome == "inconclusive"
    assert "obstacle_distance_m" in verdict.message


def hovering(mode: float, released: list[float], armed: float = 1.0) -> Trace:
    """Some seconds in the air; `released` is the parachute's state, one sample a second."""
    names = {
        "mode": mode,
        "armed": armed,
        "altitude_est_m": 30.0,
        "climb_est_mps": 0.0,
        "chute_altitude_min_set_m": 10.0,
    }
    signals = {name: packed(np.full(len(released), value)) for name, value in names.items()}
    return Trace(step_s=1.0, signals={**signals, "chute_released": packed(released)})


@pytest.mark.parametrize(
    ("trace", "policy", "outcome", "robustness", "nearness"),
    [
        (hovering(2, [0, 0, 0, 0]), "a-chute", "vacuous", None, 0.0),
        (hovering(2, [0, 0, 1, 1]), "a-chute", "held", 0.5, 1.0),
        (hovering(1, [0, 0, 1, 1]), "a-chute", "violated", -1.0, 1.0),
        (hovering(2, [0, 0, 0, 0]), "a-rtl1", "inconclusive", None, 0.0),
    ],
)
def test_a_rule_that_never_applied_is_vacuous_and_has_no_robustness(
    trace: Trace, policy: str, outcome: str, robustness: float | None, nearness: float
) -> None:
    test_case = TestCase(target=Target(), scenario=Scenario())
    flight = Flight(test_case=identity(test_case), flight_index=0, ending="completed")
    verdict = judge(test_case, flight, trace, (policy,)).verdicts[0]
    assert (verdict.outcome, verdict.robustness, verdict.nearness) == (outcome, robustness, nearness)
    assert (verdict.message == NEVER_APPLIED) == (outcome == "vacuous")


def test_the_nearest_of_the_rules_that_never_applied_counts_and_the_worst_of_those_that_did() -> None:
    verdicts = (
        Verdict(policy="a", outcome="vacuous", nearness=0.25),
        Verdict(policy="b", outcome="vacuous", nearness=0.75),
        Verdict(policy="c", outcome="inconclusive", nearness=0.0),
    )
    nothing = Judgement(test_case="x", flight_index=0, verdicts=verdicts)
    assert (worst(nothing), nearest(nothing), vacuous(nothing)) == (None, 0.75, ("a", "b"))
    held = tuple(Verdict(policy=name, outcome="held", robustness=value) for name, value in (("d", 3.0), ("e", 2.0)))
    both = msgspec.structs.replace(nothing, verdicts=(*verdicts, *held))
    assert worst(both) == held[1]
    assert nearest(msgspec.structs.replace(both, verdicts=held)) is None


CEILING = """id = "ceiling"
title = "Stays below 20 m"
source = "test"
interestingness = "climbs"
formula = "always (altitude_m <= 20)"
[signals]
altitude_m = "m"
[[examples]]
holds = true
why = "below"
duration_s = 2.0
signals = { altitude_m = 10 }
[[examples]]
holds = false
why = "above"
duration_s = 2.0
signals = { altitude_m = 30 }
"""


@pytest.mark.parametrize(
    ("heights", "is_log", "outcome"),
    [
        ([10, 15, 25, 25], False, "violated"),
        ([25, 25, 25, 25], False, "inconclusive"),
        ([25, 25, 25, 25], True, "violated"),
        ([10, 10, 10, 10], False, "held"),
    ],
)
def test_a_rule_that_the_state_at_the_beginning_breaks_is_broken_by_nobody(
    heights: list[float], is_log: bool, outcome: str
) -> None:
    """A search may begin flights where a rule of somebody's own is broken already; a log tells what really was."""
    trace = Trace(step_s=1.0, signals={"altitude_m": packed(heights)})
    flight = Flight(test_case=identity(case()), flight_index=0, ending="completed")
    sources = {"altitude_m": "POS"} if is_log else None
    (verdict,) = judge(
        case(), flight, trace, ("ceiling",), {"ceiling": PolicyText(text=CEILING, file="ceiling.toml")}, sources
    ).verdicts
    assert verdict.outcome == outcome
    assert ("began" in verdict.message) == (outcome == "inconclusive")


def test_unknown_policy_is_refused() -> None:
    flight = Flight(test_case="x", flight_index=0, ending="completed")
    with pytest.raises(Refused, match="policy"):
        judge(case(), flight, straight(0.0), ("no-such",))


def test_stimuli_give_quiet_time_and_their_own_fingerprints() -> None:
    test_case = case(box(0.0, 20.0), stimuli=(Stimulus(at_s=5.0, kind="mode", name="LOITER"),))
    assert judged(test_case, straight(2.5)).fingerprint != judged(case(box(0.0, 20.0)), straight(2.5)).fingerprint


def delivered_as(*answers: DeliveryAnswer) -> Judgement:
    """A release of the parachute in FLIP after one input at 1 s and one at 2 s, delivered as told."""
    stimuli = (
        Stimulus(at_s=1.0, kind="mode", name="FLIP"),
        Stimulus(at_s=2.0, kind="command", name="MAV_CMD_DO_PARACHUTE", values=(2.0,)),
    )
    test_case = TestCase(target=Target(), scenario=Scenario(), stimuli=stimuli)
    told = tuple(Delivered(index=index, at_s=1.0 + index, answer=answer) for index, answer in enumerate(answers))
    flight = Flight(test_case=identity(test_case), flight_index=0, ending="completed", delivered=told or None)
    return judge(test_case, flight, hovering(14, [0, 0, 0, 1, 1]), ("a-chute",))


def test_the_fingerprint_names_what_was_given_and_not_denied() -> None:
    planned = delivered_as().fingerprint
    assert delivered_as("accepted", "accepted").fingerprint == planned
    assert delivered_as("accepted", "timed_out").fingerprint == planned, "it may be what stopped the autopilot"
    denied = {delivered_as("denied", "accepted").fingerprint, delivered_as("accepted", "denied").fingerprint}
    assert len({planned, *denied}) == 3
    assert {verdict.outcome for verdict in delivered_as("denied", "denied").verdicts} == {"violated"}


@pytest.mark.parametrize(
    ("answer", "outcome"), [("accepted", "vacuous"), ("denied", "violated"), ("timed_out", "violated")]
)
def test_a_denied_order_to_stop_the_motors_is_no_excuse(answer: DeliveryAnswer, outcome: str) -> None:
    stop = Stimulus(at_s=2.0, kind="command", name="MAV_CMD_COMPONENT_ARM_DISARM", values=(0.0, 21196.0))
    test_case = TestCase(target=Target(), scenario=Scenario(), stimuli=(stop,))
    flight = Flight(
        test_case=identity(test_case),
        flight_index=0,
        ending="completed",
        delivered=(Delivered(index=0, at_s=2.0, answer=answer),),
    )
    columns = {
        "armed": [1.0] * 3 + [0.0] * 7,
        "altitude_m": [20.0] * 10,
        "chute_released": [0.0] * 10,
    }
    trace = Trace(step_s=1.0, signals={name: packed(values) for name, values in columns.items()})
    (verdict,) = judge(test_case, flight, trace, ("armed-in-flight",)).verdicts
    assert verdict.outcome == outcome, verdict.message


def test_what_was_given_after_the_last_sample_may_have_stopped_the_autopilot() -> None:
    fatal = Stimulus(at_s=2.513, kind="parameter", name="RC3_MIN", values=(0.0,))
    test_case = TestCase(target=Target(), scenario=Scenario(), stimuli=(fatal,))

    def found(*delivered: Delivered) -> str:
        flight = Flight(test_case="x", flight_index=0, ending="autopilot_died", simulated_s=2.5, delivered=delivered)
        return judge(test_case, flight, hovering(2, [0, 0, 0]), ("a-chute",)).fingerprint

    assert found(Delivered(index=0, at_s=2.52, answer="timed_out")) != found()


def test_the_service_judges_work() -> None:
    test_case = case(box(0.0, 20.0))
    blobs = MemoryBlobs()
    trace = blobs.put(pack_trace(straight(2.5)))
    flight = Flight(test_case=identity(test_case), flight_index=2, ending="completed", trace=trace)
    work = JudgeWork(test_case=test_case, flight=flight, policies=POLICIES)
    service = open_service(blobs)
    result = service.do(work, lambda: False)
    assert isinstance(result, JudgeResult)
    assert result.judgement == judge(test_case, flight, straight(2.5), POLICIES)
    nonsense = msgspec.structs.replace(flight, trace=blobs.put(b"nonsense"))
    with pytest.raises(Refused, match="trace"):
        service.do(msgspec.structs.replace(work, flight=nonsense), lambda: False)
    blobs.kept.clear()
    with pytest.raises(BlobMissing, match="is missing"):
        service.do(work, lambda: False)
