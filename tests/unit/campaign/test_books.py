"""The books, message by message."""

from __future__ import annotations

import msgspec
import pytest
from books_drive import Driver, MemoryStore, doubles, new_books
from msgspec.structs import replace

from saflite.console.view import live
from saflite.contract.control import Control
from saflite.contract.events import Judged, Quarantined, ScorerChanged, ViolationFound
from saflite.contract.flight import Flight
from saflite.contract.score import Score, Usage
from saflite.contract.test_case import identity
from saflite.contract.verdict import Verdict, failed_again
from saflite.contract.work import (
    Failure,
    FlyResult,
    FlyWork,
    HandedBack,
    Heartbeat,
    JudgeResult,
    Lease,
    MutateWork,
    ScoreResult,
    ScoreWork,
)


def facts(driver: Driver, kind: type) -> list[object]:
    """All facts of a kind so far."""
    driver.commit()
    store: object = driver.store
    assert isinstance(store, MemoryStore)
    return [event.fact for event in store.all_events if isinstance(event.fact, kind)]


def flying(driver: Driver) -> Driver:
    """Bring a campaign to where flights are handed out."""
    while not driver.books.status(driver.now).queues["fly"]:
        driver.do("mutate")
        driver.do("score", many=9)
    return driver


def test_the_budget_is_spent_to_the_last_flight_and_no_further() -> None:
    for budget in (1, 2, 3, 7, 20, 41):
        driver = new_books(budget)
        driver.run()
        assert driver.books.status(driver.now).flights == budget


@pytest.mark.parametrize(("confirm_flights", "lag", "flights_per_round"), [(0, 1, 1), (3, 2, 4), (2, 4, 8), (1, 3, 8)])
def test_the_budget_is_exact_whatever_the_rhythm(confirm_flights: int, lag: int, flights_per_round: int) -> None:
    driver = new_books(
        37, confirm_flights=confirm_flights, lag=lag, flights_per_round=flights_per_round, candidates_per_round=16
    )
    driver.run()
    assert driver.books.status(driver.now).flights == 37


def test_what_the_last_flight_of_the_budget_found_is_confirmed_beside_the_budget() -> None:
    for rng_seed in range(12):
        driver = new_books(1, rng_seed=rng_seed)
        driver.run()
        status = driver.books.status(driver.now)
        found = [fact.violation for fact in facts(driver, ViolationFound) if isinstance(fact, ViolationFound)]
        assert (status.flights, status.reflown) == (1, 2 * len(found))
        if found:
            assert (found[0].confirmation, found[0].reflown) == ("confirmed", 2)
            return
    pytest.fail("no search found anything with its first flight")


def test_a_violation_that_holds_only_under_its_own_noise_is_shown_as_such(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doubles, "WAYS", 10**9)
    driver = new_books(60, flights_per_round=8)
    driver.run()
    found = [fact.violation for fact in facts(driver, ViolationFound) if isinstance(fact, ViolationFound)]
    once = [one for one in found if one.reflown == 2 and not one.failed_again]
    assert once
    assert {one.confirmation for one in once} == {"flaky"}
    assert failed_again(once[0]) == "0 of 2, only under its own noise, rate 0.00 to 0.66"
    firm = next(one for one in found if one.reflown == one.failed_again == 2)
    assert failed_again(firm) == f"2 of 2, rate 0.34 to 1.00, robustness then {firm.again_low:.3f}"


def judged_once() -> tuple[Driver, Lease, JudgeResult]:
    """Bring a campaign to its first judgement, which is not handed in."""
    driver = flying(new_books(40))
    driver.do("fly")
    (lease,) = driver.ask("judge")
    result = driver.service.do(lease.work)
    assert isinstance(result, JudgeResult)
    return driver, lease, result


def test_a_dead_autopilot_is_a_finding_beside_the_policies_of_the_campaign() -> None:
    driver, lease, result = judged_once()
    died = Verdict(policy="autopilot-alive", outcome="violated", robustness=-1.0, severity="hard")
    verdicts = (*result.judgement.verdicts, died)
    judgement = msgspec.structs.replace(result.judgement, verdicts=verdicts, fingerprint="0123456789abcdef")
    assert driver.report(lease, JudgeResult(judgement=judgement)).status == "accepted"
    driver.run()
    found = [fact.violation.policy for fact in facts(driver, ViolationFound) if isinstance(fact, ViolationFound)]
    assert "autopilot-alive" in found


def test_verdicts_on_other_policies_are_refused() -> None:
    driver, lease, result = judged_once()
    other = Verdict(policy="of-another-campaign", outcome="held", robustness=1.0)
    judgement = msgspec.structs.replace(result.judgement, verdicts=(*result.judgement.verdicts, other))
    receipt = driver.report(lease, JudgeResult(judgement=judgement))
    assert (receipt.status, "of-another-campaign" in receipt.message) == ("refused", True)


