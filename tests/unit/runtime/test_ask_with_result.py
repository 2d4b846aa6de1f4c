"""A worker's next question for work travels with its result, and the receipt brings the answer."""

from __future__ import annotations

import msgspec
import pytest

from saflite.campaign.engine.state import NOT_JOINED
from saflite.contract import topics
from saflite.contract.work import Grant, HandedBack, Receipt, Report
from saflite.runtime import worker as w
from saflite.runtime.worker import Key

from .test_books_service import Stand, _ask, _mutated, stand
from .test_worker import _done, _lease, _of, _worker

__all__ = ["stand"]


def _reported(out: list[w.Instruction]) -> Report:
    (sent,) = _of(w.SendReport, out)
    assert isinstance(sent, w.SendReport)
    return sent.report


def test_the_next_question_goes_with_a_result_and_its_receipt_brings_work() -> None:
    worker = _worker(prefetch=0)
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    out = worker.handle(_done("a"), 1.0)
    ask = _reported(out).ask
    assert ask is not None
    assert (ask.leases_max, ask.session) == (1, "life")
    assert not _of(w.SendAsk, out)
    (kept,) = _of(w.Keep, out)
    assert isinstance(kept, w.Keep)
    assert kept.report.ask is None, "the question is of now, the result may be sent by a later life"
    receipt = Receipt(lease_id="a", epoch=1, status="accepted", grant=Grant(leases=(_lease("b"),)))
    out = worker.handle(w.Received(Key("a", 1), receipt), 1.1)
    assert _of(w.Begin, out) == [w.Begin(_lease("b"))]
    assert worker.held == (("b", 1),)


def test_who_is_given_nothing_with_a_receipt_asks_at_once_and_waits() -> None:
    worker = _worker(prefetch=0)
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    worker.handle(_done("a"), 1.0)
    receipt = Receipt(lease_id="a", epoch=1, status="accepted", grant=Grant(retry_after_s=0.0))
    assert _of(w.SendAsk, worker.handle(w.Received(Key("a", 1), receipt), 1.1))


def test_a_result_sent_again_goes_without_a_question_which_is_asked_beside_it() -> None:
    worker = _worker(prefetch=0)
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    worker.handle(_done("a"), 1.0)
    out = worker.handle(w.Received(Key("a", 1), None), 11.0)
    assert not _of(w.SendAsk, out)
    out = worker.handle(w.Tick(), 11.2)
    assert _reported(out).ask is None
    assert _of(w.SendAsk, out)
    receipt = Receipt(lease_id="a", epoch=1, status="accepted", grant=Grant(leases=(_lease("b"),)))
    assert _of(w.Begin, worker.handle(w.Received(Key("a", 1), receipt), 11.3)), "the answer to the first was late"


def test_a_late_answer_to_a_question_that_came_with_a_result_lets_no_second_one_go_out() -> None:
    worker = _worker(prefetch=0)
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    worker.handle(_done("a"), 1.0)
    worker.handle(w.Received(Key("a", 1), None), 11.0)
    assert _of(w.SendAsk, worker.handle(w.Tick(), 11.2)), "asked beside the result that is sent again"
    receipt = Receipt(lease_id="a", epoch=1, status="accepted", grant=Grant(retry_after_s=0.0))
    assert not _of(w.SendAsk, worker.handle(w.Received(Key("a", 1), receipt), 11.3))
    assert not _of(w.SendAsk, worker.handle(w.Tick(), 12.0)), "one question is under way"
    assert _of(w.SendAsk, worker.handle(w.Granted(Grant(retry_after_s=0.0)), 21.0))


def test_a_question_that_comes_with_a_result_is_answered_with_its_receipt(stand: Stand) -> None:
    report = msgspec.structs.replace(_mutated(stand), ask=_ask("mutate"))
    stand.send(topics.result("c", "mutate"), report)
    receipt = stand.last(Receipt)
    assert (receipt.status, receipt.grant) == ("accepted", Grant(retry_after_s=0.0)), "nobody waits with a result"
    stand.send(topics.result("c", "mutate"), msgspec.structs.replace(report, ask=_ask("mutate", session="other")))
    receipt = stand.last(Receipt)
    assert receipt.grant is not None
    assert (receipt.status, receipt.grant.refused) == ("duplicate", NOT_JOINED)


@pytest.mark.parametrize("ask", [("score", "w"), ("mutate", "other")])
def test_a_question_of_somebody_else_makes_a_result_unreadable(stand: Stand, ask: tuple[str, str]) -> None:
    report = msgspec.structs.replace(_mutated(stand), ask=_ask(ask[0], worker=ask[1]))
    stand.send(topics.result("c", "mutate"), report)
    receipt = stand.last(Receipt)
    assert receipt.status == "refused"
    assert "as the result it came with" in receipt.message


def test_work_comes_with_the_receipt_of_a_result(stand: Stand) -> None:
    stand.send(topics.result("c", "mutate"), _mutated(stand))
    stand.send(topics.work("c", "score"), _ask("score"))
    (lease,) = stand.last(Grant).leases
    back = Report(worker="w", lease_id=lease.lease_id, epoch=1, result=HandedBack(), ask=_ask("score"))
    stand.send(topics.result("c", "score"), back)
    grant = stand.last(Receipt).grant
    assert grant is not None
    assert [(one.lease_id, one.epoch) for one in grant.leases] == [(lease.lease_id, 2)]
