"""Judgements that an oracle of ours would never give, but that a peer may: the books take or refuse them, and go on."""

from __future__ import annotations

import msgspec
from books_drive import Driver, MemoryStore, doubles, new_books

from saflite.campaign.engine.journal import Placed, decode_line, encode_line
from saflite.contract.flight import AUTOPILOT_ALIVE
from saflite.contract.verdict import Judgement, Verdict
from saflite.contract.work import JudgeResult, Result, Stage, Work

STAGES: tuple[Stage, ...] = ("mutate", "score", "fly", "judge", "record")


def died(words: str, robustness: float = -9.0) -> Verdict:
    """Return a verdict that may stand in any judgement, beside those on the policies of the campaign."""
    return Verdict(policy=AUTOPILOT_ALIVE, outcome="violated", robustness=robustness, severity="hard", behaviour=words)


def beside(judgement: Judgement, *more: Verdict) -> JudgeResult:
    """Return a result with more verdicts than the judgement has."""
    return JudgeResult(judgement=msgspec.structs.replace(judgement, verdicts=(*judgement.verdicts, *more)))


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


def _as_one(data: bytes) -> bytes:
    """Return a line of a journal with all finds of each test case told as one behaviour."""
    line = decode_line(data)
    placed = (
        Placed(one.test_case, dict.fromkeys(one.behaviours, one.behaviours[AUTOPILOT_ALIVE])) for one in line.placed
    )
    return encode_line(msgspec.structs.replace(line, placed=tuple(placed)))
