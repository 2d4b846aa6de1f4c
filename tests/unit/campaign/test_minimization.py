"""Confirmed violations are made smaller, besides the budget, and the smallest form is flown again and recorded."""

from __future__ import annotations

import re
import sqlite3
from pathlib import Path

import msgspec
import pytest
from books_drive import Driver, doubles

from saflite.campaign.lifecycle.minimization import AT_ONCE
from saflite.campaign.storage.audit import audit
from saflite.campaign.storage.contents import Contents
from saflite.campaign.storage.sqlite import entries
from saflite.campaign.storage.store import Store, store_file
from saflite.contract import wire
from saflite.contract.blobs import Blobs
from saflite.contract.events import Event, ViolationFound
from saflite.contract.flight import Flight, Trace, pack_trace, trace_digest
from saflite.contract.rng import derive
from saflite.contract.test_case import Origin, Stimulus, TestCase, identity
from saflite.contract.verdict import Judgement, Verdict, Violation
from saflite.contract.work import FlyResult, FlyWork, JudgeResult, JudgeWork, MutateResult, MutateWork, Result, Work

TRIGGER = {"A", "B"}


class Stimulated(doubles.Service):
    """Test cases of twenty inputs; those that hold A and B, in any order, break the policy."""

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        if isinstance(work, MutateWork):
            self._mutator.memory.tell(work.outcomes, work.from_cursor, work.cursor)
            cases = tuple(self._case(work, index) for index in range(work.count))
            return MutateResult(round=work.round, test_cases=cases)
        if isinstance(work, FlyWork):
            return _flown(work, self._blobs)
        return _judged(work) if isinstance(work, JudgeWork) else super().do(work)

    def _case(self, work: MutateWork, index: int) -> TestCase:
        rng = derive(work.rng_seed, "inputs", index)
        names = rng.choice(list("ABCDEFGHIJKLMNOPQRSTUVWXYZ"), size=20, replace=False).tolist()
        stimuli = tuple(
            Stimulus(at_s=2.0 * place, kind="parameter", name=name, values=(round(float(rng.random()), 3),))
            for place, name in enumerate(names)
        )
        return msgspec.structs.replace(work.template, stimuli=stimuli, origin=Origin(strategy="test", index=index))


def _flown(work: FlyWork, blobs: Blobs) -> FlyResult:
    name = identity(work.test_case)
    trace = Trace(step_s=0.1, signals={"mode": name.encode() + b"0000"})
    flight = Flight(
        test_case=name,
        flight_index=work.flight_index,
        ending="completed",
        simulated_s=30.0,
        trace_digest=trace_digest(trace),
        trace=blobs.put(pack_trace(trace)),
    )
    return FlyResult(flight=flight)


def _judged(work: JudgeWork) -> JudgeResult:
    bad = {stimulus.name for stimulus in work.test_case.stimuli} >= TRIGGER
    verdict = Verdict(policy=doubles.POLICY, outcome="violated" if bad else "held", robustness=-1.0 if bad else 1.0)
    judgement = Judgement(
        test_case=identity(work.test_case),
        flight_index=work.flight.flight_index,
        verdicts=(verdict,),
        fingerprint="f" * 16 if bad else "",
    )
    return JudgeResult(judgement=judgement)


def started(run_dir: Path) -> Driver:
    campaign = doubles.campaign(8, record="none", shrink=True, shrink_flights_max=60)
    store = Store.create(run_dir, campaign, doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), store)
    driver.service = Stimulated(store.blobs)
    return driver


def finish(driver: Driver, workers: tuple[str, ...] = ("a", "b")) -> None:
    driver.run(workers)
    assert driver.store is not None
    driver.store.close()


def smallest(run_dir: Path) -> list[tuple[Violation, TestCase]]:
    """The smallest forms a run found, each with its test case."""
    database = sqlite3.connect(store_file(run_dir))
    facts = [wire.decode(event, Event).fact for event in entries(database, "events", store_file(run_dir))]
    found = [fact.violation for fact in facts if isinstance(fact, ViolationFound)]
    forms = [violation for violation in found if violation.message.startswith("smallest form of")]
    cases = [Contents(database).test_case(violation.test_case) for violation in forms]
    return [(violation, test_case) for violation, test_case in zip(forms, cases, strict=True) if test_case is not None]


