"""A re-flight is flown until what it is flown for has been seen, no longer; every other flight to its end."""

from __future__ import annotations

import msgspec
from books_drive import Driver, doubles, new_books

from saflite.campaign.lifecycle.confirmation import LATER_S
from saflite.contract.blobs import Blobs
from saflite.contract.flight import Purpose
from saflite.contract.work import FlyWork, JudgeResult, JudgeWork, Result, Work

WITNESS_S = 41.0
LIMIT_S = 500.0


class _Service(doubles.Service):
    """Remembers until when each flight is asked for; says of every violation when it was seen."""

    def __init__(self, blobs: Blobs, witness_to_s: float) -> None:
        super().__init__(blobs)
        self.witness_to_s = witness_to_s
        self.asked: list[tuple[Purpose, int, float | None]] = []

    def do(self, work: Work) -> Result:
        """See `Service.do`."""
        if isinstance(work, FlyWork):
            self.asked.append((work.purpose, work.flight_index, work.until_s))
        result = super().do(work)
        if not (isinstance(work, JudgeWork) and isinstance(result, JudgeResult)):
            return result
        judgement = result.judgement
        seen = [msgspec.structs.replace(one, witness_to_s=self.witness_to_s) for one in judgement.verdicts]
        return JudgeResult(judgement=msgspec.structs.replace(judgement, verdicts=tuple(seen)))


def _asked(witness_to_s: float) -> tuple[Driver, _Service]:
    driver = new_books(30, shrink=True, repeats="bitwise")
    assert driver.store is not None
    service = driver.service = _Service(driver.store.blobs, witness_to_s)
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