@pytest.mark.parametrize(
    "wrong",
    [
        {"outcome": "vacuous", "robustness": 550.0},
        {"outcome": "inconclusive", "robustness": 0.0},
        {"outcome": "held", "robustness": None},
        {"outcome": "held", "robustness": -0.5},
        {"outcome": "violated", "robustness": 0.5},
    ],
)
def test_a_verdict_that_contradicts_itself_is_refused(wrong: dict[str, object]) -> None:
    driver, lease, result = judged_once()
    verdict = msgspec.structs.replace(result.judgement.verdicts[0], **wrong)
    judgement = msgspec.structs.replace(result.judgement, verdicts=(verdict,))
    assert driver.report(lease, JudgeResult(judgement=judgement)).status == "refused"
    assert driver.report(lease, result).status == "accepted"


def test_a_rule_that_never_applied_is_told_as_such_and_is_no_success() -> None:
    driver, lease, result = judged_once()
    verdict = Verdict(policy=result.judgement.verdicts[0].policy, outcome="vacuous", nearness=0.5)
    judgement = msgspec.structs.replace(result.judgement, verdicts=(verdict,), fingerprint="")
    assert driver.report(lease, JudgeResult(judgement=judgement)).status == "accepted"
    driver.commit()
    (told,) = [fact for fact in facts(driver, Judged) if isinstance(fact, Judged)]
    assert (told.robustness, told.violated, told.vacuous) == (None, (), (verdict.policy,))
    assert isinstance(driver.store, MemoryStore)
    (outcome,) = driver.store.outcomes(-1, 10**6, 10**6)
    assert (outcome.robustness, outcome.nearness, outcome.guidance) == (None, 0.5, 550.0)


def test_a_result_counts_once() -> None:
    driver = flying(new_books())
    (lease,) = driver.ask("fly")
    result = driver.service.do(lease.work)
    assert driver.report(lease, result).status == "accepted"
    assert driver.report(lease, result).status == "duplicate"
    assert driver.books.status(driver.now).flights == 1


def test_a_result_of_another_run_or_another_worker_is_not_taken() -> None:
    driver = flying(new_books())
    (lease,) = driver.ask("fly")
    result = driver.service.do(lease.work)
    assert driver.report(lease, result, worker="somebody").status == "stale"
    stranger = type(lease)(lease_id="other:" + lease.lease_id, epoch=1, lease_s=1.0, work=lease.work)
    assert driver.report(stranger, result).status == "refused"
    assert driver.report(lease, result).status == "accepted"


def test_a_late_result_is_merged_and_the_other_worker_is_told_to_drop_the_work() -> None:
    driver = flying(new_books())
    (late,) = driver.ask("fly", "slow")
    driver.now += 11.0
    driver.books.tick(driver.now)
    (again,) = driver.ask("fly", "quick")
    assert (again.lease_id, again.epoch) == (late.lease_id, late.epoch + 1)
    assert driver.report(late, driver.service.do(late.work), "slow").status == "accepted"
    beat = Heartbeat(worker="quick", stage="fly", leases=((again.lease_id, again.epoch),))
    assert driver.books.beat(beat, driver.now).cancel == (again.lease_id,)
    assert driver.report(again, driver.service.do(again.work), "quick").status == "duplicate"
    assert driver.books.status(driver.now).flights == 1


def test_heartbeats_keep_a_lease_but_not_for_ever() -> None:
    driver = flying(new_books())
    (lease,) = driver.ask("fly")
    beat = Heartbeat(worker="a", stage="fly", leases=((lease.lease_id, lease.epoch),))
    for _ in range(13):
        driver.now += 5.0
        driver.books.tick(driver.now)
        assert driver.books.beat(beat, driver.now).cancel == ()
    driver.now += 6.0  # 2 x wall_limit_s + lease_s = 70 s are over
    driver.books.tick(driver.now)
    assert driver.books.beat(beat, driver.now).cancel == (lease.lease_id,)


def test_three_lost_attempts_quarantine_and_others_fly_on() -> None:
    driver = flying(new_books())
    (lease,) = driver.ask("fly")
    assert isinstance(lease.work, FlyWork)
    name = identity(lease.work.test_case)
    for attempt in range(3):
        driver.books.absent(f"w{attempt - 1}" if attempt else "a", "fly", driver.now)
        if attempt < 2:
            (lease,) = driver.ask("fly", f"w{attempt}")
    (fact,) = facts(driver, Quarantined)
    assert isinstance(fact, Quarantined)
    assert (fact.test_case, fact.attempts, fact.last) == (name, 3, "lost")
    driver.run()
    assert driver.books.status(driver.now).quarantined == 1


