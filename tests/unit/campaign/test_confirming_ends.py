"""A re-flight is flown until what it is flown for has been seen, no longer; every other flight to its end."""

from __future__ import annotations

from typing import Literal

import msgspec
from books_drive import Driver, MemoryStore, doubles, new_books

from saflite.campaign.lifecycle.confirmation import LATER_S
from saflite.contract.blobs import Blobs
from saflite.contract.flight import Purpose
from saflite.contract.target_info import Repeats
from saflite.contract.work import FlyWork, JudgeResult, JudgeWork, Result, Work

WITNESS_S = 41.0
LIMIT_S = 500.0


class _Service(doubles.Service):
    """Remembers until when each flight is asked for; says of every violation when it was seen."""

    def __init__(self, blobs: Blobs, witness_to_s: float, severity: Literal["soft", "hard"]) -> None:
        super().__init__(blobs)
        self.witness_to_s, self.severity = witness_to_s, severity
        self.asked: list[tuple[Purpose, int, float | None]] = []

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        if isinstance(work, FlyWork):
            self.asked.append((work.purpose, work.flight_index, work.until_s))
        result = super().do(work)
        if not (isinstance(work, JudgeWork) and isinstance(result, JudgeResult)):
            return result
        judgement = result.judgement
        when = {"witness_to_s": self.witness_to_s, "severity": self.severity}
        seen = [msgspec.structs.replace(one, **when) for one in judgement.verdicts]
        return JudgeResult(judgement=msgspec.structs.replace(judgement, verdicts=tuple(seen)))


def _asked(
    witness_to_s: float, severity: Literal["soft", "hard"] = "soft", repeats: Repeats = "bitwise"
) -> tuple[Driver, _Service]:
    driver = new_books(30, shrink=True, repeats=repeats)
    assert driver.store is not None
    service = driver.service = _Service(driver.store.blobs, witness_to_s, severity)
    driver.run()
    return driver, service


def test_re_flights_end_half_a_minute_after_the_first_flight_had_shown_it() -> None:
    _, service = _asked(WITNESS_S)
    untils = {
        purpose: {until_s for one, index, until_s in service.asked if one == purpose}
        for purpose in ("search", "check", "shrink", "confirm")
    }
    assert untils == {"search": {None}, "check": {None}, "shrink": {None}, "confirm": {WITNESS_S + LATER_S}}
    shrunk = {index: until_s for one, index, until_s in service.asked if one == "shrunk"}
    assert shrunk[0] is None, "the flight that shows the smallest form is recorded whole"


def test_one_that_could_show_it_up_to_the_time_limit_is_flown_whole() -> None:
    driver, service = _asked(LIMIT_S - LATER_S)
    assert {until_s for one, _, until_s in service.asked if one == "confirm"} == {None}
    assert driver.books.status(driver.now).flights == 30


def test_one_that_was_hard_is_flown_on_past_the_end_of_the_first_flight() -> None:
    driver, service = _asked(1.0, "hard")
    assert isinstance(driver.store, MemoryStore)
    ends = {until_s for one, _, until_s in service.asked if one == "confirm"}
    assert None not in ends
    assert min(float(until_s or 0.0) for until_s in ends) > 1.0 + LATER_S, "it may be hard for how it ended"


def test_where_flights_differ_by_nature_all_are_flown_whole() -> None:
    _, service = _asked(WITNESS_S, repeats="statistically")
    assert {until_s for one, _, until_s in service.asked if one == "confirm"} == {None}