@pytest.fixture(scope="module")
def run_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run that shrank what it found."""
    folder = tmp_path_factory.mktemp("shrink") / "run"
    finish(started(folder))
    return folder


def test_a_violation_of_twenty_inputs_is_brought_down_to_the_two_that_matter(run_dir: Path) -> None:
    forms = smallest(run_dir)
    assert forms
    for violation, test_case in forms:
        assert {stimulus.name for stimulus in test_case.stimuli} == TRIGGER
        assert (violation.confirmation, violation.failed_again, violation.reflown) == ("confirmed", 2, 2)
        assert re.fullmatch("[0-9a-f]{16}", violation.fingerprint)
        assert test_case.origin.parent


def test_shrinking_costs_no_budget_and_the_books_balance(run_dir: Path) -> None:
    figures = audit(run_dir)
    assert figures["problems"] == []
    assert figures["flights"] == 8
    assert figures["shrink_flights"] > 0


class Lucky(Stimulated):
    """As above, but fewer than five inputs violate under one noise only: what chance does to many small forms."""

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        result = super().do(work)
        if isinstance(work, JudgeWork) and work.flight.flight_index and len(work.test_case.stimuli) < 5:
            assert isinstance(result, JudgeResult)
            held = Verdict(policy=doubles.POLICY, outcome="held", robustness=1.0)
            judgement = msgspec.structs.replace(result.judgement, verdicts=(held,), fingerprint="")
            return msgspec.structs.replace(result, judgement=judgement)
        return result


def test_where_the_smallest_form_was_luck_a_larger_one_is_confirmed(tmp_path: Path) -> None:
    driver = started(tmp_path)
    assert driver.store is not None
    driver.service = Lucky(driver.store.blobs)
    finish(driver)
    forms = smallest(tmp_path)
    sizes = {
        one: [len(case.stimuli) for found, case in forms if found.confirmation == one] for one in ("flaky", "confirmed")
    }
    assert min(sizes["flaky"]) == 2
    assert sizes["confirmed"]
    assert all(5 <= size < 20 for size in sizes["confirmed"])
    assert audit(tmp_path)["problems"] == []


def test_interruptions_and_the_number_of_workers_change_nothing(run_dir: Path, tmp_path: Path) -> None:
    driver = started(tmp_path / "parts")
    for _ in range(6):
        for stage in ("mutate", "score", "fly", "judge", "fly", "fly", "judge"):
            driver.do(stage, "solo", 2)
        assert driver.store is not None
        driver.store.close()
        store = Store.open(tmp_path / "parts")
        driver = Driver(store.rebuild(), store)
        driver.service = Stimulated(store.blobs)
    finish(driver, ("solo",))
    expected = {violation.test_case for violation, _ in smallest(run_dir)}
    assert {violation.test_case for violation, _ in smallest(tmp_path / "parts")} == expected
    assert audit(tmp_path / "parts")["problems"] == []


def test_an_experiment_that_takes_workers_down_shows_nothing_and_ends(tmp_path: Path) -> None:
    driver = started(tmp_path / "run")
    lost = 0
    while not driver.books.ended:
        for stage in ("mutate", "score", "judge"):
            driver.do(stage, "a", 4)
        for lease in driver.ask("fly", "a", 4):
            if lease.work.purpose == "shrink" and lost < 30:  # type: ignore[union-attr]
                lost += 1
                continue
            driver.report(lease, driver.service.do(lease.work))
        driver.books.absent("a", "fly", driver.now)
        driver.now += 1.0
        driver.books.tick(driver.now)
        driver.commit()
        assert driver.now < 5000, "the campaign does not end"
    assert lost == 30
    assert driver.books.status(driver.now).quarantined == 0


def test_flights_of_the_search_go_before_what_makes_finds_smaller_still(tmp_path: Path) -> None:
    """Of one behaviour a bounded number is flown at once; all else waits while anything of the search does."""
    driver, at_once, waiting = started(tmp_path), 0, 0
    while not driver.books.ended:
        for stage in ("mutate", "score"):
            driver.do(stage, many=9)
        leases = driver.ask("fly")
        purposes = [lease.work.purpose for lease in leases]  # type: ignore[union-attr]
        more = driver.books.status(driver.now).flights < 8
        at_once += sum(one == "shrink" for one in purposes) if more else 0
        waiting += sum(one == "shrink" for one in purposes) if not more else 0
        for lease in leases:
            driver.report(lease, driver.service.do(lease.work))
        driver.do("judge", many=9)
        driver.now += 0.5
        driver.books.tick(driver.now)
    assert 0 < at_once <= AT_ONCE
    assert waiting > AT_ONCE
    assert smallest(tmp_path)


def test_further_behaviours_of_a_policy_may_cost_half(tmp_path: Path) -> None:
    driver = started(tmp_path)
    finish(driver)
    database = sqlite3.connect(store_file(tmp_path))
    flown = database.execute("SELECT count(*) FROM flights WHERE purpose = 'shrink'").fetchone()[0]
    behaviours = driver.books.status(driver.now).behaviours
    assert behaviours > 2
    assert flown <= 60 + 30 * (behaviours - 1)


class TwoCauses(Stimulated):
    """As above, but C alone breaks the policy, too: what was enough for the first find is not for all."""

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        result = super().do(work)
        if isinstance(work, JudgeWork) and any(one.name == "C" for one in work.test_case.stimuli):
            bad = Verdict(policy=doubles.POLICY, outcome="violated", robustness=-1.0)
            assert isinstance(result, JudgeResult)
            judgement = msgspec.structs.replace(result.judgement, verdicts=(bad,), fingerprint="f" * 16)
            return msgspec.structs.replace(result, judgement=judgement)
        return result


def test_a_behaviour_of_another_cause_than_the_first_is_made_small_as_well(tmp_path: Path) -> None:
    driver = started(tmp_path)
    assert driver.store is not None
    driver.service = TwoCauses(driver.store.blobs)
    finish(driver)
    assert {frozenset(one.name for one in case.stimuli) for _, case in smallest(tmp_path)} == {
        frozenset(TRIGGER),
        frozenset("C"),
    }
