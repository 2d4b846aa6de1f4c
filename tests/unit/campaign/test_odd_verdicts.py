"""Judgements that an oracle of ours would never give, but that a peer may: the books take or refuse them, and go on."""

from __future__ import annotations

from typing import cast

import msgspec
import numpy as np
import pytest
from books_drive import Driver, MemoryStore, doubles, new_books

from saflite.campaign.engine.journal import Placed, decode_line, encode_line
from saflite.campaign.storage.store import Store
from saflite.contract.flight import AUTOPILOT_ALIVE
from saflite.contract.rng import derive
from saflite.contract.verdict import Judgement, Verdict
from saflite.contract.work import JudgeResult, Result, Stage, Work

STAGES: tuple[Stage, ...] = ("mutate", "score", "fly", "judge", "record")


def died(words: str, robustness: float = -9.0) -> Verdict:
    """Return a verdict that may stand in any judgement, beside those on the policies of the campaign."""
    return Verdict(policy=AUTOPILOT_ALIVE, outcome="violated", robustness=robustness, severity="hard", behaviour=words)


def beside(judgement: Judgement, *more: Verdict) -> JudgeResult:
    """Return a result with more verdicts than the judgement has."""
    return JudgeResult(judgement=msgspec.structs.replace(judgement, verdicts=(*judgement.verdicts, *more)))


class Odd(doubles.Service):
    """Says of each flight that its autopilot died: never, once or twice, in words of which few are its own."""

    def __init__(self, driver: Driver, seed: int) -> None:
        assert driver.store is not None
        super().__init__(driver.store.blobs)
        self._rng = derive(seed, "odd verdicts")

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        result = super().do(work)
        if not isinstance(result, JudgeResult):
            return result
        own, many = result.judgement.verdicts[0].behaviour, int(self._rng.choice([0, 1, 1, 2]))
        return beside(result.judgement, *(died(*_odd(own, self._rng)) for _ in range(many)))


def _odd(own: str, rng: np.random.Generator) -> tuple[str, float]:
    words = (own, *(f"{doubles.POLICY}, way {way}" for way in range(doubles.WAYS)), "another way", "")
    return words[int(rng.integers(len(words)))], -float(rng.choice([1e-3, 9.0]))


class Dying(doubles.Service):
    """Says of each violation that the autopilot died as well, in the same words, and worse."""

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        result = super().do(work)
        if not (isinstance(result, JudgeResult) and (words := result.judgement.verdicts[0].behaviour)):
            return result
        return beside(result.judgement, died(words))


def dying() -> Driver:
    """Return the books of a campaign whose oracle is `Dying`."""
    driver = new_books(20)
    assert driver.store is not None
    driver.service = Dying(driver.store.blobs)
    return driver


@pytest.mark.parametrize("seed", range(6))
def test_whatever_is_said_beside_the_policies_a_campaign_ends_as_its_journal_tells(seed: int) -> None:
    driver, met = new_books(20, shrink=bool(seed % 2), shrink_flights_max=5), set()
    driver.service = Odd(driver, seed)
    while not driver.books.ended:
        for stage in STAGES:
            for worker in ("a", "b"):
                for lease in driver.ask(stage, worker, 2):
                    met.add(driver.report(lease, driver.service.do(lease.work), worker).status)
        driver.now += 0.5
        driver.books.tick(driver.now)
        assert driver.now < 2_000.0, "finds wait for ever"
    assert met == {"accepted", "refused"}
    assert isinstance(driver.store, MemoryStore)
    again = driver.store.empty_books()
    for line in driver.store.lines:
        again.replay(line)
    again.drain()
    assert again.snapshot() == driver.books.snapshot()


def test_a_judgement_tells_a_death_once() -> None:
    driver = new_books(20)
    (lease,) = driver.wait_for("judge", "a", -1)
    result = driver.service.do(lease.work)
    assert isinstance(result, JudgeResult)
    receipt = driver.report(lease, beside(result.judgement, died("one way"), died("another way")))
    assert receipt.status == "refused"
    assert "policies" in receipt.message


def test_finds_of_two_policies_in_the_same_words_are_two_behaviours() -> None:
    driver = dying()
    driver.run()
    for behaviour in driver.books._reducer.behaviours._known.values():
        others = driver.books._reducer.behaviours._by_words[behaviour.words]
        assert sorted(one.policy for one in others) == [AUTOPILOT_ALIVE, doubles.POLICY]


def test_a_run_whose_journal_takes_finds_of_two_policies_for_one_behaviour_goes_on() -> None:
    """Earlier versions did take them so, and died when the first of them was confirmed."""
    driver = dying()
    while not driver.books._reducer.behaviours._known:
        for stage in STAGES:
            driver.do(stage)
    assert isinstance(driver.store, MemoryStore)
    driver.store.lines = [_as_one(line) for line in driver.store.lines]
    resumed = Driver(driver.store.rebuild(), driver.store)
    (one,) = resumed.books._reducer.behaviours._known.values()
    assert one.policy == AUTOPILOT_ALIVE, "the worse of the two was the first"
    resumed.run()
    assert resumed.books.status(resumed.now).violations_confirmed


class Twice(doubles.Service):
    """Judges a policy as often as the campaign names it."""

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        result = super().do(work)
        return beside(result.judgement, *result.judgement.verdicts) if isinstance(result, JudgeResult) else result


def test_a_run_whose_campaign_names_a_policy_twice_goes_on_where_a_find_is_not_confirmed() -> None:
    """Earlier versions took such campaigns."""
    campaign = msgspec.structs.replace(
        doubles.campaign(60, flights_per_round=8, rng_seed=2), policies=(doubles.POLICY,) * 2
    )
    store = MemoryStore(campaign, doubles.TEMPLATE, doubles.TARGET)
    driver = Driver(store.rebuild(), cast(Store, store))
    driver.service = Twice(store.blobs)
    driver.run()
    status = driver.books.status(driver.now)
    assert status.violations_flaky
    assert status.violations_confirmed


def _as_one(data: bytes) -> bytes:
    """Return a line of a journal with all finds of each test case told as one behaviour."""
    line = decode_line(data)
    placed = (
        Placed(one.test_case, dict.fromkeys(one.behaviours, one.behaviours[AUTOPILOT_ALIVE])) for one in line.placed
    )
    return encode_line(msgspec.structs.replace(line, placed=tuple(placed)))
