"""A target whose flights violate by chance: what is confirmed, called flaky and made smaller follows the odds."""

from __future__ import annotations

from functools import cache

import msgspec
import pytest
from books_drive import Driver, MemoryStore, doubles, new_books
from scipy.stats import binom
from test_minimizer import case, chute_in_acro, twenty

from saflite.campaign.lifecycle.minimizer import Minimizer
from saflite.campaign.lifecycle.repeats import RepeatRule
from saflite.campaign.storage.journal_audit import JournalAudit
from saflite.contract.blobs import Blobs
from saflite.contract.events import FaultSeen, ViolationFound
from saflite.contract.flight import Flight, Trace, pack_trace, trace_digest, unpack_trace
from saflite.contract.rng import derive
from saflite.contract.test_case import Origin, Stimulus, TestCase, identity
from saflite.contract.verdict import Judgement, Verdict, Violation
from saflite.contract.work import FlyResult, FlyWork, JudgeResult, JudgeWork, MutateResult, MutateWork, Result, Work

THREE_OF_FIVE = RepeatRule("statistically", 5, 3)


class Chancy(doubles.Service):
    """Test cases with A and B among their inputs violate in a share `rate` of their flights, others never."""

    def __init__(self, rate: float, inputs: str = "AB", blobs: Blobs | None = None) -> None:
        super().__init__(blobs)
        self.rate, self.inputs = rate, inputs

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        if isinstance(work, MutateWork):
            self._mutator.memory.tell(work.outcomes, work.from_cursor, work.cursor)
            cases = tuple(self._case(work, index) for index in range(work.count))
            return MutateResult(round=work.round, test_cases=cases)
        if isinstance(work, FlyWork):
            return self._fly(work)
        return _judged(work, self._blobs) if isinstance(work, JudgeWork) else super().do(work)

    def _case(self, work: MutateWork, index: int) -> TestCase:
        names = derive(work.rng_seed, "order", index).permutation(list(self.inputs)).tolist()
        stimuli = tuple(
            Stimulus(at_s=2.0 * place, kind="parameter", name=name, values=(float(work.round * 100 + index),))
            for place, name in enumerate(names)
        )
        return msgspec.structs.replace(work.template, stimuli=stimuli, origin=Origin(strategy="test", index=index))

    def _fly(self, work: FlyWork) -> FlyResult:
        name = identity(work.test_case)
        drawn = derive(1, name, work.purpose, work.flight_index).random()
        bad = drawn < self.rate and {stimulus.name for stimulus in work.test_case.stimuli} >= {"A", "B"}
        noise = f"{name} {work.purpose} {work.flight_index} {bad:d}".encode()
        trace = Trace(step_s=0.1, signals={"mode": noise + b"." * (-len(noise) % 4)})
        flight = Flight(
            test_case=name, flight_index=work.flight_index, ending="completed", trace_digest=trace_digest(trace)
        )
        return FlyResult(flight=msgspec.structs.replace(flight, trace=self._blobs.put(pack_trace(trace))))


def _judged(work: JudgeWork, blobs: Blobs) -> JudgeResult:
    assert work.flight.trace is not None
    bad = unpack_trace(blobs.get(work.flight.trace)).signals["mode"].rstrip(b".").endswith(b" 1")
    verdict = Verdict(policy=doubles.POLICY, outcome="violated" if bad else "held", robustness=-1.0 if bad else 1.0)
    name, index = identity(work.test_case), work.flight.flight_index
    fingerprint = "f" * 16 if bad else ""
    return JudgeResult(
        judgement=Judgement(test_case=name, flight_index=index, verdicts=(verdict,), fingerprint=fingerprint)
    )


def run(rate: float, budget: int, inputs: str = "AB", **search: object) -> tuple[Driver, list[Violation]]:
    """Run a campaign to its end; returns it and all violations decided upon."""
    driver = new_books(budget, repeats="statistically", record="none", **search)
    assert driver.store is not None
    driver.service = Chancy(rate, inputs, driver.store.blobs)
    driver.run()
    assert isinstance(driver.store, MemoryStore)
    facts = [event.fact for event in driver.store.all_events]
    assert not [fact for fact in facts if isinstance(fact, FaultSeen)]
    return driver, [fact.violation for fact in facts if isinstance(fact, ViolationFound)]


@cache
def found_at(rate: float) -> tuple[Violation, ...]:
    """Violations of a long search."""
    _, found = run(rate, 200, flights_per_round=8, candidates_per_round=8)
    return tuple(found)


@pytest.mark.parametrize("rate", [0.3, 0.5, 0.7, 0.95])
def test_as_many_are_confirmed_as_the_odds_say(rate: float) -> None:
    found = found_at(rate)
    confirmed = sum(1 for violation in found if violation.confirmation == "confirmed")
    expected = float(binom.sf(2, 5, rate))
    assert {violation.confirmation for violation in found} <= {"confirmed", "flaky"}
    assert len(found) > 40
    low, high = binom.ppf((1e-4, 1 - 1e-4), len(found), expected)
    assert low <= confirmed <= high


