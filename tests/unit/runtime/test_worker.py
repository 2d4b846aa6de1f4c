"""The worker's state machine, driven by hand and by a seeded books double that loses and doubles answers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from saflite.contract.join import Joined
from saflite.contract.rng import derive
from saflite.contract.work import (
    BEATS_PER_LEASE,
    Failure,
    Grant,
    HandedBack,
    Lease,
    Orders,
    Receipt,
    Report,
    WarmResult,
    WarmWork,
)
from saflite.runtime import worker as w
from saflite.runtime.pending import REFUSALS_MAX
from saflite.runtime.worker import Key, Worker, WorkerConfig


def _lease(name: str, epoch: int = 1, lease_s: float = 2.0) -> Lease:
    return Lease(lease_id=name, epoch=epoch, lease_s=lease_s, work=WarmWork(model=name))


def _done(name: str) -> w.Done:
    return w.Done(Key(name, 1), WarmResult(model=name, ready=True))


def _of(kind: type, instructions: list[w.Instruction]) -> list[w.Instruction]:
    return [instruction for instruction in instructions if isinstance(instruction, kind)]


IN = w.Answered(Joined(accepted=True, worker="fly-1", session="life"))


def _worker(parallel: int = 1, prefetch: int = 1) -> Worker:
    worker = Worker(WorkerConfig("fly-1", "fly", parallel, prefetch), 0.0)
    worker.handle(w.Tick(), 0.0)
    worker.handle(IN, 0.0)
    return worker


def test_first_joins_and_asks_and_beats_only_once_it_is_in() -> None:
    worker = Worker(WorkerConfig("fly-1", "fly"), 0.0)
    assert [type(instruction) for instruction in worker.handle(w.Tick(), 0.0)] == [w.SendJoin]
    assert worker.handle(w.Tick(), 1.0) == []
    out = worker.handle(IN, 1.0)
    (ask,), (beat,) = _of(w.SendAsk, out), _of(w.SendBeat, out)
    assert isinstance(ask, w.SendAsk)
    assert isinstance(beat, w.SendBeat)
    assert ask.ask.session == beat.beat.session == "life"


def test_joining_is_tried_until_somebody_answers() -> None:
    worker, now_s, tries = Worker(WorkerConfig("fly-1", "fly"), 0.0), 0.0, 0
    while tries < 20:
        tries += len(_of(w.SendJoin, worker.handle(w.Tick(), now_s)))
        assert _of(w.SendAsk, worker.handle(w.Answered(None), now_s)) == []
        now_s = worker.next_s()
    assert 20.0 < now_s < 20 * 2.1


def test_a_refused_worker_leaves_and_says_why() -> None:
    worker = Worker(WorkerConfig("fly-1", "fly"), 0.0)
    worker.handle(w.Tick(), 0.0)
    out = worker.handle(w.Answered(Joined(accepted=False, message="protocol: expected 2, got 3")), 0.1)
    assert out == [w.Leave("protocol: expected 2, got 3", "refused")]


@pytest.mark.parametrize("by", ["grant", "orders"])
def test_whom_the_books_do_not_know_any_more_joins_again_and_goes_on_with_its_work(by: str) -> None:
    worker = _worker()
    worker.handle(w.Ordered(Orders()), 0.05)
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    lost = w.Granted(Grant(refused="who?")) if by == "grant" else w.Ordered(Orders(refused="who?"))
    out = worker.handle(lost, 1.0)
    assert len(_of(w.SendJoin, out)) == 1
    assert not _of(w.Cancel, out)
    assert not worker.is_in
    assert _of(w.SendBeat, worker.handle(w.Tick(), 1.5)) == []
    (beat,) = _of(w.SendBeat, worker.handle(IN, 1.6))
    assert isinstance(beat, w.SendBeat)
    assert beat.beat.leases == (("a", 1),)
    assert _of(w.SendReport, worker.handle(_done("a"), 2.0))


def test_with_a_patience_it_leaves_once_nobody_has_answered_for_so_long() -> None:
    worker = Worker(WorkerConfig("fly-1", "fly", patience_s=30.0), 0.0)
    now_s, out = 0.0, worker.handle(w.Tick(), 0.0)
    while not _of(w.Leave, out):
        assert now_s <= 30.0
        worker.handle(w.Answered(None), now_s)
        now_s = worker.next_s()
        out = worker.handle(w.Tick(), now_s)
    assert now_s == 30.0
    assert _of(w.Leave, out) == [w.Leave("nobody has answered for 30 s", "unanswered")]


def test_any_answer_renews_the_patience() -> None:
    worker = Worker(WorkerConfig("fly-1", "fly", patience_s=5.0), 0.0)
    worker.handle(w.Tick(), 0.0)
    worker.handle(IN, 4.0)
    assert not _of(w.Leave, worker.handle(w.Tick(), 8.0))
    worker.handle(w.Ordered(Orders()), 8.5)
    assert not _of(w.Leave, worker.handle(w.Tick(), 13.0))
    assert _of(w.Leave, worker.handle(w.Tick(), 13.6))


def test_whom_nobody_answers_connects_anew_ever_less_often() -> None:
    worker, now_s, renewed = _worker(), 0.0, []
    while now_s < 1_000.0:
        now_s = min(worker.next_s(), now_s + 1.0)
        out = worker.handle(w.Tick(), now_s)
        if _of(w.SendBeat, out):
            worker.handle(w.Ordered(None), now_s)
        if _of(w.Renew, out):
            renewed.append(round(now_s))
    pauses_s = [after - before for before, after in pairwise([0, *renewed])]
    assert 20 <= pauses_s[0] <= 40
    assert [round(pause_s / pauses_s[0]) for pause_s in pauses_s] == [1, 2, 4, 8, 16][: len(pauses_s)]
    worker.handle(w.Ordered(Orders()), now_s)
    assert not _of(w.Renew, [*worker.handle(w.Tick(), now_s + 4.0), *worker.handle(w.Tick(), now_s + 8.0)])


def test_who_stood_still_listens_before_it_connects_anew() -> None:
    worker = _worker()
    assert not _of(w.Renew, worker.handle(w.Tick(), 60.0))
    for now_s in range(61, 80):
        assert not _of(w.Renew, worker.handle(w.Tick(), float(now_s)))
    assert _of(w.Renew, [out for now_s in range(80, 101) for out in worker.handle(w.Tick(), float(now_s))])


def test_an_idle_worker_asks_for_one_lease_and_for_the_next_while_busy() -> None:
    worker = Worker(WorkerConfig("fly-1", "fly", 1, 1), 0.0)
    worker.handle(w.Tick(), 0.0)
    (ask,) = _of(w.SendAsk, worker.handle(IN, 0.0))
    assert isinstance(ask, w.SendAsk)
    assert ask.ask.leases_max == 1
    out = worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    assert [type(instruction) for instruction in out if not isinstance(instruction, w.SendBeat)] == [w.Begin, w.SendAsk]
    out = worker.handle(w.Granted(Grant(leases=(_lease("b"),))), 0.2)
    assert not _of(w.SendAsk, out)
    assert not _of(w.Begin, out)


def test_a_result_is_kept_before_it_is_sent_and_forgotten_after_its_receipt() -> None:
    worker = _worker()
    worker.handle(w.Granted(Grant(leases=(_lease("a"), _lease("b")))), 0.1)
    out = worker.handle(_done("a"), 1.0)
    assert [type(instruction) for instruction in out][:3] == [w.Keep, w.Begin, w.SendReport]
    assert Key("a", 1) in worker.held
    out = worker.handle(w.Received(Key("a", 1), Receipt(lease_id="a", epoch=1, status="accepted")), 1.1)
    assert out[0] == w.Forget(Key("a", 1))
    assert Key("a", 1) not in worker.held


def test_an_unacknowledged_result_is_sent_again_until_a_receipt_comes() -> None:
    worker = _worker()
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    worker.handle(_done("a"), 1.0)
    now_s, sent = 1.0, 0
    for _ in range(20):
        worker.handle(w.Received(Key("a", 1), None), now_s)
        now_s += w.RETRY_MAX_S
        sent += len(_of(w.SendReport, worker.handle(w.Tick(), now_s)))
    assert sent == 20


def test_a_result_the_books_cannot_read_is_dropped_in_the_end() -> None:
    worker = _worker()
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    worker.handle(_done("a"), 1.0)
    out: list[w.Instruction] = []
    for turn in range(REFUSALS_MAX):
        worker.handle(w.Tick(), 10.0 + turn * 10)
        out = worker.handle(w.Received(Key("a", 1), None, refused=True), 15.0 + turn * 10)
    assert _of(w.Forget, out)


def test_beats_name_every_lease_held_five_times_per_lease_time() -> None:
    worker = _worker()
    worker.handle(w.Ordered(Orders()), 0.05)
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    assert worker.next_s() <= 0.1 + 2.0 / BEATS_PER_LEASE + 1e-9
    (beat,) = _of(w.SendBeat, worker.handle(w.Tick(), 0.51))
    assert isinstance(beat, w.SendBeat)
    assert beat.beat.leases == (("a", 1),)


def test_in_a_crowd_heartbeats_come_as_seldom_as_the_books_say_and_few_unanswered_ones_are_no_silence() -> None:
    worker = _worker()
    worker.handle(w.Tick(), 0.02)
    worker.handle(w.Ordered(Orders(beat_s=10.0)), 0.05)
    worker.handle(w.Granted(Grant(leases=(_lease("a", lease_s=50.0),))), 0.1)
    beats, renewals = list[float](), list[float]()
    for tenth in range(2, 1500):
        out = worker.handle(w.Tick(), tenth / 10)
        beats += [tenth / 10] * len(_of(w.SendBeat, out))
        renewals += [tenth / 10] * len(_of(w.Renew, out))
        if _of(w.SendBeat, out) and len(beats) < 3:
            worker.handle(w.Ordered(Orders(beat_s=10.0)), tenth / 10)
        elif _of(w.SendBeat, out):
            worker.handle(w.Ordered(None), tenth / 10 + 0.05)
    assert np.allclose(np.diff(beats), 10.0, atol=0.2)
    assert renewals[0] >= beats[1] + 4 * 10.0


def test_a_cancelled_lease_is_dropped_without_a_report() -> None:
    worker = _worker()
    worker.handle(w.Granted(Grant(leases=(_lease("a"), _lease("b")))), 0.1)
    out = worker.handle(w.Ordered(Orders(cancel=("a", "b"))), 0.2)
    assert out[0] == w.Cancel(Key("a", 1))
    out = worker.handle(w.Done(Key("a", 1), Failure(message="cancelled")), 0.3)
    assert not _of(w.SendReport, out)
    assert not _of(w.Begin, out)
    assert worker.held == ()


def test_stopping_hands_every_lease_back_and_leaves_once_all_is_acknowledged() -> None:
    worker = _worker()
    worker.handle(w.Granted(Grant(leases=(_lease("a"), _lease("b")))), 0.1)
    out = worker.handle(w.StopAsked("signal SIGTERM"), 0.2)
    assert _of(w.Cancel, out) == [w.Cancel(Key("a", 1))]
    (report,) = _of(w.SendReport, out)
    assert isinstance(report, w.SendReport)
    assert isinstance(report.report.result, HandedBack)
    out = worker.handle(w.Done(Key("a", 1), Failure(message="cancelled")), 0.3)
    (report,) = _of(w.SendReport, out)
    assert isinstance(report, w.SendReport)
    assert isinstance(report.report.result, HandedBack)
    for name in "ab":
        out = worker.handle(w.Received(Key(name, 1), Receipt(lease_id=name, epoch=1, status="accepted")), 0.4)
    assert _of(w.Leave, out)


def test_stopping_hands_back_what_goes_on_though_it_was_told_to_end() -> None:
    """A call into a library, a machine that swaps: counted as lost, and three losses set a test case aside."""
    worker = _worker(parallel=2)
    worker.handle(w.Granted(Grant(leases=(_lease("a"), _lease("b")))), 0.1)
    worker.handle(w.StopAsked("signal SIGTERM"), 0.2)
    assert not _of(w.SendReport, worker.handle(w.Tick(), 1.0)), "there is still time to end"
    out = worker.handle(w.Tick(), 0.2 + w.STOP_GRACE_S - w.LAST_ANSWERS_S)
    reports = [send.report for send in _of(w.SendReport, out) if isinstance(send, w.SendReport)]
    assert [(report.lease_id, type(report.result)) for report in reports] == [("a", HandedBack), ("b", HandedBack)]
    worker.validate()
    assert not _of(w.SendReport, worker.handle(_done("a"), 3.5)), "it ended after all"
    for name in "ab":
        assert not _of(w.Leave, out)
        out = worker.handle(w.Received(Key(name, 1), Receipt(lease_id=name, epoch=1, status="accepted")), 3.6)
    assert _of(w.Leave, out)


def test_a_stopping_worker_leaves_in_the_end_though_nobody_answers() -> None:
    worker = _worker()
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    worker.handle(w.StopAsked("signal SIGTERM"), 0.2)
    assert _of(w.Leave, worker.handle(w.Tick(), worker.next_s() + w.STOP_GRACE_S))


def test_a_lease_granted_while_stopping_is_handed_back() -> None:
    worker = _worker()
    worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 0.1)
    worker.handle(w.StopAsked("signal SIGTERM"), 0.2)
    out = worker.handle(w.Granted(Grant(leases=(_lease("late"),))), 0.3)
    assert [report.report.lease_id for report in _of(w.SendReport, out) if isinstance(report, w.SendReport)] == ["late"]
    assert not _of(w.Begin, out)


def test_too_many_undelivered_results_stop_the_asking() -> None:
    worker = Worker(WorkerConfig("fly-1", "fly", 1, 0), 0.0)
    worker._joining.session = "life"
    for number in range(w.REPORTS_WAITING_MAX + 1):
        report = Report(worker="fly-1", lease_id=str(number), epoch=1, result=Failure(message=""))
        worker.handle(w.Found(report), 0.0)
    worker._asking = False
    assert not _of(w.SendAsk, worker.handle(w.Tick(), 1.0))


def test_books_that_grant_without_end_fill_no_memory() -> None:
    """Each receipt brought a thousand leases more, and all were kept: those beyond all that was asked are let go."""
    worker = _worker()
    for turn in range(50):
        grant = Grant(leases=tuple(_lease(f"{turn}-{number}") for number in range(1000)))
        worker.handle(w.Granted(grant), 0.1)
        (key,) = worker._running
        worker.handle(w.Done(key, WarmResult(model="", ready=True)), 0.2)
        worker.handle(w.Received(key, Receipt(lease_id=key.lease_id, epoch=1, status="accepted", grant=grant)), 0.2)
        assert len(worker.held) <= 2 * w.GRANTS_MAX + 1


@pytest.mark.parametrize("rng_seed", range(200))
def test_against_a_books_double_that_loses_answers(rng_seed: int) -> None:
    """Every lease the worker began is reported and acknowledged in the end; the state never contradicts itself."""
    rng = derive(rng_seed, "worker-test")
    worker = Worker(WorkerConfig("w", "score", parallel=2, prefetch=1), 0.0)
    now_s, made, begun, acknowledged = 0.0, 0, set[Key](), set[Key]()
    pending: list[w.Instruction] = []
    for turn in range(600):
        now_s = max(now_s + float(rng.random()) * 0.2, min(worker.next_s(), now_s + 0.3))
        event: w.Event = w.Tick()
        if pending and rng.random() < 0.8:
            instruction = pending.pop(int(rng.integers(len(pending))))
            lost = bool(rng.random() < 0.3)
            if isinstance(instruction, w.SendJoin):
                event = w.Answered(None) if lost else IN
            elif rng.random() < 0.03 and isinstance(instruction, w.SendAsk | w.SendBeat):  # the books began anew
                asked = isinstance(instruction, w.SendAsk)
                event = w.Granted(Grant(refused="who?")) if asked else w.Ordered(Orders(refused="who?"))
            elif isinstance(instruction, w.SendAsk):
                leases = tuple(_lease(f"l{made + extra}") for extra in range(instruction.ask.leases_max))
                made += 0 if lost or turn > 400 else len(leases)
                event = w.Granted(None if lost else Grant(leases=() if turn > 400 else leases))
            elif isinstance(instruction, w.SendBeat):
                event = w.Ordered(None if lost else Orders())
            elif isinstance(instruction, w.Begin):
                event = _done(instruction.lease.lease_id)
            elif isinstance(instruction, w.SendReport):
                key = Key(instruction.report.lease_id, 1)
                question = instruction.report.ask
                leases = tuple(_lease(f"l{made + extra}") for extra in range(question.leases_max if question else 0))
                leases = () if turn > 400 or rng.random() < 0.3 else leases
                made += 0 if lost else len(leases)
                grant = Grant(leases=leases, retry_after_s=0.0) if question else None
                receipt = Receipt(lease_id=key.lease_id, epoch=1, status="accepted", grant=grant)
                acknowledged |= set() if lost else {key}
                event = w.Received(key, None if lost else receipt)
        for instruction in worker.handle(event, now_s):
            if isinstance(instruction, w.Begin):
                begun.add(Key(instruction.lease.lease_id, 1))
            if isinstance(instruction, w.SendJoin | w.SendAsk | w.SendBeat | w.SendReport | w.Begin):
                pending.append(instruction)
        worker.validate()
    assert begun
    assert begun == acknowledged
    assert worker.held == ()


def test_who_drains_asks_no_more_finishes_what_it_holds_and_leaves_once_it_is_acknowledged() -> None:
    worker = _worker()
    worker.handle(w.Ordered(Orders()), 0.05)
    worker.handle(w.Granted(Grant(leases=(_lease("a"), _lease("b")))), 0.1)
    out = worker.handle(w.DrainAsked(), 1.0)
    (beat,) = _of(w.SendBeat, out)
    assert isinstance(beat, w.SendBeat)
    assert (beat.beat.state, sorted(beat.beat.leases)) == ("draining", [("a", 1), ("b", 1)])
    assert not _of(w.Cancel, out)
    for name, now_s in (("a", 2.0), ("b", 3.0)):
        out = worker.handle(_done(name), now_s)
        assert _of(w.SendReport, out)
        assert not _of(w.SendAsk, out) + _of(w.Leave, out)
        receipt = Receipt(lease_id=name, epoch=1, status="accepted")
        out = worker.handle(w.Received(Key(name, 1), receipt), now_s + 0.1)
    assert _of(w.Leave, out) == [w.Leave(w.DRAINED)]


def test_who_drains_waits_for_the_answer_of_a_poll_under_way_and_does_what_it_brings() -> None:
    worker = _worker()
    assert not _of(w.Leave, worker.handle(w.DrainAsked(), 1.0))
    assert not _of(w.Leave, worker.handle(w.Tick(), 2.0))
    out = worker.handle(w.Granted(Grant(leases=(_lease("a"),))), 3.0)
    assert _of(w.Begin, out)
    assert not _of(w.SendAsk, out)
    worker.handle(_done("a"), 4.0)
    out = worker.handle(w.Received(Key("a", 1), Receipt(lease_id="a", epoch=1, status="accepted")), 4.1)
    assert _of(w.Leave, out)


@pytest.mark.parametrize("grant", [Grant(), None], ids=["nothing to do", "nobody answers"])
def test_who_drains_and_holds_nothing_leaves_when_its_poll_ends(grant: Grant | None) -> None:
    worker = _worker()
    worker.handle(w.DrainAsked(), 1.0)
    assert _of(w.Leave, worker.handle(w.Granted(grant), 5.0)) == [w.Leave(w.DRAINED)]


def test_who_has_not_been_let_in_leaves_at_once_when_it_drains() -> None:
    worker = Worker(WorkerConfig("fly-1", "fly"), 0.0)
    worker.handle(w.Tick(), 0.0)
    assert _of(w.Leave, worker.handle(w.DrainAsked(), 0.5)) == [w.Leave(w.DRAINED)]