def test_a_grant_that_never_arrived_is_no_attempt() -> None:
    driver = flying(new_books())
    for _ in range(5):
        assert driver.ask("fly")
        driver.now += 11.0
        driver.books.tick(driver.now)
    assert driver.books.status(driver.now).quarantined == 0


def test_only_the_oldest_lease_of_a_dead_worker_counts_as_an_attempt() -> None:
    driver = flying(new_books())
    for number in range(3):
        assert len(driver.ask("fly", f"w{number}", 3)) == 3
        driver.books.absent(f"w{number}", "fly", driver.now)
    assert driver.books.status(driver.now).quarantined == 1


def test_work_handed_back_is_given_out_again_at_once() -> None:
    driver = flying(new_books())
    (lease,) = driver.ask("fly")
    assert driver.report(lease, HandedBack()).status == "accepted"
    (again,) = driver.ask("fly")
    assert (again.lease_id, again.epoch) == (lease.lease_id, lease.epoch + 1)


def test_infra_trouble_is_flown_elsewhere_and_never_a_violation() -> None:
    driver = flying(new_books())
    driver.now += 20.0
    driver.do("fly", "b", 0)
    (lease,) = driver.ask("fly")
    assert isinstance(lease.work, FlyWork)
    flight = Flight(test_case=identity(lease.work.test_case), flight_index=0, ending="infra")
    assert driver.report(lease, FlyResult(flight=flight)).status == "accepted"
    (other,) = driver.ask("fly")
    assert other.lease_id != lease.lease_id, "the same worker got it again although another one is there"
    (elsewhere,) = driver.ask("fly", "b")
    assert elsewhere.lease_id == lease.lease_id


BAD_SCORES = ("missing", "double", "eleven", "stranger", "shadow", "beside twice", "beside of others", "crowd", "usage")


@pytest.mark.parametrize("bad", BAD_SCORES)
def test_scores_that_do_not_fit_are_refused_and_the_batch_is_asked_again(bad: str) -> None:
    driver = new_books()
    driver.do("mutate")
    (lease,) = driver.ask("score")
    assert isinstance(lease.work, ScoreWork)
    names = [identity(test_case) for test_case in lease.work.test_cases]
    good = [Score(test_case=name, value=5.0, model="scripted", scored_by="scripted") for name in names]
    worse = 11.0 if bad == "eleven" else 5.0
    name = "0" * 16 if bad == "stranger" else names[0]
    wrong = Score(test_case=name, value=worse, model="scripted", scored_by="scripted", shadow=bad == "shadow")
    watching = [msgspec.structs.replace(good[0], model=f"m{number}", shadow=True) for number in range(102)]
    of_others = msgspec.structs.replace(watching[0], test_case="0" * 16)
    extra = {"beside twice": watching[:1] * 2, "beside of others": [of_others], "crowd": watching, "usage": []}
    scores = {"missing": good[1:], "double": [*good, good[0]]}.get(bad, [wrong, *good[1:]])
    scores = [*good, *extra[bad]] if bad in extra else scores
    usage = {"a model that gave no score": Usage()} if bad == "usage" else {}
    assert driver.report(lease, ScoreResult(scores=tuple(scores), usage=usage)).status == "refused"
    (again,) = driver.ask("score", "b")
    assert (again.lease_id, again.epoch) == (lease.lease_id, 2)
    assert driver.report(again, driver.service.do(again.work), "b").status == "accepted"


def test_a_batch_nobody_can_score_still_flies() -> None:
    driver = new_books()
    driver.do("mutate")
    while leases := driver.ask("score"):
        driver.report(leases[0], Failure(message="no server"))
    status = driver.books.status(driver.now)
    assert status.queues["fly"] == 3
    assert status.fallbacks == status.candidates


def test_a_mutator_that_starts_again_is_told_everything() -> None:
    driver = new_books(40)
    driver.run(until_flights=15)
    (lease,) = driver.wait_for("mutate", "fresh", cursor=-1)
    assert isinstance(lease.work, MutateWork)
    assert (lease.work.from_cursor, lease.work.cursor) == (-1, lease.work.round - 2)
    told = [(outcome.round, outcome.test_case) for outcome in lease.work.outcomes]
    assert [number for number, _ in told] == sorted(number for number, _ in told)