@pytest.mark.parametrize("rate", [0.3, 0.7])
def test_the_interval_holds_the_rate_as_often_as_it_claims(rate: float) -> None:
    found = found_at(rate)
    held = 0
    for violation in found:
        assert violation.rate_low is not None
        assert violation.rate_high is not None
        assert violation.rate_low <= violation.failed_again / violation.reflown <= violation.rate_high
        held += violation.rate_low <= rate <= violation.rate_high
    assert held / len(found) > 0.88, "the coverage of a 95 % Wilson interval of five flights is 0.9 at the least here"


def test_what_repeats_in_every_flight_is_confirmed_and_what_never_does_is_flaky() -> None:
    _, always = run(1.0, 60)
    assert {(one.confirmation, one.failed_again, one.reflown) for one in always} == {("confirmed", 3, 3)}
    rare = [one for one in found_at(0.3) if one.failed_again < 3]
    assert {one.confirmation for one in rare} == {"flaky"}


def test_the_budget_is_exact_with_five_reflights_each() -> None:
    for budget in (1, 6, 7, 50):
        driver, found = run(0.7, budget)
        assert driver.books.status(driver.now).flights == budget
        assert driver.books.status(driver.now).reflown == sum(one.reflown for one in found)


# ---- making violations smaller ------------------------------------------------------------------------------------


def shrink(rng_seed: int, rate: float, start: TestCase, shuffle: bool = False) -> tuple[Minimizer, int]:
    """Make a test case smaller that violates by chance; the answer of a flight belongs to it, whenever it is given."""
    minimizer, flown = Minimizer(start, 300, THREE_OF_FIVE), 0
    order = derive(rng_seed, "order")
    while not minimizer.done:
        asked = list(minimizer.ask())
        for place in order.permutation(len(asked)) if shuffle else range(len(asked)):
            test_case, number = asked[place]
            name = identity(test_case)
            lucky = derive(rng_seed, name, number).random() < rate
            minimizer.tell(name, number, lucky and chute_in_acro(test_case))
            minimizer.validate()
            flown += 1
    return minimizer, flown


def test_the_least_cause_is_found_at_seven_of_ten_within_the_flights() -> None:
    runs = [shrink(rng_seed, 0.7, twenty()) for rng_seed in range(60)]
    least = sum(1 for minimizer, _ in runs if [one.name[:4] for one in minimizer.best.stimuli] == ["ACRO", "MAV_"])
    assert least >= 55
    assert all(chute_in_acro(minimizer.best) for minimizer, _ in runs), "a cause was lost to a lucky flight"
    assert max(flown for _, flown in runs) <= 300


def test_the_order_of_answers_does_not_matter_to_chance_either() -> None:
    for rng_seed in range(5):
        steady, shuffled = (shrink(rng_seed, 0.7, twenty(), shuffle) for shuffle in (False, True))
        assert steady[0].best == shuffled[0].best
        assert steady[1] == shuffled[1]


def test_a_single_lucky_flight_convinces_nobody() -> None:
    start = case(*(Stimulus(at_s=float(n), kind="parameter", name=f"P{n}", values=(1.0,)) for n in range(6)))
    minimizer = Minimizer(start, 300, THREE_OF_FIVE)
    while not minimizer.done:
        for test_case, number in minimizer.ask():
            minimizer.tell(identity(test_case), number, number == 0)  # each violates once, and never again
    assert minimizer.best == start


def test_what_flights_showed_is_kept_for_a_test_case_that_comes_up_again() -> None:
    asked: list[tuple[str, int]] = []
    for rng_seed in range(5):
        minimizer = Minimizer(twenty(), 300, THREE_OF_FIVE)
        while not minimizer.done:
            for test_case, number in minimizer.ask():
                asked.append((f"{rng_seed} {identity(test_case)}", number))
                lucky = derive(rng_seed, identity(test_case), number).random() < 0.7
                minimizer.tell(identity(test_case), number, lucky and chute_in_acro(test_case))
    assert len(set(asked)) == len(asked), "a flight was asked for twice"
    for name in {name for name, _ in asked}:
        numbers = sorted(number for other, number in asked if other == name)
        assert numbers == list(range(len(numbers)))
        assert len(numbers) <= THREE_OF_FIVE.flights


def test_a_campaign_makes_its_violations_smaller_by_chance() -> None:
    driver, found = run(0.7, 12, "ABCDEFGHIJ", shrink=True)
    forms = [one for one in found if one.message.startswith("smallest form of")]
    assert len(forms) >= 3
    assert isinstance(driver.store, MemoryStore)
    least = sum(1 for one in forms if ", 2 inputs" in one.message)
    assert least >= 0.8 * len(forms)
    assert {one.reflown for one in forms} <= {3, 4, 5}
    confirmed = sum(1 for one in forms if one.confirmation == "confirmed")
    assert confirmed >= len(forms) / 2
    assert driver.books.status(driver.now).flights == 12


def test_books_balance_where_smallest_forms_held_in_their_first_flight() -> None:
    driver, found = run(0.7, 20, "ABCDEF", shrink=True)
    assert any(one.flight_index for one in found), "no smallest form held in its first flight"
    assert max(one.flight_index + one.reflown for one in found) < 2 * 5, "noises from there on are free for statistics"
    assert isinstance(driver.store, MemoryStore)
    counted = JournalAudit()
    for line in driver.store.lines:
        counted.add(line)
    assert not counted.compare_told([event.fact for event in driver.store.all_events])
    assert not counted.left_open()
    assert not counted.problems
