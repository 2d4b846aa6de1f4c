"""Finds of one behaviour: the first is confirmed and stands for all, whatever comes back first."""

from __future__ import annotations

from collections import Counter

import msgspec
from books_drive import Driver, MemoryStore, doubles, new_books

from saflite.campaign.engine.journal import Placed, decode_line, encode_line
from saflite.contract.events import ViolationFound
from saflite.contract.verdict import Violation
from saflite.contract.work import JudgeResult, JudgeWork, Result, Work


def found(driver: Driver) -> list[Violation]:
    """Return all that was decided upon."""
    assert isinstance(driver.store, MemoryStore)
    return [event.fact.violation for event in driver.store.all_events if isinstance(event.fact, ViolationFound)]


def test_only_the_first_find_of_a_behaviour_is_flown_again() -> None:
    driver = new_books(80, flights_per_round=8)
    driver.run()
    status, told = driver.books.status(driver.now), found(driver)
    by = Counter(one.confirmation for one in told)
    assert by["similar"] == status.violations_similar > by["confirmed"] == status.violations_confirmed
    assert status.behaviours == len({one.fingerprint for one in told if one.confirmation == "confirmed"})
    assert 1 < status.behaviours <= doubles.WAYS
    firm = {one.test_case: one for one in told if one.confirmation == "confirmed"}
    for one in told:
        if one.confirmation == "similar":
            assert firm[one.representative].behaviour == one.behaviour
            assert firm[one.representative].fingerprint == one.fingerprint
            assert one.rate_low is None
    assert status.reflown == sum(one.reflown for one in told)
    assert {one.reflown for one in firm.values()} == {2}, "two of three are needed, and the first two violated"


def test_outcomes_tell_which_find_was_the_first_of_its_behaviour() -> None:
    driver = new_books(80, flights_per_round=8, lag=1)
    driver.run()
    core = driver.books._core
    outcomes = [outcome for round_ in core.rounds.recent for outcome in round_.told()]
    assert any(outcome.behaviours for outcome in outcomes)
    assert all(bool(outcome.behaviours) == bool(outcome.violated) for outcome in outcomes)


class Tracked(doubles.Service):
    """Every test case violates in one and the same words, on one of two tracks, or given one input more."""

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        result = super().do(work)
        if not isinstance(work, JudgeWork):
            return result
        assert isinstance(result, JudgeResult)
        judgement, off_m = result.judgement, 20.0 * (int(result.judgement.test_case, 16) % 2)
        (verdict,) = judgement.verdicts
        if verdict.outcome != "violated":
            return result
        track = tuple((float(t), 2.0 * t, off_m if 10 < t < 20 else 0.0, 10.0) for t in range(30))
        bad = msgspec.structs.replace(verdict, behaviour="one way")
        return JudgeResult(judgement=msgspec.structs.replace(judgement, verdicts=(bad,), track=track))


def test_tracks_of_another_shape_are_another_behaviour() -> None:
    driver = new_books(60, flights_per_round=8)
    assert driver.store is not None
    driver.service = Tracked(driver.store.blobs)
    driver.run()
    firm = [one for one in found(driver) if one.confirmation == "confirmed"]
    assert {one.behaviour for one in firm} == {"one way"}
    assert driver.books.status(driver.now).behaviours == len({one.fingerprint for one in firm}) == 2


def test_a_replay_takes_what_a_find_is_from_the_journal_and_works_it_out_only_where_that_does_not_say() -> None:
    driver = new_books(40, flights_per_round=8)
    assert isinstance(driver.store, MemoryStore)
    driver.service = Tracked(driver.store.blobs)
    driver.run()
    lines = [decode_line(line) for line in driver.store.lines]
    names = {name for line in lines for one in line.placed for name in one.behaviours.values()}
    assert names == {one.fingerprint for one in found(driver)}

    said = [msgspec.structs.replace(line, placed=tuple(map(otherwise, line.placed))) for line in lines]
    again = driver.store.empty_books()
    for line in said:
        again.replay(encode_line(line))
    assert set(again._reducer.behaviours.representatives) == {f"other {name}" for name in names}

    older = driver.store.empty_books()
    for line in lines:
        older.replay(encode_line(msgspec.structs.replace(line, placed=())))
    assert older.snapshot() == driver.books.snapshot()


def otherwise(placed: Placed) -> Placed:
    """Call the behaviours of a test case's finds by other names."""
    return Placed(placed.test_case, {policy: f"other {name}" for policy, name in placed.behaviours.items()})