def test_a_swap_flips_between_batches_and_a_broken_model_is_rolled_back() -> None:
    driver = new_books()
    driver.do("mutate")
    assert driver.books.control(Control(verb="scorer", text="broken"), driver.now).accepted
    driver.do("score")
    assert driver.books.status(driver.now).scorer == "scripted"
    assert driver.books.control(Control(verb="scorer", text="another"), driver.now).accepted
    (warm,) = driver.ask("score")
    (before,) = driver.ask("score", "b")
    assert isinstance(before.work, ScoreWork)
    assert before.work.model == "scripted"
    assert driver.report(warm, driver.service.do(warm.work)).status == "accepted"
    changed = facts(driver, ScorerChanged)[-1]
    assert isinstance(changed, ScorerChanged)
    assert (changed.model, changed.previous, changed.ready) == ("another", "scripted", True)
    (after,) = driver.ask("score", "c")
    assert isinstance(after.work, ScoreWork)
    assert after.work.model == "another"
    assert driver.report(before, driver.service.do(before.work), "b").status == "accepted"


def test_the_share_a_scorer_decided_is_of_its_own_scores() -> None:
    """What scorers before it gave is none of it, nor is what the embedded one gave in its place, nor a lost batch."""
    driver = new_books()
    driver.do("mutate")
    (lease,) = driver.ask("score")
    assert driver.report(lease, driver.service.do(lease.work)).status == "accepted"
    first = driver.books.status(driver.now)
    assert first.scores == first.scores_by_model > 0
    assert driver.books.control(Control(verb="scorer", text="another"), driver.now).accepted
    driver.do("score")
    fresh = driver.books.status(driver.now)
    assert (fresh.scorer, fresh.scores, fresh.scores_by_model) == ("another", 0, 0)
    (lease,) = driver.ask("score")
    given = driver.service.do(lease.work)
    assert isinstance(given, ScoreResult)
    instead = tuple(replace(one, scored_by="blend", fault="unreachable") for one in given.scores)
    assert driver.report(lease, replace(given, scores=instead)).status == "accepted"
    dead = driver.books.status(driver.now)
    assert (dead.scores, dead.scores_by_model) == (len(instead), 0)
    assert live.decided_share(dead) == f"another decided 0% of {len(instead)} scores"
    driver.do("mutate")
    while leases := driver.ask("score"):  # and with it what the embedded scorer was asked in its place
        assert driver.report(leases[0], Failure(message="it broke")).status == "accepted"
    lost = driver.books.status(driver.now)
    assert (lost.scores_by_model, lost.fallbacks) == (0, lost.scores)
    assert lost.scores > dead.scores, "a lost batch was nobody's"
    assert driver.books.control(Control(verb="scorer", text="scripted"), driver.now).accepted
    while driver.books.status(driver.now).scorer != "scripted":
        driver.do("score")
    back = driver.books.status(driver.now)
    assert back.scores == back.scores_by_model >= first.scores


def test_pause_hands_nothing_new_out_and_stop_ends() -> None:
    driver = flying(new_books())
    assert driver.books.control(Control(verb="pause"), driver.now).accepted
    assert driver.ask("fly") == ()
    assert driver.books.control(Control(verb="resume"), driver.now).accepted
    assert driver.ask("fly")
    assert driver.books.control(Control(verb="stop"), driver.now).accepted
    assert driver.books.ended
    assert not driver.books.control(Control(verb="stop"), driver.now).accepted


def test_a_budget_below_what_is_flown_or_planned_is_refused() -> None:
    driver = flying(new_books(20))
    answer = driver.books.control(Control(verb="budget", number=1), driver.now)
    assert not answer.accepted
    assert "expected at least" in answer.message
    assert driver.books.control(Control(verb="budget", number=25), driver.now).accepted
    driver.run()
    assert driver.books.status(driver.now).flights == 25


def test_a_higher_budget_takes_an_ended_campaign_up_again() -> None:
    driver = new_books(5)
    driver.run()
    assert driver.books.control(Control(verb="budget", number=9), driver.now).accepted
    assert not driver.books.ended
    driver.run()
    assert driver.books.status(driver.now).flights == 9


def test_violations_name_two_workers_where_there_are_two() -> None:
    driver = new_books(40)
    driver.run(("a", "b"))
    violations = [fact.violation for fact in facts(driver, ViolationFound) if isinstance(fact, ViolationFound)]
    reflown = [violation for violation in violations if violation.reflown]
    assert reflown
    assert all(len(set(violation.workers)) == 2 for violation in reflown)


def test_a_single_worker_confirms_its_own_finds_and_says_so() -> None:
    driver = new_books(40)
    driver.run(("a",))
    violations = [fact.violation for fact in facts(driver, ViolationFound) if isinstance(fact, ViolationFound)]
    assert any(violation.confirmation == "confirmed" and set(violation.workers) == {"a"} for violation in violations)
