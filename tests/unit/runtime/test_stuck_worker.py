"""Work that goes on though it was taken back: its thread cannot be ended, its process can."""

from __future__ import annotations

from saflite.contract.join import Joined
from saflite.contract.work import Grant, HandedBack, Lease, Orders, WarmResult, WarmWork
from saflite.runtime import worker as w
from saflite.runtime.worker import Key, Worker, WorkerConfig


def _lease(name: str, overdue_s: float = 0.0) -> Lease:
    return Lease(lease_id=name, epoch=1, lease_s=2.0, work=WarmWork(model=name), overdue_s=overdue_s)


def _worker(parallel: int = 1) -> Worker:
    worker = Worker(WorkerConfig("score-1", "score", parallel), 0.0)
    worker.handle(w.Tick(), 0.0)
    worker.handle(w.Answered(Joined(accepted=True, worker="score-1", session="life")), 0.0)
    return worker


def test_who_cannot_end_what_was_taken_back_leaves_and_hands_back_the_rest() -> None:
    worker = _worker(parallel=2)
    worker.handle(w.Granted(Grant(leases=(_lease("hangs"), _lease("other")))), 0.0)
    worker.handle(w.Ordered(Orders(cancel=("hangs",))), 1.0)
    worker.handle(w.Tick(), 1.0 + w.STUCK_S - 0.1)
    assert not worker.stopping
    worker.handle(w.Tick(), 1.0 + w.STUCK_S)
    assert "goes on" in worker.stopping
    out = [one for tick in range(60) for one in worker.handle(w.Tick(), 1.0 + w.STUCK_S + 0.1 * tick)]
    reports = {one.report.lease_id: one.report.result for one in out if isinstance(one, w.SendReport)}
    assert isinstance(reports["other"], HandedBack)
    assert [one.left_for for one in out if isinstance(one, w.Leave)] == ["stuck"]


def test_what_had_all_the_time_of_its_lease_is_waited_for_no_longer_than_an_order_to_stop_is() -> None:
    worker = _worker()
    worker.handle(w.Granted(Grant(leases=(_lease("hangs", overdue_s=500.0),))), 0.0)
    worker.handle(w.Ordered(Orders(cancel=("hangs",))), 499.0)  # granted a little earlier than it arrived
    worker.handle(w.Tick(), 500.0 + w.STOP_GRACE_S - 0.1)
    assert not worker.stopping
    assert worker.next_s() <= 500.0 + w.STOP_GRACE_S
    worker.handle(w.Tick(), 500.0 + w.STOP_GRACE_S)
    assert "goes on" in worker.stopping


def test_what_ends_late_after_it_was_taken_back_makes_nobody_leave() -> None:
    worker = _worker()
    worker.handle(w.Granted(Grant(leases=(_lease("slow"),))), 0.0)
    worker.handle(w.Ordered(Orders(cancel=("slow",))), 1.0)
    worker.handle(w.Done(Key("slow", 1), WarmResult(model="slow", ready=True)), w.STUCK_S)
    worker.handle(w.Tick(), 2.0 * w.STUCK_S)
    assert not worker.stopping
